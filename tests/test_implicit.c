/* Implicit integrators and Newton's iteration: linear and nonlinear bodies, damping forces, statics. */
#include "support.h"

/* --------------------------------------------------------------------------------------------
 * one degree of freedom
 * -------------------------------------------------------------------------------------------- */

/* One tet of which node 1 may move along x only: k u + D(u') + m u'' = F. */
typedef struct oscillator {
    sfem_model *model;
    double k, m;
} oscillator;

static oscillator make_oscillator(double young, sfem_mass mass)
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
    def.material.young = young;
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

/* Modulus and angle of the complex pair among the roots of the method's recurrence of the given order,
 * fitted to displacements. */
static void amplification(sfem_body *body, double h, int order, double *radius, double *angle)
{
    double x[6], a[9] = {0}, c[3] = {0}, real = 0, b0, b1;
    int i, j;
    for (i = 0; i < 2 * order; ++i) {
        step(body, h);
        x[i] = node1(body);
    }
    for (i = 0; i < order; ++i) {
        for (j = 0; j < order; ++j) a[i * order + j] = x[i + j];
        c[i] = x[i + order];
    }
    solve_dense(a, c, order); /* x_{n+order} = sum c_j x_{n+j} */
    b1 = c[1];
    b0 = c[0];
    if (order == 3) { /* lambda^3 = c2 lambda^2 + c1 lambda + c0: split off the real root, by bisection */
        double low = -2, high = 2;
        for (i = 0; i < 200; ++i) {
            real = (low + high) / 2;
            if (real * real * real - c[2] * real * real - c[1] * real - c[0] < 0) low = real;
            else high = real;
        }
        b1 = c[2] - real; /* lambda^2 = b1 lambda + b0 */
        b0 = c[1] + real * b1;
    }
    *radius = sqrt(-b0);
    *angle = atan2(sqrt(-b0 - b1 * b1 / 4), b1 / 2);
}

/* The undamped table of the reference methods; each entry to the digits given. */
static void radius_period_and_damping_are_those_of_the_table(void **state)
{
    static const double omega_h[4] = {0.5, 1, 2, 10};
    static const struct {
        sfem_integrator integrator;
        int order;
        double radius[4], elongation[4], damping[4];
        double digit[3][4];
    } row[] = {
        {SFEM_HHT, 3, {.9994, .9938, .962, .838}, {.0254, .0945, .312, 2.71}, {.0011, .0068, .0252, .0656},
         {{6e-5, 6e-5, 6e-4, 6e-4}, {6e-5, 6e-5, 6e-4, 6e-3}, {6e-5, 6e-5, 6e-5, 6e-5}}},
        {SFEM_GENERALIZED_ALPHA, 3, {1, .9995, .9953, .930}, {.0216, .0826, .287, 2.74}, {.0001, .0006, .0030, .0272},
         {{6e-5, 6e-5, 6e-5, 6e-4}, {6e-5, 6e-5, 6e-4, 6e-3}, {6e-5, 6e-5, 6e-5, 6e-5}}},
        {SFEM_BATHE, 2, {.9998, .9971, .969, .457}, {.0103, .0400, .145, 3.04}, {.0004, .0031, .0182, .316},
         {{6e-5, 6e-5, 6e-4, 6e-4}, {6e-5, 6e-5, 6e-4, 6e-3}, {6e-5, 6e-5, 6e-5, 6e-4}}},
        {SFEM_BACKWARD_EULER, 2, {.894, .707, .447, .0995}, {.078, .273, .806, 5.80}, {.241, .441, .727, 1.57},
         {{6e-4, 6e-4, 6e-4, 6e-5}, {6e-4, 6e-4, 6e-4, 6e-3}, {6e-4, 6e-4, 6e-4, 6e-3}}},
    };
    oscillator o = make_oscillator(1e6, SFEM_MASS_LUMPED);
    const double w = sqrt(o.k / o.m);
    size_t i, j;
    (void)state;
    for (i = 0; i < TEST_COUNT(row); ++i)
        for (j = 0; j < 4; ++j) {
            sfem_body_def def = sfem_default_body_def();
            double radius, angle;
            sfem_body *body;
            def.integrator = row[i].integrator;
            body = oscillator_body(&o, def);
            set_node1(body, 0.01, 0.02);
            step(body, omega_h[j] / w);
            amplification(body, omega_h[j] / w, row[i].order, &radius, &angle);
            assert_near(radius, row[i].radius[j], 0, row[i].digit[0][j]);
            assert_near(omega_h[j] / angle - 1, row[i].elongation[j], 0, row[i].digit[1][j]);
            assert_near(-log(radius) / angle, row[i].damping[j], 0, row[i].digit[2][j]);
            sfem_body_free(body);
        }
    sfem_model_free(o.model);
}

