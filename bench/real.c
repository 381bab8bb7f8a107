/* real - the default step beside others on real and on unstructured meshes (real.h).
 *
 *     bench/real [--quick] [--scene TEXT] [--form TEXT] [--h 60] [--young E] [--law corotational] [--tet linear]
 *                [--poisson 0.38] [--dissipation 0.1] [--out build/bench-real] [--reference | --long | --eigen]
 *
 * Without a mode: the error of the tip nodes over a second, every 1/30 s, over their amplitude (root mean squares),
 * against the trapezoidal rule with full Newton at a small step; rejected steps; solves a step; time of a step, mean,
 * median and worst, of the processor, on one thread.
 *   --reference  makes the references that are missing (as every run does where it needs one): DIR/NAME.ref, and
 *                DIR/NAME.txt with the command that makes it. A file that does not fit the scene is made anew
 *   --long       what an undamped body's total energy has changed by at the end of each fifth of 6 s, over the largest
 *                sum of kinetic and elastic energy
 *   --eigen      the largest eigenvalue of (h^2 K(x), 4 A(x)) over every fifth pose of the reference, for A =
 *                M + p h^2 Q K0 Q^T in node frames, K exact and frozen: (p,q,r) is stable where it is below 1
 *                [Lanczos 1950, in the inner product of A, fully orthogonalised]
 */
#include "../examples/support.h"
#include "bench.h"
#include "real.h"
#include "reference.h"

enum { SAMPLES = REFERENCE_SAMPLES, FIFTHS = 5 };

typedef struct settings {
    sfem_law law;
    double poisson;
    const char *law_name, *out, *scene, *form;
    double h[8]; /* steps a second */
    int steps, quick;
} settings;

/* --------------------------------------------------------------------------------------------
 * what is compared
 * -------------------------------------------------------------------------------------------- */

typedef struct form {
    const char *name;
    sfem_integrator integrator;
    int iterations;  /* of Newton; 0: its default, to 1e-5 */
    double p;        /* 0: the default */
    double accuracy; /* 0: the default */
    sfem_precision precision;
    double refactorise;
} form;

static const form forms[] = {
    {"trapezoidal Newton", SFEM_NEWMARK, 0, 0, 0, SFEM_DOUBLE, 0},
    {"semi-implicit", SFEM_NEWMARK, 1, 0, 0, SFEM_DOUBLE, 0},
    {"backward Euler, 1", SFEM_BACKWARD_EULER, 1, 0, 0, SFEM_DOUBLE, 0},
    {"default", SFEM_PQR, 0, 0, 0, SFEM_DOUBLE, 0},
    {"default, refactorised", SFEM_PQR, 0, 0, 0, SFEM_DOUBLE, 4},
    {"default, mixed", SFEM_PQR, 0, 0, 0, SFEM_MIXED, 0},
    {"default, accuracy 1e-4", SFEM_PQR, 0, 0, 1e-4, SFEM_DOUBLE, 0},
    {"default, accuracy 1e-8", SFEM_PQR, 0, 0, 1e-8, SFEM_DOUBLE, 0},
    {"default, one solve", SFEM_PQR, 0, 0, 1, SFEM_DOUBLE, 0},
    {"KR-alpha", SFEM_KR_ALPHA, 0, 0, 0, SFEM_DOUBLE, 0},
};
enum { FORMS = sizeof forms / sizeof *forms };

static double dissipation; /* of corrected steps */

static int is_newton(const form *f)
{
    return f->integrator == SFEM_NEWMARK || f->integrator == SFEM_BACKWARD_EULER;
}

/* Smooth tets do not go with KR-alpha. */
static int applies(const form *f)
{
    return real_tet == SFEM_TET_LINEAR || f->integrator != SFEM_KR_ALPHA;
}

static sfem_body_def def_of(const form *f, const real_scene *s)
{
    sfem_body_def d = real_body_def(s);
    d.integrator = f->integrator;
    d.newton.accept_best = 1;
    d.newton.tolerance = 1e-5;
    if (f->iterations) d.newton.iterations = f->iterations;
    if (f->p > 0) d.p = f->p;
    if (f->accuracy > 0) d.accuracy = f->accuracy;
    d.precision = f->precision;
    d.refactorise = f->refactorise;
    d.dissipation = dissipation;
    return d;
}

