/* Dissipation on demand (KR-alpha, CR, Gui-lambda, Chang), and what stability and accuracy are claimed of the
 * explicit methods on one factor: springs and dampers that change, corrections, a swinging bar. */
#include "oscillator.h"
#include "linear.h"
#include "blocks.h"

/* --------------------------------------------------------------------------------------------
 * scenes
 * -------------------------------------------------------------------------------------------- */

static sfem_body_def method(sfem_integrator integrator, double parameter)
{
    sfem_body_def def = exact_body_def();
    def.integrator = integrator;
    if (integrator == SFEM_GUI) def.gui_lambda = parameter;
    if (integrator == SFEM_KR_ALPHA || integrator == SFEM_GENERALIZED_ALPHA)
        def.rho_inf = parameter;
    return def;
}

/* --------------------------------------------------------------------------------------------
 * spectrum
 * -------------------------------------------------------------------------------------------- */

/* The recurrence of `order` that its displacements follow: x_{n+order} = sum c_j x_{n+j}. The first steps
 * after the start are another's. */
static void recurrence(sfem_body *body, double h, int order, double c[3])
{
    double x[6], a[9];
    int i, j;
    for (i = 0; i < 2 * order; ++i) {
        step(body, h);
        x[i] = node1(body);
    }
    for (i = 0; i < order; ++i) {
        for (j = 0; j < order; ++j) a[i * order + j] = x[i + j];
        c[i] = x[i + order];
    }
    solve_dense(a, c, order);
}

/* The pair |lambda| e^{+- i angle}, and the real root of a third order. */
static void roots(int order, const double c[3], double *radius, double *angle, double *real)
{
    double b1 = c[1], b0 = c[0];
    int i;
    *real = 0;
    if (order ==
        3) { /* lambda^3 = c2 lambda^2 + c1 lambda + c0: split off the real root, by bisection */
        double low = -2, high = 2;
        for (i = 0; i < 200; ++i) {
            *real = (low + high) / 2;
            if (*real * *real * *real - c[2] * *real * *real - c[1] * *real - c[0] < 0)
                low = *real;
            else
                high = *real;
        }
        b1 = c[2] - *real;
        b0 = c[1] + *real * b1;
    }
    *radius = sqrt(-b0);
    *angle = atan2(sqrt(fmax(-b0 - b1 * b1 / 4, 0)), b1 / 2);
}

static void radius_period_and_damping_are_those_of_the_table(void **state)
{
    static const double omega_h[4] = {0.5, 1, 2, 10};
    static const struct {
        sfem_integrator integrator;
        double parameter;
        int order;
        double radius[4], elongation[4], damping[4], digit[3][4];
    } row[] = {
        {SFEM_KR_ALPHA,
         0.8,
         3,
         {1, .9995, .9953, .930},
         {.0216, .0826, .287, 2.74},
         {.0001, .0006, .0030, .0272},
         {{6e-5, 6e-5, 6e-5, 6e-4}, {6e-5, 6e-5, 6e-4, 6e-3}, {6e-5, 6e-5, 6e-5, 6e-5}}},
        {SFEM_KR_ALPHA,
         1,
         2,
         {1, 1, 1, 1},
         {.0205, .0784, .2732, 2.64},
         {0, 0, 0, 0},
         {{1e-9, 1e-9, 1e-9, 1e-9}, {6e-5, 6e-5, 6e-5, 6e-3}, {1e-9, 1e-9, 1e-9, 1e-9}}},
        {SFEM_GUI,
         4,
         2,
         {1, 1, 1, 1},
         {.0205, .0784, .2732, 2.64},
         {0, 0, 0, 0},
         {{1e-9, 1e-9, 1e-9, 1e-9}, {6e-5, 6e-5, 6e-5, 6e-3}, {1e-9, 1e-9, 1e-9, 1e-9}}},
        {SFEM_GUI,
         12,
         2,
         {1, 1, 1, 0},
         {-.0001, -.0022, -.0451, 0},
         {0, 0, 0, 0},
         {{1e-9, 1e-9, 1e-9, 0}, {6e-5, 6e-5, 6e-5, 0}, {1e-9, 1e-9, 1e-9, 0}}},
        {SFEM_CHANG,
         0,
         2,
         {1, 1, 1, 1},
         {.0205, .0784, .2732, 2.64},
         {0, 0, 0, 0},
         {{1e-9, 1e-9, 1e-9, 1e-9}, {6e-5, 6e-5, 6e-5, 6e-3}, {1e-9, 1e-9, 1e-9, 1e-9}}},
    };
    oscillator o = make_oscillator(1e6, SFEM_MASS_LUMPED);
    const double w = sqrt(o.k / o.m);
    size_t i, j;
    (void)state;
    for (i = 0; i < TEST_COUNT(row); ++i)
        for (j = 0; j < 4; ++j) {
            sfem_body *body = oscillator_body(&o, method(row[i].integrator, row[i].parameter));
            double c[3] = {0, 0, 0}, radius, angle, real;
            sfem_error err;
            set_node1(body, 0.01, 0.02);
            if (row[i].radius[j] == 0) {
                assert_status(sfem_body_step(body, omega_h[j] / w, &err), SFEM_UNSTABLE);
            } else {
                recurrence(body, omega_h[j] / w, row[i].order, c);
                roots(row[i].order, c, &radius, &angle, &real);
                assert_near(radius, row[i].radius[j], 0, row[i].digit[0][j]);
                assert_near(omega_h[j] / angle - 1, row[i].elongation[j], 0, row[i].digit[1][j]);
                assert_near(-log(radius) / angle, row[i].damping[j], 0, row[i].digit[2][j]);
            }
            sfem_body_free(body);
        }
    sfem_model_free(o.model);
}

