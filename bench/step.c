/* step - what a step of a soft body that swings costs, beside semi-implicit steps of the same body.
 *
 *   bench/step [--quick] [largest number of tets, 54880] [mesh files]
 *
 * Corotational blocks of 2 x .5 x .5 m, 540 to 160 000 tets, and meshes from files, held at one end of
 * their longest side, E = 1e6 Pa, nu = .45, falling under gravity from rest with h = 1/60 s. The default
 * step, guarded (p,q,r) with a turned factor, is set against the faster of two semi-implicit
 * Newmark steps, one tangent, one factorisation and one solve each: the library's own (newton.iterations
 * = 1), and one that uses the library's forces and tangents and CHOLMOD (Debian: libsuitesparse-dev)
 * at its best, with one OpenMP thread, as its build else starts four on one core. All are
 * stepped in turns, some steps at a time, on one core; medians. The ceiling is 2 readings of L, at the
 * rate at which this machine sums an array of its size in the same run.
 *
 * The library is compiled in, so that its parts can be timed.
 */
#define _GNU_SOURCE
#define SFEM_STATIC
#define SOFTFEM_IMPLEMENTATION
#include "softfem.h"
#include <sched.h>
#include <sys/wait.h>
#include <unistd.h>
#ifdef SFEM_BENCH_CHOLMOD
#include <suitesparse/cholmod.h>
#endif
#include "../examples/support.h"

#define STEP (1 / 60.0)
enum { MOST = 400, BODIES = 6 };
enum { PLAIN, FLOATS, ONCE, TWICE, HIGHER, NEWMARK };

typedef struct times {
    double v[MOST], sum;
    int n;
} times;

static void take(times *t, double v)
{
    if (t->n == MOST) return;
    t->v[t->n++] = v;
    t->sum += v;
}

