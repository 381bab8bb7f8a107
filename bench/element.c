/* What a tet costs: forces by law and precision, tangents by kind, single matrices.
 *
 * Blocks of five-tet cells, every node displaced at random by 2 % of a cell on top of a turn by one
 * radian. Each figure is the median of RUNS runs on the calling thread, in processor time. Pin it:
 *     taskset -c 1 build/bench/element [--quick]                                                  */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "bench.h"
#include "../tests/linear.h"

#define RUNS 15

static double noise(void)
{
    static uint64_t state = 1;
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (double)(state >> 11) / 9007199254740992.0 - 0.5;
}

static void *allocate(size_t bytes)
{
    void *p = calloc(bytes ? bytes : 1, 1);
    if (!p) exit(1);
    return p;
}

/* ---- a body ---- */

typedef struct scene {
    sfem_model *model;
    sfem_real *u, *force, *exact, *work, *rotation;
    sfem_int nodes, tets;
} scene;

static scene make_scene_of(const sfem_int cells[3], sfem_block_cells kind, sfem_tet tet, sfem_law law, double strain, int inverted)
{
    const sfem_real size[3] = {0.1 * cells[0], 0.1 * cells[1], 0.1 * cells[2]};
    sfem_model_def def = linear_model_def();
    const double c = cos(1.0), s = sin(1.0);
    sfem_mesh mesh;
    sfem_error err;
    scene b;
    sfem_int i;
    bench_must(sfem_mesh_block(cells, size, kind, NULL, &mesh, &err), &err);
    def.mesh = &mesh;
    def.material.poisson = 0.45;
    def.material.law = law;
    def.material.tet = tet;
    bench_must(sfem_model_create(&def, &b.model, &err), &err);
    b.nodes = mesh.nodes;
    b.tets = mesh.tets;
    b.u = (sfem_real *)allocate(3 * (size_t)b.nodes * sizeof *b.u);
    b.force = (sfem_real *)allocate(3 * (size_t)b.nodes * sizeof *b.force);
    b.exact = (sfem_real *)allocate(3 * (size_t)b.nodes * sizeof *b.exact);
    b.rotation = (sfem_real *)allocate(9 * (size_t)b.tets * sizeof *b.rotation);
    b.work = (sfem_real *)allocate(sfem_model_work_size(b.model) * sizeof *b.work);
    for (i = 0; i < b.nodes; ++i) {
        const double *X = mesh.x + 3 * i;
        double x[3];
        int k;
        for (k = 0; k < 3; ++k) x[k] = X[k] + 0.1 * strain * noise() * 2;
        if (inverted && i % inverted == 0)
            for (k = 0; k < 3; ++k) x[k] += 0.4 * noise();
        if (law == SFEM_LINEAR) {
            for (k = 0; k < 3; ++k) b.u[3 * i + k] = x[k] - X[k];
            continue;
        }
        b.u[3 * i] = c * x[0] - s * x[1] - X[0];
        b.u[3 * i + 1] = s * x[0] + c * x[1] - X[1];
        b.u[3 * i + 2] = x[2] - X[2];
    }
    sfem_mesh_free(&mesh);
    return b;
}

static scene make_scene(const sfem_int cells[3], sfem_law law, double strain, int inverted)
{
    return make_scene_of(cells, SFEM_CELL_5_TETS, SFEM_TET_LINEAR, law, strain, inverted);
}

static void free_scene(scene *b)
{
    sfem_model_free(b->model);
    free(b->u);
    free(b->force);
    free(b->exact);
    free(b->rotation);
    free(b->work);
}

static double time_forces(scene *b, sfem_precision precision, sfem_real *rotation,
                          sfem_int *inverted)
{
    const int repeat = 1 + 200000 / b->tets;
    double t[RUNS];
    int run, k;
    sfem_model_forces(b->model, b->u, precision, b->force, rotation, inverted, b->work, NULL);
    for (run = 0; run < RUNS; ++run) {
        t[run] = bench_seconds();
        for (k = 0; k < repeat; ++k)
            sfem_model_forces(b->model, b->u, precision, b->force, rotation, inverted, b->work,
                              NULL);
        t[run] = (bench_seconds() - t[run]) / repeat / b->tets * 1e9;
    }
    return bench_median(t, RUNS);
}

static double time_tangent(scene *b, sfem_tangent kind, sfem_matrix *k)
{
    const int repeat = 1 + 10000 / b->tets;
    double t[RUNS];
    int run, i;
    for (run = 0; run < RUNS; ++run) {
        t[run] = bench_seconds();
        for (i = 0; i < repeat; ++i) sfem_model_tangent(b->model, b->u, kind, k, NULL);
        t[run] = (bench_seconds() - t[run]) / repeat / b->tets * 1e9;
    }
    return bench_median(t, RUNS);
}

/* largest difference of the forces over the largest force */
static double force_error(const scene *b)
{
    double error = 0, size = 0;
    sfem_int i;
    for (i = 0; i < 3 * b->nodes; ++i) {
        error = fmax(error, fabs(b->force[i] - b->exact[i]));
        size = fmax(size, fabs(b->exact[i]));
    }
    return error / size;
}

/* ---- tables ---- */

static const char *const law_name[] = {"linear", "corotational", "StVK", "neo-Hookean"};