/* rho_inf = 1 and HHT's alpha = 0 are the trapezoidal rule; rho_inf is the radius at Omega = infinity. */
static void parameters_reach_their_limits(void **state)
{
    oscillator o = make_oscillator(1e6, SFEM_MASS_LUMPED);
    const double w = sqrt(o.k / o.m);
    sfem_body_def def = sfem_default_body_def();
    sfem_body *body[3];
    double radius, angle, rho;
    int i, k;
    (void)state;
    def.integrator = SFEM_NEWMARK;
    body[0] = oscillator_body(&o, def);
    def.integrator = SFEM_HHT;
    def.hht_alpha = 0;
    body[1] = oscillator_body(&o, def);
    def.integrator = SFEM_GENERALIZED_ALPHA;
    def.rho_inf = 1;
    body[2] = oscillator_body(&o, def);
    for (i = 0; i < 3; ++i) set_node1(body[i], 0.01, 0.02 * w);
    for (k = 0; k < 100; ++k)
        for (i = 0; i < 3; ++i) {
            step(body[i], 0.7 / w);
            assert_near(node1(body[i]), node1(body[0]), 0, 1e-11 * 0.03);
        }
    for (i = 0; i < 3; ++i) sfem_body_free(body[i]);
    for (rho = 0.2; rho < 1; rho += 0.3) {
        def.rho_inf = rho;
        body[0] = oscillator_body(&o, def);
        set_node1(body[0], 0.01, 0);
        step(body[0], 1000 / w);
        amplification(body[0], 1000 / w, 3, &radius, &angle);
        assert_near(radius, rho, 0, 1e-2); /* the pair meets the third root there: off by 1/Omega */
        sfem_body_free(body[0]);
    }
    sfem_model_free(o.model);
}

/* Error at T of u and v under u0, v0, damping xi and a load cos(nu t), against the closed form. */
static double oscillator_error(const oscillator *o, sfem_body_def def, double xi, int steps,
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
    const double h = T / steps;
    sfem_real f[12] = {0};
    sfem_body *body;
    sfem_error err;
    double error;
    int i;
    def.alpha = xi * w;
    def.beta_k = xi / w;
    body = oscillator_body(o, def);
    set_node1(body, u0, v0);
    f[3] = load * o->k;
    assert_ok(sfem_body_set_force(body, f, &err), err);
    sfem_body_start(body);
    for (i = 0; i < steps; ++i) {
        f[3] = load * o->k * cos(nu * (i + 1) * h);
        assert_ok(sfem_body_set_force(body, f, &err), err);
        step(body, h);
    }
    error = fabs(node1(body) - u);
    *velocity_error = fabs(node1_velocity(body) - v) / w;
    sfem_body_free(body);
    return error;
}

static void observed_order_is_two_but_for_backward_euler(void **state)
{
    static const sfem_integrator method[] = {SFEM_HHT, SFEM_GENERALIZED_ALPHA, SFEM_BATHE,
                                             SFEM_BACKWARD_EULER};
    static const double damping[2] = {0, 0.1};
    oscillator o = make_oscillator(1e6, SFEM_MASS_CONSISTENT);
    size_t i, j;
    (void)state;
    for (i = 0; i < TEST_COUNT(method); ++i)
        for (j = 0; j < 2; ++j) {
            const double order = method[i] == SFEM_BACKWARD_EULER ? 1 : 2;
            sfem_body_def def = sfem_default_body_def();
            double coarse, fine, coarse_v, fine_v;
            def.integrator = method[i];
            coarse = oscillator_error(&o, def, damping[j], 800, &coarse_v);
            fine = oscillator_error(&o, def, damping[j], 1600, &fine_v);
            assert_near(log(coarse / fine) / log(2), order, 0, 0.1);
            assert_near(log(coarse_v / fine_v) / log(2), order, 0, 0.1);
        }
    sfem_model_free(o.model);
}

/* --------------------------------------------------------------------------------------------
 * damping forces
 * -------------------------------------------------------------------------------------------- */

typedef struct drag {
    double c;          /* D_i = c |v_i| v_i on each axis; linear: D = c v */
    int linear, nodes;
    int calls;
} drag;

static void drag_force(void *user, const sfem_real *v, sfem_real *force)
{
    drag *d = (drag *)user;
    int i;
    ++d->calls;
    for (i = 0; i < 3 * d->nodes; ++i) force[i] += d->c * (d->linear ? 1 : fabs(v[i])) * v[i];
}