/* lambda^3 = c2 lambda^2 + c1 lambda + c0 of generalized-alpha, from its definition: what (u, h v, h^2 a)
 * becomes of each unit vector. */
static void characteristic(double rho, double omega_h, double xi, double c[3])
{
    const double am = (2 * rho - 1) / (rho + 1), af = rho / (rho + 1);
    const double gamma = 0.5 - am + af, beta = 1 / ((1 + rho) * (1 + rho)), k = omega_h * omega_h;
    const double d = 2 * xi * omega_h;
    double m[3][3], minors = 0;
    int i, j;
    for (j = 0; j < 3; ++j) {
        const double u = j == 0, v = j == 1, a = j == 2;
        const double up = u + v + (0.5 - beta) * a, vp = v + (1 - gamma) * a;
        const double rest = am * a + d * ((1 - af) * vp + af * v) + k * ((1 - af) * up + af * u);
        const double next = -rest / ((1 - am) + (1 - af) * (gamma * d + beta * k));
        m[0][j] = up + beta * next;
        m[1][j] = vp + gamma * next;
        m[2][j] = next;
    }
    for (i = 0; i < 3; ++i) {
        const int p = (i + 1) % 3, q = (i + 2) % 3;
        minors += m[p][p] * m[q][q] - m[p][q] * m[q][p];
    }
    c[2] = m[0][0] + m[1][1] + m[2][2];
    c[1] = -minors;
    c[0] = m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) -
           m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
           m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
}

/* The displacements of both follow one recurrence, with damping, too. */
static void kr_alpha_has_the_spectrum_of_generalized_alpha(void **state)
{
    static const double omega_h[] = {0.3, 1, 3, 30}, rho[] = {0, 0.3, 0.5, 0.8, 0.95},
                        xi[] = {0, 0.1, 0.6};
    oscillator o = make_oscillator(1e6, SFEM_MASS_LUMPED);
    const double w = sqrt(o.k / o.m);
    size_t i, j, k;
    int which;
    (void)state;
    for (i = 0; i < TEST_COUNT(omega_h); ++i)
        for (j = 0; j < TEST_COUNT(rho); ++j)
            for (k = 0; k < TEST_COUNT(xi); ++k)
                for (which = 0; which < 2; ++which) {
                    sfem_body_def def =
                        method(which ? SFEM_GENERALIZED_ALPHA : SFEM_KR_ALPHA, rho[j]);
                    double c[3], x[4] = {0, 0, 0, 0};
                    sfem_body *body;
                    int n;
                    def.mass_damping = xi[k] * w;
                    def.stiffness_damping = xi[k] / w;
                    body = oscillator_body(&o, def);
                    set_node1(body, 0.01, 0.02 * w);
                    characteristic(rho[j], omega_h[i], xi[k], c);
                    for (n = 0; n < 30; ++n) {
                        step(body, omega_h[i] / w);
                        memmove(x, x + 1, 3 * sizeof *x);
                        x[3] = node1(body);
                        if (n >= 4)
                            assert_near(x[3], c[2] * x[2] + c[1] * x[1] + c[0] * x[0], 0, 1e-12);
                    }
                    sfem_body_free(body);
                }
    sfem_model_free(o.model);
}

/* At h omega = 1e4 what is left of a mode after a step is rho_inf of it. */
static void the_fastest_modes_fall_by_rho_inf(void **state)
{
    static const double rho[] = {0, 0.2, 0.5, 0.8};
    oscillator o = make_oscillator(1e6, SFEM_MASS_LUMPED);
    const double h = 1e4 / sqrt(o.k / o.m);
    size_t i;
    (void)state;
    for (i = 0; i < TEST_COUNT(rho); ++i) {
        sfem_body *body = oscillator_body(&o, method(SFEM_KR_ALPHA, rho[i]));
        double most = 0;
        int k;
        set_node1(body, 0.01, 0.02);
        for (k = 0; k < 60; ++k) {
            step(body, h);
            most = fmax(most, fabs(node1(body)));
        }
        /* a triple root: k^2 rho^k */
        assert_true(fabs(node1(body)) <= 0.1 * 60 * 60 * pow(rho[i], 58) + 1e-9);
        assert_true(most < 0.1); /* the start makes nothing move farther than it would */
        sfem_body_free(body);
    }
    sfem_model_free(o.model);
}

/* --------------------------------------------------------------------------------------------
 * order
 * -------------------------------------------------------------------------------------------- */