/* Rejected steps since the state was set. */
static int64_t count_rejected(const sfem_body *b) { return sfem_body_get_info(b).rejected; }

/* Solves since the state was set; gathered: Newton's, which only the last step tells. */
static int64_t count_solves(const sfem_body *b, const form *f, int64_t gathered)
{
    return is_newton(f) ? gathered : sfem_body_get_info(b).solves;
}

/* Of the last step. */
static int64_t gather_solves(const sfem_body *b, const form *f)
{
    return is_newton(f) ? sfem_body_newton(b).iterations : 0;
}

static reference reference_for(const real_scene *s, const settings *o)
{
    const reference_def d = {o->out, o->law_name, o->poisson, o->quick};
    return reference_of(s, &d);
}

/* --------------------------------------------------------------------------------------------
 * errors and times
 * -------------------------------------------------------------------------------------------- */

typedef struct result {
    double error, rejected, solves, mean, median, worst; /* solves: a step; times in ms */
    char failure[96];
} result;

/* Adds the squares of what the tips are off by, and of what they should be at. */
static void compare(const real_scene *s, const sfem_body *body, const double *exact, double sum[2])
{
    const sfem_real *u = sfem_body_displacement(body);
    int i, k;
    for (i = 0; i < REAL_TIPS; ++i)
        for (k = 0; k < 3; ++k) {
            const size_t at = 3 * (size_t)s->tip[i] + (size_t)k;
            sum[0] += (u[at] - exact[at]) * (u[at] - exact[at]);
            sum[1] += exact[at] * exact[at];
        }
}

static result measure(const real_scene *s, const form *f, const reference *r, double steps_a_second)
{
    const sfem_body_def def = def_of(f, s);
    const int substeps = (int)floor(steps_a_second / 30 + 0.5), steps = SAMPLES * substeps;
    double *time = (double *)ex_new((size_t)steps, sizeof *time), sum[2] = {0, 0};
    int64_t gathered = 0;
    result out;
    sfem_body *body;
    sfem_error err;
    int i;
    memset(&out, 0, sizeof out);
    bench_must(real_body(s, &def, &body, &err), &err);
    bench_must(sfem_body_prepare(body, 1.0 / (30 * substeps), &err), &err);
    for (i = 0; i < steps; ++i) {
        const double begin = bench_seconds();
        if (sfem_body_step(body, 1.0 / (30 * substeps), &err) != SFEM_OK) {
            snprintf(out.failure, sizeof out.failure, "%.2f s: %.80s", sfem_body_time(body),
                     err.text);
            break;
        }
        time[i] = 1e3 * (bench_seconds() - begin);
        out.mean += time[i] / steps;
        gathered += gather_solves(body, f);
        if ((i + 1) % substeps == 0)
            compare(s, body, r->u + (size_t)(i / substeps) * 3 * (size_t)s->mesh.nodes, sum);
    }
    out.error = sqrt(sum[0] / sum[1]);
    out.rejected = 100.0 * (double)count_rejected(body) / steps;
    out.solves = (double)count_solves(body, f, gathered) / steps;
    out.median = bench_median(time, steps);
    out.worst = time[steps - 1];
    sfem_body_free(body);
    free(time);
    return out;
}

static void table_of_errors(const real_scene *s, const settings *o)
{
    const reference r = reference_for(s, o);
    double semi = 0;
    int i, k;
    printf("%-28s %6s %8s %9s %7s %8s %8s %8s %9s\n", "", "1/h", "error", "rejected", "solves",
           "ms", "median", "worst", "over semi");
    for (k = 0; k < o->steps; ++k, semi = 0)
        for (i = 0; i < FORMS; ++i) {
            result x;
            if ((o->form && !strstr(forms[i].name, o->form)) || !applies(forms + i)) continue;
            x = measure(s, forms + i, &r, o->h[k]);
            if (!strcmp(forms[i].name, "semi-implicit")) semi = x.mean;
            if (x.failure[0]) {
                printf("  %-26s %6g failed at %s\n", forms[i].name, o->h[k], x.failure);
                continue;
            }
            printf("  %-26s %6g %8.5f %7.1f %% %7.2f %8.3f %8.3f %8.3f", forms[i].name, o->h[k],
                   x.error, x.rejected, x.solves, x.mean, x.median, x.worst);
            if (semi > 0) printf(" %9.2f", x.mean / semi);
            printf("\n");
            fflush(stdout);
        }
    free(r.u);
}

