/* integrators - run time against error: every integrator of the library over a sweep of steps.
 *
 *     bench/integrators [--quick] [--out build/bench-integrators] [--cells 10,2,2] [--scene TEXT]
 *                       [--references build/bench-real]
 *
 * Bars. A bar of 1 x 0.25 x 0.25 m, nu = 0.4, 1000 kg/m^3, for a second: it falls from the horizontal, held at one
 * end (bend), or tumbles freely at 10 rad/s (spin). E = 3e5 or 3e7 Pa, corotational or stable neo-Hookean,
 * undamped or damped by 2/s. Mass damping, because that is the same force for every method: stiffness
 * damping is K0's, rotated, with a constant factor, and K(u)'s with Newton, so that the limits differ; two scenes
 * more have it (1e-2 and 1e-3 s), each family beside its own limit, and print how far apart these are.
 *   Error: the root mean square, over all nodes and every 1/15 s, of the distance from a solution converged in
 * time, over that of the displacement. That solution is Richardson's extrapolation of two runs by central
 * difference (of the scenes with stiffness damping (p,q,r) at accuracy 1e-12 without dissipation, and Newton), steps
 * halved; what it changed is printed.
 *   Real and unstructured meshes (real.h), corotational, nu = 0.38, for a second: held or spinning. Error: of the 20
 * tip nodes every 1/30 s, from the trapezoidal rule by Newton at a small step (reference.h). Without SFEM_MESHES only
 * the bars and the scattered bodies are there. Methods that such meshes take too long with are left out.
 *   Time: of the processor, one thread, per simulated second, factorisation of what is
 * constant excluded; the least of repeated runs counts, in two passes through all methods. A run is on the
 * front if none as accurate takes less than 1/1.05 of its time: so much the least varies on a busy machine.
 * The time to an error of 10, 3 or 1 % is read from the line through a method's points, logarithmic; the
 * default or one of its accuracy settings is on the front there if no other method takes less than 1/1.05 of it
 * (not asked: the default's forms without safeguard or dissipation, in mixed precision, with a factor of the present tangent).
 * A run fails that returns an error, or whose error exceeds twice the motion (opposite phases). Newton analyses once,
 * factorises in every iteration, and goes on with its best iterate where it stalls (stiff bodies that spin do, at
 * relative residuals of 1e-7 to 1e-5, from rounding); the share of such steps stands under "rejected".
 *   Writes integrators.csv, a plot for each scene, one of all bars and one of all real scenes (real.svg); the pale
 * band is the Pareto front.
 */
#include "reference.h"
#include "../tests/linear.h"

enum { SAMPLES_MOST = REFERENCE_SAMPLES, STEPS_MOST = 12, BARS = 18, REALS_MOST = 20 };
enum { SCENES = BARS + REALS_MOST, QUICK_REALS = 2, METHODS = 23, LEVELS = 4, FRONT_LEVELS = 3 };

#define NOISE                                                                                      \
    1.05 /* of two times, that nothing follows from: the least of repeated runs varies by 2 to 4 % */

/* The least of at least so many runs, of more where they are short, half of them after all other methods'. */
enum { PASSES = 2, RUNS_LEAST = 3, RUNS_MOST = 9 };
static const double enough = 0.06; /* s of a pass, then no more runs */

static const double level[LEVELS] = {0.1, 0.03, 0.01, 0.003};

/* --------------------------------------------------------------------------------------------
 * what is compared
 * -------------------------------------------------------------------------------------------- */

typedef struct method {
    const char *name, *color;
    int style, marker;
    sfem_integrator integrator;
    int coarse, fine;   /* bars: steps of 1/15 s over 2^coarse .. 2^fine */
    int real;           /* real meshes: steps of 1/30 s over 2^0 .. 2^(real-1); 0: left out */
    int setting;        /* 1: the default or an accuracy setting of it; 2: another form of it */
    double p, accuracy; /* 0: the default's */
    int conservative;   /* no dissipation */
    int no_safeguard, source, iterations;
    sfem_precision precision;
    double refactorise, tolerance; /* 0: none; Newton's own, 1e-8 */
} method;

enum { THICK = EX_LINE | EX_MARKERS | EX_THICK, PLAIN = EX_LINE | EX_MARKERS };
enum { DASHED = EX_LINE | EX_MARKERS | EX_DASHED };

/* The name, colour, style and marker; the method, halvings of bars' steps, and how many steps of real scenes. */
#define LOOKS(name_, color_, style_, marker_)                                                      \
    .name = name_, .color = color_, .style = style_, .marker = marker_
#define STEPS(integrator_, coarse_, fine_, real_)                                                  \
    .integrator = integrator_, .coarse = coarse_, .fine = fine_, .real = real_