/* Error at T of u and v under u0, v0, damping xi and a load cos(nu t), against the closed form. */
static double oscillator_error(const oscillator *o, sfem_body_def def, double xi, int steps,
                               int varying, double *velocity_error)
{
    const double w = sqrt(o->k / o->m), T = 7 / w, nu = 0.6 * w, wd = w * sqrt(1 - xi * xi);
    const double load = 0.02;
    const double a = w * w - nu * nu, b = 2 * xi * w * nu, g = load * w * w / (a * a + b * b);
    const double C = g * a, S = g * b, u0 = 0.01, v0 = 0.02 * w;
    const double A = u0 - C, B = (v0 - S * nu + xi * w * A) / wd;
    const double e = exp(-xi * w * T);
    const double u = e * (A * cos(wd * T) + B * sin(wd * T)) + C * cos(nu * T) + S * sin(nu * T);
    const double v =
        e * ((B * wd - xi * w * A) * cos(wd * T) - (A * wd + xi * w * B) * sin(wd * T)) -
        C * nu * sin(nu * T) + S * nu * cos(nu * T);
    double t = 0, error;
    sfem_real f[12] = {0};
    sfem_body *body;
    sfem_error err;
    int i;
    def.mass_damping = xi * w;
    def.stiffness_damping = xi / w;
    body = oscillator_body(o, def);
    set_node1(body, u0, v0);
    f[3] = load * o->k;
    assert_ok(sfem_body_set_lasting_force(body, f, &err), err);
    sfem_body_start(body);
    for (i = 0; i < steps; ++i) {
        const double h = T / steps * (varying ? (i % 2 ? 1.5 : 0.5) : 1);
        t += h;
        f[3] = load * o->k * cos(nu * t);
        assert_ok(sfem_body_set_lasting_force(body, f, &err), err);
        step(body, h);
    }
    error = fabs(node1(body) - u);
    *velocity_error = fabs(node1_velocity(body) - v) / w;
    sfem_body_free(body);
    return error;
}

static void displacement_and_velocity_are_of_second_order(void **state)
{
    static const struct {
        sfem_integrator integrator;
        double parameter;
    } row[] = {{SFEM_KR_ALPHA, 0},    {SFEM_KR_ALPHA, 0.5}, {SFEM_KR_ALPHA, 0.8},
               {SFEM_KR_ALPHA, 0.95}, {SFEM_KR_ALPHA, 1},   {SFEM_GUI, 4},
               {SFEM_GUI, 2},         {SFEM_GUI, 11},       {SFEM_CHANG, 0}};
    static const double xi[2] = {0, 0.1};
    size_t i, j;
    int mass, varying;
    (void)state;
    for (mass = 0; mass < 2; ++mass) {
        oscillator o = make_oscillator(1e6, mass ? SFEM_MASS_CONSISTENT : SFEM_MASS_LUMPED);
        for (i = 0; i < TEST_COUNT(row); ++i)
            for (j = 0; j < 2; ++j)
                for (varying = 0; varying < 2; ++varying) {
                    const sfem_body_def def = method(row[i].integrator, row[i].parameter);
                    double v1, v2;
                    const double e1 = oscillator_error(&o, def, xi[j], 1600, varying, &v1);
                    const double e2 = oscillator_error(&o, def, xi[j], 3200, varying, &v2);
                    assert_true(log2(e1 / e2) > 1.85 && log2(v1 / v2) > 1.85);
                }
        sfem_model_free(o.model);
    }
}

/* A mode that is far from resolved, under steps that change by a tenth all the time, or by three every now and
 * then. (Steps that change by more all the time, or as rarely with rho_inf near 1, drive it: KR-alpha has no
 * energy that they would leave alone.) */
static void steps_that_change_stay_bounded(void **state)
{
    static const double rho[] = {0, 0.5, 0.8};
    oscillator o = make_oscillator(1e6, SFEM_MASS_LUMPED);
    const double w = sqrt(o.k / o.m);
    size_t i, j;
    (void)state;
    for (i = 0; i < TEST_COUNT(rho); ++i)
        for (j = 0; j < 4; ++j) {
            const int rarely = j / 2 == 1;
            sfem_body_def def = method(SFEM_KR_ALPHA, rho[i]);
            test_random random = {3};
            sfem_body *body;
            double most = 0, h = 10;
            int k;
            if (j % 2) def.stiffness_damping = 0.3 / w;
            body = oscillator_body(&o, def);
            set_node1(body, 0.01, 0.01 * w);
            for (k = 0; k < 3000; ++k) {
                if (!rarely || k % 60 == 0)
                    h = 10 * pow(rarely ? 3 : 1.1, random_uniform(&random, -1, 1));
                step(body, h / w);
                most = fmax(most, fabs(node1(body)));
            }
            assert_true(most < 0.1);
            assert_true(fabs(node1(body)) < 1e-9);
            sfem_body_free(body);
        }
    sfem_model_free(o.model);
}

/* --------------------------------------------------------------------------------------------
 * CR, Gui and Chang as they stand in their papers, with a spring that is not that of the factor
 * -------------------------------------------------------------------------------------------- */

/* One step of u, v, a under f(u) = k bent(u), damping d, load F(t): a is that of the equation of motion. */
typedef struct paper {
    double u, v, a;
} paper;

static double hardening(double k, double u) { return k * (u + 0.5 * (u - 0.02 * tanh(u / 0.02))); }

static void chen_ricles_gui(paper *s, double lambda, double k, double m, double d, double h,
                            double load)
{
    const double a1 = m / (m + h / 2 * d + h * h * k / lambda);
    s->u += h * s->v + h * h * a1 * s->a;
    s->v += h * a1 * s->a;
    s->a = (load - d * s->v - hardening(k, s->u)) / m;
}

static void chang(paper *s, double k, double m, double d, double h, double load)
{
    const double S = m + h / 2 * d + h * h / 4 * k, before = s->a;
    s->u += (m + h / 2 * d) / S * h * s->v + m / (2 * S) * h * h * before;
    s->a = (load - d * (s->v + h / 2 * before) - hardening(k, s->u)) / (m + h / 2 * d);
    s->v += h / 2 * (before + s->a);
}

/* Displacements of the library's methods beside them, from the papers' second step on, which the library is
 * given: it starts another way. Damped, Chang's is compared with a linear spring. */
