/* step - what a step of a soft body that swings costs, beside semi-implicit steps of the same body.
 *
 *   bench/step [--quick] [largest number of tets, 54880] [mesh files]
 *
 * Corotational blocks of 2 x 0.5 x 0.5 m, 540 to 160 000 tets in cells of five, one in cells of six, and meshes from
 * files, held at one end of their longest side, E = 1e6 Pa, nu = 0.45, falling under gravity from rest; and real
 * meshes as real.h places them (nu = 0.38), where SFEM_MESHES names their directory; h = 1/60 s. The default step,
 * (p,q,r) corrected with a rotated factor, at several accuracies, is set against the faster of two semi-implicit
 * Newmark steps, one tangent, one factorisation and one solve each: the library's own (newton.iterations
 * = 1), and one that uses the library's forces and tangents and CHOLMOD (Debian: libsuitesparse-dev)
 * at its best, with one OpenMP thread, as its build else starts four on one core. All are
 * stepped in turns, some steps at a time, on one core, the semi-implicit ones on the path of the default. Mean and
 * median leave out the first two steps of a turn, whose data others have pushed out of the caches; the worst is of
 * all steps. The ceiling is 2 readings of L, at the rate at which this machine sums an array of its size in the
 * same run.
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
#include "real.h"
#include "../tests/linear.h"

#ifndef SFEM_BENCH_FLAGS
#define SFEM_BENCH_FLAGS "not stated"
#endif
#define STEP (1 / 60.0)
enum { MOST = 400 };
enum { DEFAULT, ONE_SOLVE, COARSE, FINE, FLOATS, NEWMARK, PARTS, BODIES };

static const char *const row_name[NEWMARK + 1] = {
    "default",       "accuracy 1: one solve",    "accuracy 1e-4",
    "accuracy 1e-8", "default, mixed precision", "Newmark, semi-implicit"};

typedef struct times {
    double v[MOST], sum, worst; /* worst: also of those that are not in v */
    int n;
} times;

typedef struct subject { /* what is stepped */
    sfem_model *model;
    const sfem_int *pins;
    sfem_int pin_count;
    double gravity[3];
} subject;

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
    const double *gravity;
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
static rival *rival_create(const subject *s, const unsigned char *mask)
{
    static const int way[3][2] = {{CHOLMOD_AMD, CHOLMOD_SUPERNODAL},
                                  {CHOLMOD_METIS, CHOLMOD_SUPERNODAL},
                                  {CHOLMOD_AMD, CHOLMOD_SIMPLICIAL}};
    const sfem_model *model = s->model;
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
    r->gravity = s->gravity;
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
                model->node_mass[i] * (r->gravity[c] + 4 / STEP * r->v[at] + r->acc[at]) - r->f[at];
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
    sfem_matrix_free(&r->k);
    free(r->free_of);
    free(r->u);
    free(r);
}
#endif

/* --- one body -------------------------------------------------------------------------------- */