static const method methods[METHODS] = {
    {LOOKS("default", "#2563a8", THICK, 0), STEPS(SFEM_PQR, 0, 7, 4), .setting = 1},
    {LOOKS("accuracy 1: one solve", "#6fc3ee", PLAIN, 2), STEPS(SFEM_PQR, 0, 7, 4), .setting = 1,
     .accuracy = 1},
    {LOOKS("accuracy 1e-4", "#1b9ad6", PLAIN, 1), STEPS(SFEM_PQR, 0, 7, 4), .setting = 1,
     .accuracy = 1e-4},
    {LOOKS("accuracy 1e-5", "#4a7fd0", PLAIN, 3), STEPS(SFEM_PQR, 0, 7, 4), .setting = 1,
     .accuracy = 1e-5},
    {LOOKS("accuracy 1e-8", "#123b6b", DASHED, 3), STEPS(SFEM_PQR, 0, 7, 4), .setting = 1,
     .accuracy = 1e-8},
    {LOOKS("one solve, no safeguard", "#9fb9d6", DASHED, 4), STEPS(SFEM_PQR, 0, 7, 0), .setting = 2,
     .accuracy = 1, .no_safeguard = 1},
    {LOOKS("default, mixed precision", "#123b6b", DASHED, 5), STEPS(SFEM_PQR, 0, 7, 4),
     .setting = 2, .precision = SFEM_MIXED},
    {LOOKS("(1/4,1,1) of the source", "#4d4d4d", PLAIN, 3), STEPS(SFEM_PQR, 0, 7, 0), .p = 0.25,
     .accuracy = 1, .no_safeguard = 1, .source = 1},
    {LOOKS("default, refactorised", "#3a9aa5", DASHED, 7), STEPS(SFEM_PQR, 0, 7, 4), .setting = 2,
     .refactorise = 4},
    {LOOKS("central difference", "#3f8f5b", THICK, 3), STEPS(SFEM_CENTRAL, 2, 11, 0)},
    {LOOKS("KR-alpha, 0.8", "#5d9c2f", PLAIN, 2), STEPS(SFEM_KR_ALPHA, 0, 7, 4)},
    {LOOKS("Gui, 4", "#9bbf3b", DASHED, 6), STEPS(SFEM_GUI, 0, 7, 0)},
    {LOOKS("Chang", "#c9b037", DASHED, 7), STEPS(SFEM_CHANG, 0, 7, 0)},
    {LOOKS("Newmark, Newton to 1e-8", "#d1603d", THICK, 1), STEPS(SFEM_NEWMARK, 0, 4, 0)},
    {LOOKS("Newmark, Newton to 1e-5", "#d1603d", DASHED, 4), STEPS(SFEM_NEWMARK, 0, 4, 3),
     .tolerance = 1e-5},
    {LOOKS("Newmark, Newton to 1e-3", "#a8432a", DASHED, 6), STEPS(SFEM_NEWMARK, 0, 4, 3),
     .tolerance = 1e-3},
    {LOOKS("Newmark, semi-implicit", "#b8892b", PLAIN, 0), STEPS(SFEM_NEWMARK, 0, 5, 4),
     .iterations = 1},
    {LOOKS("backward Euler", "#b04668", PLAIN, 2), STEPS(SFEM_BACKWARD_EULER, 0, 4, 0)},
    {LOOKS("backward Euler, 1 iteration", "#d98aa4", PLAIN, 6), STEPS(SFEM_BACKWARD_EULER, 0, 5, 4),
     .iterations = 1},
    {LOOKS("HHT, 0.1", "#8a5aa8", PLAIN, 3), STEPS(SFEM_HHT, 0, 4, 0)},
    {LOOKS("generalized-alpha, 0.8", "#b48ad0", DASHED, 7), STEPS(SFEM_GENERALIZED_ALPHA, 0, 4, 0)},
    {LOOKS("Bathe", "#7a3520", PLAIN, 1), STEPS(SFEM_BATHE, 0, 4, 0)},
    {LOOKS("default, no dissipation", "#3b2f8f", DASHED, 1), STEPS(SFEM_PQR, 0, 7, 4), .setting = 2,
     .conservative = 1},
};

static const method by_central = {.integrator = SFEM_CENTRAL};
static const method by_corrections = {.integrator = SFEM_PQR, .accuracy = 1e-12, .conservative = 1};
static const method by_newton = {.integrator = SFEM_NEWMARK};

typedef struct scene {
    char name[64], file[64];
    int spin, stiff, neo_hookean;
    double alpha, beta;
    const real_def *real_def; /* NULL: a bar */
    real_scene real;          /* of which real_def, model and mesh */
    sfem_model *model;
    sfem_int nodes, pin_count, *pins;
    double *v, gravity[3];   /* [3 nodes] at the start */
    int samples, rate;       /* so many a second are compared */
    const sfem_int *watched; /* [watched_count] nodes that are; NULL: all */
    size_t count;            /* numbers in a sample */
    double *reference[2];    /* [samples][count]: the limit of constant factors, and of Newton */
    double motion;           /* root mean square of the displacement */
    double enough;           /* s of a pass, then no more runs */
} scene;

typedef struct point { /* one method, one step */
    double h, error,
        time; /* time: seconds of processor per simulated second; error NAN if failed */
    int64_t steps,
        rejected;     /* by the energy safeguard; or where Newton should and did not converge */
    double solves;    /* a step */
    char failure[96]; /* empty: none */
} point;

typedef struct series {
    point at[STEPS_MOST];
    int count;
} series;

static int is_newton(const method *m)
{
    return m->integrator == SFEM_NEWMARK || m->integrator == SFEM_BACKWARD_EULER ||
           m->integrator == SFEM_HHT || m->integrator == SFEM_GENERALIZED_ALPHA ||
           m->integrator == SFEM_BATHE;
}

