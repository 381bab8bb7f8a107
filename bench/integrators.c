/* integrators - run time against error: every integrator of the library over a sweep of steps.
 *
 *     bench/integrators [--quick] [--out build/bench-integrators] [--cells 10,2,2] [--scene N]
 *
 * A bar of 1 x .25 x .25 m, nu = .4, 1000 kg/m^3, for a second: it falls from the horizontal, held at one
 * end (bend), or tumbles freely at 10 rad/s (spin). E = 3e5 or 3e7 Pa, corotational or stable neo-Hookean,
 * undamped or damped by 2/s. Mass damping, because that is the same force for every method: stiffness
 * damping is K0's, turned, with a constant factor, and K(u)'s with Newton, so that the limits differ; two scenes
 * more have it (1e-2 and 1e-3 s), each family beside its own limit, and print how far apart these are.
 *   Error: the root mean square, over all nodes and every 1/15 s, of the distance from a solution converged in
 * time, over that of the displacement. That solution is Richardson's extrapolation of two runs by central
 * difference (of the scenes with stiffness damping (p,q,r) with corrections, and Newton), steps halved; what it
 * changed is printed. Time: of the processor, one thread, per simulated second, factorisation of what is
 * constant excluded; the least of repeated runs counts, in two passes through all methods. A run is on the
 * front if none as accurate takes less than 1/1.05 of its time: so much the least varies on a busy machine.
 * A run fails that returns an error, or whose error exceeds twice the motion (opposite phases). Newton analyses once, factorises in every
 * iteration, and goes on with its best iterate where it stalls (stiff bodies that spin do, at relative
 * residuals of 1e-7 to 1e-5, from rounding); the share of such steps stands under "redone".
 *   Writes integrators.csv, a plot for each scene and one of all; the pale band is the Pareto front.
 */
#include "../examples/support.h"
#include "softfem.h"

enum { SAMPLES = 15, STEPS_MOST = 12, SCENES = 18, METHODS = 24, LEVELS = 4 };

#define NOISE                                                                                      \
    1.05 /* of two times, that nothing follows from: the least of repeated runs varies by 2 to 4 % */

/* The least of at least so many runs, of more where they are short, half of them after all other methods'. */
enum { PASSES = 2, RUNS_LEAST = 3, RUNS_MOST = 9 };
static const double enough = .06; /* s of a pass, then no more runs */

static const double level[LEVELS] = {.1, .03, .01, .003};

/* --------------------------------------------------------------------------------------------
 * what is compared
 * -------------------------------------------------------------------------------------------- */

typedef struct method {
    const char *name, *color;
    int style, marker;
    sfem_integrator integrator;
    int coarse, fine; /* steps of 1/15 s over 2^coarse .. 2^fine */
    double p;         /* 0: the default */
    int corrections, no_guard, source, iterations;
    sfem_precision precision;
    double renew, tolerance; /* 0: none; Newton's own, 1e-8 */
} method;

enum { THICK = EX_LINE | EX_MARKERS | EX_THICK, PLAIN = EX_LINE | EX_MARKERS };
enum { DASHED = EX_LINE | EX_MARKERS | EX_DASHED };