static double paper_difference(sfem_body_def def, double lambda, double damping, double omega_h)
{
    oscillator o = make_oscillator(1e6, SFEM_MASS_LUMPED);
    const double w = sqrt(o.k / o.m), h = omega_h / w, d = damping * o.m * w;
    const int linear = lambda == 0 && damping != 0;
    double most = 0, load[2] = {0, 0}, u0;
    sfem_body *body;
    sfem_error err;
    paper s;
    int k;
    def.mass_damping = damping * w;
    body = oscillator_body(&o, def);
    s.u = 0.03;
    s.v = 0.01 * w;
    s.a = -(d * s.v + (linear ? o.k * s.u : hardening(o.k, s.u))) / o.m;
    for (k = 0; k < 200; ++k) {
        load[1] = linear ? 0 : 0.01 * o.k * sin(0.3 * k);
        u0 = s.u;
        if (lambda > 0)
            chen_ricles_gui(&s, lambda, o.k, o.m, d, h, load[1]);
        else if (linear) { /* the same with the spring k u: take the excess out of the load */
            const double S = o.m + h / 2 * d + h * h / 4 * o.k, before = s.a;
            s.u += (o.m + h / 2 * d) / S * h * s.v + o.m / (2 * S) * h * h * before;
            s.a = (load[1] - d * (s.v + h / 2 * before) - o.k * s.u) / (o.m + h / 2 * d);
            s.v += h / 2 * (before + s.a);
        } else {
            chang(&s, o.k, o.m, d, h, load[1]);
        }
        if (k == 0) { /* u0 and u1 as the papers have them: a first step with the fitting force */
            sfem_body *probe = oscillator_body(&o, def);
            double reach[2], force;
            int i;
            for (i = 0; i < 2; ++i) { /* u1 is linear in the force */
                set_node1(probe, u0, 0);
                assert_ok(sfem_body_predict(probe, h, &err), err);
                sfem_body_rhs(probe)[3] += i * o.k;
                assert_ok(sfem_body_solve(probe, &err), err);
                assert_ok(sfem_body_finish(probe, &err), err);
                reach[i] = node1(probe);
            }
            force = o.k * (s.u - reach[0]) / (reach[1] - reach[0]);
            sfem_body_free(probe);
            set_node1(body, u0, 0);
            assert_ok(sfem_body_predict(body, h, &err), err);
            sfem_body_rhs(body)[3] += force;
        } else {
            assert_ok(sfem_body_predict(body, h, &err), err);
            sfem_body_rhs(body)[3] +=
                load[0] - (linear ? 0 : hardening(o.k, node1(body)) - o.k * node1(body));
        }
        assert_ok(sfem_body_solve(body, &err), err);
        assert_ok(sfem_body_finish(body, &err), err);
        most = fmax(most, fabs(node1(body) - s.u) / 0.03);
        load[0] = load[1];
    }
    sfem_body_free(body);
    sfem_model_free(o.model);
    return most;
}

static void chen_ricles_gui_and_chang_follow_their_papers(void **state)
{
    (void)state;
    assert_true(paper_difference(method(SFEM_KR_ALPHA, 1), 4, 0.1, 0.7) < 1e-12);
    assert_true(paper_difference(method(SFEM_KR_ALPHA, 1), 4, 3, 2) < 1e-12);
    assert_true(paper_difference(method(SFEM_GUI, 2.5), 2.5, 0.1, 3) < 1e-12);
    assert_true(paper_difference(method(SFEM_GUI, 11), 11, 0.1, 0.7) < 1e-12);
    assert_true(paper_difference(method(SFEM_CHANG, 0), 0, 0, 0.7) < 1e-12);
    assert_true(paper_difference(method(SFEM_CHANG, 0), 0, 0.4, 0.7) < 1e-12);
}

/* --------------------------------------------------------------------------------------------
 * bodies
 * -------------------------------------------------------------------------------------------- */

enum { MAX_NODES = 200 };

typedef struct bar {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_int pins[64], pin_count, n;
} bar;

static bar make_bar(sfem_int nx, double young, sfem_law law)
{
    const sfem_int cells[3] = {nx, 2, 2};
    const sfem_real size[3] = {0.1 * nx, 0.2, 0.2};
    sfem_model_def def = linear_model_def();
    uint64_t random = 11;
    sfem_error err;
    bar b;
    memset(&b, 0, sizeof b);
    assert_ok(block_mesh(cells, size, 0.01, &random, &b.mesh, &err), err);
    b.pin_count = block_clamp(cells, b.pins);
    b.n = b.mesh.nodes;
    assert_true(b.n <= MAX_NODES);
    def.mesh = &b.mesh;
    def.material.young = young;
    def.material.law = law;
    assert_ok(sfem_model_create(&def, &b.model, &err), err);
    return b;
}

static void drop_bar(bar *b)
{
    sfem_model_free(b->model);
    sfem_mesh_free(&b->mesh);
}

static sfem_body *bar_body(const bar *b, sfem_body_def def, int held)
{
    if (held) {
        def.pins = b->pins;
        def.pin_count = b->pin_count;
    }
    return make_body(b->model, &def);
}