/* --------------------------------------------------------------------------------------------
 * scenes
 * -------------------------------------------------------------------------------------------- */

static void describe(scene *s, int index)
{
    static const char *const bend[2] = {"bend", "spin"}, *const stiff[2] = {"soft", "stiff"};
    static const char *const law[2] = {"corotational", "neo-Hookean"};
    static const char *const damped[3] = {"undamped", "damped", "stiffness-damped"};
    int damping = index < 16 ? index & 1 : 2, i;
    memset(s, 0, sizeof *s);
    s->spin = index < 16 && (index >> 3 & 1);
    s->stiff = index < 16 ? index >> 2 & 1 : index & 1;
    s->neo_hookean = index < 16 && (index >> 1 & 1);
    s->alpha = damping == 1 ? 2 : 0;
    s->beta = damping < 2 ? 0 : s->stiff ? 1e-3 : 1e-2;
    snprintf(s->name, sizeof s->name, "%s, %s, %s, %s", bend[s->spin], stiff[s->stiff],
             law[s->neo_hookean], damped[damping]);
    snprintf(s->file, sizeof s->file, "%02d-%s-%s-%s-%s.svg", index + 1, bend[s->spin],
             stiff[s->stiff], law[s->neo_hookean], damped[damping]);
    for (i = 0; s->file[i]; ++i)
        if (s->file[i] == 'H') s->file[i] = 'h';
}

static void make_references(scene *s)
{
    int c;
    for (c = 0; c < 2; ++c)
        s->reference[c] = (double *)ex_new((size_t)s->samples * s->count, sizeof(double));
}

static void create_bar(scene *s, const sfem_int cells[3], int quick)
{
    static const sfem_real size[3] = {1, 0.25, 0.25}, omega[3] = {2, 10, 3};
    const sfem_real center[3] = {0.5, 0.125, 0.125};
    sfem_model_def def = linear_model_def();
    sfem_mesh mesh;
    sfem_error err;
    sfem_int i;
    int c;
    bench_must(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), &err);
    s->nodes = mesh.nodes;
    s->count = 3 * (size_t)mesh.nodes;
    s->samples = s->rate = 15;
    s->enough = quick ? enough / 4 : enough;
    s->gravity[2] = s->spin ? 0 : -9.81;
    s->pins = (sfem_int *)ex_new((size_t)mesh.nodes, sizeof *s->pins);
    s->v = (double *)ex_new(3 * (size_t)mesh.nodes, sizeof *s->v);
    make_references(s);
    for (i = 0; i < mesh.nodes; ++i) {
        if (!s->spin && mesh.x[3 * i] == 0) s->pins[s->pin_count++] = i;
        for (c = 0; s->spin && c < 3; ++c) {
            const int d = (c + 1) % 3, e = (c + 2) % 3;
            s->v[3 * i + c] = omega[d] * (mesh.x[3 * i + e] - center[e]) -
                              omega[e] * (mesh.x[3 * i + d] - center[d]);
        }
    }
    def.mesh = &mesh;
    def.material.young = s->stiff ? 3e7 : 3e5;
    def.material.poisson = 0.4;
    def.material.law = s->neo_hookean ? SFEM_NEOHOOKEAN : SFEM_COROTATIONAL;
    def.material.mass_damping = s->alpha;
    def.material.stiffness_damping = s->beta;
    bench_must(sfem_model_create(&def, &s->model, &err), &err);
    sfem_mesh_free(&mesh);
}

/* "r05-octopus-free.svg" */
static void describe_real(scene *s, const real_def *d, int index)
{
    int i;
    memset(s, 0, sizeof *s);
    s->real_def = d;
    snprintf(s->name, sizeof s->name, "%s", d->name);
    snprintf(s->file, sizeof s->file, "r%02d-%s.svg", index + 1, d->name);
    for (i = 0; s->file[i]; ++i)
        if (s->file[i] == ' ') s->file[i] = '-';
}

static const double real_poisson = 0.38;

static void create_real(scene *s, int quick)
{
    sfem_error err;
    bench_must(real_open(s->real_def, SFEM_COROTATIONAL, real_poisson, &s->real, &err), &err);
    s->model = s->real.model;
    s->nodes = s->real.mesh.nodes;
    s->pins = s->real.pins;
    s->pin_count = s->real.pin_count;
    s->v = s->real.velocity;
    memcpy(s->gravity, s->real.gravity, sizeof s->gravity);
    s->watched = s->real.tip;
    s->count = 3 * REAL_TIPS;
    s->samples = s->rate = REFERENCE_SAMPLES;
    s->enough = quick ? enough / 4 : 5 * enough;
    make_references(s);
}

static void destroy(scene *s)
{
    if (s->real_def) {
        real_close(&s->real);
    } else {
        sfem_model_free(s->model);
        free(s->pins);
        free(s->v);
    }
    free(s->reference[0]);
    free(s->reference[1]);
}

