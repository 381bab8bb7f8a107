/* The sparse solver against CHOLMOD, one core and two: the library's blocks (sfem_mesh_block) of 540 to 160 000
 * tetrahedra, and real meshes, where SFEM_MESHES names their directory.
 *
 *   bench/solver [largest number of tets] [most passes] [mesh files]
 *
 * CHOLMOD takes part if compiled with SFEM_BENCH_CHOLMOD (Debian: libsuitesparse-dev, libopenblas-dev; link -lcholmod
 * -lopenblas), METIS's ordering with SFEM_BENCH_METIS (libmetis-dev; -lmetis). CHOLMOD is taken at its best:
 * supernodal or simplicial, AMD or METIS, whichever is the fastest on the matrix, and with one
 * OpenMP thread, as Debian's build else starts four on one core. All of one row is measured in
 * turns in one process, on the core where it starts, which taskset chooses; medians. A factor's time counts all that
 * it needs for the solves that follow.
 */
#define _GNU_SOURCE
#include "bench.h"
#include "../tests/block_fem.h"
#include <limits.h>
#include <sched.h>
#include <stdio.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>
#ifdef SFEM_BENCH_CHOLMOD
#include <suitesparse/cholmod.h>
#endif
#ifdef SFEM_BENCH_METIS
#include <metis.h>
#endif

enum { MOST = 400 };

/* On one core the processor's time, since others may be at work; on two the clock's, since threads share the work. */
static clockid_t watch = CLOCK_MONOTONIC;