static void drag_tangent(void *user, const sfem_real *v, sfem_matrix *a)
{
    const drag *d = (const drag *)user;
    sfem_int i;
    int c;
    for (i = 0; i < a->n; ++i)
        for (c = 0; c < 3; ++c)
            a->val[9 * (a->row[i + 1] - 1) + 4 * c] += d->c * (d->linear ? 1 : 2 * fabs(v[3 * i + c]));
}

/* m v' = -c |v| v has v = v0/(1 + s), u = m/c log(1 + s), s = c v0 t/m. */
static void quadratic_drag_follows_its_closed_form(void **state)
{
    static const sfem_integrator method[] = {SFEM_NEWMARK, SFEM_HHT, SFEM_GENERALIZED_ALPHA, SFEM_BATHE,
                                             SFEM_BACKWARD_EULER};
    oscillator o = make_oscillator(1e-12, SFEM_MASS_LUMPED);
    size_t i;
    int with_tangent, fine, k;
    (void)state;
    for (i = 0; i < TEST_COUNT(method); ++i)
        for (with_tangent = 0; with_tangent < 2; ++with_tangent) {
            const double v0 = 3, T = 2, s = 3 * v0 * T;
            drag d = {0, 0, 4, 0};
            double error[2][2];
            d.c = 3 * o.m;
            for (fine = 0; fine < 2; ++fine) {
                const int steps = fine ? 800 : 400;
                sfem_body_def def = sfem_default_body_def();
                sfem_body *body;
                def.integrator = method[i];
                def.newton.tolerance = 1e-11;
                def.damping_force.force = drag_force;
                def.damping_force.tangent = with_tangent ? drag_tangent : NULL;
                def.damping_force.user = &d;
                body = oscillator_body(&o, def);
                set_node1(body, 0, v0);
                for (k = 0; k < steps; ++k) {
                    sfem_newton_info info;
                    step(body, T / steps);
                    info = sfem_body_newton(body);
                    assert_true(info.converged);
                    if (!(info.iterations <= (method[i] == SFEM_BATHE ? 2 : 1) * (with_tangent ? 4 : 16))) print_message("%d %d %d %g\n",(int)i,k,info.iterations,info.residual);
                    assert_true(info.iterations <= (method[i] == SFEM_BATHE ? 2 : 1) * (with_tangent ? 4 : 16));
                    if (!with_tangent) assert_int_equal(info.factorisations, 0);
                }
                error[fine][0] = fabs(node1(body) - log(1 + s) / 3);
                error[fine][1] = fabs(node1_velocity(body) - v0 / (1 + s));
                sfem_body_free(body);
            }
            for (k = 0; k < 2; ++k) {
                const double order = log(error[0][k] / error[1][k]) / log(2);
                assert_near(order, method[i] == SFEM_BACKWARD_EULER ? 1 : 2, 0, 0.15);
            }
            assert_true(error[1][0] < (method[i] == SFEM_BACKWARD_EULER ? 2e-2 : 1e-4));
        }
    sfem_model_free(o.model);
}

/* --------------------------------------------------------------------------------------------
 * bodies
 * -------------------------------------------------------------------------------------------- */

typedef struct block {
    sfem_model *model;
    sfem_int pins[64], pin_count, nodes;
} block;

static block make_block(sfem_int nx, sfem_int ny, sfem_int nz, sfem_mass mass, double alpha, double beta)
{
    const sfem_int cells[3] = {nx, ny, nz};
    const sfem_real size[3] = {0.1 * nx, 0.1 * ny, 0.1 * nz};
    sfem_model_def def = sfem_default_model_def();
    test_random random = {7};
    sfem_mesh mesh;
    sfem_error err;
    sfem_int i;
    block b;
    memset(&b, 0, sizeof b);
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
    for (i = 0; i < 3 * mesh.nodes; ++i) mesh.x[i] += random_uniform(&random, -0.01, 0.01);
    for (i = 0; i < (ny + 1) * (nz + 1); ++i) b.pins[b.pin_count++] = i;
    def.mesh = &mesh;
    def.mass = mass;
    def.material.young = 1e5;
    def.material.alpha = alpha;
    def.material.beta = beta;
    assert_ok(sfem_model_create(&def, &b.model, &err), err);
    b.nodes = mesh.nodes;
    sfem_mesh_free(&mesh);
    return b;
}

static double difference(const sfem_body *a, const sfem_body *b, int nodes, double *size)
{
    const sfem_real *u = sfem_body_displacement(a), *v = sfem_body_displacement(b);
    double worst = 0;
    int i;
    for (i = 0; i < 3 * nodes; ++i) {
        worst = fmax(worst, fabs(u[i] - v[i]));
        *size = fmax(*size, fabs(v[i]));
    }
    return worst;
}