static sfem_body *make_body(const scene *s, const method *m, sfem_error *err)
{
    sfem_body_def def = sfem_default_body_def();
    sfem_body *body = NULL;
    def.integrator = m->integrator;
    if (m->p > 0) def.p = m->p;
    if (m->accuracy > 0) def.accuracy = m->accuracy;
    if (m->conservative) def.dissipation = 0;
    def.safeguard = !m->no_safeguard;
    if (m->source) def.frame = SFEM_FRAME_REST;
    def.plain_load = m->source;
    def.precision = m->precision;
    def.refactorise = m->refactorise;
    def.newton.accept_best = 1;
    if (m->tolerance > 0) def.newton.tolerance = m->tolerance;
    if (m->iterations) {
        def.newton.iterations = m->iterations;
        def.newton.line_search = !(m->iterations == 1);
    }
    def.pins = s->pins;
    def.pin_count = s->pin_count;
    memcpy(def.gravity, s->gravity, sizeof def.gravity);
    return sfem_body_create(s->model, &def, &body, err) == SFEM_OK ? body : NULL;
}

/* --------------------------------------------------------------------------------------------
 * runs
 * -------------------------------------------------------------------------------------------- */

/* Of a field [nodes][3] what is compared. */
static void sample(const scene *s, const double *u, double *out)
{
    size_t i, k;
    if (!s->watched) memcpy(out, u, s->count * sizeof *u);
    for (i = 0; s->watched && i < s->count / 3; ++i)
        for (k = 0; k < 3; ++k) out[3 * i + k] = u[3 * (size_t)s->watched[i] + k];
}

/* From the start through the samples in 2^halvings steps each; where out is given, the displacements at their
 * ends go there, as far as they came. Seconds of processor. */
static double run(const scene *s, sfem_body *body, int halvings, double *out, point *p)
{
    int64_t unconverged = 0;
    const double h = 1.0 / (s->rate << halvings);
    const size_t n = 3 * (size_t)s->nodes;
    sfem_error err;
    double spent = 0, iterations = 0;
    int i, k;
    size_t j;
    bench_must(sfem_body_set_state(body, NULL, s->v, &err), &err);
    for (i = 0; i < s->samples; ++i) {
        const double start = bench_seconds();
        const double *u;
        for (k = 0; k < 1 << halvings; ++k) {
            if (sfem_body_step(body, h, &err) != SFEM_OK) {
                snprintf(p->failure, sizeof p->failure, "%.90s", err.text);
                return spent;
            }
            iterations += sfem_body_newton(body).iterations;
            unconverged +=
                sfem_body_newton(body).iterations > 2 && !sfem_body_newton(body).converged;
        }
        spent += bench_seconds() - start;
        u = sfem_body_displacement(body);
        for (j = 0; j < n; ++j)
            if (!(fabs(u[j]) < 100)) {
                snprintf(p->failure, sizeof p->failure, "exploded after %.2f s",
                         (i + 1.0) / s->rate);
                return spent;
            }
        if (out) sample(s, u, out + (size_t)i * s->count);
    }
    p->steps = sfem_body_get_info(body).steps;
    p->rejected = sfem_body_get_info(body).rejected + unconverged;
    p->solves = ((double)sfem_body_get_info(body).solves + iterations) / (s->samples << halvings);
    return spent * s->rate / s->samples;
}

static double rms(const double *a, const double *b, size_t n)
{
    double sum = 0;
    size_t i;
    for (i = 0; i < n; ++i) sum += (a[i] - (b ? b[i] : 0)) * (a[i] - (b ? b[i] : 0));
    return sqrt(3 * sum / (double)n);
}

/* The limit of a family: two runs, extrapolated; what that changed of the finer, over the motion. */
static double refer(scene *s, const method *m, int halvings, double *out)
{
    const size_t n = (size_t)s->samples * s->count;
    double *coarse = (double *)ex_new(n, sizeof *coarse), changed = 0;
    int way;
    size_t i;
    for (way = 0; way < 2; ++way) {
        sfem_error err;
        sfem_body *body = make_body(s, m, &err);
        point p;
        memset(&p, 0, sizeof p);
        if (!body) ex_fail("%s", err.text);
        run(s, body, halvings + way, way ? out : coarse, &p);
        if (p.failure[0]) ex_fail("the reference of %s: %s", s->name, p.failure);
        sfem_body_free(body);
    }
    for (i = 0; i < n; ++i) {
        const double d = (out[i] - coarse[i]) / 3;
        changed += d * d;
        out[i] += d;
    }
    free(coarse);
    s->motion = rms(out, NULL, n);
    return sqrt(3 * changed / (double)n) / s->motion;
}

/* The first pass takes the error, too; the second, of runs that are short enough to be repeated, the time again. */
static void measure(const scene *s, const method *m, int halvings, int pass, double *work, point *p)
{
    const size_t n = (size_t)s->samples * s->count;
    const double *exact = s->reference[is_newton(m)];
    sfem_body *body;
    sfem_error err;
    double total = 0;
    int k;
    if (pass && (p->failure[0] || p->time > s->enough)) return;
    if (!pass) {
        memset(p, 0, sizeof *p);
        p->h = 1.0 / (s->rate << halvings);
        p->error = p->time = NAN;
    }
    body = make_body(s, m, &err);
    if (!body || sfem_body_prepare(body, p->h, &err) != SFEM_OK) {
        snprintf(p->failure, sizeof p->failure, "%.90s", err.text);
        sfem_body_free(body);
        return;
    }
    for (k = 0;
         k < RUNS_MOST && !(k && p->failure[0]) && total < (k < RUNS_LEAST ? 3 : 1) * s->enough;
         ++k) {
        const double t = run(s, body, halvings, pass || k ? NULL : work, p);
        total += t;
        if (!(p->time <= t)) p->time = t;
    }
    if (!pass && !p->failure[0]) {
        p->error = rms(work, exact, n) / s->motion;
        if (p->error > 2)
            snprintf(p->failure, sizeof p->failure, "error %.3g of the motion", p->error);
    }
    if (p->failure[0]) p->error = NAN;
    sfem_body_free(body);
}

