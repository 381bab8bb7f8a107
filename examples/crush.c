/* crush - a soft bar is twisted, let go, crushed to a point, and comes back.
 *
 *     //|==========|//  ->  //|~~~~~~~|//  ->  //|=======   ->   .   ->   =========
 *       rest                 a full turn        let go         a point     as it was
 *
 * A corotational body under the default step, which no violence makes explode: (p,q,r) with a factor
 * rotated node by node, corrected, with an energy safeguard [softfem.h, >>safeguard]. A contact sheet is left in the
 * --out directory.
 *
 *     cc -O2 -c -DSOFTFEM_IMPLEMENTATION -x c softfem.h && cc -O2 -I. examples/crush.c softfem.o -lm
 *
 * The last lines on stdout are `key value`: shape_error is the largest distance from the rest shape
 * at the end, best rotated and moved, over the length of the bar.
 */
#include "support.h"
#include "softfem.h"
#include "elastic.h"

enum { FRAMES = 9 };

static const ex_option table[] = {
    {"--cells", "NX,NY,NZ", "16,4,4", "cells of the bar, five tets each"},
    {"--young", "E", "3e5", "Young's modulus, Pa"},
    {"--poisson", "NU", "0.3", "Poisson's ratio"},
    {"--turns", "N", "1", "how far one end is twisted"},
    {"--dt", "H", "0.016666666666666666", "time step, s"},
    {"--accuracy", "A", "1e-6",
     "corrections stop below this part of the energy in motion; 1: one solve a step"},
    {"--dissipation", "ALPHA", "0.1", "0 to 1/3: damps what a step does not resolve"},
    {"--out", "DIR", "build/crush", "where files go"},
    {"--quick", NULL, NULL, "a small run: a coarse bar"},
    {NULL, NULL, NULL, NULL}};

typedef struct run {
    ex_options o;
    sfem_mesh mesh;
    sfem_surface surface;
    sfem_model *model;
    sfem_body *body;
    double h;
    int64_t steps, rejected, solves; /* before the state was last set */
    double *frame[FRAMES];
    char caption[FRAMES][48];
    int frames;
} run;

static void must(sfem_status status, const sfem_error *err)
{
    if (status != SFEM_OK) ex_fail("%s", err->text);
}

/* 1. The bar, 1 x 0.2 x 0.2 m, both ends held. */
static void make(run *r)
{
    const sfem_real size[3] = {1, 0.2, 0.2};
    sfem_model_def model = sfem_default_model_def();
    sfem_body_def body = sfem_default_body_def();
    double cells[3];
    sfem_int n[3];
    sfem_error err;
    int k;
    ex_reals(&r->o, "--cells", 3, cells);
    for (k = 0; k < 3; ++k) n[k] = (sfem_int)(ex_given(&r->o, "--quick") ? (k ? 2 : 8) : cells[k]);
    must(sfem_mesh_block(n, size, SFEM_CELL_5_TETS, NULL, &r->mesh, &err), &err);
    must(sfem_mesh_surface(&r->mesh, NULL, &r->surface, &err), &err);
    model.mesh = &r->mesh;
    model.material.law = SFEM_COROTATIONAL;
    model.material.young = ex_real(&r->o, "--young");
    model.material.poisson = ex_real(&r->o, "--poisson");
    model.material.mass_damping = 0.5;
    model.material.stiffness_damping = 0.004;
    must(sfem_model_create(&model, &r->model, &err), &err);
    body.accuracy = ex_real(&r->o, "--accuracy");
    body.dissipation = ex_real(&r->o, "--dissipation");
    must(sfem_body_create(r->model, &body, &r->body, &err), &err);
}

static void hold(run *r, int left, int right)
{
    sfem_int *pins = (sfem_int *)ex_new((size_t)r->mesh.nodes, sizeof *pins), i, count = 0;
    sfem_error err;
    for (i = 0; i < r->mesh.nodes; ++i)
        if ((left && r->mesh.x[3 * i] < 1e-6) || (right && r->mesh.x[3 * i] > 1 - 1e-6))
            pins[count++] = i;
    must(sfem_body_set_pins(r->body, count, pins, NULL, &err), &err);
    free(pins);
}

static void photograph(run *r, const char *caption)
{
    r->frame[r->frames] = (double *)ex_new(3 * (size_t)r->mesh.nodes, sizeof(double));
    sfem_body_positions(r->body, r->frame[r->frames]);
    snprintf(r->caption[r->frames++], sizeof *r->caption, "%s", caption);
}

static void go(run *r, double seconds)
{
    sfem_int i;
    sfem_error err;
    for (i = 0; i < (sfem_int)(seconds / r->h + 0.5); ++i)
        must(sfem_body_step(r->body, r->h, &err), &err);
}

/* 2. The right end rotates about the bar's axis, in a second. */
static void twist(run *r, double turns)
{
    const sfem_int steps = ex_steps(1, r->h);
    char caption[48];
    sfem_int i, k;
    sfem_error err;
    for (k = 1; k <= steps; ++k) {
        const double a = 2 * 3.14159265358979 * turns * k / steps, c = cos(a), s = sin(a);
        for (i = 0; i < r->mesh.nodes; ++i) {
            const double *x = r->mesh.x + 3 * i, y = x[1] - 0.1, z = x[2] - 0.1;
            const double to[3] = {x[0], 0.1 + c * y - s * z, 0.1 + s * y + c * z};
            if (x[0] > 1 - 1e-6) must(sfem_body_move_pin(r->body, i, to, &err), &err);
        }
        must(sfem_body_step(r->body, r->h, &err), &err);
        if (k != steps / 2 && k != steps) continue;
        snprintf(caption, sizeof caption, "twisted by %.0f degrees", 360 * turns * k / steps);
        photograph(r, caption);
    }
}