static void forces_by_size(int quick)
{
    static const sfem_int cells[][3] = {{12, 3, 3}, {20, 5, 5}, {40, 10, 10}, {56, 14, 14}};
    int size, law;
    printf("\nforces, ns a tet        tets   double   with R    mixed   mixed's error\n");
    for (size = 0; size < (quick ? 1 : 4); ++size)
        for (law = SFEM_LINEAR; law <= SFEM_NEOHOOKEAN; ++law) {
            scene b = make_scene(cells[size], (sfem_law)law, 0.02, 0);
            const double d = time_forces(&b, SFEM_DOUBLE, NULL, NULL);
            const double r = time_forces(&b, SFEM_DOUBLE, b.rotation, NULL);
            double m;
            memcpy(b.exact, b.force, 3 * (size_t)b.nodes * sizeof *b.force);
            m = time_forces(&b, SFEM_MIXED, NULL, NULL);
            printf("  %-16s %9d %8.1f %8.1f %8.1f   %.1e\n", law_name[law], (int)b.tets, d, r, m,
                   force_error(&b));
            free_scene(&b);
        }
}

static void forces_of_smooth_tets(int quick)
{
    static const sfem_law law[3] = {SFEM_LINEAR, SFEM_COROTATIONAL, SFEM_NEOHOOKEAN};
    const sfem_int n = quick ? 6 : 14, cells[3] = {n, n, n};
    int cell, k;
    printf("\nforces, ns a tet        tets   linear   smooth   smooth/linear\n");
    for (cell = 5; cell <= 6; ++cell)
        for (k = 0; k < 3; ++k) {
            double ns[2];
            int tet, tets = 0;
            for (tet = SFEM_TET_LINEAR; tet <= SFEM_TET_SMOOTH; ++tet) {
                scene b = make_scene_of(cells, cell == 5 ? SFEM_CELL_5_TETS : SFEM_CELL_6_TETS, (sfem_tet)tet, law[k], 0.02, 0);
                ns[tet] = time_forces(&b, SFEM_DOUBLE, NULL, NULL);
                tets = (int)b.tets;
                free_scene(&b);
            }
            printf("  %-16s %9d %8.1f %8.1f   %.2f\n", law_name[law[k]], tets, ns[0], ns[1], ns[1] / ns[0]);
        }
}

static void forces_by_strain(int quick)
{
    static const double strain[] = {1e-4, 1e-3, 1e-2, 1e-1, 3e-1};
    static const int every[] = {20, 5, 1};
    const sfem_int cells[3] = {20, 5, 5};
    sfem_int inverted;
    int i;
    printf("\ncorotational forces by state       double    mixed   mixed's error   inverted\n");
    for (i = 0; i < (quick ? 1 : 8); ++i) {
        scene b = make_scene(cells, SFEM_COROTATIONAL, i < 5 ? strain[i] : 0.02,
                             i < 5 ? 0 : every[i - 5]);
        const double d = time_forces(&b, SFEM_DOUBLE, NULL, &inverted);
        double m;
        memcpy(b.exact, b.force, 3 * (size_t)b.nodes * sizeof *b.force);
        m = time_forces(&b, SFEM_MIXED, NULL, NULL);
        if (i < 5)
            printf("  nodes moved by %-7g of a cell", strain[i]);
        else
            printf("  one node in %-3d thrown far off", every[i - 5]);
        printf(" %8.1f %8.1f   %.1e        %5.1f %%\n", d, m, force_error(&b),
               100.0 * inverted / b.tets);
        free_scene(&b);
    }
}

static void tangents(int quick)
{
    const sfem_int cells[3] = {quick ? 4 : 20, 5, 5};
    int law;
    printf("\ntangents, ns a tet        exact      PSD   frozen\n");
    for (law = SFEM_LINEAR; law <= SFEM_NEOHOOKEAN; ++law) {
        scene b = make_scene(cells, (sfem_law)law, 0.02, 0);
        sfem_matrix k;
        sfem_error err;
        bench_must(sfem_model_combine(b.model, 1, 0, 0, NULL, &k, &err), &err);
        printf("  %-18s %10.0f", law_name[law], time_tangent(&b, SFEM_TANGENT_EXACT, &k));
        printf(" %8.0f", time_tangent(&b, SFEM_TANGENT_PSD, &k));
        printf(" %8.0f\n", time_tangent(&b, SFEM_TANGENT_FROZEN, &k));
        sfem_matrix_free(&k);
        free_scene(&b);
    }
}

static void single(void)
{
    enum { COUNT = 1000 };
    static sfem_real f[COUNT][9];
    sfem_real r[9], u[9], v[9], s[3], t[RUNS], sum = 0;
    int i, k, run, what;
    static const char *const name[] = {"sfem_polar, strained by 10 %", "sfem_polar, random",
                                       "sfem_signed_svd, strained by 10 %"};
    printf("\nsingle matrices, ns\n");
    for (what = 0; what < 3; ++what) {
        for (i = 0; i < COUNT; ++i)
            for (k = 0; k < 9; ++k) f[i][k] = what == 1 ? noise() : 0.2 * noise() + (k % 4 == 0);
        for (run = 0; run < RUNS; ++run) {
            t[run] = bench_seconds();
            for (i = 0; i < COUNT; ++i) {
                if (what < 2)
                    sfem_polar(f[i], r, NULL);
                else
                    sfem_signed_svd(f[i], u, s, v);
                sum += what < 2 ? r[0] : s[0];
            }
            t[run] = (bench_seconds() - t[run]) / COUNT * 1e9;
        }
        printf("  %-36s %6.0f\n", name[what], bench_median(t, RUNS));
    }
    if (sum == 1) printf("\n"); /* so that nothing is optimised away */
}

int main(int argc, char **argv)
{
    const int quick = argc > 1 && !strcmp(argv[1], "--quick");
    printf("vector width: %d doubles (8 AVX-512, 4 AVX2, 1 portable); one thread\n%s\n",
           sfem_vector_width(), SFEM_BENCH_FLAGS);
    forces_by_size(quick);
    forces_of_smooth_tets(quick);
    forces_by_strain(quick);
    tangents(quick);
    single();
    return 0;
}