/* --------------------------------------------------------------------------------------------
 * energy over six seconds
 * -------------------------------------------------------------------------------------------- */

static void swing(const real_scene *s, const form *f, double steps_a_second, double seconds)
{
    const sfem_body_def def = def_of(f, s);
    const int steps = FIFTHS * (int)floor(steps_a_second * seconds / FIFTHS + 0.5);
    double begin, change[FIFTHS], scale = 0, first;
    int64_t gathered = 0;
    sfem_body *body;
    sfem_error err;
    int i, done = 0;
    bench_must(real_body(s, &def, &body, &err), &err);
    bench_must(sfem_body_prepare(body, 1 / steps_a_second, &err), &err);
    first = sfem_body_energy(body).total;
    begin = bench_seconds();
    for (i = 1; i <= steps; ++i) {
        sfem_energy e;
        if (sfem_body_step(body, 1 / steps_a_second, &err) != SFEM_OK) break;
        gathered += gather_solves(body, f);
        e = sfem_body_energy(body);
        if (e.kinetic + e.elastic > scale) scale = e.kinetic + e.elastic;
        if (i % (steps / FIFTHS) == 0) change[done++] = e.total - first;
    }
    printf("  %-26s %6g ", f->name, steps_a_second);
    for (i = 0; i < done; ++i) printf(" %+8.4f", change[i] / scale);
    if (done < FIFTHS)
        printf("  failed at %.2f s: %s\n", sfem_body_time(body), err.text);
    else
        printf(" %7.1f %% %7.2f %8.3f\n", 100.0 * (double)count_rejected(body) / steps,
               (double)count_solves(body, f, gathered) / steps,
               1e3 * (bench_seconds() - begin) / steps);
    fflush(stdout);
    sfem_body_free(body);
}

static void table_of_energies(const real_scene *s, const settings *o)
{
    int i, k;
    printf("%-28s %6s   energy at the fifths of 6 s less that at 0, over its peak %9s %7s %8s\n",
           "", "1/h", "rejected", "solves", "ms");
    for (k = 0; k < o->steps; ++k)
        for (i = 0; i < FORMS; ++i)
            if ((!o->form || strstr(forms[i].name, o->form)) && applies(forms + i))
                swing(s, forms + i, o->h[k], 6);
}

/* --------------------------------------------------------------------------------------------
 * the largest eigenvalue of (h^2 K(x), 4 A(x))
 * -------------------------------------------------------------------------------------------- */

enum { LANCZOS = 50, POSES_EVERY = 5 };

typedef struct pencil {
    const real_scene *s;
    double h, p;
    unsigned char *held; /* [nodes] */
    double *frame;       /* [nodes][3][3] */
    sfem_matrix k;       /* the tangent at the pose */
    sfem_ldl *factor;    /* of M + p h^2 K0 */
    double *work, *z;    /* of the factor; [nodes][3] */
} pencil;

/* y = Q x, or Q^T x; zero where nodes are held. x may be y. */
static void rotate(const pencil *a, int back, const double *x, double *y)
{
    sfem_int i;
    int k;
    for (i = 0; i < a->s->mesh.nodes; ++i, x += 3, y += 3) {
        const double *q = a->frame + 9 * (size_t)i, v[3] = {x[0], x[1], x[2]};
        for (k = 0; k < 3; ++k)
            y[k] = a->held[i] ? 0
                   : back     ? q[k] * v[0] + q[3 + k] * v[1] + q[6 + k] * v[2]
                              : q[3 * k] * v[0] + q[3 * k + 1] * v[1] + q[3 * k + 2] * v[2];
    }
}