/* --------------------------------------------------------------------------------------------
 * fronts
 * -------------------------------------------------------------------------------------------- */

/* Least time in which any of them reaches the error or less. */
static double least_time(const series *all, int count, double error)
{
    double best = HUGE_VAL;
    int i, k;
    for (i = 0; i < count; ++i)
        for (k = 0; k < all[i].count; ++k)
            if (all[i].at[k].error <= error && all[i].at[k].time < best) best = all[i].at[k].time;
    return best;
}

/* Time to an error: where the line through the series' points, logarithmic, first comes below it. */
static double time_to(const series *s, double error)
{
    double best = NAN;
    int k;
    for (k = 0; k < s->count; ++k) {
        const point *b = &s->at[k], *a = k ? b - 1 : NULL;
        double t;
        if (!(b->error <= error)) continue;
        t = b->time;
        if (a && a->error > error && a->time < b->time)
            t = b->time * pow(a->time / b->time, log(error / b->error) / log(a->error / b->error));
        if (!(t >= best)) best = t;
    }
    return best;
}

/* The method that reaches the error first, of the settings of the default or of the others; -1: none. */
static int first_to(const series *all, double error, int setting, double *time)
{
    int i, best = -1;
    for (i = 0; i < METHODS; ++i) {
        const double t = time_to(all + i, error);
        if (methods[i].setting != setting || !(t > 0) || (best >= 0 && t >= *time)) continue;
        best = i;
        *time = t;
    }
    return best;
}

/* Is no run as accurate in less than 1/margin of the time? */
static int on_front(const series *all, const point *p, double margin)
{
    return p->error <= 1 && p->time <= margin * least_time(all, METHODS, p->error);
}

/* The front as a line, by time. */
static int front_line(const series *all, double *x, double *y)
{
    int count = 0, i, k, j;
    for (i = 0; i < METHODS; ++i)
        for (k = 0; k < all[i].count; ++k) {
            const point *p = &all[i].at[k];
            if (!on_front(all, p, 1)) continue;
            for (j = count++; j > 0 && x[j - 1] > 1e3 * p->time; --j)
                x[j] = x[j - 1], y[j] = y[j - 1];
            x[j] = 1e3 * p->time;
            y[j] = p->error;
        }
    return count;
}

/* --------------------------------------------------------------------------------------------
 * pictures
 * -------------------------------------------------------------------------------------------- */

enum { POINTS = METHODS * STEPS_MOST };

typedef struct picture {
    ex_plot plot;
    char title[96];
    double x[METHODS][STEPS_MOST], y[METHODS][STEPS_MOST], front_x[POINTS], front_y[POINTS];
    double failed_x[POINTS], failed_y[POINTS];
} picture;

/* Of real scenes without the default's other forms. */
static void draw(picture *q, const scene *s, const series *measured)
{
    static series all[METHODS];
    int i, k, failed = 0;
    memcpy(all, measured, sizeof all);
    for (i = 0; s->real_def && i < METHODS; ++i)
        if (methods[i].setting == 2) all[i].count = 0;
    snprintf(q->title, sizeof q->title, "%s", s->name);
    q->plot = ex_plot_new(q->title, "ms of processor per simulated second", "error / motion",
                          EX_LOG_X | EX_LOG_Y);
    ex_plot_add(&q->plot, "Pareto front", q->front_x, q->front_y,
                front_line(all, q->front_x, q->front_y), EX_LINE | EX_BAND);
    ex_plot_look(&q->plot, "#e0a800", 0);
    for (i = 0; i < METHODS; ++i) {
        for (k = 0; k < all[i].count; ++k) {
            q->x[i][k] = 1e3 * all[i].at[k].time;
            q->y[i][k] = all[i].at[k].error;
            if (!all[i].at[k].failure[0]) continue;
            q->x[i][k] = q->y[i][k] = NAN;
            if (!(all[i].at[k].time > 0)) continue;
            q->failed_x[failed] = 1e3 * all[i].at[k].time;
            q->failed_y[failed++] = 2;
        }
        if (!all[i].count) continue;
        ex_plot_add(&q->plot, methods[i].name, q->x[i], q->y[i], all[i].count, methods[i].style);
        ex_plot_look(&q->plot, methods[i].color, methods[i].marker);
    }
    ex_plot_add(&q->plot, NULL, q->x[0], q->y[0], all[0].count, methods[0].style); /* on top */
    ex_plot_look(&q->plot, methods[0].color, methods[0].marker);
    if (failed) {
        ex_plot_add(&q->plot, "failed on the way", q->failed_x, q->failed_y, failed, EX_MARKERS);
        ex_plot_look(&q->plot, "#c00000", 7);
    }
}

