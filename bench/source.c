/* source - the experiments of the paper that (p,q,r) is from, measured on this library's own steps.
 *
 *     bench/source [--quick] [--out build/bench-source]
 *
 * [Yuan et al. 2017, "A novel unconditionally stable explicit integration method for finite element method"]
 *   figs. 2-4  spectral radius, period elongation (PE) and amplitude decay (AD) against Omega = omega h for damping
 *              ratios xi = 0, .05, .2. A body of one degree of freedom is stepped, and the recurrence that its
 *              displacements follow is solved for. PE and AD by eqs. 30-32 as printed beside what they should be:
 *              arctan(|sigma/epsilon|) folds phases beyond a right angle, AD lacks its minus. Not drawn: Chang 2011
 *              and Ding 2016, whose texts were not at hand (the source says that the latter equals Gui's
 *              if linear); its "implicit method [1]" is taken for backward Euler.
 *   fig. 1, tables 1-2, fig. 5  time of a step, implicit Newmark with 1, 3, 5 iterations against the
 *              proposed method. The models are not to be had: blocks of the nearest numbers of tets stand for them,
 *              held at one end, falling, E = 1e6 Pa, nu = .3, corotational, h = 1/60 s, one thread.
 *   figs. 6-8  a node pulled along x, implicit against proposed under f, 10 f, 100 f, 200 f. Neither mesh nor
 *              load are given: a block of 432 tets, a force that rises, stays and falls over 100 steps. Fig. 8: the
 *              deformed block at the end of the full load, as it is, and magnified to the same load.
 */
#include "../examples/support.h"
#include "softfem.h"
#include "../tests/linear.h"

enum { RATIOS = 3, POINTS = 100, SIZES = 6, STEPS = 100 };

static const double damping_ratio[RATIOS] = {0, .05, .2};

static void must(sfem_status status, const sfem_error *err)
{
    if (status != SFEM_OK) ex_fail("%s", err->text);
}

static double processor_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* --------------------------------------------------------------------------------------------
 * figs. 2-4
 * -------------------------------------------------------------------------------------------- */

typedef struct rule {
    const char *name, *color;
    int style;
    sfem_integrator integrator;
    int order; /* of the recurrence */
    double p, q, r;
    int alias; /* the curve of the one before: measured, not drawn */
} rule;

enum { SOLID = EX_LINE, DASH = EX_LINE | EX_DASHED, FAT = EX_LINE | EX_THICK, RULES = 13 };

static const rule rules[RULES] = {
    {"proposed (1/4,1,1) = trapezoidal = CR = Gui = Chang", "#2563a8", FAT, SFEM_PQR, 2, .25, 1, 1,
     0},
    {"trapezoidal (Newmark 1/4)", "", 0, SFEM_NEWMARK, 2, 0, 0, 0, 1},
    {"CR (KR-alpha, rho = 1)", "", 0, SFEM_KR_ALPHA, 2, 0, 0, 1, 1},
    {"Gui, lambda = 4", "", 0, SFEM_GUI, 2, 0, 0, 0, 1},
    {"Chang 2002", "", 0, SFEM_CHANG, 2, 0, 0, 0, 1},
    {"proposed (1/2,1,1)", "#6fa8dc", SOLID, SFEM_PQR, 2, .5, 1, 1, 0},
    {"proposed (1/4,2,1)", "#3a9aa5", DASH, SFEM_PQR, 2, .25, 2, 1, 0},
    {"proposed (1/4,1,3)", "#d1603d", FAT, SFEM_PQR, 2, .25, 1, 3, 0},
    {"central difference", "#3f8f5b", SOLID, SFEM_CENTRAL, 2, 0, 1, 1, 0},
    {"backward Euler (\"implicit [1]\")", "#b04668", SOLID, SFEM_BACKWARD_EULER, 2, 0, 0, 0, 0},
    {"HHT, .1", "#8a5aa8", SOLID, SFEM_HHT, 3, 0, 0, 0, 0},
    {"generalized-alpha = KR-alpha, .8", "#b8892b", SOLID, SFEM_GENERALIZED_ALPHA, 3, 0, 0, .8, 0},
    {"KR-alpha, .8", "", 0, SFEM_KR_ALPHA, 3, 0, 0, .8, 1},
};

