/* Modes of clamped blocks of 540 to 55 000 tetrahedra: block Lanczos with its proof against ARPACK on
 * CHOLMOD's factor, which proves nothing.
 *
 *   bench/eigen [largest number of tets] [passes]
 *
 * ARPACK and CHOLMOD take part if compiled with SFEM_BENCH_ARPACK (Debian: libarpack2-dev,
 * libsuitesparse-dev; link -larpack -lcholmod). ARPACK works as it does best: lumped mass, so that the
 * operator root(M) K^-1 root(M) is symmetric and its inner product plain; 2 k vectors, the usual advice;
 * the tolerance at which its backward errors are those asked of block Lanczos, 1e-13. Its time is
 * analysis, factor, iteration, vectors; ours also finds the free axes, assembles, counts, and measures
 * backward errors. All on one core, in turns; medians. Lost: modes below the bound at which the signs
 * of K - tau M were counted, less those that a method returned there. */
#define _GNU_SOURCE
#include "bench.h"
#include "../tests/linear.h"
#include <math.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#ifdef SFEM_BENCH_ARPACK
#include <arpack/arpack.h>
#include <suitesparse/cholmod.h>
#endif

enum { MOST = 64 };

typedef struct outcome {
    double seconds;
    int found;    /* below the bound */
    double error; /* the worst backward error */
    int solves;
} outcome;

typedef struct problem {
    sfem_model *model;
    sfem_int nodes, tets, pin_count, *pins;
    unsigned char *held; /* [nodes] */
} problem;

static problem create(const sfem_int cells[3])
{
    const sfem_real size[3] = {(double)cells[0] / cells[1], 1, (double)cells[2] / cells[1]};
    sfem_model_def def = linear_model_def();
    sfem_error err;
    sfem_mesh mesh;
    problem p;
    sfem_int i;
    bench_must(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), &err);
    def.mesh = &mesh;
    def.material.poisson = 0.45;
    bench_must(sfem_model_create(&def, &p.model, &err), &err);
    p.nodes = mesh.nodes;
    p.tets = mesh.tets;
    p.pins = (sfem_int *)malloc((size_t)mesh.nodes * sizeof *p.pins);
    p.held = (unsigned char *)calloc((size_t)mesh.nodes, 1);
    p.pin_count = 0;
    for (i = 0; i < mesh.nodes; ++i)
        if (mesh.x[3 * i] == 0) {
            p.held[i] = 1;
            p.pins[p.pin_count++] = i;
        }
    sfem_mesh_free(&mesh);
    return p;
}

static outcome ours(const problem *p, int modes, double *bound, int *below)
{
    sfem_modes_def def = sfem_default_modes_def();
    sfem_modes m;
    sfem_error err;
    outcome o;
    int i;
    def.modes = modes;
    def.pins = p->pins;
    def.pin_count = p->pin_count;
    o.seconds = bench_seconds();
    bench_must(sfem_modes_create(p->model, &def, &m, &err), &err);
    o.seconds = bench_seconds() - o.seconds;
    o.solves = m.info.solves;
    o.error = 0;
    for (i = 0; i < m.count; ++i) o.error = fmax(o.error, m.error[i]);
    o.found = m.count;
    *bound = m.info.verified ? m.info.bound : 0;
    *below = m.info.below;
    if (*below > m.count) { /* the bound lies above a cluster that the last mode is in */
        *bound = m.lambda[m.count - 1] * (1 + 1e-9);
        *below = m.count;
    }
    sfem_modes_free(&m);
    return o;
}

#ifdef SFEM_BENCH_ARPACK
typedef struct matrices { /* the free axes: K's lower half by columns, M's diagonal */
    int n;
    cholmod_sparse *k;
    double *root, norm_k, norm_m;
} matrices;