static sfem_body *make_body(const subject *s, int kind)
{
    sfem_body_def def = sfem_default_body_def();
    sfem_body *body = NULL;
    sfem_error err;
    def.pins = s->pins;
    def.pin_count = s->pin_count;
    memcpy(def.gravity, s->gravity, sizeof def.gravity);
    if (kind == FLOATS) def.precision = SFEM_MIXED;
    if (kind == ONE_SOLVE) def.accuracy = 1;
    if (kind == COARSE) def.accuracy = 1e-4;
    if (kind == FINE) def.accuracy = 1e-8;
    if (kind == NEWMARK) {
        def.integrator = SFEM_NEWMARK;
        def.newton.iterations = 1;
        def.newton.tangent = SFEM_TANGENT_FROZEN;
        def.newton.line_search = 0;
    }
    must(sfem_body_create(s->model, &def, &body, &err), &err);
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

/* Puts a body where another one is. */
static void follow(sfem_body *body, sfem_body *other)
{
    sfem_error err;
    double *v = other->rhs;
    sfem_body_velocities(other, v);
    must(sfem_body_set_state(body, other->state.u, v, &err), &err);
}

/* The parts of a default step, in seconds, by themselves. */
typedef struct parts {
    times force, frames, solve, energies;
} parts;

static void time_parts(sfem_body *b, parts *p)
{
    double t = now(), next;
    (void)sfemi_safeguard_forces(b, b->state.u, b->safeguard.f);
    take(&p->force, (next = now()) - t);
    sfemi_rotated_frames(b, b->safeguard.frame);
    take(&p->frames, (t = now()) - next);
    memcpy(b->zm, b->state.f, 3 * (size_t)b->model->mesh.nodes * sizeof *b->zm);
    next = now();
    sfemi_rotated_solve_system(b, b->factor, b->state.u, b->state.frame, b->zm);
    take(&p->solve, (t = now()) - next);
    (void)sfemi_safeguard_measure(b, b->state.u, b->state.w, b->safeguard.f, 0, STEP);
    take(&p->energies, now() - t);
}

/* Some steps of each body, in turn. */
static void run_round(sfem_body **body, times *t, parts *part, int few)
{
    int k, j;
    for (k = 0; k <= NEWMARK; ++k) {
        const int last = k == NEWMARK ? few : 10;
        if (k == NEWMARK) follow(body[k], body[DEFAULT]);
        for (j = k == NEWMARK ? -1 : -2; j < last; ++j) {
            const double once = time_step(body[k]);
            if (j >= 0) take(t + k, once);
            if (once > t[k].worst) t[k].worst = once;
        }
    }
    follow(body[PARTS], body[DEFAULT]);
    (void)time_step(body[PARTS]);
    for (j = 0; j < 4; ++j) time_parts(body[PARTS], part);
}

static void print_row(const char *name, const times *t, const sfem_body *b, double best)
{
    const sfem_body_info info = sfem_body_get_info(b);
    printf("  %-26s %9.1f %9.1f %9.1f %6.1f", name, 1e6 * mean(t), 1e6 * median(t), 1e6 * t->worst,
           t->worst / median(t));
    if (info.solves)
        printf(" %7.2f %6.2f %%", (double)info.solves / (double)info.steps,
               100.0 * (double)info.rejected / (double)info.steps);
    else
        printf(" %7.2f %8s", 1.0, "");
    printf(" %7.2f\n", mean(t) / best);
}

static void run(const char *name, const subject *s, int rounds)
{
    static times t[NEWMARK + 1], cholmod;
    static parts part;
    const sfem_int tets = s->model->mesh.tets;
    const double ns = 1e9 / tets;
    const int few = tets > 30000 ? 1 : 2;
    sfem_body *body[BODIES];
    double best;
    size_t bytes;
    int k, i;
#ifdef SFEM_BENCH_CHOLMOD
    rival *r;
    int j;
#endif
    memset(t, 0, sizeof t);
    memset(&part, 0, sizeof part);
    memset(&cholmod, 0, sizeof cholmod);
    for (k = 0; k < BODIES; ++k) body[k] = make_body(s, k);
#ifdef SFEM_BENCH_CHOLMOD
    r = rival_create(s, body[DEFAULT]->mask);
#endif
    for (i = 0; i < rounds; ++i) {
        run_round(body, t, &part, few);
#ifdef SFEM_BENCH_CHOLMOD
        sfem_body_velocities(body[DEFAULT], body[DEFAULT]->rhs);
        rival_start(r, body[DEFAULT]->state.u, body[DEFAULT]->rhs);
        for (j = -1; j < few; ++j) {
            const double once = rival_step(r);
            if (j >= 0) take(&cholmod, once);
            if (once > cholmod.worst) cholmod.worst = once;
        }
#endif
    }
    best = mean(t + NEWMARK);
    if (cholmod.n && mean(&cholmod) < best) best = mean(&cholmod);
    printf("%s: %d nodes, %d tets, %d held; %d steps\n", name, (int)s->model->mesh.nodes, (int)tets,
           (int)s->pin_count, 12 * rounds);
    for (k = 0; k <= NEWMARK; ++k) print_row(row_name[k], t + k, body[k], best);
#ifdef SFEM_BENCH_CHOLMOD
    print_row("the same on CHOLMOD", &cholmod, body[NEWMARK], best);
    rival_free(r);
#endif
    bytes = sfem_body_get_info(body[DEFAULT]).factor_bytes;
    printf("  ns a tet: forces %.1f, frames %.1f, a solve %.1f (%.1f us, ceiling %.1f), energies "
           "%.1f\n\n",
           ns * median(&part.force), ns * median(&part.frames), ns * median(&part.solve),
           1e6 * median(&part.solve), 2e6 * (double)bytes / bandwidth(bytes),
           ns * median(&part.energies));
    fflush(stdout);
    for (k = 0; k < BODIES; ++k) sfem_body_free(body[k]);
}

static int rounds_of(sfem_int tets, int quick)
{
    int rounds = (int)(6e5 / tets / (1 + tets / 4e4));
    if (rounds > 35) rounds = 35;
    if (quick) rounds /= 8;
    return rounds < 3 ? 3 : rounds;
}

/* Held at the lower end of its longest side; gravity along -z. */
static void run_mesh(const char *name, const sfem_mesh *mesh, int quick)
{
    sfem_model_def def = linear_model_def();
    sfem_int *pins = (sfem_int *)ex_new((size_t)mesh->nodes, sizeof *pins), i, count = 0;
    double low[3], high[3];
    subject s = {NULL, NULL, 0, {0, 0, -9.81}};
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
        if (mesh->x[3 * i + axis] < low[axis] + 0.02 * (high[axis] - low[axis])) pins[count++] = i;
    def.mesh = mesh;
    def.material.poisson = 0.45;
    def.material.law = SFEM_COROTATIONAL;
    must(sfem_model_create(&def, &s.model, &err), &err);
    s.pins = pins;
    s.pin_count = count;
    run(name, &s, rounds_of(mesh->tets, quick));
    sfem_model_free(s.model);
    free(pins);
}

/* A scene of real.h. */
static void run_real(const char *name, int quick)
{
    real_scene scene;
    subject s;
    sfem_error err;
    int k;
    for (k = 0; k < REAL_SCENES && strcmp(real_table[k].name, name); ++k) continue;
    if (k == REAL_SCENES || !real_there(real_table + k)) {
        printf("%s: left out, SFEM_MESHES names no directory with its mesh\n\n", name);
        return;
    }
    must(real_open(real_table + k, SFEM_COROTATIONAL, 0.38, &scene, &err), &err);
    s.model = scene.model;
    s.pins = scene.pins;
    s.pin_count = scene.pin_count;
    memcpy(s.gravity, scene.gravity, sizeof s.gravity);
    run(name, &s, rounds_of(scene.mesh.tets, quick));
    real_close(&scene);
}

static void print_head(void)
{
    printf("vectors   %d doubles wide\n", sfem_vector_width());
    printf("flags     %s\n", SFEM_BENCH_FLAGS);
#ifndef SFEM_BENCH_CHOLMOD
    printf("without CHOLMOD: install libsuitesparse-dev\n");
#endif
    printf("\n%-28s %9s %9s %9s %6s %7s %8s %7s\n", "us a step", "mean", "median", "worst", "/med.",
           "solves", "rejected", "/semi");
    printf("  /med.: the worst over the median; /semi: the mean over that of the faster "
           "semi-implicit step\n\n");
}

static void run_files(char **files, int quick)
{
    for (; *files; ++files) {
        const char *name = strrchr(*files, '/') ? strrchr(*files, '/') + 1 : *files;
        sfem_mesh mesh;
        sfem_error err;
        if (sfem_mesh_read(*files, NULL, &mesh, &err) != SFEM_OK) {
            printf("%s: %s\n", name, err.text);
            continue;
        }
        run_mesh(name, &mesh, quick);
        sfem_mesh_free(&mesh);
    }
}

static void one_core(int quick, long largest, char **files)
{
    static const struct {
        const char *name;
        sfem_int tets, cells[3];
        sfem_block_cells kind;
    } block[] = {{"bar, 540", 540, {12, 3, 3}, SFEM_CELL_5_TETS},
                 {"bar, 2.5k", 2500, {20, 5, 5}, SFEM_CELL_5_TETS},
                 {"bar, 2.4k, cells of six tets", 2400, {16, 5, 5}, SFEM_CELL_6_TETS},
                 {"bar, 7k", 6860, {28, 7, 7}, SFEM_CELL_5_TETS},
                 {"bar, 20k", 20000, {40, 10, 10}, SFEM_CELL_5_TETS},
                 {"bar, 55k", 54880, {56, 14, 14}, SFEM_CELL_5_TETS},
                 {"bar, 160k", 160000, {80, 20, 20}, SFEM_CELL_5_TETS}};
    const sfem_real size[3] = {2, 0.5, 0.5};
    cpu_set_t set;
    size_t i;
    CPU_ZERO(&set);
    CPU_SET((size_t)sched_getcpu(), &set); /* where it is: taskset chooses another */
    sched_setaffinity(0, sizeof set, &set);
    print_head();
    for (i = 0; i < sizeof block / sizeof *block; ++i) {
        sfem_mesh mesh;
        sfem_error err;
        if (block[i].tets > largest) continue;
        must(sfem_mesh_block(block[i].cells, size, block[i].kind, NULL, &mesh, &err), &err);
        run_mesh(block[i].name, &mesh, quick);
        sfem_mesh_free(&mesh);
    }
    run_real("octopus 3e6", quick);
    run_real("armadillo 1e6", quick);
    run_files(files, quick);
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