/* Newton's path (taken because of a damping force that is D = c v) beside the linear one with the same D in its
 * matrix, loads, pins, handles and step changing: one equation, two programs. */
static void newton_on_a_linear_body_is_linear_newmark(void **state)
{
    static const double bary[4] = {0.4, 0.3, 0.2, 0.1};
    static const sfem_mass mass[2] = {SFEM_MASS_LUMPED, SFEM_MASS_CONSISTENT};
    int m, tangent, k, j, c;
    (void)state;
    for (m = 0; m < 2; ++m)
        for (tangent = 0; tangent < 2; ++tangent) {
            block b = make_block(4, 1, 2, mass[m], 0.4, 0.003);
            unsigned char axes[64];
            drag d = {0, 1, 0, 0};
            sfem_body_def def = sfem_default_body_def();
            sfem_body *body[2];
            sfem_int handle[2][2];
            sfem_real *f = (sfem_real *)calloc((size_t)(9 * b.nodes), sizeof *f);
            sfem_real *r0 = f + 3 * b.nodes, *r1 = r0 + 3 * b.nodes;
            sfem_error err;
            double size = 0;
            for (k = 0; k < b.pin_count; ++k) axes[k] = (unsigned char)(k % 3 == 1 ? 5 : 7);
            d.nodes = b.nodes;
            def.integrator = SFEM_NEWMARK;
            def.gravity[1] = -3;
            def.alpha = 0.2;
            def.beta_k = 0.001;
            def.pins = b.pins;
            def.pin_axes = axes;
            def.pin_count = b.pin_count;
            body[0] = make_body(b.model, &def);
            def.newton.tolerance = 1e-12;
            def.damping_force.force = drag_force; /* of strength 0 */
            def.damping_force.tangent = tangent ? drag_tangent : NULL;
            def.damping_force.user = &d;
            body[1] = make_body(b.model, &def);
            for (k = 0; k < 200; ++k) {
                const double h = k < 80 ? 0.01 : k < 150 ? 0.02 : 0.013, t = sfem_body_time(body[0]) + h;
                for (j = 0; j < 3 * b.nodes; ++j) f[j] = k < 30 ? 0 : 0.3 * sin(7 * t + 0.1 * j);
                for (j = 0; j < 2; ++j) {
                    sfem_real x[3];
                    assert_ok(sfem_body_set_force(body[j], f, &err), err);
                    for (c = 0; c < 3; ++c)
                        x[c] = sfem_model_mesh(b.model)->x[c] + 0.02 * (1 - cos(5 * t)) * (c + 1);
                    assert_ok(sfem_body_move_pin(body[j], 0, x, &err), err);
                    if (k == 40) {
                        assert_ok(sfem_body_grab_node(body[j], b.nodes - 1, &handle[j][0], &err), err);
                        assert_ok(sfem_body_grab_point(body[j], 20, bary, &handle[j][1], &err), err);
                    }
                    if (k >= 50 && k < 160) {
                        sfem_body_handle_position(body[j], handle[j][0], x);
                        x[1] += 0.001 * sin(0.2 * k);
                        assert_ok(sfem_body_move_handle(body[j], handle[j][0], x, &err), err);
                    }
                    if (k == 160) sfem_body_release_handle(body[j], handle[j][0]);
                    step(body[j], h);
                }
                assert_true(difference(body[1], body[0], b.nodes, &size) <= 1e-10 * size);
                if (k > 40) {
                    sfem_real g0[3], g1[3];
                    sfem_body_handle_force(body[0], handle[0][1], g0);
                    sfem_body_handle_force(body[1], handle[1][1], g1);
                    assert_all_near(g0, g1, 3, 1e-7, 1e-9);
                }
                sfem_body_reactions(body[0], r0);
                sfem_body_reactions(body[1], r1);
                assert_all_near(r0, r1, 3 * b.nodes, 1e-8, 0);
                assert_true(sfem_body_newton(body[1]).converged);
                assert_true(sfem_body_newton(body[1]).iterations <= 2);
            }
            assert_true(size > 0.01);
            for (j = 0; j < 2; ++j) sfem_body_free(body[j]);
            sfem_model_free(b.model);
            free(f);
        }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(radius_period_and_damping_are_those_of_the_table),
        cmocka_unit_test(parameters_reach_their_limits),
        cmocka_unit_test(observed_order_is_two_but_for_backward_euler),
        cmocka_unit_test(quadratic_drag_follows_its_closed_form),
        cmocka_unit_test(newton_on_a_linear_body_is_linear_newmark),
    };
    return run_all_tests(tests);
}