/* 3. Every node goes to the middle. */
static void crush(run *r)
{
    double *u = (double *)ex_new(3 * (size_t)r->mesh.nodes, sizeof *u);
    const double middle[3] = {0.5, 0.1, 0.1};
    const sfem_body_info info = sfem_body_get_info(r->body);
    sfem_error err;
    sfem_int i;
    for (i = 0; i < 3 * r->mesh.nodes; ++i) u[i] = middle[i % 3] - r->mesh.x[i];
    must(sfem_body_set_state(r->body, u, NULL, &err), &err);
    r->steps += info.steps;
    r->rejected += info.rejected;
    r->solves += info.solves;
    free(u);
}

/* The largest distance from the rest shape, rotated by the mean deformation's rotation. */
static double shape_error(const run *r, const double *x)
{
    const double *mass = sfem_model_node_mass(r->model), total = sfem_model_total_mass(r->model);
    double now[3] = {0, 0, 0}, rest[3] = {0, 0, 0}, f[9], rotation[9], most = 0;
    sfem_int i;
    int j, k;
    memset(f, 0, sizeof f);
    for (i = 0; i < 3 * r->mesh.nodes; ++i) {
        now[i % 3] += mass[i / 3] * x[i] / total;
        rest[i % 3] += mass[i / 3] * r->mesh.x[i] / total;
    }
    for (i = 0; i < r->mesh.nodes; ++i)
        for (k = 0; k < 9; ++k)
            f[k] += mass[i] * (x[3 * i + k / 3] - now[k / 3]) *
                    (r->mesh.x[3 * i + k % 3] - rest[k % 3]);
    sfem_polar(f, rotation, NULL);
    for (i = 0; i < r->mesh.nodes; ++i) {
        double d2 = 0;
        for (j = 0; j < 3; ++j) {
            double d = x[3 * i + j] - now[j];
            for (k = 0; k < 3; ++k) d -= rotation[3 * j + k] * (r->mesh.x[3 * i + k] - rest[k]);
            d2 += d * d;
        }
        most = fmax(most, sqrt(d2));
    }
    return most;
}

static void draw(const run *r)
{
    const double direction[3] = {0.35, -1, 0.3};
    ex_picture *p = ex_picture_new(1500, 1050);
    ex_style style = ex_default_style();
    double lower[3], upper[3], *value[FRAMES], low, high;
    int k;
    p->bar = 1;
    style.low = 0;
    style.high = 0;
    for (k = 0; k < r->frames; ++k) {
        ex_bounds(r->frame[k], r->mesh.nodes, k == 0, lower, upper);
        value[k] = ex_node_stress(r->model, &r->mesh, r->frame[k]);
        ex_range(value[k], r->mesh.nodes, &low, &high);
        if (k <= 2) style.high = fmax(style.high, high);
    }
    for (k = 0; k < r->frames; ++k) {
        ex_view_begin(p, k, 3, 3, lower, upper, direction);
        ex_view_surface(p, r->mesh.nodes, r->frame[k], r->surface.triangles, r->surface.tri,
                        value[k], &style);
        ex_view_end(p, r->caption[k]);
        free(value[k]);
    }
    ex_colorbar(p, "stress, Pa", 0, style.high);
    ex_picture_write(p, ex_path(ex_text(&r->o, "--out"), "crush.png"));
    ex_picture_free(p);
}

int main(int argc, char **argv)
{
    static const double pause[5] = {1.0 / 60, 0.05, 0.1, 0.3, 4.5};
    sfem_body_info info;
    double start, seconds = 0, error;
    char caption[48];
    run r;
    int k;
    memset(&r, 0, sizeof r);
    r.o = ex_parse(argc, argv, "Twists a soft bar, crushes it to a point, and waits.", table);
    r.h = ex_positive(&r.o, "--dt");
    ex_make_directory(ex_text(&r.o, "--out"));
    start = ex_seconds();
    make(&r);
    photograph(&r, "at rest");
    hold(&r, 1, 1);
    twist(&r, ex_real(&r.o, "--turns"));
    hold(&r, 1, 0);
    go(&r, 0.1);
    photograph(&r, "let go");
    hold(&r, 0, 0);
    crush(&r);
    for (k = 0; k < 5; ++k) {
        go(&r, pause[k]);
        seconds += pause[k];
        snprintf(caption, sizeof caption, "%.2f s after it was a point", seconds);
        photograph(&r, caption);
    }
    start = ex_seconds() - start;
    draw(&r);
    info = sfem_body_get_info(r.body);
    error = shape_error(&r, r.frame[r.frames - 1]);
    printf("wrote %s/crush.png\n", ex_text(&r.o, "--out"));
    printf("nodes %d\ntets %d\nsteps %ld\nrejected %ld\nsolves %ld\nseconds %.3f\n"
           "shape_error %.3g\n",
           (int)r.mesh.nodes, (int)r.mesh.tets, (long)(r.steps + info.steps),
           (long)(r.rejected + info.rejected), (long)(r.solves + info.solves), start, error);
    for (k = 0; k < r.frames; ++k) free(r.frame[k]);
    sfem_body_free(r.body);
    sfem_model_free(r.model);
    sfem_surface_free(&r.surface);
    sfem_mesh_free(&r.mesh);
    return 0;
}