static int compare(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(const times *t)
{
    double v[MOST];
    memcpy(v, t->v, sizeof v);
    qsort(v, (size_t)t->n, sizeof *v, compare);
    return t->n ? v[t->n / 2] : 0;
}

/* Of the processor: others may be using it, too. */
static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static double mean(const times *t) { return t->n ? t->sum / t->n : 0; }

static void must(sfem_status status, const sfem_error *err)
{
    if (status != SFEM_OK) ex_fail("%s", err->text);
}

/* bytes a second, of summing an array of so many bytes */
#if defined(__GNUC__)
typedef double lanes __attribute__((vector_size(32), aligned(8), may_alias));
#if defined(__x86_64__)
__attribute__((target("avx2")))
#endif
static double
sum(const double *x, size_t n)
{
    lanes a = {0, 0, 0, 0}, b = a, c = a, d = a;
    size_t i;
    for (i = 0; i + 16 <= n; i += 16) {
        a += *(const lanes *)(const void *)(x + i);
        b += *(const lanes *)(const void *)(x + i + 4);
        c += *(const lanes *)(const void *)(x + i + 8);
        d += *(const lanes *)(const void *)(x + i + 12);
    }
    a += b + c + d;
    return a[0] + a[1] + a[2] + a[3];
}
#else
static double sum(const double *x, size_t n)
{
    double a = 0, b = 0, c = 0, d = 0;
    size_t i;
    for (i = 0; i + 4 <= n; i += 4) a += x[i], b += x[i + 1], c += x[i + 2], d += x[i + 3];
    return a + b + c + d;
}
#endif

static double bandwidth(size_t bytes)
{
    const size_t n = bytes / sizeof(double) + 16;
    double *x = (double *)ex_new(n, sizeof *x);
    const int repeats = (int)(2e8 / (double)bytes) + 3;
    static volatile double sink;
    times t;
    int k;
    memset(&t, 0, sizeof t);
    memset(x, 0, n * sizeof *x);
    for (k = 0; k < repeats; ++k) {
        const double start = now();
        sink = sum(x, n);
        if (k) take(&t, now() - start);
    }
    (void)sink;
    free(x);
    return (double)bytes / median(&t);
}

/* --- semi-implicit Newmark on CHOLMOD ---------------------------------------------------------- */

#ifdef SFEM_BENCH_CHOLMOD
typedef struct rival {
    const sfem_model *model;
    cholmod_common c;
    cholmod_sparse *a;
    cholmod_factor *l;
    cholmod_dense *b, *x, *y, *e;
    sfem_matrix k;
    sfem_int *free_of; /* [nodes] its row, or -1 */
    double *u, *v, *acc, *f, *work;
} rival;

static void rival_fill(rival *r)
{
    const sfem_matrix *k = &r->k;
    double *out = (double *)r->a->x;
    sfem_int i, at;
    int row, col;
    for (i = 0; i < k->n; ++i)
        for (row = 0; r->free_of[i] >= 0 && row < 3; ++row)
            for (at = k->row[i]; at < k->row[i + 1]; ++at) {
                const double *b = k->val + 9 * (size_t)at + 3 * row;
                if (r->free_of[k->col[at]] < 0) continue;
                for (col = 0; col < (k->col[at] == i ? row + 1 : 3); ++col)
                    *out++ = b[col] + (k->col[at] == i && col == row
                                           ? 4 / (STEP * STEP) * r->model->node_mass[i]
                                           : 0);
            }
}

static void rival_shape(rival *r, sfem_int dofs)
{
    const sfem_matrix *k = &r->k;
    size_t count = 0;
    int *p, *index;
    sfem_int i, at;
    int row, col, n = 0;
    for (i = 0; i < k->n; ++i)
        for (at = k->row[i]; at < k->row[i + 1]; ++at)
            if (r->free_of[i] >= 0 && r->free_of[k->col[at]] >= 0) count += k->col[at] == i ? 6 : 9;
    r->a = cholmod_allocate_sparse((size_t)dofs, (size_t)dofs, count, 1, 1, 1, CHOLMOD_REAL, &r->c);
    p = (int *)r->a->p;
    index = (int *)r->a->i;
    for (i = 0; i < k->n; ++i)
        for (row = 0; r->free_of[i] >= 0 && row < 3; ++row) {
            *p++ = n;
            for (at = k->row[i]; at < k->row[i + 1]; ++at) {
                const sfem_int j = r->free_of[k->col[at]];
                if (j < 0) continue;
                for (col = 0; col < (k->col[at] == i ? row + 1 : 3); ++col)
                    index[n++] = 3 * j + col;
            }
        }
    *p = n;
}

static double rival_step(rival *r);

static void rival_start(rival *r, const double *u, const double *v)
{
    const size_t bytes = 3 * (size_t)r->model->mesh.nodes * sizeof *u;
    memcpy(r->u, u, bytes);
    memcpy(r->v, v, bytes);
    memset(r->acc, 0, bytes);
}

/* The ordering and form that CHOLMOD steps fastest with, of those that bench/solver tries. */
static rival *rival_create(const sfem_model *model, const unsigned char *mask)
{
    static const int way[3][2] = {{CHOLMOD_AMD, CHOLMOD_SUPERNODAL},
                                  {CHOLMOD_METIS, CHOLMOD_SUPERNODAL},
                                  {CHOLMOD_AMD, CHOLMOD_SIMPLICIAL}};
    const sfem_int nodes = model->mesh.nodes;
    const size_t n = 3 * (size_t)nodes;
    rival *r = (rival *)ex_new(1, sizeof *r);
    double least = 0, *zero = (double *)ex_new(n, sizeof *zero);
    sfem_int i, dofs = 0;
    sfem_error err;
    int w, k, best = 0, last = nodes > 3000 ? 2 : 3;
    memset(zero, 0, n * sizeof *zero);
    memset(r, 0, sizeof *r);
    r->model = model;
    r->u = (double *)ex_new(4 * n + sfem_model_work_size(model), sizeof *r->u);
    r->v = r->u + n;
    r->acc = r->u + 2 * n;
    r->f = r->u + 3 * n;
    r->work = r->u + 4 * n;
    r->free_of = (sfem_int *)ex_new((size_t)nodes, sizeof *r->free_of);
    for (i = 0; i < nodes; ++i) r->free_of[i] = mask[i] ? -1 : dofs++;
    dofs *= 3;
    must(sfem_model_combine(model, 1, 0, 0, NULL, &r->k, &err), &err);
    cholmod_start(&r->c);
    rival_shape(r, dofs);
    r->b = cholmod_allocate_dense((size_t)dofs, 1, (size_t)dofs, CHOLMOD_REAL, &r->c);
    for (w = 0; w <= last; ++w) {
        double t = 0;
        if (r->l) cholmod_free_factor(&r->l, &r->c);
        r->c.nmethods = 1;
        r->c.method[0].ordering = way[w < last ? w : best][0];
        r->c.supernodal = way[w < last ? w : best][1];
        r->c.postorder = 1;
        r->c.final_ll = 1;
        r->l = cholmod_analyze(r->a, &r->c);
        rival_start(r, zero, zero);
        for (k = 0; k < 3; ++k) {
            const double once = rival_step(r);
            if (k == 0 || once < t) t = once;
        }
        if (w < last && (w == 0 || t < least)) {
            least = t;
            best = w;
        }
    }
    free(zero);
    return r;
}

/* (4/h^2 M + K(u)) d = M (g + 4/h v + a) - f(u), one iteration of Newton's; seconds. */
static double rival_step(rival *r)
{
    const sfem_model *model = r->model;
    const double start = now(), *x;
    double *b = (double *)r->b->x;
    sfem_int i;
    int c;
    (void)sfem_model_forces(model, r->u, SFEM_DOUBLE, r->f, NULL, NULL, r->work, NULL);
    sfem_model_tangent(model, r->u, SFEM_TANGENT_FROZEN, &r->k, NULL);
    rival_fill(r);
    for (i = 0; i < model->mesh.nodes; ++i)
        for (c = 0; r->free_of[i] >= 0 && c < 3; ++c) {
            const size_t at = 3 * (size_t)i + (size_t)c;
            b[3 * r->free_of[i] + c] =
                model->node_mass[i] * ((c == 2 ? -9.81 : 0) + 4 / STEP * r->v[at] + r->acc[at]) -
                r->f[at];
        }
    cholmod_factorize(r->a, r->l, &r->c);
    cholmod_solve2(CHOLMOD_A, r->l, r->b, NULL, &r->x, NULL, &r->y, &r->e, &r->c);
    x = (const double *)r->x->x;
    for (i = 0; i < model->mesh.nodes; ++i)
        for (c = 0; r->free_of[i] >= 0 && c < 3; ++c) {
            const size_t at = 3 * (size_t)i + (size_t)c;
            const double d = x[3 * r->free_of[i] + c];
            r->u[at] += d;
            r->acc[at] = 4 / (STEP * STEP) * d - 4 / STEP * r->v[at] - r->acc[at];
            r->v[at] = 2 / STEP * d - r->v[at];
        }
    return now() - start;
}

static void rival_free(rival *r)
{
    cholmod_free_dense(&r->b, &r->c);
    cholmod_free_dense(&r->x, &r->c);
    cholmod_free_dense(&r->y, &r->c);
    cholmod_free_dense(&r->e, &r->c);
    cholmod_free_factor(&r->l, &r->c);
    cholmod_free_sparse(&r->a, &r->c);
    cholmod_finish(&r->c);
    sfem_matrix_free(&r->k, NULL);
    free(r->free_of);
    free(r->u);
    free(r);
}
#endif

/* --- one body -------------------------------------------------------------------------------- */

static sfem_body *make_body(sfem_model *model, sfem_int pin_count, const sfem_int *pins, int kind)
{
    sfem_body_def def = sfem_default_body_def();
    sfem_body *body = NULL;
    sfem_error err;
    def.pins = pins;
    def.pin_count = pin_count;
    def.gravity[2] = -9.81;
    if (kind == FLOATS) def.precision = SFEM_MIXED;
    if (kind == ONCE || kind == TWICE) def.corrections = kind == ONCE ? 1 : 2;
    def.correction_tolerance = 0;
    if (kind == HIGHER) def.p = .3;
    if (kind == NEWMARK) {
        def.integrator = SFEM_NEWMARK;
        def.newton.iterations = 1;
        def.newton.tangent = SFEM_TANGENT_FROZEN;
        def.newton.no_line_search = 1;
    }
    must(sfem_body_create(model, &def, &body, &err), &err);
    must(sfem_body_prepare(body, STEP, &err), &err);
    return body;
}

static double time_step(sfem_body *body)
{
    const double start = now();
    sfem_error err;
    must(sfem_body_step(body, STEP, &err), &err);
    return now() - start;
}

/* The parts of a default step, in seconds, by themselves. */
typedef struct parts {
    times force, frames, solve, guard;
} parts;

static void time_parts(sfem_body *b, parts *p)
{
    double t = now(), next;
    (void)sfemi_guard_forces(b, b->state.u, b->guard.f);
    take(&p->force, (next = now()) - t);
    sfemi_turn_frames(b, b->guard.frame);
    take(&p->frames, (t = now()) - next);
    memcpy(b->zm, b->state.f, 3 * (size_t)b->model->mesh.nodes * sizeof *b->zm);
    next = now();
    sfemi_turn_solve(b, b->factor, b->state.u, b->state.frame, b->zm);
    take(&p->solve, (t = now()) - next);
    (void)sfemi_guard_measure(b, b->state.u, b->state.w, b->guard.f, 0, STEP);
    take(&p->guard, now() - t);
}

static double redone(const sfem_body *b) /* per cent of the steps */
{
    const sfem_body_info info = sfem_body_get_info(b);
    return 100.0 * (double)info.rejected / (double)info.steps;
}

static void run(const char *name, sfem_model *model, sfem_int pin_count, const sfem_int *pins,
                int rounds)
{
    static times t[BODIES], cholmod;
    static parts part;
    const sfem_int tets = model->mesh.tets;
    const double ns = 1e9 / tets;
    sfem_body *body[BODIES];
    sfem_body_info info;
    double best, step, ceiling;
    int k, i, j;
#ifdef SFEM_BENCH_CHOLMOD
    rival *r;
#endif
    memset(t, 0, sizeof t);
    memset(&part, 0, sizeof part);
    memset(&cholmod, 0, sizeof cholmod);
    for (k = 0; k < BODIES; ++k) body[k] = make_body(model, pin_count, pins, k);
#ifdef SFEM_BENCH_CHOLMOD
    r = rival_create(model, body[0]->mask);
#endif
    for (i = 0; i < rounds; ++i) {
        const int few = tets > 30000 ? 1 : 2;
        for (k = 0; k < BODIES; ++k)
            for (j = k == NEWMARK ? -1 : -2; j < (k == NEWMARK ? few : 10); ++j) {
                double once;
                if (k == NEWMARK && j < 0) { /* on the default's path */
                    sfem_error err;
                    double *v = body[0]->rhs;
                    sfem_body_velocities(body[0], v);
                    must(sfem_body_set_state(body[k], body[0]->state.u, v, &err), &err);
                }
                once = time_step(body[k]);
                if (j >= 0) take(t + k, once);
            }
#ifdef SFEM_BENCH_CHOLMOD
        sfem_body_velocities(body[0], body[0]->rhs);
        rival_start(r, body[0]->state.u, body[0]->rhs);
        for (j = -1; j < few; ++j) {
            const double once = rival_step(r);
            if (j >= 0) take(&cholmod, once);
        }
#endif
        for (j = 0; j < 4; ++j) time_parts(body[0], &part);
    }
    info = sfem_body_get_info(body[0]);
    step = median(t + PLAIN);
    best = median(t + NEWMARK);
    if (cholmod.n && median(&cholmod) < best) best = median(&cholmod);
    ceiling = 2 * (double)info.factor_bytes / bandwidth(info.factor_bytes);
    printf("%-9s %7d %9.1f %9.1f %9.1f %9.1f %9.1f | %10.1f %10.1f | %5.1f %5.1f %5.1f %5.1f |"
           " %5.1f %5.1f %5.1f %5.1f %8.1f | %5.2f %5.2f\n",
           name, (int)tets, 1e6 * step, 1e6 * mean(t + PLAIN), 1e6 * median(t + FLOATS),
           1e6 * median(t + ONCE), 1e6 * median(t + TWICE), 1e6 * median(t + NEWMARK),
           1e6 * median(&cholmod), best / step, best / mean(t + PLAIN), best / mean(t + HIGHER),
           best / median(t + FLOATS), ns * median(&part.force), ns * median(&part.frames),
           ns * median(&part.solve), ns * median(&part.guard), 1e6 * ceiling, redone(body[PLAIN]),
           redone(body[HIGHER]));
    fflush(stdout);
#ifdef SFEM_BENCH_CHOLMOD
    rival_free(r);
#endif
    for (k = 0; k < BODIES; ++k) sfem_body_free(body[k]);
}

static int rounds_of(sfem_int tets, int quick)
{
    int rounds = (int)(6e5 / tets / (1 + tets / 4e4));
    if (rounds > 35) rounds = 35;
    if (quick) rounds /= 8;
    return rounds < 3 ? 3 : rounds;
}

static void run_mesh(const char *name, const sfem_mesh *mesh, int quick)
{
    sfem_model_def def = sfem_default_model_def();
    sfem_int *pins = (sfem_int *)ex_new((size_t)mesh->nodes, sizeof *pins), i, count = 0;
    double low[3], high[3];
    sfem_model *model = NULL;
    sfem_error err;
    int c, axis = 0;
    for (c = 0; c < 3; ++c) {
        low[c] = high[c] = mesh->x[c];
        for (i = 0; i < mesh->nodes; ++i) {
            if (mesh->x[3 * i + c] < low[c]) low[c] = mesh->x[3 * i + c];
            if (mesh->x[3 * i + c] > high[c]) high[c] = mesh->x[3 * i + c];
        }
        if (high[c] - low[c] > high[axis] - low[axis]) axis = c;
    }
    for (i = 0; i < mesh->nodes; ++i)
        if (mesh->x[3 * i + axis] < low[axis] + .02 * (high[axis] - low[axis])) pins[count++] = i;
    def.mesh = mesh;
    def.material.poisson = .45;
    def.material.law = SFEM_COROTATIONAL;
    must(sfem_model_create(&def, &model, &err), &err);
    run(name, model, count, pins, rounds_of(mesh->tets, quick));
    sfem_model_free(model);
    free(pins);
}

static void one_core(int quick, long largest, char **files)
{
    static const struct {
        const char *name;
        sfem_int tets, cells[3];
    } block[] = {{"540", 540, {12, 3, 3}},     {"2.5k", 2500, {20, 5, 5}},
                 {"7k", 6860, {28, 7, 7}},     {"20k", 20000, {40, 10, 10}},
                 {"55k", 54880, {56, 14, 14}}, {"160k", 160000, {80, 20, 20}}};
    const sfem_real size[3] = {2, .5, .5};
    sfem_mesh mesh;
    sfem_error err;
    cpu_set_t set;
    size_t i;
    CPU_ZERO(&set);
    CPU_SET(sysconf(_SC_NPROCESSORS_ONLN) > 1 ? 1 : 0, &set);
    sched_setaffinity(0, sizeof set, &set);
    printf("vectors   %d doubles wide\n", sfem_vector_width());
#ifdef SFEM_BENCH_FLAGS
    printf("flags     %s\n", SFEM_BENCH_FLAGS);
#endif
#ifndef SFEM_BENCH_CHOLMOD
    printf("without CHOLMOD: install libsuitesparse-dev\n");
#endif
    printf("\nus a step: default, its mean with what is redone, mixed precision, 1 correction, 2 | "
           "semi-implicit"
           " Newmark, on CHOLMOD |\nthe faster of these over: default, its mean, mean at p = .3, "
           "mixed |"
           "\nns a tet: forces, frames, solve, energies; ceiling of the solve, us | redone, %%, at "
           "p = .3\n\n");
    for (i = 0; i < sizeof block / sizeof *block; ++i) {
        if (block[i].tets > largest) continue;
        must(sfem_mesh_block(block[i].cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), &err);
        run_mesh(block[i].name, &mesh, quick);
        sfem_mesh_free(&mesh);
    }
    for (; *files; ++files) {
        const char *name = strrchr(*files, '/') ? strrchr(*files, '/') + 1 : *files;
        char tag[10];
        if (sfem_mesh_read(*files, NULL, &mesh, &err) != SFEM_OK) {
            printf("%.9s: %s\n", name, err.text);
            continue;
        }
        snprintf(tag, sizeof tag, "%s", name);
        run_mesh(tag, &mesh, quick);
        sfem_mesh_free(&mesh);
    }
}

int main(int argc, char **argv)
{
    const int quick = argc > 1 && strcmp(argv[1], "--quick") == 0;
    char **rest = argv + 1 + quick;
    long largest = quick ? 2500 : 54880;
    pid_t child;
    if (*rest && atol(*rest) > 0) largest = atol(*rest++);
    if (getenv("SFEM_BENCH_ONE_CORE")) {
        one_core(quick, largest, rest);
        return 0;
    }
    (void)argc;
    child = fork(); /* OpenMP reads its limits when the program starts, so start it again */
    if (child == 0) {
        setenv("OMP_THREAD_LIMIT", "1", 1);
        setenv("OPENBLAS_NUM_THREADS", "1", 1);
        setenv("SFEM_BENCH_ONE_CORE", "1", 1);
        execv("/proc/self/exe", argv);
        _exit(1);
    }
    waitpid(child, NULL, 0);
    return 0;
}