/* Node frames polar(sum V_e R_e) of the displacements u, as the library has them, and the tangent. */
static void pencil_pose(pencil *a, const double *u, sfem_tangent kind)
{
    const sfem_mesh *m = &a->s->mesh;
    const sfem_real *volume = sfem_model_tet_volume(a->s->model);
    double *rotation = (double *)ex_new(9 * (size_t)m->tets, sizeof *rotation);
    double *sum = (double *)ex_new(9 * (size_t)m->nodes, sizeof *sum);
    double *force = (double *)ex_new(3 * (size_t)m->nodes, sizeof *force);
    double *work = (double *)ex_new(sfem_model_work_size(a->s->model), sizeof *work);
    sfem_int i;
    int k;
    sfem_model_forces(a->s->model, u, SFEM_DOUBLE, force, rotation, NULL, work, NULL);
    for (i = 0; i < 4 * m->tets; ++i)
        for (k = 0; k < 9; ++k)
            sum[9 * (size_t)m->tet[i] + (size_t)k] +=
                volume[i / 4] * rotation[9 * (size_t)(i / 4) + (size_t)k];
    for (i = 0; i < m->nodes; ++i) sfem_polar(sum + 9 * (size_t)i, a->frame + 9 * (size_t)i, NULL);
    sfem_model_tangent(a->s->model, u, kind, &a->k, NULL);
    free(rotation);
    free(sum);
    free(force);
    free(work);
}

/* The factor of M + p h^2 K0, with rows of the unit matrix for held nodes. */
static void pencil_factor(pencil *a)
{
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_matrix m;
    sfem_error err;
    sfem_int i, k;
    int c;
    bench_must(sfem_model_combine(a->s->model, a->p * a->h * a->h, 1, 0, NULL, &m, &err), &err);
    for (i = 0; i < m.n; ++i)
        for (k = m.row[i]; k < m.row[i + 1]; ++k)
            for (c = 0; c < 9 && (a->held[i] || a->held[m.col[k]]); ++c)
                m.val[9 * (size_t)k + (size_t)c] = i == m.col[k] && c % 4 == 0;
    def.x = a->s->mesh.x;
    bench_must(sfem_ldl_create(&def, &m, &a->factor, &err), &err);
    sfem_matrix_free(&m);
    a->work = (double *)ex_new(sfem_ldl_work_size(a->factor, 1), sizeof *a->work);
}

/* y = A x */
static void pencil_multiply(const pencil *a, const double *x, double *y)
{
    const sfem_real *mass = sfem_model_node_mass(a->s->model);
    const size_t n = 3 * (size_t)a->s->mesh.nodes;
    size_t i;
    rotate(a, 1, x, a->z);
    sfem_model_multiply_stiffness(a->s->model, a->z, y, NULL);
    rotate(a, 0, y, y);
    for (i = 0; i < n; ++i)
        y[i] = a->held[i / 3] ? 0 : a->p * a->h * a->h * y[i] + mass[i / 3] * x[i];
}

static double dot(const double *x, const double *y, size_t n)
{
    double sum = 0;
    size_t i;
    for (i = 0; i < n; ++i) sum += x[i] * y[i];
    return sum;
}

/* Makes y orthogonal to the first `count` vectors v in the inner product of A (av = A v), and of length 1; ay = A y. */
static double orthonormalize(const pencil *a, int count, const double *v, const double *av,
                             double *y, double *ay)
{
    const size_t n = 3 * (size_t)a->s->mesh.nodes;
    double length;
    size_t i;
    int k, twice;
    for (twice = 0; twice < 2; ++twice)
        for (k = 0; k < count; ++k) {
            const double c = dot(av + (size_t)k * n, y, n);
            for (i = 0; i < n; ++i) y[i] -= c * v[(size_t)k * n + i];
        }
    pencil_multiply(a, y, ay);
    length = sqrt(dot(y, ay, n));
    for (i = 0; i < n; ++i) {
        y[i] /= length;
        ay[i] /= length;
    }
    return length;
}

