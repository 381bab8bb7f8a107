/* grab - a hand takes a bar by its end, bends it, holds it and lets go:
 *
 *                  ,-> hand          A q'' = b - J^T l,  x - target = C l - tau x',  J = dx/dq
 *             ,---'
 *     //|====' warped modes         the hand feels l, the source's sign; the plots show the pull on it
 *
 * The bar is reduced to a few modes and saved to a block, as a game would ship it; the rest of the program
 * knows nothing but that block. The hand holds the mean of the end face (a region handle). Writes force.svg (the
 * pull over time), curve.svg (over how far the hand is: there, and back), grab.png and force.csv to the --out
 * directory.
 *
 *     cc -O2 -c -DSOFTFEM_IMPLEMENTATION -x c softfem.h && cc -O2 -I. examples/grab.c softfem.o -lm
 *
 * The last lines on stdout are `key value`.
 */
#include "support.h"
#include "softfem.h"

enum { FRAMES = 9 };

static const ex_option table[] = {
    {"--cells", "NX,NY,NZ", "30,4,4", "cells of the bar, 2 x 0.2 x 0.2 m, five tets each"},
    {"--young", "E", "1e6", "Young's modulus, Pa"},
    {"--modes", "N", "20", "modes"},
    {"--ratio", "XI", "0.05", "damping ratio of each mode"},
    {"--warp", "none|rotation|path", "path", "how modes rotate"},
    {"--pull", "D", "0.8", "how far the end is drawn up, m"},
    {"--dt", "H", "0.01", "time step, s"},
    {"--seconds", "T", "6", "1/3 up, 1/6 held, 1/6 down by half, then let go"},
    {"--out", "DIR", "build/grab", "where files go"},
    {"--quick", NULL, NULL, "a small run: a coarse bar"},
    {NULL, NULL, NULL, NULL}};

typedef struct run {
    ex_options o;
    sfem_reduced *reduced;
    sfem_reduced_view *view; /* the surface */
    sfem_modal *body;
    sfem_int *face, face_count, handle;
    double h, length, modes_seconds, step_seconds;
    sfem_int steps, held; /* let go after so many */
    size_t block_bytes;
    double *time, *pull, *distance; /* [steps] */
    double *frame[FRAMES];
    char caption[FRAMES][48];
    int frames;
} run;

static void must(sfem_status status, const sfem_error *err)
{
    if (status != SFEM_OK) ex_fail("%s", err->text);
}

/* 1. What is done once, before the game ships: mesh, modes, reduced model, block. */
static void *make_block(run *r)
{
    const sfem_real size[3] = {2, 0.2, 0.2};
    sfem_model_def model_def = sfem_default_model_def();
    sfem_modes_def modes_def = sfem_default_modes_def();
    sfem_reduced_def def = sfem_default_reduced_def();
    sfem_reduced *reduced;
    sfem_model *model;
    sfem_modes modes;
    sfem_mesh mesh;
    sfem_int n[3], *pins, i;
    double cells[3], *ratio, start;
    void *block;
    sfem_error err;
    int k;
    ex_reals(&r->o, "--cells", 3, cells);
    for (k = 0; k < 3; ++k) n[k] = (sfem_int)(ex_given(&r->o, "--quick") ? (k ? 2 : 12) : cells[k]);
    must(sfem_mesh_block(n, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), &err);
    model_def.mesh = &mesh;
    model_def.material.young = ex_real(&r->o, "--young");
    must(sfem_model_create(&model_def, &model, &err), &err);
    modes_def.modes = (sfem_int)ex_integer(&r->o, "--modes");
    modes_def.pin_count = (n[1] + 1) * (n[2] + 1); /* the face x = 0 comes first */
    pins = (sfem_int *)ex_new((size_t)modes_def.pin_count, sizeof *pins);
    for (i = 0; i < modes_def.pin_count; ++i) pins[i] = i;
    modes_def.pins = pins;
    start = ex_seconds();
    must(sfem_modes_create(model, &modes_def, &modes, &err), &err);
    r->modes_seconds = ex_seconds() - start;
    ratio = (double *)ex_new((size_t)modes.count, sizeof *ratio);
    for (k = 0; k < modes.count; ++k) ratio[k] = ex_real(&r->o, "--ratio");
    def.ratio = ratio;
    must(sfem_reduced_create(model, &modes, &def, &reduced, &err), &err);
    r->block_bytes = sfem_reduced_size(reduced);
    block = ex_new(1, r->block_bytes);
    sfem_reduced_save(reduced, block);
    printf("bar: %d tets, %d modes from %.3g to %.3g Hz, a block of %.0f kB\n", (int)mesh.tets,
           (int)modes.count, sfem_modes_hz(&modes, 0), sfem_modes_hz(&modes, modes.count - 1),
           (double)r->block_bytes / 1e3);
    sfem_reduced_free(reduced);
    sfem_modes_free(&modes);
    sfem_model_free(model);
    sfem_mesh_free(&mesh);
    free(ratio);
    free(pins);
    return block;
}