/* v = velocity + spin x (X - centre of the box) */
static void set_motion(const bar *b, sfem_body *body, const double velocity[3],
                       const double spin[3])
{
    const double centre[3] = {0.05 * (b->n / 9 - 1), 0.1, 0.1};
    sfem_real v[3 * MAX_NODES];
    sfem_error err;
    sfem_int i;
    for (i = 0; i < b->n; ++i) {
        const double x = b->mesh.x[3 * i] - centre[0], y = b->mesh.x[3 * i + 1] - centre[1],
                     z = b->mesh.x[3 * i + 2] - centre[2];
        v[3 * i] = velocity[0] + spin[1] * z - spin[2] * y;
        v[3 * i + 1] = velocity[1] + spin[2] * x - spin[0] * z;
        v[3 * i + 2] = velocity[2] + spin[0] * y - spin[1] * x;
    }
    assert_ok(sfem_body_set_state(body, NULL, v, &err), err);
}

static void momentum(const bar *b, const double *u0, const double *u1, double h, double p[6])
{
    const double *mass = sfem_model_node_mass(b->model);
    sfem_int i;
    int c;
    memset(p, 0, 6 * sizeof *p);
    for (i = 0; i < b->n; ++i) {
        double x[3], w[3];
        for (c = 0; c < 3; ++c) {
            x[c] = b->mesh.x[3 * i + c] + u1[3 * i + c];
            w[c] = mass[i] * (u1[3 * i + c] - u0[3 * i + c]) / h;
        }
        for (c = 0; c < 3; ++c) {
            p[c] += w[c];
            p[3 + c] += x[(c + 1) % 3] * w[(c + 2) % 3] - x[(c + 2) % 3] * w[(c + 1) % 3];
        }
    }
}

/* A free body that turns, brakes by its mass and is pulled: momenta follow the equation of motion, with forces of
 * the caller's, too. */
static void free_bodies_keep_exact_momenta(void **state)
{
    static const sfem_law law[] = {SFEM_COROTATIONAL, SFEM_STVK, SFEM_NEOHOOKEAN};
    const double velocity[3] = {0.3, -0.2, 0.1}, spin[3] = {1, 2, -3}, h = 1.0 / 240;
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(law); ++k) {
        bar b = make_bar(5, 1e6, law[k]);
        const size_t n = 3 * (size_t)b.n;
        sfem_body_def def = method(SFEM_KR_ALPHA, 0.7);
        double before[3 * MAX_NODES], p[6], first[6] = {0, 0, 0, 0, 0, 0}, size[2];
        sfem_body *body;
        sfem_error err;
        int i, c;
        def.stiffness_damping = 1e-3;
        body = bar_body(&b, def, 0);
        set_motion(&b, body, velocity, spin);
        for (i = 0; i < 1000; ++i) {
            memcpy(before, sfem_body_displacement(body), n * sizeof *before);
            assert_ok(sfem_body_predict(body, h, &err), err);
            if (i == 300) sfem_body_rhs(body)[3 * 7 + 1] += 20; /* a push of 20 N for a step */
            assert_ok(sfem_body_solve(body, &err), err);
            assert_ok(sfem_body_finish(body, &err), err);
            momentum(&b, before, sfem_body_displacement(body), h, p);
            if (i == 0) memcpy(first, p, sizeof p);
            if (i == 300) { /* acts at the places before the step */
                const double *x = b.mesh.x + 3 * 7, *u = before + 3 * 7, push = 20 * h;
                first[1] += push;
                first[3] -= push * (x[2] + u[2]);
                first[5] += push * (x[0] + u[0]);
            }
            size[0] = sqrt(first[0] * first[0] + first[1] * first[1] + first[2] * first[2]);
            size[1] = sqrt(first[3] * first[3] + first[4] * first[4] + first[5] * first[5]);
            for (c = 0; c < 6; ++c) assert_near(p[c], first[c], 0, 1e-10 * size[c / 3]);
        }
        assert_int_equal(sfem_body_get_info(body).rejected, 0);
        sfem_body_free(body);
        drop_bar(&b);
    }
}

/* A push in a step that is rejected is not lost. */
static void rejected_steps_keep_the_forces_of_the_caller(void **state)
{
    static const sfem_integrator integrator[] = {SFEM_PQR, SFEM_KR_ALPHA};
    const double push = 3e4, h = 1.0 / 60;
    size_t k;
    (void)state;
    for (k = 0; k < 2; ++k) {
        bar b = make_bar(5, 1e6, SFEM_COROTATIONAL);
        sfem_body *body = bar_body(&b, method(integrator[k], 0.8), 0);
        const double zero[3 * MAX_NODES] = {0};
        double before[3 * MAX_NODES], p[6], change = 0;
        sfem_error err;
        int i;
        for (i = 0; i < 20; ++i) {
            memcpy(before, i ? sfem_body_displacement(body) : zero,
                   3 * (size_t)b.n * sizeof *before);
            assert_ok(sfem_body_predict(body, h, &err), err);
            if (i < 10) sfem_body_rhs(body)[3 * 7 + 1] += push;
            change += i < 10 ? push * h : 0;
            assert_ok(sfem_body_solve(body, &err), err);
            assert_ok(sfem_body_finish(body, &err), err);
        }
        momentum(&b, before, sfem_body_displacement(body), h, p);
        assert_true(sfem_body_get_info(body).rejected > 0);
        print_message("    %.3f of the push, %d steps rejected\n", p[1] / change,
                      (int)sfem_body_get_info(body).rejected);
        /* w is the velocity of mid-step: half a push is still to come, until a rejected step ends at its end */
        assert_true(fabs(p[1] / change - 1) < 1e-12 || fabs(p[1] / change - 0.95) < 1e-12);
        sfem_body_free(body);
        drop_bar(&b);
    }
}