static matrices extract(const problem *p, cholmod_common *common)
{
    const sfem_matrix *k = sfem_model_stiffness(p->model);
    const sfem_real *mass = sfem_model_node_mass(p->model);
    int *number = (int *)malloc((size_t)p->nodes * sizeof *number), i, at, r, c, free_nodes = 0;
    size_t entries = 0, e = 0;
    cholmod_triplet *t;
    double *sum;
    matrices m;
    for (i = 0; i < p->nodes; ++i) number[i] = p->held[i] ? -1 : free_nodes++;
    for (i = 0; i < p->nodes; ++i)
        for (at = k->row[i]; at < k->row[i + 1]; ++at)
            if (!p->held[i] && !p->held[k->col[at]]) entries += k->col[at] == i ? 6 : 9;
    m.n = 3 * free_nodes;
    m.root = (double *)malloc((size_t)m.n * sizeof *m.root);
    sum = (double *)calloc((size_t)m.n, sizeof *sum);
    t = cholmod_allocate_triplet((size_t)m.n, (size_t)m.n, entries, -1, CHOLMOD_REAL, common);
    for (i = 0; i < p->nodes; ++i)
        for (at = k->row[i]; at < k->row[i + 1]; ++at)
            for (r = 0; r < 3; ++r)
                for (c = 0; c < 3; ++c) {
                    const int j = k->col[at], u = 3 * number[i] + r, v = 3 * number[j] + c;
                    const double x = k->val[9 * (size_t)at + (size_t)(3 * r + c)];
                    if (p->held[i] || p->held[j] || u < v) continue;
                    ((int *)t->i)[e] = u;
                    ((int *)t->j)[e] = v;
                    ((double *)t->x)[e++] = x;
                    sum[u] += fabs(x);
                    if (u != v) sum[v] += fabs(x);
                }
    t->nnz = e;
    m.k = cholmod_triplet_to_sparse(t, e, common);
    m.norm_k = m.norm_m = 0;
    for (i = 0; i < p->nodes; ++i)
        for (c = 0; c < 3 && !p->held[i]; ++c) {
            m.root[3 * number[i] + c] = sqrt(mass[i]);
            m.norm_m = fmax(m.norm_m, mass[i]);
            m.norm_k = fmax(m.norm_k, sum[3 * number[i] + c]);
        }
    cholmod_free_triplet(&t, common);
    free(number);
    free(sum);
    return m;
}

static double backward(const matrices *m, const double *y, double lambda, double *x, double *z)
{
    const int *start = (const int *)m->k->p, *row = (const int *)m->k->i;
    const double *value = (const double *)m->k->x;
    double rest = 0, length = 0;
    int i, at;
    for (i = 0; i < m->n; ++i) {
        x[i] = y[i] / m->root[i];
        z[i] = -lambda * m->root[i] * y[i];
    }
    for (i = 0; i < m->n; ++i)
        for (at = start[i]; at < start[i + 1]; ++at) {
            z[row[at]] += value[at] * x[i];
            if (row[at] != i) z[i] += value[at] * x[row[at]];
        }
    for (i = 0; i < m->n; ++i) {
        rest += z[i] * z[i];
        length += x[i] * x[i];
    }
    return sqrt(rest / length) / (m->norm_k + lambda * m->norm_m);
}

static outcome arpack(const matrices *m, int modes, double bound, cholmod_common *common)
{
    const size_t n = (size_t)m->n;
    const int vectors = 2 * modes < m->n ? 2 * modes : m->n;
    const int length = vectors * (vectors + 8);
    double *v = (double *)malloc(n * (size_t)vectors * sizeof *v);
    double *work = (double *)malloc(3 * n * sizeof *work),
           *rest = (double *)malloc(n * sizeof *rest);
    double *large = (double *)malloc((size_t)length * sizeof *large);
    double *theta = (double *)malloc((size_t)modes * sizeof *theta);
    int *select = (int *)malloc((size_t)vectors * sizeof *select);
    int parameters[11] = {1, 0, 1000, 1, 0, 0, 1, 0, 0, 0, 0}, place[11], ido = 0, info = 0, i;
    cholmod_dense *b = cholmod_allocate_dense(n, 1, n, CHOLMOD_REAL, common), *x = NULL, *y = NULL,
                  *e = NULL;
    cholmod_factor *factor;
    outcome o;
    o.solves = 0;
    o.seconds = bench_seconds();
    factor = cholmod_analyze(m->k, common);
    cholmod_factorize(m->k, factor, common);
    for (;;) {
        dsaupd_c(&ido, "I", m->n, "LM", modes, 1e-12, rest, vectors, v, m->n, parameters, place,
                 work, large, length, &info);
        if (ido != 1 && ido != -1) break;
        for (i = 0; i < m->n; ++i) ((double *)b->x)[i] = m->root[i] * work[place[0] - 1 + i];
        cholmod_solve2(CHOLMOD_A, factor, b, NULL, &x, NULL, &y, &e, common);
        for (i = 0; i < m->n; ++i) work[place[1] - 1 + i] = m->root[i] * ((double *)x->x)[i];
        ++o.solves;
    }
    dseupd_c(1, "A", select, theta, v, m->n, 0, "I", m->n, "LM", modes, 1e-12, rest, vectors, v,
             m->n, parameters, place, work, large, length, &info);
    o.seconds = bench_seconds() - o.seconds;
    if (info != 0) fprintf(stderr, "ARPACK: info %d\n", info);
    o.found = 0;
    o.error = 0;
    for (i = 0; i < modes; ++i) {
        o.found += 1 / theta[i] < bound;
        o.error = fmax(o.error, backward(m, v + (size_t)i * n, 1 / theta[i], work, work + n));
    }
    cholmod_free_factor(&factor, common);
    cholmod_free_dense(&b, common);
    cholmod_free_dense(&x, common);
    cholmod_free_dense(&y, common);
    cholmod_free_dense(&e, common);
    free(v);
    free(work);
    free(rest);
    free(large);
    free(theta);
    free(select);
    return o;
}
#endif