/* 2. What the game does: load, make a body and a view, find the end face. */
static void load(run *r, const void *block)
{
    sfem_modal_def def = sfem_default_modal_def();
    sfem_reduced_info info;
    sfem_error err;
    sfem_int i;
    must(sfem_reduced_load(block, r->block_bytes, NULL, &r->reduced, &err), &err);
    info = sfem_reduced_get_info(r->reduced);
    def.warp = (sfem_warp)ex_choice(&r->o, "--warp"); /* in the order of the enumeration */
    def.max_handle_nodes = info.nodes;
    must(sfem_modal_create(r->reduced, &def, &r->body, &err), &err);
    must(sfem_reduced_view_surface(r->reduced, SFEM_MIXED, &r->view, &err), &err);
    r->face = (sfem_int *)ex_new((size_t)info.nodes, sizeof *r->face);
    for (i = 0; i < info.nodes; ++i) r->length = fmax(r->length, info.x[3 * i]);
    for (i = 0; i < info.nodes; ++i)
        if (info.x[3 * i] > r->length - 1e-9) r->face[r->face_count++] = i;
}

static double smooth(double t) /* from 0 to 1 and at rest at both ends */
{
    t = ex_clamp(t, 0, 1);
    return t * t * (3 - 2 * t);
}

/* How far up the hand is: up, held, half way down. The end of a bent bar also comes nearer. */
static void hand(const run *r, double t, const double *from, double *at)
{
    const double all = r->held * r->h, up = 0.5 * all, hold = 0.75 * all;
    const double d =
        ex_real(&r->o, "--pull") * (smooth(t / up) - 0.5 * smooth((t - hold) / (all - hold)));
    at[0] = from[0] - 0.6 * d * d / r->length;
    at[1] = from[1];
    at[2] = from[2] + d;
}

static void keep(run *r, const char *what, double t)
{
    const size_t bytes = 3 * (size_t)sfem_reduced_view_count(r->view) * sizeof(double);
    if (r->frames == FRAMES) return;
    r->frame[r->frames] = (double *)ex_new(1, bytes);
    sfem_modal_positions(r->body, r->view, r->frame[r->frames]);
    snprintf(r->caption[r->frames++], sizeof r->caption[0], "%s, %.2f s", what, t);
}

/* 3. The hand and the steps. */
static void play(run *r)
{
    double from[3], at[3], force[3], spent = 0;
    sfem_int i;
    sfem_error err;
    must(sfem_modal_grab_region(r->body, r->face_count, r->face, NULL, &r->handle, &err), &err);
    sfem_modal_handle_position(r->body, r->handle, from);
    for (i = 0; i < r->steps; ++i) {
        const double t = (i + 1) * r->h;
        double start;
        if (i == r->held) sfem_modal_release_handle(r->body, r->handle);
        if (i % ((r->steps + FRAMES - 1) / FRAMES) == 0)
            keep(r, i < r->held ? "held" : "let go", i * r->h);
        hand(r, t, from, at);
        start = ex_seconds();
        if (i < r->held) must(sfem_modal_move_handle(r->body, r->handle, at, &err), &err);
        must(sfem_modal_step(r->body, r->h, &err), &err);
        spent += ex_seconds() - start;
        r->time[i] = t;
        r->pull[i] = 0;
        r->distance[i] = at[2] - from[2];
        if (i >= r->held) continue;
        sfem_modal_handle_force(r->body, r->handle, force);
        r->pull[i] = force[2];
    }
    r->step_seconds = spent / r->steps;
}