/* An impulse is one in every step: accepted, rejected, after a rejected one; steps of all lengths. */
static void impulses_are_whole_in_rejected_steps(void **state)
{
    static const sfem_integrator integrator[] = {SFEM_PQR, SFEM_KR_ALPHA, SFEM_CHANG};
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(integrator); ++k) {
        bar b = make_bar(5, 1e6, SFEM_NEOHOOKEAN);
        sfem_body_def def = method(integrator[k], 0.8);
        test_random random = {3};
        double v[3 * MAX_NODES], start[6], end[6], given[3] = {0, 0, 0}, zero[3 * MAX_NODES];
        sfem_body *body;
        sfem_error err;
        int64_t rejected;
        int i, c;
        def.accuracy = 1;
        body = bar_body(&b, def, 0);
        memset(zero, 0, sizeof zero);
        for (i = 0; i < 3 * (int)b.n; ++i) v[i] = random_uniform(&random, -30, 30);
        assert_ok(sfem_body_set_state(body, NULL, v, &err), err);
        momentum(&b, zero, v, 1, start);
        for (i = 0; i < 60; ++i) {
            double j[3];
            for (c = 0; c < 3; ++c) given[c] += j[c] = random_uniform(&random, -20, 30);
            assert_ok(sfem_body_predict(body, random_uniform(&random, .5, 1.5) / 30, &err), err);
            if (i % 2) assert_ok(sfem_body_add_impulse(body, i % b.n, j, &err), err);
            assert_ok(sfem_body_solve(body, &err), err);
            if (i % 2 == 0) assert_ok(sfem_body_add_impulse(body, i % b.n, j, &err), err);
            assert_ok(sfem_body_finish(body, &err), err);
        }
        assert_true(sfem_body_get_info(body).rejected > 5);
        do { /* the mean velocity of a step that is not rejected */
            memcpy(v, sfem_body_displacement(body), 3 * (size_t)b.n * sizeof *v);
            rejected = sfem_body_get_info(body).rejected;
            assert_ok(sfem_body_step(body, 1. / 240, &err), err);
        } while (sfem_body_get_info(body).rejected > rejected);
        momentum(&b, v, sfem_body_displacement(body), 1. / 240, end);
        for (c = 0; c < 3; ++c) assert_near(end[c], start[c] + given[c], 0, 1e-8);
        sfem_body_free(body);
        drop_bar(&b);
    }
}

/* The turned form of a body that hardly moves is that of the linear body. */
static void tiny_motions_are_those_of_the_linear_law(void **state)
{
    sfem_real u[2][3 * MAX_NODES], v[3 * MAX_NODES];
    test_random random = {5};
    size_t n = 0;
    int k, i;
    (void)state;
    for (k = 0; k < 2; ++k) {
        bar b = make_bar(4, 1e6, k ? SFEM_COROTATIONAL : SFEM_LINEAR);
        sfem_body_def def = method(SFEM_KR_ALPHA, 0.8);
        sfem_body *body;
        sfem_error err;
        sfem_int node;
        def.mass_damping = 0.5;
        def.stiffness_damping = 1e-3;
        def.gravity[1] = -1e-7;
        def.safeguard = 0; /* energies of 1e-15 J are rounding */
        body = bar_body(&b, def, 1);
        n = 3 * (size_t)b.n;
        random.state = 5;
        random_fill(&random, v, n, -1e-8, 1e-8);
        assert_ok(sfem_body_set_state(body, NULL, v, &err), err);
        /* held from the start, by equal steps: where that changes a linear body starts afresh */
        assert_ok(sfem_body_grab_node(body, b.n - 1, &node, &err), err);
        for (i = 0; i < 60; ++i) step(body, 1.0 / 60);
        memcpy(u[k], sfem_body_displacement(body), n * sizeof **u);
        sfem_body_free(body);
        drop_bar(&b);
    }
    assert_all_near(u[0], u[1], n, 1e-4, 0); /* strains of 1e-10 have lost ten digits */
}

/* A bar that sags by its own length: halving h quarters the error. */
static void nonlinear_bodies_have_second_order(void **state)
{
    static const struct {
        sfem_integrator integrator;
        double parameter;
    } row[] = {{SFEM_KR_ALPHA, 0.3}, {SFEM_KR_ALPHA, 0.8}, {SFEM_GUI, 3.5}, {SFEM_CHANG, 0}};
    size_t j;
    int k;
    (void)state;
    for (j = 0; j < TEST_COUNT(row); ++j) {
        double u[4][3 * MAX_NODES], error[3];
        size_t i, n = 0;
        for (k = 0; k < 4; ++k) {
            bar b = make_bar(5, 2e4, SFEM_COROTATIONAL);
            sfem_body_def def = method(row[j].integrator, row[j].parameter);
            sfem_body *body;
            int s;
            def.gravity[1] = -9.81;
            body = bar_body(&b, def, 1);
            n = 3 * (size_t)b.n;
            for (s = 0; s < 80 << k; ++s) step(body, 0.4 / (80 << k));
            assert_int_equal(sfem_body_get_info(body).rejected, 0);
            memcpy(u[k], sfem_body_displacement(body), n * sizeof **u);
            sfem_body_free(body);
            drop_bar(&b);
        }
        for (k = 0; k < 3; ++k) {
            error[k] = 0;
            for (i = 0; i < n; ++i) error[k] += (u[k][i] - u[k + 1][i]) * (u[k][i] - u[k + 1][i]);
        }
        assert_near(log2(error[1] / error[2]) / 2, 2, 0, 0.2);
    }
}

