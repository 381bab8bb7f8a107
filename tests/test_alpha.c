/* Dissipation on demand (KR-alpha, CR, Gui-lambda, Chang), and what stability and accuracy are claimed of the
 * explicit methods on one factor: springs and dampers that change, corrections, a swinging bar. */
#include "support.h"

/* --------------------------------------------------------------------------------------------
 * scenes
 * -------------------------------------------------------------------------------------------- */

/* One tet of which node 1 may move along x only: k u + d u' + m u'' = F with the entries of K, D, M. */
typedef struct oscillator {
    sfem_model *model;
    double k, m;
} oscillator;

static oscillator make_oscillator(sfem_mass mass)
{
    static sfem_real x[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
    static sfem_int tet[4] = {0, 1, 2, 3};
    sfem_model_def def = sfem_default_model_def();
    oscillator o;
    sfem_mesh mesh;
    sfem_error err;
    sfem_matrix m;
    memset(&mesh, 0, sizeof mesh);
    mesh.nodes = 4;
    mesh.tets = 1;
    mesh.x = x;
    mesh.tet = tet;
    def.mesh = &mesh;
    def.mass = mass;
    assert_ok(sfem_model_create(&def, &o.model, &err), err);
    assert_ok(sfem_model_combine(o.model, 0, 1, 0, NULL, &m, &err), err);
    o.k = sfem_model_stiffness(o.model)->val[9 * 2];
    o.m = m.val[9 * 2];
    sfem_matrix_free(&m, NULL);
    return o;
}

static sfem_body *make_body(sfem_model *model, const sfem_body_def *def)
{
    sfem_body *body = NULL;
    sfem_error err;
    assert_ok(sfem_body_create(model, def, &body, &err), err);
    return body;
}

static sfem_body *oscillator_body(const oscillator *o, sfem_body_def def)
{
    static const sfem_int pins[4] = {0, 2, 3, 1};
    static const unsigned char axes[4] = {7, 7, 7, SFEM_AXIS_Y | SFEM_AXIS_Z};
    def.pins = pins;
    def.pin_axes = axes;
    def.pin_count = 4;
    return make_body(o->model, &def);
}

static void set_node1(sfem_body *body, double u, double v)
{
    sfem_real uu[12] = {0}, vv[12] = {0};
    sfem_error err;
    uu[3] = u;
    vv[3] = v;
    assert_ok(sfem_body_set_state(body, uu, vv, &err), err);
}

static double node1(const sfem_body *body) { return sfem_body_displacement(body)[3]; }

static double node1_velocity(const sfem_body *body)
{
    sfem_real v[12];
    sfem_body_velocities(body, v);
    return v[3];
}

static void step(sfem_body *body, double h)
{
    sfem_error err;
    assert_ok(sfem_body_step(body, h, &err), err);
}

static sfem_body_def method(sfem_integrator integrator, double parameter)
{
    sfem_body_def def = sfem_default_body_def();
    def.integrator = integrator;
    if (integrator == SFEM_GUI) def.gui_lambda = parameter;
    if (integrator == SFEM_KR_ALPHA || integrator == SFEM_GENERALIZED_ALPHA) def.rho_inf = parameter;
    return def;
}

static void solve_dense(double *a, double *x, int n)
{
    int i, j, k;
    for (i = 0; i < n; ++i) {
        for (k = i, j = i + 1; j < n; ++j)
            if (fabs(a[j * n + i]) > fabs(a[k * n + i])) k = j;
        for (j = 0; j < n; ++j) {
            const double t = a[i * n + j];
            a[i * n + j] = a[k * n + j];
            a[k * n + j] = t;
        }
        {
            const double t = x[i];
            x[i] = x[k];
            x[k] = t;
        }
        for (j = i + 1; j < n; ++j) {
            const double f = a[j * n + i] / a[i * n + i];
            for (k = i; k < n; ++k) a[j * n + k] -= f * a[i * n + k];
            x[j] -= f * x[i];
        }
    }
    for (i = n - 1; i >= 0; --i) {
        for (k = i + 1; k < n; ++k) x[i] -= a[i * n + k] * x[k];
        x[i] /= a[i * n + i];
    }
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
    if (order == 3) { /* lambda^3 = c2 lambda^2 + c1 lambda + c0: split off the real root, by bisection */
        double low = -2, high = 2;
        for (i = 0; i < 200; ++i) {
            *real = (low + high) / 2;
            if (*real * *real * *real - c[2] * *real * *real - c[1] * *real - c[0] < 0) low = *real;
            else high = *real;
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
        {SFEM_KR_ALPHA, 0.8, 3,
         {1, .9995, .9953, .930}, {.0216, .0826, .287, 2.74}, {.0001, .0006, .0030, .0272},
         {{6e-5, 6e-5, 6e-5, 6e-4}, {6e-5, 6e-5, 6e-4, 6e-3}, {6e-5, 6e-5, 6e-5, 6e-5}}},
        {SFEM_KR_ALPHA, 1, 2,
         {1, 1, 1, 1}, {.0205, .0784, .2732, 2.64}, {0, 0, 0, 0},
         {{1e-9, 1e-9, 1e-9, 1e-9}, {6e-5, 6e-5, 6e-5, 6e-3}, {1e-9, 1e-9, 1e-9, 1e-9}}},
        {SFEM_GUI, 4, 2,
         {1, 1, 1, 1}, {.0205, .0784, .2732, 2.64}, {0, 0, 0, 0},
         {{1e-9, 1e-9, 1e-9, 1e-9}, {6e-5, 6e-5, 6e-5, 6e-3}, {1e-9, 1e-9, 1e-9, 1e-9}}},
        {SFEM_GUI, 12, 2,
         {1, 1, 1, 0}, {-.0001, -.0022, -.0451, 0}, {0, 0, 0, 0},
         {{1e-9, 1e-9, 1e-9, 0}, {6e-5, 6e-5, 6e-5, 0}, {1e-9, 1e-9, 1e-9, 0}}},
        {SFEM_CHANG, 0, 2,
         {1, 1, 1, 1}, {.0205, .0784, .2732, 2.64}, {0, 0, 0, 0},
         {{1e-9, 1e-9, 1e-9, 1e-9}, {6e-5, 6e-5, 6e-5, 6e-3}, {1e-9, 1e-9, 1e-9, 1e-9}}},
    };
    oscillator o = make_oscillator(SFEM_MASS_LUMPED);
    const double w = sqrt(o.k / o.m);
    size_t i, j;
    (void)state;
    for (i = 0; i < TEST_COUNT(row); ++i)
        for (j = 0; j < 4; ++j) {
            sfem_body *body = oscillator_body(&o, method(row[i].integrator, row[i].parameter));
            double c[3], radius, angle, real;
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
    c[0] = m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
           m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
}

/* The displacements of both follow one recurrence, with damping, too. */
static void kr_alpha_has_the_spectrum_of_generalized_alpha(void **state)
{
    static const double omega_h[] = {0.3, 1, 3, 30}, rho[] = {0, 0.3, 0.5, 0.8, 0.95}, xi[] = {0, 0.1, 0.6};
    oscillator o = make_oscillator(SFEM_MASS_LUMPED);
    const double w = sqrt(o.k / o.m);
    size_t i, j, k;
    int which;
    (void)state;
    for (i = 0; i < TEST_COUNT(omega_h); ++i)
        for (j = 0; j < TEST_COUNT(rho); ++j)
            for (k = 0; k < TEST_COUNT(xi); ++k)
                for (which = 0; which < 2; ++which) {
                    sfem_body_def def = method(which ? SFEM_GENERALIZED_ALPHA : SFEM_KR_ALPHA, rho[j]);
                    double c[3], x[4] = {0, 0, 0, 0};
                    sfem_body *body;
                    int n;
                    def.alpha = xi[k] * w;
                    def.beta_k = xi[k] / w;
                    body = oscillator_body(&o, def);
                    set_node1(body, 0.01, 0.02 * w);
                    characteristic(rho[j], omega_h[i], xi[k], c);
                    for (n = 0; n < 30; ++n) {
                        step(body, omega_h[i] / w);
                        memmove(x, x + 1, 3 * sizeof *x);
                        x[3] = node1(body);
                        if (n >= 4) assert_near(x[3], c[2] * x[2] + c[1] * x[1] + c[0] * x[0], 0, 1e-12);
                    }
                    sfem_body_free(body);
                }
    sfem_model_free(o.model);
}

/* At h omega = 1e4 what is left of a mode after a step is rho_inf of it. */
static void the_fastest_modes_fall_by_rho_inf(void **state)
{
    static const double rho[] = {0, 0.2, 0.5, 0.8};
    oscillator o = make_oscillator(SFEM_MASS_LUMPED);
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
static double oscillator_error(const oscillator *o, sfem_body_def def, double xi, int steps, int varying,
                               double *velocity_error)
{
    const double w = sqrt(o->k / o->m), T = 7 / w, nu = 0.6 * w, wd = w * sqrt(1 - xi * xi);
    const double load = 0.02;
    const double a = w * w - nu * nu, b = 2 * xi * w * nu, g = load * w * w / (a * a + b * b);
    const double C = g * a, S = g * b, u0 = 0.01, v0 = 0.02 * w;
    const double A = u0 - C, B = (v0 - S * nu + xi * w * A) / wd;
    const double e = exp(-xi * w * T);
    const double u = e * (A * cos(wd * T) + B * sin(wd * T)) + C * cos(nu * T) + S * sin(nu * T);
    const double v = e * ((B * wd - xi * w * A) * cos(wd * T) - (A * wd + xi * w * B) * sin(wd * T)) -
                     C * nu * sin(nu * T) + S * nu * cos(nu * T);
    double t = 0, error;
    sfem_real f[12] = {0};
    sfem_body *body;
    sfem_error err;
    int i;
    def.alpha = xi * w;
    def.beta_k = xi / w;
    body = oscillator_body(o, def);
    set_node1(body, u0, v0);
    f[3] = load * o->k;
    assert_ok(sfem_body_set_force(body, f, &err), err);
    sfem_body_start(body);
    for (i = 0; i < steps; ++i) {
        const double h = T / steps * (varying ? (i % 2 ? 1.5 : 0.5) : 1);
        t += h;
        f[3] = load * o->k * cos(nu * t);
        assert_ok(sfem_body_set_force(body, f, &err), err);
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
    } row[] = {{SFEM_KR_ALPHA, 0},   {SFEM_KR_ALPHA, 0.5}, {SFEM_KR_ALPHA, 0.8}, {SFEM_KR_ALPHA, 0.95},
               {SFEM_KR_ALPHA, 1},   {SFEM_GUI, 4},        {SFEM_GUI, 2},        {SFEM_GUI, 11},
               {SFEM_CHANG, 0}};
    static const double xi[2] = {0, 0.1};
    size_t i, j;
    int mass, varying;
    (void)state;
    for (mass = 0; mass < 2; ++mass) {
        oscillator o = make_oscillator(mass ? SFEM_MASS_CONSISTENT : SFEM_MASS_LUMPED);
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
    oscillator o = make_oscillator(SFEM_MASS_LUMPED);
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
            if (j % 2) def.beta_k = 0.3 / w;
            body = oscillator_body(&o, def);
            set_node1(body, 0.01, 0.01 * w);
            for (k = 0; k < 3000; ++k) {
                if (!rarely || k % 60 == 0) h = 10 * pow(rarely ? 3 : 1.1, random_uniform(&random, -1, 1));
                step(body, h / w);
                most = fmax(most, fabs(node1(body)));
            }
            assert_true(most < 0.1);
            assert_true(fabs(node1(body)) < 1e-9);
            sfem_body_free(body);
        }
    sfem_model_free(o.model);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(radius_period_and_damping_are_those_of_the_table),
        cmocka_unit_test(kr_alpha_has_the_spectrum_of_generalized_alpha),
        cmocka_unit_test(the_fastest_modes_fall_by_rho_inf),
        cmocka_unit_test(displacement_and_velocity_are_of_second_order),
        cmocka_unit_test(steps_that_change_stay_bounded),
    };
    return run_all_tests(tests);
}