static double now(void)
{
    struct timespec t;
    clock_gettime(watch, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void machine(void)
{
    char line[256];
    FILE *f = fopen("/proc/cpuinfo", "r");
    while (f && fgets(line, sizeof line, f))
        if (!strncmp(line, "model name", 10)) {
            printf("machine   %s", strchr(line, ':') + 2);
            break;
        }
    if (f) fclose(f);
    printf("cores     %ld\ncompiler  %s\n", sysconf(_SC_NPROCESSORS_ONLN), __VERSION__);
#ifdef SFEM_BENCH_FLAGS
    printf("flags     %s\n", SFEM_BENCH_FLAGS);
#endif
}

#ifdef SFEM_BENCH_CHOLMOD
typedef struct rival {
    cholmod_common c;
    cholmod_sparse *a;
    cholmod_factor *l;
    cholmod_dense *b, *x, *y, *e;
    double analyse;
} rival;

static cholmod_sparse *rival_matrix(const sfem_matrix *m, cholmod_common *c)
{
    const size_t count = sfem_matrix_csr_count(m), n = 3 * (size_t)m->n;
    int *row = (int *)malloc((n + 1) * sizeof *row), *col = (int *)malloc(count * sizeof *col);
    double *val = (double *)malloc(count * sizeof *val);
    cholmod_sparse *a;
    size_t i, at = 0;
    int k;
    sfem_matrix_to_csr(m, row, col, val, NULL);
    a = cholmod_allocate_sparse(n, n, count, 1, 1, 1, CHOLMOD_REAL, c); /* upper by columns */
    for (i = 0; i < n; ++i) {
        ((int *)a->p)[i] = (int)at;
        for (k = row[i]; k < row[i + 1]; ++k)
            if (col[k] <= (int)i) {
                ((int *)a->i)[at] = col[k];
                ((double *)a->x)[at++] = val[k];
            }
    }
    ((int *)a->p)[n] = (int)at;
    free(row);
    free(col);
    free(val);
    return a;
}

static void rival_open(rival *r, const sfem_matrix *m, const double *b, int method, int mode,
                       int factor)
{
    double t;
    size_t i;
    memset(r, 0, sizeof *r);
    cholmod_start(&r->c);
    r->c.nmethods = 1;
    r->c.method[0].ordering = method;
    r->c.postorder = 1;
    r->c.supernodal = mode;
    r->c.final_ll = 1;
    r->a = rival_matrix(m, &r->c);
    t = now();
    r->l = cholmod_analyze(r->a, &r->c);
    r->analyse = now() - t;
    if (factor) cholmod_factorize(r->a, r->l, &r->c);
    r->b = cholmod_allocate_dense(r->a->nrow, 1, r->a->nrow, CHOLMOD_REAL, &r->c);
    for (i = 0; i < r->a->nrow; ++i) ((double *)r->b->x)[i] = b[i];
}

static double rival_factor(rival *r)
{
    const double t = now();
    cholmod_factorize(r->a, r->l, &r->c);
    return now() - t;
}

static double rival_solve(rival *r)
{
    const double t = now();
    cholmod_solve2(CHOLMOD_A, r->l, r->b, NULL, &r->x, NULL, &r->y, &r->e, &r->c);
    return now() - t;
}

static void rival_close(rival *r)
{
    cholmod_free_dense(&r->b, &r->c);
    cholmod_free_dense(&r->x, &r->c);
    cholmod_free_dense(&r->y, &r->c);
    cholmod_free_dense(&r->e, &r->c);
    cholmod_free_factor(&r->l, &r->c);
    cholmod_free_sparse(&r->a, &r->c);
    cholmod_finish(&r->c);
}

#endif

#ifdef SFEM_BENCH_METIS
/* Operations of L with METIS's ordering of the node graph, counted as the library counts its own.
 */
static double metis_flops(const block_fem *f)
{
    const sfem_matrix *a = &f->a;
    idx_t n = a->n, *start = (idx_t *)calloc((size_t)n + 2, sizeof *start), *adj, *perm, *inverse;
    sfem_int i, k, *bi, *bj;
    sfem_matrix permuted;
    double flops, *bv = NULL;
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_ldl *ldl = NULL;
    for (i = 0; i < n; ++i)
        for (k = a->row[i]; k < a->row[i + 1] - 1; ++k) {
            ++start[i + 2];
            ++start[a->col[k] + 2];
        }
    for (i = 0; i < n; ++i) start[i + 2] += start[i + 1];
    adj = (idx_t *)malloc(((size_t)start[n + 1] + 1) * sizeof *adj);
    for (i = 0; i < n; ++i)
        for (k = a->row[i]; k < a->row[i + 1] - 1; ++k) {
            adj[start[i + 1]++] = a->col[k];
            adj[start[a->col[k] + 1]++] = i;
        }
    perm = (idx_t *)malloc((size_t)n * sizeof *perm);
    inverse = (idx_t *)malloc((size_t)n * sizeof *inverse);
    METIS_NodeND(&n, start, adj, NULL, NULL, perm, inverse);
    bi = (sfem_int *)malloc((size_t)a->row[n] * sizeof *bi);
    bj = (sfem_int *)malloc((size_t)a->row[n] * sizeof *bj);
    bv = (double *)calloc((size_t)a->row[n] * 9, sizeof *bv);
    for (i = 0; i < n; ++i)
        for (k = a->row[i]; k < a->row[i + 1]; ++k) {
            bi[k] = inverse[i];
            bj[k] = inverse[a->col[k]];
            if (i == a->col[k])
                bv[9 * (size_t)k] = bv[9 * (size_t)k + 4] = bv[9 * (size_t)k + 8] = 1;
        }
    sfem_matrix_create(a->n, a->row[n], bi, bj, bv, NULL, &permuted, NULL);
    def.ordering = SFEM_ORDER_NATURAL;
    sfem_ldl_create(&def, &permuted, &ldl, NULL);
    flops = sfem_ldl_get_info(ldl).flops;
    sfem_ldl_free(ldl);
    sfem_matrix_free(&permuted);
    free(bi);
    free(bj);
    free(bv);
    free(perm);
    free(inverse);
    free(start);
    free(adj);
    return flops;
}
#endif

typedef struct times {
    double v[MOST];
    int n;
} times;

static void take(times *t, double v)
{
    if (t->n < MOST) t->v[t->n++] = v;
}

static double factor_time(sfem_ldl *ldl, const sfem_matrix *a)
{
    const double t = now();
    sfem_ldl_refactor(ldl, a, NULL);
    return now() - t;
}

static double solve_time(const sfem_ldl *ldl, int rhs, double *x, const double *b, double *work,
                         const sfem_exec *exec)
{
    const size_t n = 3 * (size_t)sfem_ldl_get_info(ldl).n;
    double t;
    int r;
    for (r = 0; r < rhs; ++r) memcpy(x + (size_t)r * n, b, n * sizeof *x);
    t = now();
    sfem_ldl_solve(ldl, rhs, x, work, exec);
    return now() - t;
}

static void *refuse(size_t bytes, void *user)
{
    return bytes > *(const size_t *)user ? NULL : malloc(bytes);
}

static void release(void *memory, void *user)
{
    (void)user;
    free(memory);
}

/* Everything on one core. */
static void row_one(const char *name, const block_fem *f, int passes)
{
    static times factor, solve, solve32, solve8, factor32, rfactor, rsolve;
    double analyse = 0;
    size_t limit;
    const size_t n = 3 * (size_t)f->n;
    double *b = (double *)malloc(n * sizeof *b), *x = (double *)malloc(8 * n * sizeof *x), *work, t;
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_ldl *ldl = NULL, *ldl32 = NULL;
    sfem_ldl_info info;
    sfem_error err;
    size_t i;
    int k;
    factor.n = solve.n = solve32.n = solve8.n = factor32.n = rfactor.n = rsolve.n = 0;
    def.x = f->x;
    for (i = 0; i < n; ++i) b[i] = sin(1.3 * (double)i);
    if (sfem_ldl_create(&def, &f->a, &ldl, &err) != SFEM_OK) {
        printf("%-10s %s\n", name, err.text);
        goto done;
    }
    limit = sfem_ldl_get_info(ldl).factor_bytes / 2;
    def.allocator.allocate = refuse;
    def.allocator.release = release;
    def.allocator.user = &limit;
    for (k = 0; k < 7; ++k) { /* the analysis alone: stopped where it asks for the memory of L */
        sfem_ldl *none = NULL;
        t = now();
        if (sfem_ldl_create(&def, &f->a, &none, &err) != SFEM_OUT_OF_MEMORY) goto done;
        t = now() - t;
        if (k == 0 || t < analyse) analyse = t;
    }
    memset(&def.allocator, 0, sizeof def.allocator);
    def.precision = SFEM_MIXED;
    if (sfem_ldl_create(&def, &f->a, &ldl32, &err) != SFEM_OK) goto done;
    info = sfem_ldl_get_info(ldl);
    work = (double *)malloc(sfem_ldl_work_size(ldl, 8) * sizeof *work);
    {
#ifdef SFEM_BENCH_CHOLMOD
        static const struct {
            int method, mode;
            const char *name;
        } way[3] = {{CHOLMOD_AMD, CHOLMOD_SUPERNODAL, "AMD, supernodal"},
                    {CHOLMOD_METIS, CHOLMOD_SUPERNODAL, "METIS, supernodal"},
                    {CHOLMOD_AMD, CHOLMOD_SIMPLICIAL, "AMD, simplicial"}};
        int best_factor = -1, best_solve = -1, w;
        double least = 0, least_solve = 0, amd = 0;
        rival r;
        for (k = 0; k < 5; ++k) {
            rival_open(&r, &f->a, b, CHOLMOD_AMD, CHOLMOD_SUPERNODAL, 0);
            if (k == 0 || r.analyse < amd) amd = r.analyse;
            rival_close(&r);
        }
        for (w = 0; w < (f->n > 3000 ? 2 : 3); ++w) { /* which is its best? */
            double tf = 1e9, ts = 1e9;
            rival_open(&r, &f->a, b, way[w].method, way[w].mode, 1);
            for (k = 0; k < 5 && (k < 2 || f->n < 20000); ++k) {
                t = rival_factor(&r);
                if (t < tf) tf = t;
                t = rival_solve(&r);
                if (t < ts) ts = t;
            }
            if (best_factor < 0 || tf < least) {
                least = tf;
                best_factor = w;
            }
            if (best_solve < 0 || ts < least_solve) {
                least_solve = ts;
                best_solve = w;
            }
            rival_close(&r);
        }
        rival_open(&r, &f->a, b, way[best_factor].method, way[best_factor].mode, 1);
#endif
        for (k = 0; k < passes; ++k) {
#ifdef SFEM_BENCH_CHOLMOD
            take(&rfactor, rival_factor(&r));
#endif
            take(&factor, factor_time(ldl, &f->a));
            take(&factor32, factor_time(ldl32, &f->a));
        }
#ifdef SFEM_BENCH_CHOLMOD
        if (best_solve != best_factor) {
            rival_close(&r);
            rival_open(&r, &f->a, b, way[best_solve].method, way[best_solve].mode, 1);
        }
#endif
        for (k = 0; k < 3 * passes; ++k) {
#ifdef SFEM_BENCH_CHOLMOD
            take(&rsolve, rival_solve(&r));
#endif
            take(&solve, solve_time(ldl, 1, x, b, work, NULL));
            take(&solve32, solve_time(ldl32, 1, x, b, work, NULL));
            if (k % 3 == 0) take(&solve8, solve_time(ldl, 8, x, b, work, NULL));
        }
        printf("%-9s %8.3f %8.3f %9.1f %9.1f %6.2f %8.2f %7.1f %8.3g %-5s", name,
               1e3 * bench_median(factor.v, factor.n), 1e3 * bench_median(factor32.v, factor32.n),
               1e6 * bench_median(solve.v, solve.n), 1e6 * bench_median(solve32.v, solve32.n),
               bench_median(solve8.v, solve8.n) / bench_median(solve.v, solve.n), 1e3 * analyse,
               1e-6 * (double)info.bytes, info.flops,
               info.ordering == SFEM_ORDER_AMD ? "AMD" : "cuts");
#ifdef SFEM_BENCH_METIS
        printf(" %5.2f", info.flops / metis_flops(f));
#endif
#ifdef SFEM_BENCH_CHOLMOD
        printf(" | %8.3f %9.1f %8.2f | %5.2f %5.2f %5.2f %5.2f  %s\n",
               1e3 * bench_median(rfactor.v, rfactor.n), 1e6 * bench_median(rsolve.v, rsolve.n),
               1e3 * amd, bench_median(factor.v, factor.n) / bench_median(rfactor.v, rfactor.n),
               bench_median(solve.v, solve.n) / bench_median(rsolve.v, rsolve.n),
               bench_median(solve32.v, solve32.n) / bench_median(rsolve.v, rsolve.n), analyse / amd,
               best_factor == best_solve ? way[best_factor].name : "factor and solve differ");
        rival_close(&r);
#else
        printf("\n");
#endif
        fflush(stdout);
    }
    free(work);
done:
    sfem_ldl_free(ldl);
    sfem_ldl_free(ldl32);
    free(b);
    free(x);
}

/* Two threads against one, and whether the bits agree. */
static void row_two(const char *name, const block_fem *f, int passes)
{
    static times factor[2], solve[2];
    const size_t n = 3 * (size_t)f->n;
    double *b = (double *)malloc(n * sizeof *b), *x[2], *work[2];
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_ldl *ldl[2] = {NULL, NULL};
    sfem_exec exec;
    size_t i;
    int k, p;
    def.x = f->x;
    memset(&exec, 0, sizeof exec);
    for (i = 0; i < n; ++i) b[i] = sin(1.3 * (double)i);
    for (p = 0; p < 2; ++p) {
        factor[p].n = solve[p].n = 0;
        def.exec.threads = p + 1;
        x[p] = (double *)malloc(n * sizeof **x);
        if (sfem_ldl_create(&def, &f->a, &ldl[p], NULL) != SFEM_OK) return;
        work[p] = (double *)malloc(sfem_ldl_work_size(ldl[p], 1) * sizeof **work);
    }
    for (k = 0; k < passes; ++k)
        for (p = 0; p < 2; ++p) take(&factor[p], factor_time(ldl[p], &f->a));
    for (k = 0; k < 3 * passes; ++k)
        for (p = 0; p < 2; ++p) {
            exec.threads = p + 1;
            take(&solve[p], solve_time(ldl[p], 1, x[p], b, work[p], &exec));
        }
    printf("%-9s %8.3f %8.3f %6.2f   %9.1f %9.1f %6.2f   %s\n", name,
           1e3 * bench_median(factor[0].v, factor[0].n),
           1e3 * bench_median(factor[1].v, factor[1].n),
           bench_median(factor[0].v, factor[0].n) / bench_median(factor[1].v, factor[1].n),
           1e6 * bench_median(solve[0].v, solve[0].n), 1e6 * bench_median(solve[1].v, solve[1].n),
           bench_median(solve[0].v, solve[0].n) / bench_median(solve[1].v, solve[1].n),
           memcmp(x[0], x[1], n * sizeof **x) ? "BITS DIFFER" : "same bits");
    fflush(stdout);
    for (p = 0; p < 2; ++p) {
        sfem_ldl_free(ldl[p]);
        free(x[p]);
        free(work[p]);
    }
    free(b);
}

/* A = K h^2/4 + M of a mesh held at the lower end of its longest side, h = 1/60 s; assembled from scratch. */
static block_fem held(const sfem_mesh *mesh)
{
    unsigned char *clamp = (unsigned char *)malloc((size_t)mesh->nodes);
    sfem_mesh_report report;
    block_fem f;
    sfem_int i;
    int k, axis = 0;
    sfem_mesh_check(mesh, &report, NULL);
    for (k = 1; k < 3; ++k)
        if (report.box[1][k] - report.box[0][k] > report.box[1][axis] - report.box[0][axis]) axis = k;
    memset(clamp, 1, (size_t)mesh->nodes); /* nodes of no tet are left out */
    for (i = 0; i < 4 * mesh->tets; ++i) {
        const double x = mesh->x[3 * mesh->tet[i] + axis] - report.box[0][axis];
        clamp[mesh->tet[i]] = x < .02 * (report.box[1][axis] - report.box[0][axis]);
    }
    f = block_fem_assemble(mesh->nodes, mesh->x, mesh->tets, mesh->tet, clamp, 1e6, .45, 1000, 1. / 14400, 1);
    free(clamp);
    return f;
}

/* Of cubes of which cells[2] make a metre. */
static block_fem held_block(const sfem_int cells[3], sfem_block_cells kind)
{
    const sfem_real size[3] = {(double)cells[0] / cells[2], (double)cells[1] / cells[2], 1};
    sfem_mesh mesh;
    sfem_error err;
    block_fem f;
    if (sfem_mesh_block(cells, size, kind, NULL, &mesh, &err) != SFEM_OK) {
        printf("%s\n", err.text);
        exit(1);
    }
    f = held(&mesh);
    sfem_mesh_free(&mesh);
    return f;
}

/* Small bodies: the sparse factor, analysis included, beside the dense one; medians, us. */
static void dense_rows(void)
{
    static const sfem_int cells[][3] = {{1, 1, 1}, {2, 1, 1}, {4, 1, 1}, {6, 1, 1}, {8, 1, 1}, {5, 2, 2}, {9, 2, 2}};
    double t[4][MOST];
    size_t i;
    printf("\ndense     scalars  sparse factor, solve  dense factor, solve, us\n");
    for (i = 0; i < sizeof cells / sizeof *cells; ++i) {
        block_fem f = held_block(cells[i], SFEM_CELL_5_TETS);
        const size_t n = 3 * (size_t)f.n;
        double *a = (double *)malloc(n * n * sizeof *a), *x = (double *)calloc(n, sizeof *x), *work;
        sfem_ldl_def def = sfem_default_ldl_def();
        sfem_ldl *ldl = NULL;
        int k, j;
        def.x = f.x;
        for (k = 0; k < 100; ++k) {
            double start = now();
            sfem_ldl_free(ldl);
            if (sfem_ldl_create(&def, &f.a, &ldl, NULL)) return;
            t[0][k] = now() - start;
            work = (double *)malloc((sfem_ldl_work_size(ldl, 1) + 1) * sizeof *work);
            start = now();
            for (j = 0; j < 20; ++j) sfem_ldl_solve(ldl, 1, x, work, NULL);
            t[1][k] = (now() - start) / 20;
            free(work);
            start = now();
            sfem_matrix_to_dense(&f.a, a);
            if (sfem_dense_cholesky((sfem_int)n, a, NULL)) return;
            t[2][k] = now() - start;
            start = now();
            for (j = 0; j < 20; ++j) sfem_dense_cholesky_solve((sfem_int)n, a, 1, x);
            t[3][k] = (now() - start) / 20;
        }
        printf("          %7d  %13.2f  %5.2f  %12.2f  %5.2f\n", (int)n,
               1e6 * bench_median(t[0], 100), 1e6 * bench_median(t[1], 100),
               1e6 * bench_median(t[2], 100), 1e6 * bench_median(t[3], 100));
        sfem_ldl_free(ldl);
        block_fem_free(&f);
        free(a);
        free(x);
    }
}

static const struct {
    const char *name;
    sfem_int tets, cells[3];
    sfem_block_cells kind;
} block[] = {{"540", 540, {12, 3, 3}, SFEM_CELL_5_TETS},         {"2.5k", 2500, {20, 5, 5}, SFEM_CELL_5_TETS},
             {"7k", 6860, {28, 7, 7}, SFEM_CELL_5_TETS},         {"20k", 20000, {40, 10, 10}, SFEM_CELL_5_TETS},
             {"55k", 54880, {56, 14, 14}, SFEM_CELL_5_TETS},     {"160k", 160000, {80, 20, 20}, SFEM_CELL_5_TETS},
             {"6 tets 3k", 3000, {20, 5, 5}, SFEM_CELL_6_TETS},  {"6 tets 24k", 24000, {40, 10, 10}, SFEM_CELL_6_TETS}};

/* Of others, in SFEM_MESHES. */
static const char *const real[] = {"mj_shark_ascii22.msh", "igl_octopus_low.mesh", "pbd_armadillo_4k.node",
                                   "vega_comb.veg",        "vega_helix.veg",       "ipc_rod300x33.msh"};

static int passes_of(sfem_int tets, int most)
{
    int passes = (int)(4e6 / tets / (1 + tets / 2e4));
    if (passes > MOST / 3) passes = MOST / 3;
    if (passes > most) passes = most;
    return passes < 3 ? 3 : passes;
}

/* A mesh from a file. */
static void given(void (*row)(const char *, const block_fem *, int), const char *path, long largest, int most)
{
    const char *name = strrchr(path, '/') ? strrchr(path, '/') + 1 : path;
    sfem_error err;
    sfem_mesh mesh;
    block_fem f;
    if (sfem_mesh_read(path, NULL, &mesh, &err) || sfem_mesh_check(&mesh, NULL, &err)) {
        printf("%.12s: %s\n", name, err.text);
        return;
    }
    if (mesh.tets <= largest) {
        f = held(&mesh);
        row(name, &f, passes_of(mesh.tets, most));
        block_fem_free(&f);
    }
    sfem_mesh_free(&mesh);
}

static void rows(void (*row)(const char *, const block_fem *, int), long largest, int most,
                 char **mesh)
{
    const char *directory = getenv("SFEM_MESHES");
    char path[1024];
    size_t i;
    for (i = 0; i < sizeof block / sizeof *block; ++i) {
        block_fem f;
        if (block[i].tets > largest) continue;
        f = held_block(block[i].cells, block[i].kind);
        row(block[i].name, &f, passes_of(block[i].tets, most));
        block_fem_free(&f);
    }
    for (i = 0; directory && i < sizeof real / sizeof *real; ++i) {
        snprintf(path, sizeof path, "%s/%s", directory, real[i]);
        if (access(path, R_OK) == 0) given(row, path, largest, most);
    }
    while (*mesh) given(row, *mesh++, LONG_MAX, most);
}

int main(int argc, char **argv)
{
    const long largest = argc > 1 ? atol(argv[1]) : 60000;
    const int most = argc > 2 ? atoi(argv[2]) : 100;
    pid_t child;
    /* one core: OpenMP reads its limits when the program starts, so start it again */
    if (getenv("SFEM_BENCH_ONE_CORE")) {
        cpu_set_t set;
        watch = CLOCK_PROCESS_CPUTIME_ID;
        CPU_ZERO(&set);
        CPU_SET((size_t)sched_getcpu(), &set);
        sched_setaffinity(0, sizeof set, &set);
        machine();
        printf("\none core  factor ms, with float copy; solve us, f64, f32, 8 at once / 1; "
               "analysis ms;"
               " MB; flops of L, over those with METIS's ordering\n          and CHOLMOD's factor, solve, AMD "
               "analysis; ratios of factor, solve f64, f32, analysis\n");
#ifndef SFEM_BENCH_METIS
        printf("          without METIS: install libmetis-dev\n");
#endif
#ifndef SFEM_BENCH_CHOLMOD
        printf("          without CHOLMOD: install libsuitesparse-dev libopenblas-dev\n");
#endif
        rows(row_one, largest, most, argv + (argc > 3 ? 3 : argc));
        dense_rows();
        return 0;
    }
    child = fork();
    if (child == 0) {
        setenv("OMP_THREAD_LIMIT", "1", 1);
        setenv("OPENBLAS_NUM_THREADS", "1", 1);
        setenv("SFEM_BENCH_ONE_CORE", "1", 1);
        execv("/proc/self/exe", argv);
        _exit(1);
    }
    waitpid(child, NULL, 0);
    printf("\ntwo cores factor ms with 1 and 2 threads, gain; solve us likewise\n");
    rows(row_two, largest, most, argv + (argc > 3 ? 3 : argc));
    return 0;
}
