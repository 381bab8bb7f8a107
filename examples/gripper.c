/* gripper - two fingers squeeze a soft fruit, lift it, and feel it; with too little friction it slips out:
 *
 *      |   ,--.   |
 *    ->| ( soft ) |<-       2 mu F >= m g holds, F the force of one finger on the body
 *      |   `--'   |
 *     _____________
 *
 * The scene is scenes/gripper.h: fingers that go together until each feels the grip that was asked for, then up, then
 * still. sfem_contact_obstacle_force is what a sensor in them reads. It is done twice, with --friction and with --slippery.
 * Writes gripper.png, force.svg (what one finger feels over time), curve.svg (over how far it has pressed in) and
 * gripper.csv to the --out directory.
 *
 *     cc -O2 -c -DSOFTFEM_IMPLEMENTATION -x c softfem.h && cc -O2 -I. examples/gripper.c softfem.o -lm
 *
 * The last lines on stdout are `key value`.
 */
#include "support.h"
#include "softfem.h"
#include "elastic.h"
#include "scenes/all.h"

enum { FRAMES = 3, RUNS = 2 };

static const ex_option table[] = {
    {"--tets", "N", "4000", "of the fruit, about"},
    {"--young", "E", "5e4", "Young's modulus, Pa"},
    {"--friction", "MU", "0.8", "between fingers and fruit"},
    {"--slippery", "MU", "0.15", "the same the second time"},
    {"--grip", "G", "1.2", "force of a finger, in weights of the fruit"},
    {"--dt", "H", "0.008333333333333333", "time step, s"},
    {"--out", "DIR", "build/gripper", "where files go"},
    {"--quick", NULL, NULL, "a small run: a coarse fruit"},
    {NULL, NULL, NULL, NULL}};

#define END 2.6 /* s */

typedef struct trial { /* of one friction */
    sc_world *w;
    double *normal, *tangent, *depth, *height; /* [steps]: N, N, m, m */
    double *frame[FRAMES], finger[FRAMES][2][3], time[FRAMES];
    sfem_int closing; /* steps */
} trial;

typedef struct run {
    ex_options o;
    double h, *time;
    sfem_int steps;
    trial trial[RUNS];
} run;

static void must(sfem_status status, const sfem_error *err)
{
    if (status != SFEM_OK) ex_fail("%s", err->text);
}

/* 1. The scene, with one friction. */
static void open_scene(const run *r, trial *t, double friction)
{
    const char *const name[6] = {"tets", "E", "friction", "grip", "h", NULL};
    const double value[5] = {ex_given(&r->o, "--quick") ? 800 : (double)ex_integer(&r->o, "--tets"), ex_real(&r->o, "--young"),
                             friction, ex_real(&r->o, "--grip"), 1000 * r->h};
    double all[SC_SLIDERS];
    sfem_error err;
    int k;
    for (k = 0; k < SC_SLIDERS; ++k) all[k] = sc_scene_gripper.slider[k].value;
    for (k = 0; name[k]; ++k) all[sc_slider_of(&sc_scene_gripper, name[k])] = value[k];
    t->w = sc_open(&sc_scene_gripper, all, &err);
    if (!t->w) ex_fail("%s", err.text);
}

static double height_of(const sc_world *w) /* of its centre of mass, above where it lay */
{
    const double *u = sfem_body_displacement(w->item[0].body), *mass = sfem_model_node_mass(w->model);
    double sum = 0, all = 0;
    sfem_int i;
    for (i = 0; i < w->mesh.nodes; ++i) {
        sum += mass[i] * u[3 * i + 2];
        all += mass[i];
    }
    return sum / all;
}

static void finger_at(const sc_world *w, int k, double at[3])
{
    double axes[9];
    sfem_contact_obstacle_pose(w->contact, w->obstacle[SC_FINGER + k].id, at, axes);
}

static void keep(trial *t, int k)
{
    int i;
    t->frame[k] = (double *)ex_new(3 * (size_t)t->w->mesh.nodes, sizeof(double));
    sc_positions(t->w, 0, t->frame[k]);
    t->time[k] = t->w->time;
    for (i = 0; i < 2; ++i) finger_at(t->w, i, t->finger[k][i]);
}