/* 4. Pictures, plots, tables. */
static void draw(const run *r)
{
    const sfem_reduced_info info = sfem_reduced_get_info(r->reduced);
    const double direction[3] = {0.15, -1, 0.2};
    ex_picture *p = ex_picture_new(1500, 1050);
    ex_style style = ex_default_style();
    double lower[3], upper[3];
    int k;
    for (k = 0; k < r->frames; ++k)
        ex_bounds(r->frame[k], info.surface_nodes, k == 0, lower, upper);
    for (k = 0; k < r->frames; ++k) {
        ex_view_begin(p, k, 3, 3, lower, upper, direction);
        ex_view_surface(p, info.surface_nodes, r->frame[k], info.surface_triangles,
                        info.surface_tri, NULL, &style);
        ex_view_end(p, r->caption[k]);
        free(r->frame[k]);
    }
    ex_picture_write(p, ex_path(ex_text(&r->o, "--out"), "grab.png"));
    ex_picture_free(p);
}

static void plot(const run *r)
{
    const char *out = ex_text(&r->o, "--out");
    ex_plot time = ex_plot_new("The pull of the hand", "time, s", "force upward, N", 0);
    ex_plot path =
        ex_plot_new("Force over displacement", "how far up the hand is, m", "force upward, N", 0);
    FILE *f = ex_open(ex_path(out, "force.csv"));
    sfem_int i;
    ex_plot_add(&time, NULL, r->time, r->pull, r->steps, EX_LINE);
    ex_plot_write(&time, ex_path(out, "force.svg"));
    ex_plot_add(&path, NULL, r->distance, r->pull, r->held, EX_LINE);
    ex_plot_write(&path, ex_path(out, "curve.svg"));
    fprintf(f, "time,distance,force\n");
    for (i = 0; i < r->steps; ++i)
        fprintf(f, "%.6g,%.9g,%.9g\n", r->time[i], r->distance[i], r->pull[i]);
    ex_close(f, ex_path(out, "force.csv"));
}

int main(int argc, char **argv)
{
    double most = 0;
    void *block;
    sfem_int i;
    run r;
    memset(&r, 0, sizeof r);
    r.o = ex_parse(argc, argv, "A hand takes a bar by its end, bends it, and lets go.", table);
    if (ex_integer(&r.o, "--modes") < 1) ex_fail("--modes must be at least 1");
    r.h = ex_positive(&r.o, "--dt");
    r.steps = ex_steps(ex_positive(&r.o, "--seconds"), r.h);
    if (r.steps < 9) ex_fail("--seconds over --dt must be at least 9 steps");
    r.held = r.steps * 2 / 3;
    ex_make_directory(ex_text(&r.o, "--out"));
    block = make_block(&r);
    load(&r, block);
    free(block);
    r.time = (double *)ex_new(3 * (size_t)r.steps, sizeof *r.time);
    r.pull = r.time + r.steps;
    r.distance = r.pull + r.steps;
    play(&r);
    keep(&r, "at the end", r.steps * r.h);
    draw(&r);
    plot(&r);
    for (i = 0; i < r.steps; ++i) most = fmax(most, fabs(r.pull[i]));
    printf("wrote %s/grab.png, force.svg, curve.svg, force.csv\n", ex_text(&r.o, "--out"));
    printf(
        "modes_ms %.3f\nblock_bytes %lu\nstep_us %.3f\nlargest_force %.6g\nforce_when_held %.6g\n",
        1e3 * r.modes_seconds, (unsigned long)r.block_bytes, 1e6 * r.step_seconds, most,
        r.pull[r.held * 3 / 4 - 1]);
    free(r.time);
    free(r.face);
    sfem_modal_free(r.body);
    sfem_reduced_view_free(r.view);
    sfem_reduced_free(r.reduced);
    return 0;
}