/* --------------------------------------------------------------------------------------------
 * tables
 * -------------------------------------------------------------------------------------------- */

typedef struct tally {                  /* of one method over the scenes */
    int fronts, near, points, failures; /* scenes, runs on the front; all runs */
    double ratio[LEVELS][SCENES];       /* of the time to an error over the default's */
    int ratios[LEVELS];
} tally;

typedef struct kind { /* bars, or real meshes */
    tally method[METHODS];
    int settled[FRONT_LEVELS]; /* scenes in which the default or a setting is on the front there */
    char off[SCENES * 96];     /* scenes in which the default is on no front */
    picture *pictures;         /* [SCENES] */
    ex_plot plots[SCENES];
    int scenes;
} kind;

/* The point at so many steps a second, or NULL. */
static const point *point_at(const series *s, double steps)
{
    int k;
    for (k = 0; k < s->count; ++k)
        if (fabs(steps * s->at[k].h - 1) < 1e-6) return &s->at[k];
    return NULL;
}

static void print_times(const series *all, const series *r, tally *t)
{
    int l;
    for (l = 0; l < LEVELS; ++l) {
        const double mine = time_to(r, level[l]), its = time_to(all, level[l]);
        if (mine > 0 && its > 0)
            printf(" %8.2f (%6.2f)", 1e3 * mine, mine / its);
        else if (mine > 0)
            printf(" %8.2f (     -)", 1e3 * mine);
        else
            printf(" %8s %8s", "-", "");
        if (mine > 0 && its > 0) t->ratio[l][t->ratios[l]++] = mine / its;
    }
    printf("\n");
}

static void print_method(const series *all, int i, tally *t)
{
    const series *r = all + i;
    const point *at[3];
    int front = 0, k;
    at[0] = point_at(r, 60);
    at[1] = point_at(r, 240);
    at[2] = &r->at[r->count - 1];
    for (k = 0; k < r->count; ++k) {
        front += on_front(all, &r->at[k], NOISE);
        t->failures += r->at[k].failure[0] != 0;
    }
    t->near += front;
    t->fronts += front > 0;
    t->points += r->count;
    printf("%c %-27s", front ? '*' : ' ', methods[i].name);
    for (k = 0; k < 3; ++k)
        if (at[k])
            printf(k < 2 ? " %7.4f" : " %7.5f", at[k]->error);
        else
            printf(" %7s", "-");
    if (at[0] && at[0]->steps > 0 && !at[0]->failure[0])
        printf(" | %7.2f %6.2f %5.1f %% |", 1e3 * at[0]->time, at[0]->solves,
               100.0 * (double)at[0]->rejected / (double)at[0]->steps);
    else
        printf(" | %7s %6s %7s |", "-", "", "");
    print_times(all, r, t);
}

/* Per level of error: is the default, or one of its accuracy settings, on the front? */
static void print_fronts(const series *all, kind *c)
{
    int l;
    for (l = 0; l < FRONT_LEVELS; ++l) {
        double mine = 0, other = 0;
        const int i = first_to(all, level[l], 1, &mine), j = first_to(all, level[l], 0, &other);
        const int on = i >= 0 && (j < 0 || mine <= NOISE * other);
        printf("  at %2.0f %%: %s", 100 * level[l],
               on       ? "on the front, "
               : i >= 0 ? "OFF the front, "
                        : "OFF the front, no setting of the default gets there");
        if (i >= 0) printf("'%s' in %.2f ms", methods[i].name, 1e3 * mine);
        if (j >= 0)
            printf("; of the others '%s' in %.2f", methods[j].name, 1e3 * other);
        else
            printf("; of the others none");
        printf("\n");
        c->settled[l] += on;
    }
}

static void print_scene(const series *all, kind *c, const char *name)
{
    const int fronts = c->method[0].fronts;
    int i, k, l;
    printf("  %-27s %7s %7s %7s | %7s %6s %7s | %s\n", "", "h=1/60", "1/240", "finest", "ms 1/60",
           "solves", "rejected",
           "ms per second for an error of 10 %, 3 %, 1 %, 0.3 % (times the default's)");
    for (i = 0; i < METHODS; ++i)
        if (all[i].count) print_method(all, i, &c->method[i]);
    if (c->method[0].fronts == fronts) {
        const size_t used = strlen(c->off);
        snprintf(c->off + used, sizeof c->off - used, "%s%s", used ? "; " : "", name);
    }
    printf("  failed:");
    for (i = 0, l = 0; i < METHODS; ++i)
        for (k = 0; k < all[i].count; ++k)
            if (all[i].at[k].failure[0])
                printf("%s %s at h = 1/%.0f: %s", l++ ? ";" : "", methods[i].name,
                       1 / all[i].at[k].h, all[i].at[k].failure);
    printf("%s\n  time of the default over the least for its error, by h:", l ? "" : " none");
    for (k = 0; k < all->count; ++k)
        if (all->at[k].error <= 1)
            printf(" 1/%.0f %.2f", 1 / all->at[k].h,
                   all->at[k].time / least_time(all, METHODS, all->at[k].error));
    printf("\n");
    print_fronts(all, c);
    printf("\n");
    fflush(stdout);
}