/* Spun, kicked, inside out, scattered: the guard holds these methods, too, and the energy falls. */
static void violent_runs_keep_their_energy(void **state)
{
    static const struct {
        sfem_integrator integrator;
        double parameter;
    } row[] = {{SFEM_KR_ALPHA, 0},
               {SFEM_KR_ALPHA, 0.8},
               {SFEM_KR_ALPHA, 1},
               {SFEM_GUI, 3},
               {SFEM_CHANG, 0}};
    static const double young[] = {1e4, 1e6, 1e9};
    const double zero[3] = {0, 0, 0}, spin[3] = {0, 0, 20};
    size_t i, j;
    int kind, k;
    (void)state;
    for (i = 0; i < TEST_COUNT(row); ++i)
        for (j = 0; j < TEST_COUNT(young); ++j)
            for (kind = 0; kind < 4; ++kind) {
                bar b = make_bar(5, young[j], SFEM_COROTATIONAL);
                sfem_body *body = bar_body(&b, method(row[i].integrator, row[i].parameter), 0);
                double u[3 * MAX_NODES], v[3 * MAX_NODES], start, most = 0;
                test_random random = {17};
                sfem_error err;
                memset(u, 0, sizeof u);
                memset(v, 0, sizeof v);
                for (k = 0; k < 3 * b.n; ++k) {
                    if (kind == 1) v[k] = 10 * random_normal(&random);
                    if (kind == 2) u[k] = -2 * b.mesh.x[k];
                    if (kind == 3) u[k] = random_uniform(&random, -0.5, 0.5);
                }
                assert_ok(sfem_body_set_state(body, u, v, &err), err);
                if (kind == 0) set_motion(&b, body, zero, spin);
                start = sfem_body_energy(body).total;
                for (k = 0; k < 60; ++k) {
                    sfem_energy e;
                    step(body, 1.0 / 30);
                    e = sfem_body_energy(body);
                    most = fmax(most, e.elastic);
                }
                if (!(most < 2 * start))
                    fail_msg("method %d %g, Y %g, scene %d: %g of %g J", (int)row[i].integrator,
                             row[i].parameter, young[j], kind, most, start);
                sfem_body_free(body);
                drop_bar(&b);
            }
}

/* --------------------------------------------------------------------------------------------
 * state, threads, memory, refusals
 * -------------------------------------------------------------------------------------------- */

/* Spun, taken by a handle, let go, with steps that change. */
static void go_on(const bar *b, sfem_body *body, sfem_int *handle, int first, int last)
{
    sfem_error err;
    int k;
    for (k = first; k < last; ++k) {
        if (k == 5) assert_ok(sfem_body_grab_node(body, b->n - 1, handle, &err), err);
        if (k == 25) sfem_body_release_handle(body, *handle);
        step(body, k < 12 ? 1.0 / 60 : 1.0 / 50);
    }
}

static void a_saved_state_continues_bit_for_bit(void **state)
{
    static const int cut[] = {0, 1, 13, 29};
    const double zero[3] = {0, 0, 0}, spin[3] = {0, 0, 6};
    int law, k;
    (void)state;
    for (law = SFEM_LINEAR; law <= SFEM_COROTATIONAL; ++law)
        for (k = 0; k < 4; ++k) {
            bar b = make_bar(4, 3e5, (sfem_law)law);
            sfem_body_def def = method(SFEM_KR_ALPHA, 0.6);
            sfem_body *one, *two;
            sfem_int handle = 0;
            sfem_error err;
            void *memory;
            size_t bytes;
            def.stiffness_damping = 1e-3;
            one = bar_body(&b, def, 0);
            two = bar_body(&b, def, 0);
            set_motion(&b, one, zero, spin);
            go_on(&b, one, &handle, 0, cut[k]);
            bytes = sfem_body_state_size(one);
            memory = malloc(bytes);
            sfem_body_save_state(one, memory);
            assert_ok(sfem_body_load_state(two, memory, bytes, &err), err);
            go_on(&b, one, &handle, cut[k], 40);
            go_on(&b, two, &handle, cut[k], 40);
            assert_true(hash_reals(sfem_body_displacement(one), 3 * (size_t)b.n) ==
                        hash_reals(sfem_body_displacement(two), 3 * (size_t)b.n));
            free(memory);
            sfem_body_free(one);
            sfem_body_free(two);
            drop_bar(&b);
        }
}

static void any_number_of_threads_gives_the_same_bits(void **state)
{
    const double zero[3] = {0, 0, 0}, spin[3] = {0, 0, 6};
    uint64_t hash = 0;
    int threads;
    (void)state;
    for (threads = 1; threads <= 4; threads += threads) {
        bar b = make_bar(10, 3e5, SFEM_COROTATIONAL);
        sfem_body_def def = method(SFEM_KR_ALPHA, 0.6);
        sfem_body *body;
        sfem_int handle;
        def.exec = thread_exec(threads);
        body = bar_body(&b, def, 0);
        set_motion(&b, body, zero, spin);
        go_on(&b, body, &handle, 0, 30);
        if (threads == 1) hash = hash_reals(sfem_body_displacement(body), 3 * (size_t)b.n);
        assert_true(hash == hash_reals(sfem_body_displacement(body), 3 * (size_t)b.n));
        sfem_body_free(body);
        drop_bar(&b);
    }
}