/* The largest eigenvalue of h^2 K x = lambda 4 A x. */
static double pencil_largest(pencil *a)
{
    const size_t n = 3 * (size_t)a->s->mesh.nodes;
    double *v = (double *)ex_new((LANCZOS + 1) * n, sizeof *v),
           *av = (double *)ex_new((LANCZOS + 1) * n, sizeof *av);
    double t[LANCZOS * LANCZOS] = {0}, lambda[LANCZOS], work[5 * LANCZOS];
    body_random random = {1};
    sfem_error err;
    size_t i;
    int j;
    for (i = 0; i < n; ++i) v[i] = a->held[i / 3] ? 0 : body_uniform(&random, -0.5, 0.5);
    orthonormalize(a, 0, v, av, v, av);
    for (j = 0; j < LANCZOS; ++j) {
        double *x = v + (size_t)j * n, *y = x + n, length;
        sfem_matrix_multiply(&a->k, x, y, NULL);
        for (i = 0; i < n; ++i) y[i] = a->held[i / 3] ? 0 : y[i];
        t[j + j * LANCZOS] = dot(x, y, n);
        rotate(a, 1, y, y);
        sfem_ldl_solve(a->factor, 1, y, a->work, NULL);
        rotate(a, 0, y, y);
        length = orthonormalize(a, j + 1, v, av, y, av + (size_t)(j + 1) * n);
        if (j + 1 < LANCZOS) t[j + 1 + j * LANCZOS] = length;
    }
    bench_must(sfem_dense_eigen(LANCZOS, t, NULL, lambda, work, &err), &err);
    free(v);
    free(av);
    return a->h * a->h / 4 * lambda[LANCZOS - 1];
}

static void table_of_eigenvalues(const real_scene *s, const settings *o)
{
    static const sfem_tangent kind[2] = {SFEM_TANGENT_EXACT, SFEM_TANGENT_FROZEN};
    static const double p[3] = {0.28, 0.5, 1};
    const size_t nodes = (size_t)s->mesh.nodes;
    const reference r = reference_for(s, o);
    pencil a;
    sfem_error err;
    int i, j, k, c, pose;
    memset(&a, 0, sizeof a);
    a.s = s;
    a.held = (unsigned char *)ex_new(nodes, 1);
    a.frame = (double *)ex_new(9 * nodes, sizeof *a.frame);
    a.z = (double *)ex_new(3 * nodes, sizeof *a.z);
    for (i = 0; i < s->pin_count; ++i) a.held[s->pins[i]] = 1;
    bench_must(sfem_model_combine(s->model, 1, 0, 0, NULL, &a.k, &err), &err);
    printf("%6s %5s   largest and median over the poses: exact %13s frozen\n", "1/h", "p", "");
    for (k = 0; k < o->steps; ++k)
        for (i = 0; i < 3; ++i) {
            a.h = 1 / o->h[k];
            a.p = p[i];
            pencil_factor(&a);
            printf("%6g %5g", o->h[k], p[i]);
            for (c = 0; c < 2; ++c) {
                double top[SAMPLES];
                for (j = 0, pose = POSES_EVERY - 1; pose < SAMPLES; pose += POSES_EVERY) {
                    pencil_pose(&a, r.u + (size_t)pose * 3 * nodes, kind[c]);
                    top[j++] = pencil_largest(&a);
                }
                printf(" %11.3f", (bench_median(top, j), top[j - 1]));
                printf(" %8.3f  ", top[j / 2]);
            }
            printf("\n");
            fflush(stdout);
            sfem_ldl_free(a.factor);
            free(a.work);
        }
    sfem_matrix_free(&a.k);
    free(a.held);
    free(a.frame);
    free(a.z);
    free(r.u);
}

/* --------------------------------------------------------------------------------------------
 * main
 * -------------------------------------------------------------------------------------------- */

static void print_scene(const real_scene *s, const settings *o)
{
    printf("\n%s: %d nodes, %d tets, %.1f %% of them below quality 0.1, %d nodes held; %s, nu = "
           "%g, E = %g Pa\n",
           s->def->name, (int)s->mesh.nodes, (int)s->mesh.tets, 100 * body_below(&s->mesh, 0.1),
           (int)s->pin_count, o->law_name, o->poisson, s->def->young);
}