/* 2. One trial. */
static void play(run *r, trial *t)
{
    const sfem_int frame[FRAMES] = {(sfem_int)(SC_CLOSE / r->h), (sfem_int)((SC_LIFT + SC_HOLD) / 2 / r->h), r->steps - 1};
    sfem_int i;
    sfem_error err;
    double at[3], first[3];
    int k, kept = 0;
    finger_at(t->w, 0, first);
    for (i = 0; i < r->steps; ++i) {
        double force[2][3];
        must(sc_step(t->w, &err), &err);
        for (k = 0; k < 2; ++k) sc_obstacle_force(t->w, SC_FINGER + k, force[k]);
        finger_at(t->w, 0, at);
        t->normal[i] = sc_grip_felt(t->w);
        t->tangent[i] = -(force[0][2] + force[1][2]) / 2;
        t->depth[i] = fmax(0, first[0] - at[0] - 0.004); /* that far away it began */
        t->height[i] = height_of(t->w);
        if (!t->w->phase) t->closing = i;
        if (kept < FRAMES && i >= frame[kept]) keep(t, kept++);
        ex_progress(t == r->trial ? "gripper" : "slippery", i, r->steps);
    }
}

/* 3. Pictures, plots, a table. */
static void draw_finger(ex_picture *p, const double size[3], const double at[3])
{
    static const int32_t tri[12][3] = {{0, 2, 3}, {0, 3, 1}, {4, 5, 7}, {4, 7, 6}, {0, 1, 5}, {0, 5, 4},
                                       {2, 6, 7}, {2, 7, 3}, {0, 4, 6}, {0, 6, 2}, {1, 3, 7}, {1, 7, 5}};
    ex_style grey = ex_default_style();
    double x[8][3];
    int k, c;
    for (k = 0; k < 8; ++k)
        for (c = 0; c < 3; ++c) x[k][c] = at[c] + (k >> c & 1 ? 1 : -1) * size[c];
    grey.color[0] = grey.color[1] = 0.5;
    grey.color[2] = 0.55;
    grey.edges = 0;
    grey.flat = 1;
    ex_view_surface(p, 8, x[0], 12, tri[0], NULL, &grey);
}

static void draw(const run *r)
{
    static const char *const what[FRAMES] = {"squeezed", "lifted", "held"};
    const double direction[3] = {0.4, -1, 0.25};
    const int quick = ex_given(&r->o, "--quick");
    const sfem_mesh *mesh = &r->trial[0].w->mesh; /* of both */
    const sfem_surface *surface = &r->trial[0].w->surface;
    const sfem_model *model = r->trial[0].w->model;
    ex_picture *p = ex_picture_new(quick ? 1050 : 1500, quick ? 600 : 860);
    ex_style style = ex_default_style();
    double lower[3], upper[3], low, high;
    int i, j, k;
    p->ground = 0;
    p->bar = 1;
    for (j = 0; j < RUNS; ++j)
        for (k = 0; k < FRAMES; ++k) {
            double *value = ex_node_stress(model, mesh, r->trial[j].frame[k]);
            ex_range(value, mesh->nodes, &low, &high);
            style.high = fmax(style.high * (j + k > 0), high);
            ex_bounds(r->trial[j].frame[k], mesh->nodes, j + k == 0, lower, upper);
            ex_bounds(r->trial[j].finger[k][0], 2, 0, lower, upper);
            free(value);
        }
    style.low = lower[2] = 0;
    for (j = 0; j < RUNS; ++j)
        for (k = 0; k < FRAMES; ++k) {
            const trial *t = r->trial + j;
            double *value = ex_node_stress(model, mesh, t->frame[k]);
            char caption[80];
            const int slipped = k > 0 && t->height[(sfem_int)(t->time[k] / r->h) - 1] < 0.5 * SC_RISE * (k == 1 ? 0.5 : 1);
            ex_view_begin(p, FRAMES * j + k, FRAMES, RUNS, lower, upper, direction);
            for (i = 0; i < 2; ++i) draw_finger(p, t->w->obstacle[SC_FINGER + i].def.size, t->finger[k][i]);
            ex_view_surface(p, mesh->nodes, t->frame[k], surface->triangles, surface->tri, value, &style);
            snprintf(caption, sizeof caption, "friction %.2g, %.2f s: %s", sc_value(t->w, "friction", 0), t->time[k],
                     slipped ? "slipped" : what[k]);
            ex_view_end(p, caption);
            free(value);
        }
    ex_colorbar(p, "stress, Pa", 0, style.high);
    ex_picture_write(p, ex_path(ex_text(&r->o, "--out"), "gripper.png"));
    ex_picture_free(p);
}

