/* scenes - the scenes of examples/scenes for some time each, at their sliders' defaults: what a step takes of a processor,
 * and whether they survive.
 *
 * A scene survives if all of its nodes stay within 100 m, and it makes at most 1 % of the energy that its bodies have had:
 * their energy budgets (sfem_body_fracture), less the work of contacts, which these do not contain.
 *
 *     scenes [--seconds S, 5] [--scene NAME] [--quick]
 *
 * --seconds   of the scene's own time, at most 1000 steps
 * --quick     1 s of small bodies
 * Status 1 if a scene does not survive. */
#include "../examples/support.h"
#include "bench.h"
#include "../examples/scenes/all.h"

enum { MOST = 1000 }; /* steps */

static int stays(sc_world *w)
{
    sfem_int i;
    int k;
    for (k = 0; k < w->items; ++k) {
        sc_positions(w, k, w->x);
        for (i = 0; i < 3 * w->mesh.nodes; ++i)
            if (!(fabs(w->x[i]) < 100)) return 0;
    }
    return 1;
}

static int measure(const sc_scene *scene, double seconds, int small)
{
    double values[SC_SLIDERS], *time, made = 0, sum = 0;
    sfem_error err;
    sc_measure m;
    sc_world *w;
    int k, steps, survives = 1;
    for (k = 0; k < SC_SLIDERS; ++k) values[k] = scene->slider[k].value;
    k = sc_slider_of(scene, "tets");
    if (small && k >= 0) values[k] = scene->slider[k].low;
    w = sc_open(scene, values, &err);
    if (!w) ex_fail("%s", err.text);
    steps = (int)fmin(MOST, ceil(seconds / sc_step_length(w)));
    time = (double *)malloc((size_t)steps * sizeof *time);
    for (k = 0; k < steps && survives; ++k) {
        const double t = bench_seconds();
        bench_must(sc_step(w, &err), &err);
        time[k] = bench_seconds() - t;
        sum += time[k];
        if (k > 2) made = fmax(made, sc_energy_made(w)); /* what starts with a jerk has little energy yet */
        survives = stays(w) && made <= 0.01;
    }
    m = sc_measure_all(w);
    qsort(time, (size_t)k, sizeof *time, bench_compare);
    printf("%-9s %6d %5d %8.2f %8.2f %8.2f %8.4f %6.0f %6.0f %6.0f  %s\n", scene->name, (int)(w->mesh.tets * w->items), k,
           1e3 * sum / k, 1e3 * time[k / 2], 1e3 * time[k - 1], made, m.rejected, m.contacts, m.pieces,
           survives ? "" : "FAILED");
    fflush(stdout);
    free(time);
    sc_close(w);
    return survives;
}

int main(int argc, char **argv)
{
    const char *only = NULL;
    double seconds = 5;
    int i, small = 0, survive = 1, found = 0;
    for (i = 1; i < argc; ++i) {
        if (!strcmp(argv[i], "--quick")) seconds = 1, small = 1;
        else if (!strcmp(argv[i], "--seconds") && i + 1 < argc) seconds = atof(argv[++i]);
        else if (!strcmp(argv[i], "--scene") && i + 1 < argc) only = argv[++i];
        else ex_fail("usage: scenes [--seconds S] [--scene NAME] [--quick]");
    }
    if (!(seconds > 0)) ex_fail("--seconds has to be > 0");
    printf("%-9s %6s %5s %8s %8s %8s %8s %6s %6s %6s\n", "scene", "tets", "steps", "mean ms", "median", "worst", "made", "reject",
           "touch", "pieces");
    for (i = 0; i < SC_SCENES; ++i) {
        if (only ? strcmp(only, sc_scenes[i]->name) : !strcmp(sc_scenes[i]->name, "mesh")) continue; /* mesh needs a file */
        ++found;
        survive &= measure(sc_scenes[i], seconds, small);
    }
    if (!found) ex_fail("no such scene");
    return !survive;
}