static void row(const sfem_int cells[3], int modes, int passes)
{
    problem p = create(cells);
    double t[2][MOST], bound = 0;
    outcome us;
    int below = 0, pass;
#ifdef SFEM_BENCH_ARPACK
    cholmod_common common;
    outcome them;
    matrices m;
    memset(&them, 0, sizeof them);
    cholmod_start(&common);
    m = extract(&p, &common);
#endif
    us = ours(&p, modes, &bound, &below); /* the first of each is not counted */
    for (pass = 0; pass < passes; ++pass) {
        us = ours(&p, modes, &bound, &below);
        t[0][pass] = us.seconds;
#ifdef SFEM_BENCH_ARPACK
        them = arpack(&m, modes, bound, &common);
        t[1][pass] = them.seconds;
#endif
    }
    printf("%7d %5d | %9.2f %6d %5d %8.1e", (int)p.tets, modes, 1e3 * bench_median(t[0], passes),
           us.solves, below - us.found, us.error);
#ifdef SFEM_BENCH_ARPACK
    printf(" | %9.2f %6d %5d %8.1e | %5.2f %5.2f%s", 1e3 * bench_median(t[1], passes), them.solves,
           below - them.found, them.error, bench_median(t[0], passes) / bench_median(t[1], passes),
           p.tets < 6860 ? 1.0
           : modes < 40  ? 0.75
                         : 0.65,
           below > them.found ? "  ARPACK lost modes" : "");
    cholmod_free_sparse(&m.k, &common);
    cholmod_finish(&common);
    free(m.root);
#endif
    printf("\n");
    fflush(stdout);
    sfem_model_free(p.model);
    free(p.pins);
    free(p.held);
}

int main(int argc, char **argv)
{
    static const sfem_int cells[][3] = {{12, 3, 3}, {15, 4, 4},   {20, 5, 5},  {28, 7, 7},
                                        {33, 9, 9}, {40, 10, 10}, {56, 14, 14}};
    const double most = argc > 1 ? atof(argv[1]) : 60000;
    const int given = argc > 2 ? atoi(argv[2]) : 0;
    cpu_set_t core;
    size_t i;
    int k;
    CPU_ZERO(&core);
    CPU_SET((size_t)sched_getcpu(), &core);
    sched_setaffinity(0, sizeof core, &core);
#ifdef SFEM_BENCH_FLAGS
    printf("%s\n", SFEM_BENCH_FLAGS);
#endif
    printf("   tets modes |  block Lanczos, proof included |  ARPACK + CHOLMOD, no proof    |\n"
           "              |        ms solves  lost    error |        ms solves  lost    error | "
           "ratio  goal\n");
    for (i = 0; i < sizeof cells / sizeof *cells; ++i)
        for (k = 20; k <= 60; k += 40) {
            const double tets = 5.0 * cells[i][0] * cells[i][1] * cells[i][2];
            const int passes = tets < 3000 ? 15 : tets < 10000 ? 9 : tets < 30000 ? 5 : 3;
            if (tets <= most) row(cells[i], k, given > 0 && given < MOST ? given : passes);
        }
    return 0;
}