static const method methods[METHODS] = {
    {"(p,q,r), the default", "#2563a8", THICK, 0, SFEM_PQR, 0, 7, 0, 0, 0, 0, 0, SFEM_DOUBLE, 0, 0},
    {"(p,q,r), 1 correction", "#1b9ad6", PLAIN, 1, SFEM_PQR, 0, 7, 0, 1, 0, 0, 0, SFEM_DOUBLE, 0,
     0},
    {"(p,q,r), 2 corrections", "#6fc3ee", PLAIN, 2, SFEM_PQR, 0, 7, 0, 2, 0, 0, 0, SFEM_DOUBLE, 0,
     0},
    {"(p,q,r), 4 corrections", "#9fb9d6", DASHED, 3, SFEM_PQR, 0, 7, 0, 4, 0, 0, 0, SFEM_DOUBLE, 0,
     0},
    {"(p,q,r), no guard", "#2563a8", DASHED, 4, SFEM_PQR, 0, 7, 0, 0, 1, 0, 0, SFEM_DOUBLE, 0, 0},
    {"(p,q,r), mixed precision", "#123b6b", DASHED, 5, SFEM_PQR, 0, 7, 0, 0, 0, 0, 0, SFEM_MIXED, 0,
     0},
    {"(p,q,r), p = 1/4", "#6b7fd7", DASHED, 6, SFEM_PQR, 0, 7, .25, 0, 0, 0, 0, SFEM_DOUBLE, 0, 0},
    {"(p,q,r), renewed factor", "#3a9aa5", DASHED, 7, SFEM_PQR, 0, 7, 0, 0, 0, 0, 0, SFEM_DOUBLE,
     1e6, 0},
    {"(1/4,1,1) of the source", "#4d4d4d", PLAIN, 3, SFEM_PQR, 0, 7, .25, 0, 1, 1, 0, SFEM_DOUBLE,
     0, 0},
    {"central difference", "#3f8f5b", THICK, 3, SFEM_CENTRAL, 2, 11, 0, 0, 0, 0, 0, SFEM_DOUBLE, 0,
     0},
    {"KR-alpha, .8", "#5d9c2f", PLAIN, 2, SFEM_KR_ALPHA, 0, 7, 0, 0, 0, 0, 0, SFEM_DOUBLE, 0, 0},
    {"Gui, 4", "#9bbf3b", DASHED, 6, SFEM_GUI, 0, 7, 0, 0, 0, 0, 0, SFEM_DOUBLE, 0, 0},
    {"Chang", "#c9b037", DASHED, 7, SFEM_CHANG, 0, 7, 0, 0, 0, 0, 0, SFEM_DOUBLE, 0, 0},
    {"Newmark, Newton to 1e-8", "#d1603d", THICK, 1, SFEM_NEWMARK, 0, 4, 0, 0, 0, 0, 0, SFEM_DOUBLE,
     0, 0},
    {"Newmark, Newton to 1e-5", "#d1603d", DASHED, 4, SFEM_NEWMARK, 0, 4, 0, 0, 0, 0, 0,
     SFEM_DOUBLE, 0, 1e-5},
    {"Newmark, Newton to 1e-3", "#a8432a", DASHED, 6, SFEM_NEWMARK, 0, 4, 0, 0, 0, 0, 0,
     SFEM_DOUBLE, 0, 1e-3},
    {"Newmark, 2 iterations", "#e08a4f", PLAIN, 5, SFEM_NEWMARK, 0, 4, 0, 0, 0, 0, 2, SFEM_DOUBLE,
     0, 0},
    {"Newmark, semi-implicit", "#b8892b", PLAIN, 0, SFEM_NEWMARK, 0, 5, 0, 0, 0, 0, 1, SFEM_DOUBLE,
     0, 0},
    {"backward Euler", "#b04668", PLAIN, 2, SFEM_BACKWARD_EULER, 0, 4, 0, 0, 0, 0, 0, SFEM_DOUBLE,
     0, 0},
    {"backward Euler, 1 iteration", "#d98aa4", PLAIN, 6, SFEM_BACKWARD_EULER, 0, 5, 0, 0, 0, 0, 1,
     SFEM_DOUBLE, 0, 0},
    {"HHT, .1", "#8a5aa8", PLAIN, 3, SFEM_HHT, 0, 4, 0, 0, 0, 0, 0, SFEM_DOUBLE, 0, 0},
    {"generalized-alpha, .8", "#b48ad0", DASHED, 7, SFEM_GENERALIZED_ALPHA, 0, 4, 0, 0, 0, 0, 0,
     SFEM_DOUBLE, 0, 0},
    {"Bathe", "#7a3520", PLAIN, 1, SFEM_BATHE, 0, 4, 0, 0, 0, 0, 0, SFEM_DOUBLE, 0, 0},
    {"Bathe, 1 iteration", "#b07a68", DASHED, 5, SFEM_BATHE, 0, 4, 0, 0, 0, 0, 1, SFEM_DOUBLE, 0,
     0},
};

static const method by_central = {"", "", 0, 0, SFEM_CENTRAL, 0, 0, 0,
                                  0,  0,  0, 0, SFEM_DOUBLE,  0, 0};
static const method by_corrections = {"", "", 0, 0, SFEM_PQR,    0, 0, 0,
                                      3,  0,  0, 0, SFEM_DOUBLE, 0, 0};
static const method by_newton = {"", "", 0, 0, SFEM_NEWMARK, 0, 0, 0,
                                 0,  0,  0, 0, SFEM_DOUBLE,  0, 0};

typedef struct scene {
    char name[64], file[48];
    int spin, stiff, neo_hookean;
    double alpha, beta;
    sfem_model *model;
    sfem_int nodes, pin_count, *pins;
    double *v;            /* [3 nodes] at the start */
    double *reference[2]; /* [SAMPLES][3 nodes]: the limit of constant factors, and of Newton */
    double motion;        /* root mean square of the displacement */
} scene;