static void write_csv(FILE *f, const scene *s, const series *all)
{
    int i, k;
    for (i = 0; i < METHODS; ++i)
        for (k = 0; k < all[i].count; ++k) {
            const point *p = &all[i].at[k];
            fprintf(f, "\"%s\",\"%s\",%.9g,%.6g,%.6g,%d,%ld,%ld,%.3g,\"%s\"\n", s->name,
                    methods[i].name, p->h, p->error, 1e3 * p->time, on_front(all, p, NOISE),
                    (long)p->steps, (long)p->rejected, p->solves, p->failure);
        }
    fflush(f);
}

static void print_summary(kind *c, const char *what)
{
    tally *t = c->method;
    int i, l;
    printf(
        "Over %d scenes of %s: on how many fronts, failed of all runs, and the median (in how many "
        "scenes it gets\nthere) of the time to an error over the default's\n\n%-27s %6s %9s",
        c->scenes, what, "", "fronts", "failed");
    for (l = 0; l < LEVELS; ++l) printf("  %10.1f %%", 100 * level[l]);
    printf("\n");
    for (i = 0; i < METHODS; ++i) {
        if (!t[i].points) continue;
        printf("%-27s %6d %4d/%-4d", methods[i].name, t[i].fronts, t[i].failures, t[i].points);
        for (l = 0; l < LEVELS; ++l) {
            const int n = t[i].ratios[l];
            if (n)
                printf("  %6.2f (%2d)", bench_median(t[i].ratio[l], n), n);
            else
                printf("  %11s", "-");
        }
        printf("\n");
    }
    printf("\nthe default is on the front, within %.0f %% of the time, in %d of %d scenes, with %d "
           "of its %d runs%s%s\n",
           100 * (NOISE - 1), t[0].fronts, c->scenes, t[0].near, t[0].points,
           *c->off ? "; off it in: " : "", c->off);
    printf("it or one of its accuracy settings is on the front");
    for (l = 0; l < FRONT_LEVELS; ++l)
        printf("%s at %.0f %% in %d", l ? "," : "", 100 * level[l], c->settled[l]);
    printf(" of %d\n\n", c->scenes);
}

/* --------------------------------------------------------------------------------------------
 * all of it
 * -------------------------------------------------------------------------------------------- */

static void find_bar_references(scene *s, int quick)
{
    const size_t n = (size_t)s->samples * s->count;
    if (s->beta == 0) {
        const double changed = refer(s, &by_central, quick ? 8 : 11, s->reference[0]);
        memcpy(s->reference[1], s->reference[0], n * sizeof(double));
        printf("%s\n  motion %.4f m; reference: h = 1/%d, extrapolation changed %.1e\n", s->name,
               s->motion, s->rate << (quick ? 9 : 12), changed);
    } else {
        const double newton = refer(s, &by_newton, quick ? 3 : 4, s->reference[1]);
        const double changed = refer(s, &by_corrections, quick ? 7 : 8, s->reference[0]);
        printf("%s\n  motion %.4f m; references: extrapolation changed %.1e (constant factor), "
               "%.1e (Newton); apart %.1e\n",
               s->name, s->motion, changed, newton,
               rms(s->reference[0], s->reference[1], n) / s->motion);
    }
}

static void find_real_reference(scene *s, const char *directory, int quick)
{
    const reference_def d = {directory, "corotational", real_poisson, quick};
    const reference r = reference_of(&s->real, &d);
    const size_t n = (size_t)s->samples * s->count;
    int i;
    for (i = 0; i < s->samples; ++i)
        sample(s, r.u + (size_t)i * 3 * (size_t)s->nodes, s->reference[0] + (size_t)i * s->count);
    free(r.u);
    memcpy(s->reference[1], s->reference[0], n * sizeof(double));
    s->motion = rms(s->reference[0], NULL, n);
    printf(
        "%s\n  %d nodes, %d tets, %d held; the tips move by %.4f m; reference: Newmark by Newton "
        "at h = 1/%d\n",
        s->name, (int)s->nodes, (int)s->real.mesh.tets, (int)s->pin_count, s->motion,
        30 * (quick ? 8 : s->real_def->reference));
}

typedef struct bench {
    const char *out, *references;
    int quick;
    FILE *csv;
    kind *kinds; /* bars, real meshes */
} bench;

/* The last step of a method's sweep in halvings, from its first on; < coarse: the method is left out. */
static int last_halving(const bench *b, const scene *s, const method *m)
{
    if (s->real_def) return m->real - 1 - (b->quick && m->real > 3);
    return b->quick ? m->coarse + 4 : m->fine;
}

static void run_scene(bench *b, scene *s)
{
    static series all[METHODS];
    kind *c = b->kinds + (s->real_def != NULL);
    double *work = (double *)ex_new((size_t)s->samples * s->count, sizeof *work);
    int pass, m, h;
    memset(all, 0, sizeof all);
    for (pass = 0; pass < (b->quick ? 1 : PASSES); ++pass)
        for (m = 0; m < METHODS; ++m) {
            all[m].count = 0;
            for (h = s->real_def ? 0 : methods[m].coarse; h <= last_halving(b, s, methods + m);
                 ++h) {
                ex_progress(s->name, pass * METHODS + m, PASSES * METHODS);
                measure(s, &methods[m], h, pass, work, &all[m].at[all[m].count++]);
            }
        }
    ex_progress(s->name, 1, 1);
    print_scene(all, c, s->name);
    write_csv(b->csv, s, all);
    draw(c->pictures + c->scenes, s, all);
    c->plots[c->scenes] = c->pictures[c->scenes].plot;
    c->plots[c->scenes].title = c->pictures[c->scenes].title;
    ex_plot_write(c->plots + c->scenes, ex_path(b->out, s->file));
    ++c->scenes;
    free(work);
}