static sfem_status make_and_run(sfem_allocator allocator, void *user, sfem_error *err)
{
    const bar *b = (const bar *)user;
    sfem_model_def def = linear_model_def();
    sfem_body_def body_def = method(SFEM_KR_ALPHA, 0.5);
    sfem_model *model = NULL;
    sfem_body *body = NULL;
    sfem_status status;
    sfem_int handle;
    int k;
    def.mesh = &b->mesh;
    def.material.law = b->n > 30 ? SFEM_COROTATIONAL : SFEM_LINEAR;
    def.allocator = body_def.allocator = allocator;
    status = sfem_model_create(&def, &model, err);
    if (status == SFEM_OK) status = sfem_body_create(model, &body_def, &body, err);
    if (status == SFEM_OK) status = sfem_body_grab_node(body, 0, &handle, err);
    for (k = 0; k < 3 && status == SFEM_OK; ++k) status = sfem_body_step(body, 1.0 / 60, err);
    sfem_body_free(body);
    sfem_model_free(model);
    return status;
}

static void every_allocation_may_fail(void **state)
{
    int k;
    (void)state;
    for (k = 2; k < 5; k += 2) {
        bar b = make_bar(k, 1e6, SFEM_LINEAR);
        fail_every_allocation(make_and_run, &b);
        drop_bar(&b);
    }
}

static void a_prepared_body_allocates_nothing(void **state)
{
    int law;
    (void)state;
    for (law = SFEM_LINEAR; law <= SFEM_COROTATIONAL; ++law) {
        bar b = make_bar(4, 1e6, (sfem_law)law);
        sfem_body_def def = method(SFEM_KR_ALPHA, 0.8);
        sfem_model_def model = linear_model_def();
        test_memory memory = {0};
        sfem_body *body;
        sfem_error err;
        size_t calls;
        int k;
        def.allocator = model.allocator = test_allocator(&memory); /* the model's: a body's own factor */
        def.may_allocate = 0;
        sfem_model_free(b.model);
        model.mesh = &b.mesh;
        model.material.young = 1e6;
        model.material.law = (sfem_law)law;
        assert_ok(sfem_model_create(&model, &b.model, &err), err);
        body = bar_body(&b, def, 1);
        assert_status(sfem_body_step(body, 0.01, &err), SFEM_NOT_PREPARED);
        assert_ok(sfem_body_prepare(body, 0.01, &err), err);
        calls = memory.calls;
        for (k = 0; k < 10; ++k) step(body, 0.01);
        assert_true(memory.calls == calls);
        assert_true(sfem_body_get_info(body).body_bytes <= memory.bytes);
        sfem_body_free(body);
        drop_bar(&b);
        assert_no_leak(memory);
    }
}

static void factors_are_shared_where_coefficients_agree(void **state)
{
    static const sfem_integrator same[] = {SFEM_PQR, SFEM_NEWMARK, SFEM_GUI, SFEM_CHANG,
                                           SFEM_KR_ALPHA};
    bar b = make_bar(4, 1e6, SFEM_LINEAR);
    sfem_body *body[TEST_COUNT(same)];
    size_t i;
    (void)state;
    for (i = 0; i < TEST_COUNT(same); ++i) {
        body[i] = bar_body(&b, method(same[i], same[i] == SFEM_GUI ? 4 : 1), 1);
        step(body[i], 0.01);
    }
    assert_int_equal(sfem_body_get_info(body[0]).factor_users, TEST_COUNT(same));
    for (i = 0; i < TEST_COUNT(same); ++i) sfem_body_free(body[i]);
    drop_bar(&b);
}

static void drag(void *user, const sfem_real *v, sfem_real *force)
{
    (void)user;
    (void)v;
    (void)force;
}

static void what_does_not_fit_is_refused(void **state)
{
    bar b = make_bar(2, 1e6, SFEM_LINEAR);
    sfem_body_def def = method(SFEM_GUI, 0);
    sfem_body *body;
    sfem_error err;
    (void)state;
    assert_status(sfem_body_create(b.model, &def, &body, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "lambda");
    def = method(SFEM_KR_ALPHA, 1.1);
    assert_status(sfem_body_create(b.model, &def, &body, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "rho_inf");
    def = method(SFEM_KR_ALPHA, 0.5);
    def.damping_force.force = drag;
    assert_status(sfem_body_create(b.model, &def, &body, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "implicit");
    drop_bar(&b);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(radius_period_and_damping_are_those_of_the_table),
        cmocka_unit_test(kr_alpha_has_the_spectrum_of_generalized_alpha),
        cmocka_unit_test(the_fastest_modes_fall_by_rho_inf),
        cmocka_unit_test(displacement_and_velocity_are_of_second_order),
        cmocka_unit_test(steps_that_change_stay_bounded),
        cmocka_unit_test(chen_ricles_gui_and_chang_follow_their_papers),
        cmocka_unit_test(free_bodies_keep_exact_momenta),
        cmocka_unit_test(rejected_steps_keep_the_forces_of_the_caller),
        cmocka_unit_test(impulses_are_whole_in_rejected_steps),
        cmocka_unit_test(tiny_motions_are_those_of_the_linear_law),
        cmocka_unit_test(nonlinear_bodies_have_second_order),
        cmocka_unit_test(violent_runs_keep_their_energy),
        cmocka_unit_test(a_saved_state_continues_bit_for_bit),
        cmocka_unit_test(any_number_of_threads_gives_the_same_bits),
        cmocka_unit_test(a_prepared_body_allocates_nothing),
        cmocka_unit_test(every_allocation_may_fail),
        cmocka_unit_test(factors_are_shared_where_coefficients_agree),
        cmocka_unit_test(what_does_not_fit_is_refused),
    };
    return run_all_tests(tests);
}