static void plot(const run *r)
{
    const char *out = ex_text(&r->o, "--out");
    ex_plot force = ex_plot_new("What one finger feels", "time, s", "force, N", 0);
    ex_plot curve = ex_plot_new("Force over depth, as it closes", "how far a finger has pressed in, m", "force, N", 0);
    FILE *f = ex_open(ex_path(out, "gripper.csv"));
    char name[2 * RUNS][48];
    sfem_int i, closing = r->trial[0].closing;
    int j;
    for (j = 0; j < RUNS; ++j) {
        snprintf(name[2 * j], sizeof *name, "squeeze, friction %.2g", sc_value(r->trial[j].w, "friction", 0));
        snprintf(name[2 * j + 1], sizeof *name, "lift, friction %.2g", sc_value(r->trial[j].w, "friction", 0));
        ex_plot_add(&force, name[2 * j], r->time, r->trial[j].normal, r->steps, EX_LINE);
        ex_plot_add(&force, name[2 * j + 1], r->time, r->trial[j].tangent, r->steps, EX_LINE);
    }
    ex_plot_write(&force, ex_path(out, "force.svg"));
    ex_plot_add(&curve, NULL, r->trial[0].depth, r->trial[0].normal, closing > 1 ? closing : r->steps, EX_LINE);
    ex_plot_write(&curve, ex_path(out, "curve.svg"));
    fprintf(f, "time,normal,lift,depth,height,slippery_normal,slippery_lift,slippery_depth,slippery_height\n");
    for (i = 0; i < r->steps; ++i) {
        fprintf(f, "%.6g", r->time[i]);
        for (j = 0; j < RUNS; ++j)
            fprintf(f, ",%.9g,%.9g,%.9g,%.9g", r->trial[j].normal[i], r->trial[j].tangent[i], r->trial[j].depth[i],
                    r->trial[j].height[i]);
        fprintf(f, "\n");
    }
    ex_close(f, ex_path(out, "gripper.csv"));
}

int main(int argc, char **argv)
{
    run r;
    sfem_int i;
    int j, k;
    memset(&r, 0, sizeof r);
    r.o = ex_parse(argc, argv, "Two fingers squeeze, lift and feel a soft fruit.", table);
    r.h = ex_positive(&r.o, "--dt");
    r.steps = ex_steps(END, r.h);
    ex_make_directory(ex_text(&r.o, "--out"));
    r.time = (double *)ex_new((1 + 4 * RUNS) * (size_t)r.steps, sizeof *r.time);
    for (i = 0; i < r.steps; ++i) r.time[i] = (i + 1) * r.h;
    for (j = 0; j < RUNS; ++j) {
        trial *t = r.trial + j;
        open_scene(&r, t, ex_real(&r.o, j ? "--slippery" : "--friction"));
        if (!j) printf("fruit: %d nodes, %d tets\n", (int)t->w->mesh.nodes, (int)t->w->mesh.tets);
        t->normal = r.time + (1 + 4 * j) * r.steps;
        t->tangent = t->normal + r.steps;
        t->depth = t->tangent + r.steps;
        t->height = t->depth + r.steps;
        play(&r, t);
    }
    draw(&r);
    plot(&r);
    printf("wrote %s/gripper.png, force.svg, curve.svg, gripper.csv\n", ex_text(&r.o, "--out"));
    printf("weight %.4g\ngrip %.4g\n", sc_weight(r.trial[0].w), r.trial[0].normal[r.steps - 1]);
    printf("lift_per_finger %.6g\nheld_at %.4g\nslipped_at %.4g\n", r.trial[0].tangent[r.steps - 1],
           r.trial[0].height[r.steps - 1], r.trial[1].height[r.steps - 1]);
    for (j = 0; j < RUNS; ++j)
        for (k = 0; k < FRAMES; ++k) free(r.trial[j].frame[k]);
    for (j = 0; j < RUNS; ++j) sc_close(r.trial[j].w);
    free(r.time);
    return 0;
}