static settings settings_of(const ex_options *o)
{
    settings s;
    const char *list = ex_text(o, "--h");
    char *end;
    memset(&s, 0, sizeof s);
    s.quick = ex_given(o, "--quick");
    s.law_name = ex_text(o, "--law");
    s.law = ex_choice(o, "--law") == 0   ? SFEM_COROTATIONAL
            : ex_choice(o, "--law") == 1 ? SFEM_STVK
                                         : SFEM_NEOHOOKEAN;
    real_tet = (sfem_tet)ex_choice(o, "--tet"); /* in the order of the enumeration */
    if (real_tet == SFEM_TET_SMOOTH) {          /* references of their own */
        static char name[64];
        snprintf(name, sizeof name, "%s --tet smooth", s.law_name);
        s.law_name = name;
    }
    s.poisson = ex_real(o, "--poisson");
    dissipation = ex_real(o, "--dissipation");
    s.out = ex_text(o, "--out");
    s.scene = ex_text(o, "--scene");
    s.form = ex_text(o, "--form");
    do {
        s.h[s.steps] = strtod(list, &end);
        if (end == list || s.h[s.steps] < 30 || fmod(s.h[s.steps], 30) != 0 || s.steps == 7)
            ex_fail("--h: up to 7 steps a second, multiples of 30, not '%s'", list);
        ++s.steps;
        list = end + (*end == ',');
    } while (*list);
    return s;
}

int main(int argc, char **argv)
{
    static const ex_option table[] = {
        {"--quick", NULL, NULL, "three small scenes, references at h = 1/240"},
        {"--scene", "TEXT", NULL, "only scenes with this in their names"},
        {"--form", "TEXT", NULL, "only rows with this in their names"},
        {"--young", "E", NULL, "Young's modulus, Pa, instead of the scenes' own"},
        {"--h", "N,..", "60", "steps a second, multiples of 30"},
        {"--law", "corotational|stvk|neohookean", "corotational", "of the material"},
        {"--tet", "linear|smooth", "linear", "of the material"},
        {"--poisson", "NU", "0.38", "Poisson's ratio"},
        {"--dissipation", "A", "0.1", "of corrected steps"},
        {"--out", "DIR", "build/bench-real", "where the references are kept"},
        {"--reference", NULL, NULL, "only make the references that are missing"},
        {"--long", NULL, NULL, "energy over six seconds"},
        {"--eigen", NULL, NULL, "the largest eigenvalues over the references' poses"},
        {NULL, NULL, NULL, NULL}};
    const ex_options o = ex_parse(argc, argv, "The step on real and unstructured meshes.", table);
    const settings s = settings_of(&o);
    const double begin = ex_seconds();
    int k, run = 0;
    ex_make_directory(s.out);
    printf("vectors %d doubles wide; flags: %s\n", sfem_vector_width(), SFEM_BENCH_FLAGS);
    for (k = 0; k < REAL_SCENES; ++k) {
        real_def d = real_table[k];
        real_scene scene;
        sfem_error err;
        if (s.scene && !strstr(d.name, s.scene)) continue;
        if (s.quick && !s.scene && strcmp(d.name, "octopus 3e6") && strcmp(d.name, "bar 1e6") &&
            strcmp(d.name, "shark 1e6"))
            continue;
        if (!real_there(&d)) {
            printf("\n%s: left out, SFEM_MESHES names no directory with %s\n", d.name, d.file);
            continue;
        }
        if (ex_given(&o, "--young")) d.young = ex_positive(&o, "--young");
        bench_must(real_open(&d, s.law, s.poisson, &scene, &err), &err);
        print_scene(&scene, &s);
        if (ex_given(&o, "--reference"))
            free(reference_for(&scene, &s).u);
        else if (ex_given(&o, "--long"))
            table_of_energies(&scene, &s);
        else if (ex_given(&o, "--eigen"))
            table_of_eigenvalues(&scene, &s);
        else
            table_of_errors(&scene, &s);
        real_close(&scene);
        ++run;
    }
    if (!run) printf("no such scene\n");
    printf("\n%.0f s\n", ex_seconds() - begin);
    return 0;
}