static void run_bars(bench *b, const char *only, const sfem_int cells[3])
{
    int i;
    for (i = 0; i < BARS; ++i) {
        scene s;
        char number[16];
        describe(&s, i);
        snprintf(number, sizeof number, "%d", i + 1);
        if (only ? strcmp(only, number) && !strstr(s.name, only) : b->quick && i != 0 && i != 8)
            continue;
        create_bar(&s, cells, b->quick);
        find_bar_references(&s, b->quick);
        run_scene(b, &s);
        destroy(&s);
    }
}

/* Those of real_table that run unless others are asked for. */
static int is_chosen(const char *name, int quick)
{
    static const char *const chosen[] = {"octopus 3e6",    "scattered soft",   "octopus 2e5",
                                         "octopus free",   "armadillo 2e5",    "armadillo 1e6",
                                         "armadillo free", "bar 1e6",          "far bar 5k",
                                         "shark 1e6",      "simpleBridge 1e6", "scattered stiff"};
    const int count = quick ? QUICK_REALS : (int)(sizeof chosen / sizeof *chosen);
    int i;
    for (i = 0; i < count; ++i)
        if (!strcmp(name, chosen[i])) return 1;
    return 0;
}

static void run_reals(bench *b, const char *only)
{
    int i;
    for (i = 0; i < REAL_SCENES && i < REALS_MOST; ++i) {
        const real_def *d = real_table + i;
        scene s;
        if (only ? !strstr(d->name, only) : !is_chosen(d->name, b->quick)) continue;
        if (!real_there(d)) {
            printf("%s\n  left out, SFEM_MESHES names no directory with %s\n\n", d->name, d->file);
            continue;
        }
        describe_real(&s, d, i);
        create_real(&s, b->quick);
        find_real_reference(&s, b->references, b->quick);
        run_scene(b, &s);
        destroy(&s);
    }
}

int main(int argc, char **argv)
{
    static const ex_option table[] = {
        {"--quick", NULL, NULL, "four scenes, fewer steps and runs"},
        {"--out", "DIR", "build/bench-integrators", "where to write"},
        {"--references", "DIR", "build/bench-real", "where those of real meshes are kept"},
        {"--cells", "A,B,C", "10,2,2", "cells along the bar, five tets each"},
        {"--scene", "TEXT", NULL,
         "only scenes with this in their names, also others of real.h; a number: that bar"},
        {NULL, NULL, NULL, NULL}};
    static kind kinds[2];
    static const char *const what[2] = {"bars", "real and unstructured meshes"};
    static const char *const file[2] = {"integrators.svg", "real.svg"};
    const ex_options o = ex_parse(argc, argv, "Run time against error of every integrator.", table);
    const double begin = ex_seconds();
    double cells[3];
    sfem_int counts[3];
    bench b;
    int i;
    b.quick = ex_given(&o, "--quick");
    b.out = ex_text(&o, "--out");
    b.references = ex_text(&o, "--references");
    b.kinds = kinds;
    ex_reals(&o, "--cells", 3, cells);
    for (i = 0; i < 3; ++i) counts[i] = b.quick ? (i ? 2 : 6) : (sfem_int)cells[i];
    for (i = 0; i < 2; ++i) kinds[i].pictures = (picture *)ex_new(SCENES, sizeof(picture));
    ex_make_directory(b.out);
    ex_make_directory(b.references);
    b.csv = ex_open(ex_path(b.out, "integrators.csv"));
    fprintf(b.csv, "scene,method,h,error,ms_per_second,on_front,steps,rejected,solves,failure\n");
    printf(
        "bars of %d x %d x %d cells of five tets, %d tets; vectors %d doubles wide; *: within 5 %% "
        "of the Pareto front\nflags: %s\n\n",
        (int)counts[0], (int)counts[1], (int)counts[2],
        (int)(5 * counts[0] * counts[1] * counts[2]), sfem_vector_width(), SFEM_BENCH_FLAGS);
    run_bars(&b, ex_text(&o, "--scene"), counts);
    run_reals(&b, ex_text(&o, "--scene"));
    ex_close(b.csv, ex_path(b.out, "integrators.csv"));
    for (i = 0; i < 2; ++i) {
        if (!kinds[i].scenes) continue;
        print_summary(kinds + i, what[i]);
        ex_plots_write(kinds[i].plots, kinds[i].scenes,
                       kinds[i].scenes > 2 ? 4 - i : kinds[i].scenes, ex_path(b.out, file[i]));
        printf("wrote %s\n", ex_path(b.out, file[i]));
    }
    if (!kinds[0].scenes && !kinds[1].scenes) printf("no such scene\n");
    printf("wrote %s; %.0f s\n", ex_path(b.out, "integrators.csv"), ex_seconds() - begin);
    for (i = 0; i < 2; ++i) free(kinds[i].pictures);
    return 0;
}