typedef struct spectrum {                 /* NAN: refused, or no oscillation */
    double radius, period, decay;         /* PE and AD as they should be, and */
    double printed_period, printed_decay; /* by eqs. 30-32 as they stand */
} spectrum;

/* One tet of which node 1 may move along x only: k u + d u' + m u'' = 0. */
typedef struct oscillator {
    sfem_model *model;
    double omega;
} oscillator;

static oscillator make_oscillator(void)
{
    static sfem_real x[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
    static sfem_int tet[4] = {0, 1, 2, 3};
    sfem_model_def def = linear_model_def();
    oscillator o;
    sfem_mesh mesh;
    sfem_error err;
    const sfem_matrix *k;
    sfem_int at;
    memset(&mesh, 0, sizeof mesh);
    mesh.nodes = 4;
    mesh.tets = 1;
    mesh.x = x;
    mesh.tet = tet;
    def.mesh = &mesh;
    must(sfem_model_create(&def, &o.model, &err), &err);
    k = sfem_model_stiffness(o.model);
    for (at = k->row[1]; k->col[at] != 1;) ++at;
    o.omega = sqrt(k->val[9 * at] / sfem_model_node_mass(o.model)[1]);
    return o;
}

static sfem_body *oscillator_body(const oscillator *o, const rule *m, double xi)
{
    static const sfem_int pins[4] = {0, 2, 3, 1};
    static const unsigned char axes[4] = {7, 7, 7, SFEM_AXIS_Y | SFEM_AXIS_Z};
    sfem_body_def def = sfem_default_body_def();
    sfem_real u[12] = {0}, v[12] = {0};
    sfem_body *body;
    sfem_error err;
    def.integrator = m->integrator;
    if (m->integrator == SFEM_PQR) {
        def.p = m->p;
        def.q = m->q;
        def.r = m->r;
    } else if (m->integrator == SFEM_KR_ALPHA || m->integrator == SFEM_GENERALIZED_ALPHA) {
        def.rho_inf = m->r;
    }
    def.mass_damping = 2 * xi * o->omega;
    def.pins = pins;
    def.pin_axes = axes;
    def.pin_count = 4;
    u[3] = .01;
    v[3] = .02 * o->omega;
    must(sfem_body_create(o->model, &def, &body, &err), &err);
    must(sfem_body_set_state(body, u, v, &err), &err);
    return body;
}

/* c of x_{n+order} = sum c_j x_{n+j}, of 2 order numbers x; by Cramer's rule. */
static void recurrence(const double *x, int order, double *c)
{
    double a[3][3], d = 1;
    int i, j, k;
    for (k = -1; k < order; ++k) {
        double det;
        for (i = 0; i < 3; ++i)
            for (j = 0; j < 3; ++j)
                a[i][j] = i < order && j < order ? (j == k ? x[i + order] : x[i + j]) : i == j;
        det = a[0][0] * (a[1][1] * a[2][2] - a[1][2] * a[2][1]) -
              a[0][1] * (a[1][0] * a[2][2] - a[1][2] * a[2][0]) +
              a[0][2] * (a[1][0] * a[2][1] - a[1][1] * a[2][0]);
        if (k < 0)
            d = det;
        else
            c[k] = det / d;
    }
}

/* lambda^2 = b1 lambda + b0, of a third order after its real root, by bisection, is split off. */
static double split(int order, const double *c, double *b1, double *b0)
{
    double low = -2, high = 2, root = 0;
    int i;
    *b1 = c[1];
    *b0 = c[0];
    if (order < 3) return 0;
    for (i = 0; i < 200; ++i) {
        root = (low + high) / 2;
        if (root * root * root - c[2] * root * root - c[1] * root - c[0] < 0)
            low = root;
        else
            high = root;
    }
    *b1 = c[2] - root;
    *b0 = c[1] + root * *b1;
    return fabs(root);
}

static spectrum measure(const oscillator *o, const rule *m, double Omega, double xi)
{
    const double nothing = NAN;
    spectrum s = {nothing, nothing, nothing, nothing, nothing};
    sfem_body *body = oscillator_body(o, m, xi);
    const int slow =
        Omega < .5 && m->order == 3; /* the third root, of at most a half, is let die first */
    const int order = slow ? 2 : m->order;
    double x[6] = {0}, c[3] = {0}, b1, b0, real, epsilon, sigma2, bar;
    sfem_error err;
    int i;
    for (i = slow ? -80 : -1; i < 2 * order; ++i) { /* the first step is another's */
        const sfem_status status = sfem_body_step(body, Omega / o->omega, &err);
        if (status == SFEM_UNSTABLE) {
            sfem_body_free(body);
            return s;
        }
        must(status, &err);
        if (i >= 0) x[i] = sfem_body_displacement(body)[3];
    }
    sfem_body_free(body);
    recurrence(x, order, c);
    real = split(order, c, &b1, &b0);
    epsilon = b1 / 2;
    sigma2 = -b0 - epsilon * epsilon;
    if (sigma2 < 0) {
        s.radius = fabs(epsilon) + sqrt(-sigma2);
        return s;
    }
    s.radius = fmax(sqrt(-b0), real);
    bar = atan2(sqrt(sigma2), epsilon);
    s.period = Omega * sqrt(1 - xi * xi) / bar - 1;
    s.decay = -log(sqrt(-b0)) / bar;
    bar = atan(fabs(sqrt(sigma2) / epsilon)) / sqrt(1 - xi * xi);
    s.printed_period = (Omega - bar) / bar;
    s.printed_decay = log(-b0) / (2 * bar);
    return s;
}

typedef struct curves {
    double Omega[POINTS];
    double y[5][RULES][RATIOS][POINTS];
} curves;

static double within(double x, double low, double high) { return x >= low && x <= high ? x : NAN; }

static void draw_curves(const curves *k, const char *out)
{
    static const char *const what[5] = {"Spectral radius", "Period elongation",
                                        "Numerical and physical damping", "PE as printed (arctan)",
                                        "AD as printed (no minus, arctan)"};
    static const char *const label[5] = {"radius", "PE", "-ln radius / phase", "PE", "AD"};
    static const char *const file[3] = {"fig2-radius.svg", "fig3-period.svg", "fig4-decay.svg"};
    static char title[6][64];
    int f, i, m, row;
    for (f = 0; f < 3; ++f) {
        ex_plot p[6];
        const int rows = f ? 2 : 1;
        for (row = 0; row < rows; ++row)
            for (i = 0; i < RATIOS; ++i) {
                const int which = row ? f + 2 : f, at = RATIOS * row + i;
                snprintf(title[at], sizeof title[at], "%s, xi = %g", what[which], damping_ratio[i]);
                p[at] = ex_plot_new(title[at], "Omega", label[which], 0);
                for (m = 0; m < RULES; ++m) {
                    if (rules[m].alias) continue;
                    ex_plot_add(&p[at], rules[m].name, k->Omega, k->y[which][m][i], POINTS,
                                rules[m].style);
                    ex_plot_look(&p[at], rules[m].color, 0);
                }
            }
        ex_plots_write(p, RATIOS * rows, RATIOS, ex_path(out, file[f]));
    }
}

static void print_spectra(const oscillator *o)
{
    static const double Omega[5] = {.5, 1, 2, 5, 10};
    int m, i, k;
    for (i = 0; i < RATIOS; ++i) {
        printf("xi = %g: radius / PE / damping measured, at Omega =\n%-54s", damping_ratio[i], "");
        for (k = 0; k < 5; ++k) printf(" %-21g", Omega[k]);
        printf("\n");
        for (m = 0; m < RULES; ++m) {
            printf("%-54s", rules[m].name);
            for (k = 0; k < 5; ++k) {
                const spectrum s = measure(o, &rules[m], Omega[k], damping_ratio[i]);
                if (!(s.radius >= 0))
                    printf(" %-21s", "refused");
                else
                    printf(" %6.4f/%7.4f/%6.4f", s.radius, s.period, s.decay);
            }
            printf("\n");
        }
        printf("\n");
    }
}

static void print_mistakes(const oscillator *o)
{
    static const double Omega[] = {.5, 1, 1.5, 2, 2.5, 3, 4, 5};
    const rule *one = &rules[0], *three = &rules[7], *central = &rules[8];
    size_t k;
    printf("\"r = 3 offers the least period distortion when Omega is pretty large\": PE at xi = 0\n"
           "%8s %12s %12s | %12s %12s %s\n",
           "Omega", "r = 1", "r = 3", "r = 1", "r = 3", " as printed, by arctan");
    for (k = 0; k < sizeof Omega / sizeof *Omega; ++k) {
        const spectrum a = measure(o, one, Omega[k], 0), b = measure(o, three, Omega[k], 0);
        printf("%8.2f %12.4f %12.4f | %12.4f %12.4f  %s\n", Omega[k], a.period, b.period,
               a.printed_period, b.printed_period,
               fabs(b.printed_period) < fabs(a.printed_period) ? "r = 3 seems best" : "");
    }
    printf("r = 3 is a body three times as heavy: its period is long by sqrt 3 = +73 %% as Omega "
           "goes to 0.\n\n"
           "\"Extremely large amplitude decay\" of central difference, and its PE that \"exceeds "
           "all the other methods\": "
           "xi = .05\n%8s %12s %12s | %12s %12s %12s  as printed\n",
           "Omega", "damping", "PE", "AD", "PE", "phase");
    for (k = 0; k < sizeof Omega / sizeof *Omega; ++k) {
        const double w = Omega[k] < 2 ? Omega[k] : 1.99;
        const spectrum a = measure(o, central, w, .05);
        printf("%8.2f %12.4f %12.4f | %12.4f %12.4f %12.4f\n", w, a.decay, a.period,
               a.printed_decay, a.printed_period, w / (1 + a.printed_period));
        if (Omega[k] >= 2) break;
    }
    printf("The phase goes to pi as Omega goes to 2; arctan makes that 0, and divides by it. "
           "Undamped, AD is 0.\n\n");
}

static void spectra(const char *out, int quick)
{
    curves *c = (curves *)ex_new(1, sizeof *c);
    double apart[RULES] = {0};
    oscillator o = make_oscillator();
    int i, m, k, base = 0;
    print_spectra(&o);
    for (m = 0; m < RULES; ++m) {
        if (!rules[m].alias && m != 11) base = 0;
        if (m == 12) base = 11;
        for (i = 0; i < RATIOS; ++i)
            for (k = quick ? POINTS - 3 : 0; k < POINTS; ++k) {
                const double Omega = .05 * (k + 1);
                const spectrum s = measure(&o, &rules[m], Omega, damping_ratio[i]);
                c->Omega[k] = Omega;
                c->y[0][m][i][k] = s.radius;
                c->y[1][m][i][k] = within(s.period, -1, 4);
                c->y[2][m][i][k] = within(s.decay, -.5, 1.2);
                c->y[3][m][i][k] = within(s.printed_period, -1, 8);
                c->y[4][m][i][k] = within(s.printed_decay, -2, .5);
                if (rules[m].alias) apart[m] = fmax(apart[m], fabs(s.radius - c->y[0][base][i][k]));
            }
    }
    for (m = 0; m < RULES; ++m)
        if (rules[m].alias)
            printf("%s: its radius is that of %s to %.0e\n", rules[m].name,
                   rules[m < 5 ? 0 : 11].name, apart[m]);
    printf("\n");
    print_mistakes(&o);
    if (!quick) draw_curves(c, out);
    sfem_model_free(o.model);
    free(c);
}

/* --------------------------------------------------------------------------------------------
 * fig. 1, tables 1-2, fig. 5
 * -------------------------------------------------------------------------------------------- */

typedef struct size {
    const char *name;
    sfem_int elements, cells[3];
    sfem_block_cells kind;
    double implicit, proposed; /* ms, as printed */
} size;

static const size sizes[SIZES] = {
    {"Kidney", 433, {8, 3, 3}, SFEM_CELL_6_TETS, 157, 36},
    {"Armadillo", 1499, {12, 5, 5}, SFEM_CELL_5_TETS, 429, 137},
    {"Bunny", 2819, {13, 6, 6}, SFEM_CELL_6_TETS, 780, 272},
    {"Lung", 4188, {15, 8, 7}, SFEM_CELL_5_TETS, 1298, 409},
    {"Heart", 5607, {13, 9, 8}, SFEM_CELL_6_TETS, 1610, 541},
    {"Brain", 6605, {15, 11, 8}, SFEM_CELL_5_TETS, 1940, 701},
};

enum { ONE, THREE, FIVE, PROPOSED, DEFAULT, WAYS };

static sfem_model *make_block(const sfem_int cells[3], sfem_block_cells kind, sfem_law law)
{
    const sfem_real box[3] = {.05 * cells[0], .05 * cells[1], .05 * cells[2]};
    sfem_model_def def = linear_model_def();
    sfem_model *model;
    sfem_mesh mesh;
    sfem_error err;
    must(sfem_mesh_block(cells, box, kind, NULL, &mesh, &err), &err);
    def.mesh = &mesh;
    def.material.law = law;
    must(sfem_model_create(&def, &model, &err), &err);
    sfem_mesh_free(&mesh);
    return model;
}

static sfem_body *make_body(sfem_model *model, int way, sfem_body_def def)
{
    static const sfem_int iterations[3] = {1, 3, 5};
    const sfem_mesh *mesh = sfem_model_mesh(model);
    sfem_int *pins = (sfem_int *)ex_new((size_t)mesh->nodes, sizeof *pins), i;
    sfem_body *body;
    sfem_error err;
    if (way < PROPOSED) {
        def.integrator = SFEM_NEWMARK;
        def.newton.iterations = iterations[way];
        def.newton.tolerance = 0; /* all of them */
        def.newton.accept_best = 1, def.newton.line_search = 0;
    } else if (way == PROPOSED) {
        def.p = .25;
        def.frame = SFEM_FRAME_REST;
        def.accuracy = 1; /* one solve */
        def.safeguard = 0, def.plain_load = 1;
    }
    for (i = 0; i < mesh->nodes; ++i)
        if (mesh->x[3 * i] == 0) pins[def.pin_count++] = i;
    def.pins = pins;
    must(sfem_body_create(model, &def, &body, &err), &err);
    free(pins);
    return body;
}

static int compare(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* ms of a step, the lower quartile (the machine may be busy), and how many systems it solved. 15 at a time: the
 * proposed method, in the rest pose's frame, explodes soon after. */
static double time_steps(sfem_model *model, int way, int steps, double *solves)
{
    sfem_body_def def = sfem_default_body_def();
    sfem_body *body;
    double t[64];
    sfem_error err;
    int i;
    def.gravity[2] = -9.81;
    body = make_body(model, way, def);
    must(sfem_body_prepare(body, 1 / 60.0, &err), &err);
    *solves = 0;
    for (i = -2; i < steps; ++i) {
        double start;
        if (i > 0 && i % 15 == 0) must(sfem_body_set_state(body, NULL, NULL, &err), &err);
        start = processor_seconds();
        must(sfem_body_step(body, 1 / 60.0, &err), &err);
        if (i < 0) continue;
        t[i] = 1e3 * (processor_seconds() - start);
        *solves += way < PROPOSED ? (double)sfem_body_newton(body).iterations / steps : 1.0 / steps;
    }
    qsort(t, (size_t)steps, sizeof *t, compare);
    sfem_body_free(body);
    return t[steps / 4];
}

static void speeds(const char *out, int quick)
{
    static double ms[WAYS][SIZES], tets[SIZES], his[2][SIZES], elements[SIZES];
    ex_plot p[2];
    int i, way;
    printf("Tables 1-2, fig. 1: ms and frames of a step; j: iterations at most (mean of those "
           "made: three do); ratio: implicit "
           "with j = 1 over proposed\n%-10s %5s %6s | %16s %16s %16s | %15s %15s | %7s %7s %7s\n",
           "", "tets", "here", "j = 1", "j = 3", "j = 5", "proposed", "default", "ratio", "source",
           "default");
    for (i = 0; i < (quick ? 2 : SIZES); ++i) {
        sfem_model *model = make_block(sizes[i].cells, sizes[i].kind, SFEM_COROTATIONAL);
        double solves[WAYS];
        tets[i] = sfem_model_mesh(model)->tets;
        elements[i] = sizes[i].elements;
        his[0][i] = sizes[i].implicit;
        his[1][i] = sizes[i].proposed;
        for (way = 0; way < WAYS; ++way)
            ms[way][i] = time_steps(model, way, way < PROPOSED ? 15 : 60, &solves[way]);
        printf("%-10s %5d %6.0f |", sizes[i].name, (int)sizes[i].elements, tets[i]);
        for (way = ONE; way <= FIVE; ++way) printf(" %8.2f (%4.1f) ", ms[way][i], solves[way]);
        printf("|");
        for (; way < WAYS; ++way) printf(" %7.3f %7.0f", ms[way][i], 1e3 / ms[way][i]);
        printf(" | %7.2f %7.2f %7.2f\n", ms[ONE][i] / ms[PROPOSED][i], his[0][i] / his[1][i],
               ms[ONE][i] / ms[DEFAULT][i]);
        fflush(stdout);
        sfem_model_free(model);
    }
    printf("frames a second, implicit j = 1:");
    for (i = 0; i < (quick ? 2 : SIZES); ++i)
        printf(" %.1f (source %.1f)", 1e3 / ms[ONE][i], 1e3 / his[0][i]);
    printf("\nThe source's ratios fall with size, 4.36 to 2.77; the text says that they rise.\n\n");
    if (quick) return;
    p[0] = ex_plot_new("Fig. 1: implicit Newmark by iterations", "tets", "ms a step",
                       EX_LOG_X | EX_LOG_Y);
    p[1] = ex_plot_new("Fig. 5: implicit and proposed", "tets", "ms a step", EX_LOG_X | EX_LOG_Y);
    ex_plot_add(&p[0], "implicit, 1 iteration", tets, ms[ONE], SIZES, EX_LINE | EX_MARKERS);
    ex_plot_add(&p[0], "3 iterations", tets, ms[THREE], SIZES, EX_LINE | EX_MARKERS);
    ex_plot_add(&p[0], "5 iterations", tets, ms[FIVE], SIZES, EX_LINE | EX_MARKERS);
    ex_plot_add(&p[0], "1 iteration, as printed", elements, his[0], SIZES,
                EX_LINE | EX_MARKERS | EX_DASHED);
    ex_plot_add(&p[1], "implicit, 1 iteration", tets, ms[ONE], SIZES, EX_LINE | EX_MARKERS);
    ex_plot_add(&p[1], "proposed (1/4,1,1)", tets, ms[PROPOSED], SIZES, EX_LINE | EX_MARKERS);
    ex_plot_add(&p[1], "this library's default", tets, ms[DEFAULT], SIZES, EX_LINE | EX_MARKERS);
    ex_plot_add(&p[1], "implicit, as printed", elements, his[0], SIZES,
                EX_LINE | EX_MARKERS | EX_DASHED);
    ex_plot_add(&p[1], "proposed, as printed", elements, his[1], SIZES,
                EX_LINE | EX_MARKERS | EX_DASHED);
    ex_plot_write(&p[0], ex_path(out, "fig1-iterations.svg"));
    ex_plot_write(&p[1], ex_path(out, "fig5-time.svg"));
}

/* --------------------------------------------------------------------------------------------
 * figs. 6-8
 * -------------------------------------------------------------------------------------------- */

static double history(int k) /* of the load, N, at step k */
{
    const double f = 40;
    return k < 20 ? f * k / 20 : k < 50 ? f : k < 70 ? f * (70 - k) / 20 : 0;
}

enum { IMPLICIT, AS_PRINTED, AVERAGED, PEAK = 49 }; /* the last step of the full load */

/* x of the node that is pulled; the displacements [nodes][3] at the end of the full load, unless shape is NULL. */
static void pull(sfem_model *model, int way, double scale, double *x, double *shape)
{
    const sfem_int node = sfem_model_mesh(model)->nodes - 1;
    sfem_real *force = (sfem_real *)ex_new(3 * (size_t)node + 3, sizeof *force);
    sfem_body_def def = sfem_default_body_def();
    sfem_body *body;
    sfem_error err;
    int k;
    def.mass_damping = 1;
    def.stiffness_damping = 2e-3;
    def.p = 0.25;
    def.accuracy = 1; /* one solve a step */
    def.plain_load = way == AS_PRINTED;
    if (way == IMPLICIT) def.integrator = SFEM_NEWMARK;
    body = make_body(model, DEFAULT, def);
    sfem_body_start(body);
    for (k = 0; k < STEPS; ++k) {
        force[3 * node] = scale * history(k + 1);
        must(sfem_body_set_lasting_force(body, force, &err), &err);
        must(sfem_body_step(body, 1 / 60.0, &err), &err);
        x[k] = sfem_body_displacement(body)[3 * node];
        if (shape && k == PEAK)
            memcpy(shape, sfem_body_displacement(body), (3 * (size_t)node + 3) * sizeof *shape);
    }
    sfem_body_free(body);
    free(force);
}

static double furthest(const double *a, const double *b)
{
    double most = 0;
    int k;
    for (k = 0; k < STEPS; ++k) most = fmax(most, fabs(a[k] - (b ? b[k] : 0)));
    return most;
}

/* Fig. 8: in the first row deformations as they are, in the second times 100 f over the load. */
static void draw_shapes(const char *out, const sfem_model *model, double *const shape[5])
{
    static const struct {
        int run;
        double times;
        const char *caption;
    } view[6] = {{0, 1, "implicit, f"},
                 {3, 1, "proposed, 100 f"},
                 {4, 1, "proposed, 200 f"},
                 {0, 100, "implicit, f, displacements x 100"},
                 {1, 100, "proposed, f, displacements x 100"},
                 {4, 0.5, "proposed, 200 f, displacements x 1/2"}};
    const sfem_mesh *mesh = sfem_model_mesh(model);
    const double direction[3] = {0.6, -1, 0.55};
    double *x = (double *)ex_new(3 * (size_t)mesh->nodes, sizeof *x), lower[3], upper[3];
    double *length = (double *)ex_new((size_t)mesh->nodes, sizeof *length), low;
    ex_picture *p = ex_picture_new(1500, 760);
    ex_style style = ex_default_style();
    sfem_surface surface;
    sfem_error err;
    sfem_int i;
    int v, pass;
    must(sfem_mesh_surface(mesh, NULL, &surface, &err), &err);
    p->bar = 1;
    for (pass = 0; pass < 2; ++pass) /* the box of all views first */
        for (v = 0; v < 6; ++v) {
            const double *u = shape[view[v].run];
            for (i = 0; i < 3 * mesh->nodes; ++i) x[i] = mesh->x[i] + view[v].times * u[i];
            for (i = 0; i < mesh->nodes; ++i)
                length[i] = view[v].times * sqrt(ex_dot(u + 3 * (size_t)i, u + 3 * (size_t)i));
            if (!pass) {
                double high;
                ex_bounds(x, mesh->nodes, v == 0, lower, upper);
                ex_range(length, mesh->nodes, &low, &high);
                style.high = v ? fmax(style.high, high) : high;
                continue;
            }
            ex_view_begin(p, v, 3, 2, lower, upper, direction);
            ex_view_surface(p, mesh->nodes, x, surface.triangles, surface.tri, length, &style);
            ex_view_end(p, view[v].caption);
        }
    ex_colorbar(p, "drawn, m", 0, style.high);
    ex_picture_write(p, ex_path(out, "fig8-deformations.png"));
    ex_picture_free(p);
    sfem_surface_free(&surface);
    free(length);
    free(x);
}

/* The largest distance between two fields of displacements, the second taken so many times, over the first. */
static double shapes_apart(const sfem_mesh *mesh, const double *a, const double *b, double times)
{
    double most = 0, far = 0;
    sfem_int i;
    for (i = 0; i < 3 * mesh->nodes; ++i) {
        most = fmax(most, fabs(a[i]));
        far = fmax(far, fabs(a[i] - times * b[i]));
    }
    return far / most;
}

static void loads(const char *out)
{
    static const char *const law[2] = {"linear", "corotational"};
    static const char *const name[5] = {"implicit, f", "proposed, f", "proposed, 10 f",
                                        "proposed, 100 f", "proposed, 200 f"};
    static const double scale[5] = {1, 1, 10, 100, 200};
    static double x[5][STEPS], averaged[STEPS], step[STEPS], f[STEPS];
    double *shape[5];
    ex_plot p[3];
    int w, i, k;
    for (k = 0; k < STEPS; ++k) {
        step[k] = k + 1;
        f[k] = history(k + 1);
    }
    printf("Fig. 7: a node pulled, h = 1/60 s, most of its displacement along x, m, and the "
           "distance between the "
           "methods over that\n");
    for (w = 1; w >= 0; --w) {
        sfem_model *model =
            make_block(sizes[0].cells, sizes[0].kind, w ? SFEM_COROTATIONAL : SFEM_LINEAR);
        for (i = 0; i < 5; ++i) {
            shape[i] = w ? NULL : (double *)ex_new(3 * (size_t)sfem_model_mesh(model)->nodes, sizeof(double));
            if (!w || i < 2) pull(model, i ? AS_PRINTED : IMPLICIT, scale[i], x[i], shape[i]);
        }
        pull(model, AVERAGED, 1, averaged, NULL);
        printf("%-13s implicit f %.6f, proposed f %.6f; apart %.1e with its load, %.1e with "
               "Newmark's\n",
               law[w], furthest(x[0], NULL), furthest(x[1], NULL),
               furthest(x[1], x[0]) / furthest(x[0], NULL),
               furthest(averaged, x[0]) / furthest(x[0], NULL));
        for (i = 1; !w && i < 5; ++i)
            printf("%s%s over the load is apart from implicit f by %.1e", i > 1 ? "; " : "Fig. 8: ", name[i],
                   shapes_apart(sfem_model_mesh(model), shape[0], shape[i], 1 / scale[i]));
        if (!w) {
            printf(" of the largest displacement\n");
            draw_shapes(out, model, shape);
        }
        for (i = 0; i < 5; ++i) free(shape[i]);
        sfem_model_free(model);
    }
    printf("linear, proposed over implicit:");
    for (i = 1; i < 5; ++i)
        printf(" %s %.4f;", name[i] + 10, furthest(x[i], NULL) / furthest(x[0], NULL));
    printf("\nUnder the same f they agree. That 100 f gives the displacements of f, as the source "
           "finds, is none of "
           "the method's doing.\n");
    p[0] = ex_plot_new("Fig. 6: load (a substitute)", "step", "f, N", 0);
    ex_plot_add(&p[0], NULL, step, f, STEPS, EX_LINE);
    p[1] = ex_plot_new("Fig. 7, under the same f", "step", "displacement along x, m", 0);
    ex_plot_add(&p[1], NULL, step, x[0], STEPS, EX_LINE | EX_BAND);
    ex_plot_add(&p[1], NULL, step, x[1], STEPS, EX_LINE | EX_DASHED);
    p[2] = ex_plot_new("Fig. 7", "step", "displacement along x, m", 0);
    for (i = 0; i < 5; ++i) {
        ex_plot_add(&p[2], name[i], step, x[i], STEPS,
                    i == 0 ? EX_LINE | EX_BAND : EX_LINE | EX_DASHED);
        if (i < 2) ex_plot_look(&p[1], i ? "#d1603d" : "#2563a8", 0);
    }
    { /* the legend is that of the first */
        ex_plot order[3];
        order[0] = p[2];
        order[1] = p[1];
        order[2] = p[0];
        ex_plots_write(order, 3, 3, ex_path(out, "fig7-loads.svg"));
    }
}

int main(int argc, char **argv)
{
    static const ex_option table[] = {{"--quick", NULL, NULL, "few sizes, no pictures of spectra"},
                                      {"--out", "DIR", "build/bench-source", "where to write"},
                                      {NULL, NULL, NULL, NULL}};
    const ex_options o = ex_parse(argc, argv, "The experiments of the (p,q,r) paper.", table);
    const int quick = ex_given(&o, "--quick");
    const char *out = ex_text(&o, "--out");
    const double begin = ex_seconds();
    ex_make_directory(out);
    spectra(out, quick);
    speeds(out, quick);
    loads(out);
    printf("\nwrote the figures to %s; %.0f s\n", out, ex_seconds() - begin);
    return 0;
}