typedef struct point { /* one method, one step */
    double h, error,
        time; /* time: seconds of processor per simulated second; error NAN if failed */
    int64_t steps, redone; /* redone: by the guard, or where Newton should and did not converge */
    double iterations;
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

static double processor_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void must(sfem_status status, const sfem_error *err)
{
    if (status != SFEM_OK) ex_fail("%s", err->text);
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

static void create(scene *s, const sfem_int cells[3])
{
    static const sfem_real size[3] = {1, .25, .25}, omega[3] = {2, 10, 3};
    const sfem_real center[3] = {.5, .125, .125};
    sfem_model_def def = sfem_default_model_def();
    sfem_mesh mesh;
    sfem_error err;
    sfem_int i;
    int c;
    must(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), &err);
    s->nodes = mesh.nodes;
    s->pins = (sfem_int *)ex_new((size_t)mesh.nodes, sizeof *s->pins);
    s->v = (double *)ex_new(3 * (size_t)mesh.nodes, sizeof *s->v);
    for (c = 0; c < 2; ++c)
        s->reference[c] = (double *)ex_new(SAMPLES * 3 * (size_t)mesh.nodes, sizeof(double));
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
    def.material.poisson = .4;
    def.material.law = s->neo_hookean ? SFEM_NEOHOOKEAN : SFEM_COROTATIONAL;
    def.material.alpha = s->alpha;
    def.material.beta = s->beta;
    must(sfem_model_create(&def, &s->model, &err), &err);
    sfem_mesh_free(&mesh);
}

static void destroy(scene *s)
{
    sfem_model_free(s->model);
    free(s->pins);
    free(s->v);
    free(s->reference[0]);
    free(s->reference[1]);
}

static sfem_body *make_body(const scene *s, const method *m, sfem_error *err)
{
    sfem_body_def def = sfem_default_body_def();
    sfem_body *body = NULL;
    def.integrator = m->integrator;
    if (m->p > 0) def.p = m->p;
    def.corrections = m->corrections;
    if (m->corrections >= 3) def.correction_tolerance = m->corrections == 3 ? 0 : 1e-3;
    def.no_guard = m->no_guard;
    if (m->source) def.frame = SFEM_FRAME_REST;
    def.plain_load = m->source;
    def.precision = m->precision;
    def.renew_flops = m->renew;
    def.renew_drift = m->renew > 0 ? .1 : 0;
    def.newton.accept_best = 1;
    if (m->tolerance > 0) def.newton.tolerance = m->tolerance;
    if (m->iterations) {
        def.newton.iterations = m->iterations;
        def.newton.no_line_search = m->iterations == 1;
    }
    def.pins = s->pins;
    def.pin_count = s->pin_count;
    def.gravity[2] = s->spin ? 0 : -9.81;
    return sfem_body_create(s->model, &def, &body, err) == SFEM_OK ? body : NULL;
}

/* --------------------------------------------------------------------------------------------
 * runs
 * -------------------------------------------------------------------------------------------- */

/* From the start through SAMPLES stretches of 1/15 s in 2^halvings steps each; where out is given, the
 * displacements at their ends go there, as far as they came. Seconds of processor. */
static double run(const scene *s, sfem_body *body, int halvings, double *out, point *p)
{
    int64_t unconverged = 0;
    const double h = 1.0 / (15 << halvings);
    const size_t n = 3 * (size_t)s->nodes;
    sfem_error err;
    double spent = 0, iterations = 0;
    int i, k;
    size_t j;
    must(sfem_body_set_state(body, NULL, s->v, &err), &err);
    for (i = 0; i < SAMPLES; ++i) {
        const double start = processor_seconds();
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
        spent += processor_seconds() - start;
        u = sfem_body_displacement(body);
        for (j = 0; j < n; ++j)
            if (!(fabs(u[j]) < 100)) {
                snprintf(p->failure, sizeof p->failure, "exploded after %.2f s", (i + 1) / 15.0);
                return spent;
            }
        if (out) memcpy(out + (size_t)i * n, u, n * sizeof *u);
    }
    p->steps = sfem_body_get_info(body).steps;
    p->redone = sfem_body_get_info(body).rejected + unconverged;
    p->iterations = iterations / (SAMPLES << halvings);
    return spent;
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
    const size_t n = SAMPLES * 3 * (size_t)s->nodes;
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
    const size_t n = SAMPLES * 3 * (size_t)s->nodes;
    const double *exact = s->reference[is_newton(m)];
    sfem_body *body;
    sfem_error err;
    double total = 0;
    int k;
    if (pass && (p->failure[0] || p->time > enough)) return;
    if (!pass) {
        memset(p, 0, sizeof *p);
        p->h = 1.0 / (15 << halvings);
        p->error = p->time = NAN;
    }
    body = make_body(s, m, &err);
    if (!body || sfem_body_prepare(body, p->h, &err) != SFEM_OK) {
        snprintf(p->failure, sizeof p->failure, "%.90s", err.text);
        sfem_body_free(body);
        return;
    }
    for (k = 0; k < RUNS_MOST && !(k && p->failure[0]) && total < (k < RUNS_LEAST ? 3 : 1) * enough;
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

static void draw(picture *q, const scene *s, const series *all)
{
    int i, k, failed = 0;
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

static void print_scene(const series *all, tally *t)
{
    int i, k, l;
    printf("  %-27s %7s %7s %7s | %7s %7s | %s\n", "", "h=1/60", "1/240", "finest", "ms 1/60",
           "redone", "ms per second for an error of 10 %, 3 %, 1 %, .3 % (times the default's)");
    for (i = 0; i < METHODS; ++i) {
        const series *r = all + i;
        int front = 0, at60 = -1, at240 = -1, bad = 0;
        const point *last = &r->at[r->count - 1];
        for (k = 0; k < r->count; ++k) {
            front += on_front(all, &r->at[k], NOISE);
            t[i].near += on_front(all, &r->at[k], NOISE);
            bad += r->at[k].failure[0] != 0;
            if (fabs(60 * r->at[k].h - 1) < 1e-6) at60 = k;
            if (fabs(240 * r->at[k].h - 1) < 1e-6) at240 = k;
        }
        printf("%c %-27s %7.4f %7.4f %7.5f | ", front ? '*' : ' ', methods[i].name,
               r->at[at60].error, r->at[at240].error, last->error);
        if (r->at[at60].steps > 0 && !r->at[at60].failure[0])
            printf("%7.2f %5.1f %% |", 1e3 * r->at[at60].time,
                   100.0 * (double)r->at[at60].redone / (double)r->at[at60].steps);
        else
            printf("%7s %7s |", "-", "");
        for (l = 0; l < LEVELS; ++l) {
            const double mine = time_to(r, level[l]), his = time_to(all, level[l]);
            if (mine > 0 && his > 0)
                printf(" %8.2f (%6.2f)", 1e3 * mine, mine / his);
            else if (mine > 0)
                printf(" %8.2f (     -)", 1e3 * mine);
            else
                printf(" %8s %8s", "-", "");
            if (mine > 0 && his > 0) t[i].ratio[l][t[i].ratios[l]++] = mine / his;
        }
        printf("\n");
        t[i].fronts += front > 0;
        t[i].points += r->count;
        t[i].failures += bad;
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
    printf("\n\n");
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
                    (long)p->steps, (long)p->redone, p->iterations, p->failure);
        }
    fflush(f);
}

static int compare(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static void print_summary(tally *t, int scenes, const char *off)
{
    int i, l;
    printf("Over %d scenes: on how many fronts, failed of all runs, and the median (in how many "
           "scenes it "
           "gets there)\nof the time to an error over the default's\n\n%-27s %6s %9s",
           scenes, "", "fronts", "failed");
    for (l = 0; l < LEVELS; ++l) printf("  %10.1f %%", 100 * level[l]);
    printf("\n");
    for (i = 0; i < METHODS; ++i) {
        printf("%-27s %6d %4d/%-4d", methods[i].name, t[i].fronts, t[i].failures, t[i].points);
        for (l = 0; l < LEVELS; ++l) {
            const int n = t[i].ratios[l];
            qsort(t[i].ratio[l], (size_t)n, sizeof(double), compare);
            if (n)
                printf("  %6.2f (%2d)", t[i].ratio[l][n / 2], n);
            else
                printf("  %11s", "-");
        }
        printf("\n");
    }
    printf("\nthe default is on the front, within %.0f %% of the time, in %d of %d scenes, with %d "
           "of its %d runs%s%s\n",
           100 * (NOISE - 1), t[0].fronts, scenes, t[0].near, t[0].points,
           *off ? "; off it in: " : "", off);
}

/* --------------------------------------------------------------------------------------------
 * all of it
 * -------------------------------------------------------------------------------------------- */

static void find_references(scene *s, int quick)
{
    const size_t n = SAMPLES * 3 * (size_t)s->nodes;
    if (s->beta == 0) {
        const double changed = refer(s, &by_central, quick ? 10 : 11, s->reference[0]);
        memcpy(s->reference[1], s->reference[0], n * sizeof(double));
        printf("%s\n  motion %.4f m; reference: h = 1/%d, extrapolation changed %.1e\n", s->name,
               s->motion, 15 << (quick ? 11 : 12), changed);
    } else {
        const double newton = refer(s, &by_newton, quick ? 3 : 4, s->reference[1]);
        const double changed = refer(s, &by_corrections, quick ? 7 : 8, s->reference[0]);
        printf("%s\n  motion %.4f m; references: extrapolation changed %.1e (constant factor), "
               "%.1e (Newton); "
               "apart %.1e\n",
               s->name, s->motion, changed, newton,
               rms(s->reference[0], s->reference[1], n) / s->motion);
    }
}

int main(int argc, char **argv)
{
    static const ex_option table[] = {
        {"--quick", NULL, NULL, "two scenes, five steps"},
        {"--out", "DIR", "build/bench-integrators", "where to write"},
        {"--cells", "A,B,C", "10,2,2", "cells along the bar, five tets each"},
        {"--scene", "N", "0", "only the Nth of the scenes"},
        {NULL, NULL, NULL, NULL}};
    static series all[METHODS];
    static tally t[METHODS];
    static char off[SCENES * 72];
    const ex_options o = ex_parse(argc, argv, "Run time against error of every integrator.", table);
    const int quick = ex_given(&o, "--quick");
    const long only = ex_integer(&o, "--scene");
    const char *out = ex_text(&o, "--out");
    picture *pictures = (picture *)ex_new(SCENES, sizeof *pictures);
    ex_plot plots[SCENES];
    const double begin = ex_seconds();
    double cells[3], *work;
    sfem_int counts[3];
    FILE *csv;
    int i, m, h, pass, done = 0;
    ex_reals(&o, "--cells", 3, cells);
    for (i = 0; i < 3; ++i) counts[i] = quick ? (i ? 2 : 6) : (sfem_int)cells[i];
    ex_make_directory(out);
    csv = ex_open(ex_path(out, "integrators.csv"));
    fprintf(csv, "scene,method,h,error,ms_per_second,on_front,steps,redone,iterations,failure\n");
    printf("%d x %d x %d cells of five tets, %d tets; vectors %d doubles wide; *: within 5 %% of "
           "the Pareto front\n",
           (int)counts[0], (int)counts[1], (int)counts[2],
           (int)(5 * counts[0] * counts[1] * counts[2]), sfem_vector_width());
#ifdef SFEM_BENCH_FLAGS
    printf("flags: %s\n", SFEM_BENCH_FLAGS);
#endif
    printf("\n");
    for (i = 0; i < SCENES; ++i) {
        scene s;
        if (only ? i + 1 != only : quick && i != 0 && i != 8) continue;
        describe(&s, i);
        create(&s, counts);
        find_references(&s, quick);
        work = (double *)ex_new(SAMPLES * 3 * (size_t)s.nodes, sizeof *work);
        memset(all, 0, sizeof all);
        for (pass = 0; pass < PASSES; ++pass)
            for (m = 0; m < METHODS; ++m) {
                all[m].count = 0;
                for (h = methods[m].coarse; h <= (quick ? methods[m].coarse + 4 : methods[m].fine);
                     ++h) {
                    ex_progress(s.name, pass * METHODS + m, PASSES * METHODS);
                    measure(&s, &methods[m], h, pass, work, &all[m].at[all[m].count++]);
                }
            }
        ex_progress(s.name, 1, 1);
        m = t[0].fronts;
        print_scene(all, t);
        if (t[0].fronts == m) {
            const size_t used = strlen(off);
            snprintf(off + used, sizeof off - used, "%s%s", used ? "; " : "", s.name);
        }
        write_csv(csv, &s, all);
        draw(pictures + done, &s, all);
        plots[done] = pictures[done].plot;
        plots[done].title = pictures[done].title;
        ex_plot_write(plots + done, ex_path(out, s.file));
        ++done;
        free(work);
        destroy(&s);
    }
    ex_close(csv, ex_path(out, "integrators.csv"));
    ex_plots_write(plots, done, done > 2 ? 4 : done, ex_path(out, "integrators.svg"));
    print_summary(t, done, off);
    printf("\nwrote %s/integrators.csv, .svg; %.0f s\n", out, ex_seconds() - begin);
    free(pictures);
    return 0;
}
