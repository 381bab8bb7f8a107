/* Implicit integrators and Newton's iteration: linear and nonlinear bodies, damping forces, statics. */
#include "oscillator.h"
#include "linear.h"
#include "blocks.h"

/* --------------------------------------------------------------------------------------------
 * one degree of freedom
 * -------------------------------------------------------------------------------------------- */

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
    if (order ==
        3) { /* lambda^3 = c2 lambda^2 + c1 lambda + c0: split off the real root, by bisection */
        double low = -2, high = 2;
        for (i = 0; i < 200; ++i) {
            real = (low + high) / 2;
            if (real * real * real - c[2] * real * real - c[1] * real - c[0] < 0)
                low = real;
            else
                high = real;
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
        {SFEM_HHT,
         3,
         {.9994, .9938, .962, .838},
         {.0254, .0945, .312, 2.71},
         {.0011, .0068, .0252, .0656},
         {{6e-5, 6e-5, 6e-4, 6e-4}, {6e-5, 6e-5, 6e-4, 6e-3}, {6e-5, 6e-5, 6e-5, 6e-5}}},
        {SFEM_GENERALIZED_ALPHA,
         3,
         {1, .9995, .9953, .930},
         {.0216, .0826, .287, 2.74},
         {.0001, .0006, .0030, .0272},
         {{6e-5, 6e-5, 6e-5, 6e-4}, {6e-5, 6e-5, 6e-4, 6e-3}, {6e-5, 6e-5, 6e-5, 6e-5}}},
        {SFEM_BATHE,
         2,
         {.9998, .9971, .969, .457},
         {.0103, .0400, .145, 3.04},
         {.0004, .0031, .0182, .316},
         {{6e-5, 6e-5, 6e-4, 6e-4}, {6e-5, 6e-5, 6e-4, 6e-3}, {6e-5, 6e-5, 6e-5, 6e-4}}},
        {SFEM_BACKWARD_EULER,
         2,
         {.894, .707, .447, .0995},
         {.078, .273, .806, 5.80},
         {.241, .441, .727, 1.57},
         {{6e-4, 6e-4, 6e-4, 6e-5}, {6e-4, 6e-4, 6e-4, 6e-3}, {6e-4, 6e-4, 6e-4, 6e-3}}},
    };
    oscillator o = make_oscillator(1e6, SFEM_MASS_LUMPED);
    const double w = sqrt(o.k / o.m);
    size_t i, j;
    (void)state;
    for (i = 0; i < TEST_COUNT(row); ++i)
        for (j = 0; j < 4; ++j) {
            sfem_body_def def = exact_body_def();
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
    sfem_body_def def = exact_body_def();
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
    const double v =
        e * ((B * wd - xi * w * A) * cos(wd * T) - (A * wd + xi * w * B) * sin(wd * T)) -
        C * nu * sin(nu * T) + S * nu * cos(nu * T);
    const double h = T / steps;
    sfem_real f[12] = {0};
    sfem_body *body;
    sfem_error err;
    double error;
    int i;
    def.mass_damping = xi * w;
    def.stiffness_damping = xi / w;
    body = oscillator_body(o, def);
    set_node1(body, u0, v0);
    f[3] = load * o->k;
    assert_ok(sfem_body_set_lasting_force(body, f, &err), err);
    sfem_body_start(body);
    for (i = 0; i < steps; ++i) {
        f[3] = load * o->k * cos(nu * (i + 1) * h);
        assert_ok(sfem_body_set_lasting_force(body, f, &err), err);
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
            sfem_body_def def = exact_body_def();
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
    double c; /* D_i = c |v_i| v_i on each axis; linear: D = c v */
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
            a->val[9 * (a->row[i + 1] - 1) + 4 * c] +=
                d->c * (d->linear ? 1 : 2 * fabs(v[3 * i + c]));
}

/* m v' = -c |v| v has v = v0/(1 + s), u = m/c log(1 + s), s = c v0 t/m. */
static void quadratic_drag_follows_its_closed_form(void **state)
{
    static const sfem_integrator method[] = {SFEM_NEWMARK, SFEM_HHT, SFEM_GENERALIZED_ALPHA,
                                             SFEM_BATHE, SFEM_BACKWARD_EULER};
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
                sfem_body_def def = exact_body_def();
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
                    assert_true(info.iterations <=
                                (method[i] == SFEM_BATHE ? 2 : 1) * (with_tangent ? 4 : 16));
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

static block make_block(sfem_int nx, sfem_int ny, sfem_int nz, sfem_mass mass, double alpha,
                        double beta)
{
    const sfem_int cells[3] = {nx, ny, nz};
    const sfem_real size[3] = {0.1 * nx, 0.1 * ny, 0.1 * nz};
    sfem_model_def def = linear_model_def();
    uint64_t random = 7;
    sfem_mesh mesh;
    sfem_error err;
    block b;
    memset(&b, 0, sizeof b);
    assert_ok(block_mesh(cells, size, 0.01, &random, &mesh, &err), err);
    b.pin_count = block_clamp(cells, b.pins);
    def.mesh = &mesh;
    def.mass = mass;
    def.material.young = 1e5;
    def.material.mass_damping = alpha;
    def.material.stiffness_damping = beta;
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
            sfem_body_def def = exact_body_def();
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
            def.mass_damping = 0.2;
            def.stiffness_damping = 0.001;
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
                const double h = k < 80    ? 0.01
                                 : k < 150 ? 0.02
                                           : 0.013,
                             t = sfem_body_time(body[0]) + h;
                for (j = 0; j < 3 * b.nodes; ++j) f[j] = k < 30 ? 0 : 0.3 * sin(7 * t + 0.1 * j);
                for (j = 0; j < 2; ++j) {
                    sfem_real x[3];
                    assert_ok(sfem_body_set_lasting_force(body[j], f, &err), err);
                    for (c = 0; c < 3; ++c)
                        x[c] = sfem_model_mesh(b.model)->x[c] + 0.02 * (1 - cos(5 * t)) * (c + 1);
                    assert_ok(sfem_body_move_pin(body[j], 0, x, &err), err);
                    if (k == 40) {
                        assert_ok(sfem_body_grab_node(body[j], b.nodes - 1, &handle[j][0], &err),
                                  err);
                        assert_ok(sfem_body_grab_point(body[j], 20, bary, &handle[j][1], &err),
                                  err);
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

/* --------------------------------------------------------------------------------------------
 * nonlinear bodies
 * -------------------------------------------------------------------------------------------- */

static const sfem_law laws[3] = {SFEM_COROTATIONAL, SFEM_STVK, SFEM_NEOHOOKEAN};
static const sfem_integrator methods[5] = {SFEM_NEWMARK, SFEM_BACKWARD_EULER, SFEM_HHT,
                                           SFEM_GENERALIZED_ALPHA, SFEM_BATHE};

typedef struct beam {
    sfem_model *model;
    sfem_int nodes;
} beam;

enum { END = 6 }; /* nodes 0 .. 5 are the end x = 0 */

/* 6 x 1 x 2 cells, jittered, turned by r. */
static beam make_beam(sfem_law law, double young, double alpha, double beta, const double r[9],
                      sfem_allocator allocator)
{
    const sfem_int cells[3] = {6, 1, 2};
    const sfem_real size[3] = {0.6, 0.1, 0.15};
    sfem_model_def def = linear_model_def();
    uint64_t random = 11;
    sfem_mesh mesh;
    sfem_error err;
    sfem_int i;
    int c;
    beam b;
    assert_ok(block_mesh(cells, size, 0.005, &random, &mesh, &err), err);
    for (i = 0; r && i < mesh.nodes; ++i) {
        const double x[3] = {mesh.x[3 * i], mesh.x[3 * i + 1], mesh.x[3 * i + 2]};
        for (c = 0; c < 3; ++c)
            mesh.x[3 * i + c] = r[3 * c] * x[0] + r[3 * c + 1] * x[1] + r[3 * c + 2] * x[2];
    }
    def.mesh = &mesh;
    def.material.young = young;
    def.material.law = law;
    def.material.mass_damping = alpha;
    def.material.stiffness_damping = beta;
    def.allocator = allocator;
    assert_ok(sfem_model_create(&def, &b.model, &err), err);
    b.nodes = mesh.nodes;
    sfem_mesh_free(&mesh);
    return b;
}

static beam plain_beam(sfem_law law, double young)
{
    const sfem_allocator standard = {NULL, NULL, NULL};
    return make_beam(law, young, 0, 0, NULL, standard);
}

static sfem_body_def clamped(sfem_integrator integrator)
{
    static const sfem_int end[END] = {0, 1, 2, 3, 4, 5};
    sfem_body_def def = exact_body_def();
    def.integrator = integrator;
    def.pins = end;
    def.pin_count = END;
    return def;
}

/* |F + M g - f(u)| over |F + M g| on the nodes from `first` on, from the model's own forces. */
static double out_of_balance(const beam *b, const sfem_body *body, const double g[3],
                             const double *load, sfem_int first)
{
    const size_t n = 3 * (size_t)b->nodes;
    sfem_real *f = (sfem_real *)calloc(n + sfem_model_work_size(b->model), sizeof *f);
    double r2 = 0, f2 = 0;
    size_t i;
    sfem_model_forces(b->model, sfem_body_displacement(body), SFEM_DOUBLE, f, NULL, NULL, f + n,
                      NULL);
    for (i = 3 * (size_t)first; i < n; ++i) {
        const double w = sfem_model_node_mass(b->model)[i / 3] * g[i % 3] + (load ? load[i] : 0);
        r2 += (f[i] - w) * (f[i] - w);
        f2 += w * w;
    }
    free(f);
    return sqrt(r2 / f2);
}

static void newton_converges_quadratically(void **state)
{
    size_t i, k;
    (void)state;
    for (i = 0; i < 3; ++i)
        for (k = 0; k < 5; ++k) {
            beam b = plain_beam(laws[i], 1e5);
            sfem_body_def def = clamped(methods[k]);
            double residual[8] = {0};
            int j, quadratic = 0;
            if (methods[k] == SFEM_BATHE) def.integrator = SFEM_NEWMARK, def.beta = 0.3;
            def.gravity[2] = -9.81;
            def.newton.tolerance = 0;
            def.newton.accept_best = 1;
            for (j = 2; j < 8; ++j) {
                sfem_body *body;
                int s;
                def.newton.iterations = 20;
                body = make_body(b.model, &def);
                for (s = 0; s < 6; ++s) step(body, 1. / 60);
                sfem_body_free(body);
                def.newton.iterations = j;
                body = make_body(b.model, &def);
                step(body, 0.15); /* a step so large that it needs a few iterations */
                residual[j] = sfem_body_newton(body).residual;
                sfem_body_free(body);
            }
            for (j = 2; j < 7; ++j) { /* once it is near, each residual is the square of the last */
                if (residual[j] > 1e-2 || residual[j + 1] < 1e-14) continue;
                assert_true(residual[j + 1] < fmax(30 * residual[j] * residual[j], 2e-13));
                ++quadratic;
            }
            assert_true(quadratic > 0);
            assert_true(residual[7] < 1e-11);
            sfem_model_free(b.model);
        }
}

/* The equilibrium of a cantilever that sags by most of its length: no force left, whichever way it came. */
static void a_sagging_cantilever_is_in_equilibrium(void **state)
{
    const double g[3] = {0, -4, -9.81};
    size_t i;
    (void)state;
    for (i = 0; i < 3; ++i) {
        beam b = plain_beam(laws[i], 2e4);
        sfem_body_def def = clamped(SFEM_NEWMARK);
        sfem_body *body[4];
        sfem_newton_info info;
        sfem_error err;
        double size = 0;
        int k, j;
        def.newton.tolerance = 1e-13;
        memcpy(def.gravity, g, sizeof g);
        for (k = 0; k < 4; ++k) {
            def.newton.load_steps = k == 1 ? 7 : 1;
            if (k == 3) def.integrator = SFEM_PQR; /* statics do not care */
            body[k] = make_body(b.model, &def);
            if (k == 2) { /* by way of somewhere else */
                for (j = 1; j < 6; ++j) {
                    const double side[3] = {0, 3. * j, -2. * j};
                    assert_ok(sfem_body_set_gravity(body[k], side, &err), err);
                    assert_ok(sfem_body_solve_static(body[k], &err), err);
                    assert_true(out_of_balance(&b, body[k], side, NULL, END) < 1e-11);
                }
                assert_ok(sfem_body_set_gravity(body[k], g, &err), err);
            }
            assert_ok(sfem_body_solve_static(body[k], &err), err);
            info = sfem_body_newton(body[k]);
            assert_true(info.converged);
            assert_true(info.load_steps >= def.newton.load_steps);
            assert_true(out_of_balance(&b, body[k], g, NULL, END) < 1e-11);
            assert_true(difference(body[k], body[0], b.nodes, &size) <= 1e-9 * size);
        }
        assert_true(size > 0.3);    /* of a length of .6 */
        if (laws[i] != SFEM_STVK) { /* and a step from there stays there */
            step(body[0], 0.01);
            assert_true(difference(body[0], body[1], b.nodes, &size) <= 1e-9 * size);
        }
        for (k = 0; k < 4; ++k) sfem_body_free(body[k]);
        sfem_model_free(b.model);
    }
}

static const double turned[9] = {0.36, 0.48, -0.8, -0.8, 0.6, 0, 0.48, 0.64, 0.6}; /* a rotation */

static void turn(const double *x, double *y)
{
    int c;
    for (c = 0; c < 3; ++c)
        y[c] = turned[3 * c] * x[0] + turned[3 * c + 1] * x[1] + turned[3 * c + 2] * x[2];
}

/* Everything turned: mesh, gravity, velocity; the solution turns, too. */
static void a_turned_problem_has_the_turned_solution(void **state)
{
    const sfem_allocator standard = {NULL, NULL, NULL};
    const double g[3] = {1, -4, -9.81};
    size_t i, k;
    (void)state;
    for (i = 0; i < 3; ++i)
        for (k = 0; k < 6; ++k) {
            beam b[2];
            sfem_body *body[2];
            sfem_body_def def = clamped(methods[k % 5]);
            sfem_real *v = NULL;
            sfem_error err;
            int j, s, c;
            def.newton.tolerance = 1e-12;
            def.newton.tangent = k == 1 ? SFEM_TANGENT_PSD : SFEM_TANGENT_EXACT;
            for (j = 0; j < 2; ++j) {
                b[j] = make_beam(laws[i], 4e4, 0.1, 0.002, j ? turned : NULL, standard);
                if (j)
                    turn(g, def.gravity);
                else
                    memcpy(def.gravity, g, sizeof g);
                body[j] = make_body(b[j].model, &def);
                v = (sfem_real *)calloc((size_t)(3 * b[j].nodes), sizeof *v);
                for (s = 0; s < b[j].nodes; ++s) {
                    const double w[3] = {0, sfem_model_mesh(b[0].model)->x[3 * s], 0.3};
                    if (j)
                        turn(w, v + 3 * s);
                    else
                        memcpy(v + 3 * s, w, sizeof w);
                }
                assert_ok(sfem_body_set_state(body[j], NULL, v, &err), err);
                for (s = 0; k < 5 && s < 12; ++s) step(body[j], 0.02);
                if (k == 5) assert_ok(sfem_body_solve_static(body[j], &err), err);
                free(v);
            }
            for (s = 0; s < b[0].nodes; ++s) {
                double u[3];
                turn(sfem_body_displacement(body[0]) + 3 * s, u);
                for (c = 0; c < 3; ++c)
                    assert_near(u[c], sfem_body_displacement(body[1])[3 * s + c], 0, 1e-9);
            }
            for (j = 0; j < 2; ++j) {
                sfem_body_free(body[j]);
                sfem_model_free(b[j].model);
            }
        }
}

/* Linear and angular momentum of a body at its present place. */
static void momenta(const beam *b, const sfem_body *body, double p[3], double l[3])
{
    const size_t n = 3 * (size_t)b->nodes;
    sfem_real *x = (sfem_real *)malloc(2 * n * sizeof *x), *v = x + n;
    sfem_int i;
    int c;
    sfem_body_positions(body, x);
    sfem_body_velocities(body, v);
    for (c = 0; c < 3; ++c) p[c] = l[c] = 0;
    for (i = 0; i < b->nodes; ++i)
        for (c = 0; c < 3; ++c) {
            const double m = sfem_model_node_mass(b->model)[i];
            const int d = (c + 1) % 3, e = (c + 2) % 3;
            p[c] += m * v[3 * i + c];
            l[c] += m * (x[3 * i + d] * v[3 * i + e] - x[3 * i + e] * v[3 * i + d]);
        }
    free(x);
}

/* A free body that tumbles and vibrates: linear momentum to rounding, angular to the order of the method. */
static double angular_drift(sfem_law law, sfem_integrator method, double h, double time)
{
    beam b = plain_beam(law, 1e5);
    sfem_body_def def = exact_body_def();
    sfem_real *v = (sfem_real *)calloc((size_t)(3 * b.nodes), sizeof *v);
    double p0[3], l0[3], p[3], l[3], drift = 0, size = 0;
    sfem_body *body;
    sfem_error err;
    int i, c;
    def.integrator = method;
    def.newton.tolerance = 1e-12;
    body = make_body(b.model, &def);
    for (i = 0; i < b.nodes; ++i) {
        const sfem_real *x = sfem_model_mesh(b.model)->x + 3 * i;
        v[3 * i] = 2 - 3 * x[1];
        v[3 * i + 1] = 3 * x[0] - 2 * x[2];
        v[3 * i + 2] = 2 * x[1] + 4 * x[0] * x[0];
    }
    assert_ok(sfem_body_set_state(body, NULL, v, &err), err);
    momenta(&b, body, p0, l0);
    for (i = 0; i < (int)(time / h + 0.5); ++i) step(body, h);
    momenta(&b, body, p, l);
    for (c = 0; c < 3; ++c) {
        assert_near(p[c], p0[c], 0, 1e-9 * fabs(p0[0]));
        drift += (l[c] - l0[c]) * (l[c] - l0[c]);
        size += l0[c] * l0[c];
    }
    sfem_body_free(body);
    sfem_model_free(b.model);
    free(v);
    return sqrt(drift / size);
}

static void a_free_body_keeps_its_momentum(void **state)
{
    size_t i, k;
    (void)state;
    for (i = 0; i < 3; ++i)
        for (k = 0; k < 5; ++k) {
            const double order = methods[k] == SFEM_BACKWARD_EULER ? 1 : 2;
            const double coarse = angular_drift(laws[i], methods[k], 1. / 400, 0.5);
            const double fine = angular_drift(laws[i], methods[k], 1. / 800, 0.5);
            assert_true(coarse < (order == 1 ? 0.2 : 0.02));
            assert_true(fine < coarse * pow(2, 0.5 - order));
        }
}

/* One iteration: u' = u + (M 4/h^2 + K(u))^-1 (F - f(u) + M (4/h v + a)), solved here. */
static void one_iteration_is_the_semi_implicit_step(void **state)
{
    size_t i;
    (void)state;
    for (i = 0; i < 3; ++i) {
        beam b = plain_beam(laws[i], 1e5);
        const size_t n = 3 * (size_t)b.nodes;
        const double h = 0.02;
        sfem_body_def def = clamped(SFEM_NEWMARK);
        sfem_real *f = (sfem_real *)calloc(5 * n + sfem_model_work_size(b.model), sizeof *f),
                  *v = f + n;
        sfem_real *a = v + n, *u = a + n, *expected = u + n;
        const sfem_real *mass = sfem_model_node_mass(b.model);
        sfem_matrix k;
        sfem_body *body;
        sfem_cg_def cg = sfem_default_cg_def();
        sfem_error err;
        int s;
        size_t j;
        def.gravity[2] = -9.81;
        def.newton.iterations = 1;
        body = make_body(b.model, &def);
        step(body, h);
        memcpy(u, sfem_body_displacement(body), n * sizeof *u);
        sfem_body_velocities(body, v);
        for (s = 0; s < 5; ++s) { /* a by Newmark's own formula, from u and v before and after */
            sfem_real *work;
            for (j = 0; j < n; ++j) a[j] = sfem_body_acceleration(body)[j];
            assert_ok(sfem_model_combine(b.model, 1, 0, 0, NULL, &k, &err), err);
            sfem_model_tangent(b.model, u, SFEM_TANGENT_EXACT, &k, NULL);
            sfem_model_forces(b.model, u, SFEM_DOUBLE, f, NULL, NULL, expected + n, NULL);
            for (j = 0; j < n; ++j) {
                const sfem_int node = (sfem_int)(j / 3);
                k.val[9 * (k.row[node + 1] - 1) + 4 * (sfem_int)(j % 3)] +=
                    4 / (h * h) * mass[node];
                f[j] = mass[node] * (4 / h * v[j] + a[j] + (j % 3 == 2 ? -9.81 : 0)) - f[j];
                if (node >= END) continue;
                k.val[9 * (k.row[node + 1] - 1) + 4 * (sfem_int)(j % 3)] += 1e20; /* held */
                f[j] = 0;
            }
            cg.tolerance = 1e-14;
            cg.max_iterations = 5000;
            work = (sfem_real *)malloc(sfem_cg_work_size(&cg, &k) * sizeof *work);
            memset(expected, 0, n * sizeof *expected);
            sfem_cg_solve(&cg, &k, f, expected, work, NULL, &err);
            for (j = 0; j < n; ++j) expected[j] += u[j];
            step(body, h);
            assert_all_near(expected, sfem_body_displacement(body), n, 1e-9, 0);
            assert_int_equal(sfem_body_newton(body).iterations, 1);
            assert_int_equal(sfem_body_newton(body).factorisations, 1);
            memcpy(u, sfem_body_displacement(body), n * sizeof *u);
            sfem_body_velocities(body, v);
            sfem_matrix_free(&k);
            free(work);
        }
        sfem_body_free(body);
        sfem_model_free(b.model);
        free(f);
    }
}

/* What is asked for in vain fails with a sentence, and is as if it had not been asked. */
static void a_step_that_does_not_converge_leaves_no_trace(void **state)
{
    size_t i, k;
    (void)state;
    for (i = 0; i < 3; ++i)
        for (k = 0; k < 6; ++k) {
            beam b = plain_beam(laws[i], 1e5);
            sfem_body_def def = clamped(methods[k % 5]);
            sfem_body *body[2];
            sfem_newton_info info;
            sfem_error err;
            void *before, *after;
            size_t bytes;
            sfem_int handle;
            int j, s;
            def.gravity[2] = -9.81;
            def.newton.iterations = 4;
            for (j = 0; j < 2; ++j) {
                body[j] = make_body(b.model, &def);
                if (k < 5) /* a failure before the first step, too */
                    for (s = 0; s < 10; ++s) step(body[j], 0.005);
                assert_ok(sfem_body_grab_node(body[j], b.nodes - 1, &handle, &err), err);
            }
            bytes = sfem_body_state_size(body[0]);
            before = malloc(2 * bytes);
            after = (char *)before + bytes;
            sfem_body_save_state(body[0], before);
            assert_status(sfem_body_step(body[0], 3, &err), SFEM_NOT_CONVERGED);
            assert_names(err, "did not converge: residual");
            assert_names(err, "after 4 iterations");
            info = sfem_body_newton(body[0]);
            assert_true(!info.converged && info.residual > 1e-8 && info.iterations >= 4);
            sfem_body_save_state(body[0], after);
            assert_memory_equal(before, after, bytes);
            for (s = 0; s < 5; ++s)
                for (j = 0; j < 2; ++j) step(body[j], 0.005);
            for (j = 0; j < 2; ++j) sfem_body_save_state(body[j], j ? after : before);
            assert_memory_equal(before, after, bytes);
            free(before);
            for (j = 0; j < 2; ++j) sfem_body_free(body[j]);
            def.newton.accept_best = 1;
            body[0] = make_body(b.model, &def);
            step(body[0], 3);
            assert_false(sfem_body_newton(body[0]).converged);
            sfem_body_free(body[0]);
            sfem_model_free(b.model);
        }
}

/* What is prepared for Newton serves steps of any length, but not of these. */
static void steps_without_a_length_are_refused(void **state)
{
    const double h[5] = {0, -0.005, (double)NAN, (double)INFINITY, -(double)INFINITY};
    size_t i, k;
    (void)state;
    for (i = 0; i < 5; ++i) {
        beam b = plain_beam(laws[1], 1e5);
        sfem_body_def def = clamped(methods[i]);
        sfem_body *body = make_body(b.model, &def);
        const size_t bytes = sfem_body_state_size(body);
        char *before = (char *)malloc(2 * bytes);
        sfem_error err;
        step(body, 0.005);
        sfem_body_save_state(body, before);
        for (k = 0; k < TEST_COUNT(h); ++k) {
            assert_status(sfem_body_step(body, h[k], &err), SFEM_BAD_ARGUMENT);
            assert_names(err, "the time step is");
            assert_status(sfem_body_predict(body, h[k], &err), SFEM_BAD_ARGUMENT);
            sfem_body_save_state(body, before + bytes);
            assert_memory_equal(before, before + bytes, bytes);
        }
        free(before);
        sfem_body_free(body);
        sfem_model_free(b.model);
    }
}

static void a_static_solution_that_fails_leaves_no_trace(void **state)
{
    beam b = plain_beam(SFEM_COROTATIONAL, 1e3);
    sfem_body_def def = clamped(SFEM_NEWMARK);
    sfem_real force[3] = {0, 0, 0};
    uint64_t hash;
    sfem_body *body;
    sfem_error err;
    (void)state;
    def.newton.iterations = 3;
    def.newton.tolerance = 1e-14;
    body = make_body(b.model, &def);
    force[1] = 1e9;
    assert_ok(sfem_body_add_lasting_force(body, b.nodes - 1, force, &err), err);
    step(body, 1e-6);
    hash = hash_reals(sfem_body_displacement(body), (size_t)(3 * b.nodes));
    assert_status(sfem_body_solve_static(body, &err), SFEM_NOT_CONVERGED);
    assert_names(err, "of the load");
    assert_true(hash == hash_reals(sfem_body_displacement(body), (size_t)(3 * b.nodes)));
    sfem_body_free(body);
    def.pin_count = 0; /* held by nothing */
    def.newton = exact_body_def().newton;
    body = make_body(b.model, &def);
    assert_status(sfem_body_solve_static(body, &err), SFEM_NOT_SPD);
    assert_names(err, "held by nothing");
    sfem_body_free(body);
    sfem_model_free(b.model);
}

/* Rayleigh damping by the current K brakes a rotation w x x by what holds it together and no more:
 * K(u) (w x x) = w x f = M w^2 v, so w' = -beta w^3 and E = E0/(1 + 2 beta w0^2 t). K at rest would stop it. */
static void damping_nearly_spares_rigid_rotation(void **state)
{
    const sfem_allocator standard = {NULL, NULL, NULL};
    beam b = make_beam(SFEM_COROTATIONAL, 1e6, 0, 0.02, NULL, standard);
    sfem_body_def def = exact_body_def();
    sfem_real *v = (sfem_real *)calloc((size_t)(3 * b.nodes), sizeof *v), c[3] = {0, 0, 0};
    sfem_body *body;
    sfem_error err;
    double before, after;
    int i, k;
    (void)state;
    def.integrator = SFEM_NEWMARK;
    body = make_body(b.model, &def);
    for (i = 0; i < b.nodes; ++i)
        for (k = 0; k < 3; ++k)
            c[k] += sfem_model_node_mass(b.model)[i] * sfem_model_mesh(b.model)->x[3 * i + k] /
                    sfem_model_total_mass(b.model);
    for (i = 0; i < b.nodes; ++i) {
        const sfem_real *x = sfem_model_mesh(b.model)->x + 3 * i;
        v[3 * i] = -2 * (x[1] - c[1]);
        v[3 * i + 1] = 2 * (x[0] - c[0]);
    }
    assert_ok(sfem_body_set_state(body, NULL, v, &err), err);
    before = sfem_body_energy(body).total;
    for (i = 0; i < 400; ++i) step(body, 0.005);
    after = sfem_body_energy(body).total;
    assert_near(after, before / (1 + 2 * 0.02 * 2 * 2 * 2), 0.005, 0);
    sfem_body_free(body);
    sfem_model_free(b.model);
    free(v);
}

/* Undamped, the trapezoidal rule keeps the energy of a swing within its own error, and all agree as h falls. */
static void methods_agree_as_the_step_falls(void **state)
{
    size_t i, k;
    (void)state;
    for (i = 0; i < 3; ++i) {
        beam b = plain_beam(laws[i], 1e5);
        sfem_real *reference = (sfem_real *)calloc((size_t)(3 * b.nodes), sizeof *reference);
        for (k = 0; k < 5; ++k) {
            double error[2] = {0, 0}, size = 0, order;
            int fine, s, j;
            for (fine = k == 0 ? -1 : 0; fine < 2; ++fine) {
                const double h = fine < 0 ? 1. / 6400 : fine ? 1. / 800 : 1. / 400;
                sfem_body_def def = clamped(fine < 0 ? SFEM_NEWMARK : methods[k]);
                sfem_body *body;
                double start;
                def.gravity[2] = -9.81;
                def.newton.tolerance = 1e-9;
                body = make_body(b.model, &def);
                start = sfem_body_energy(body).total;
                for (s = 0; s < (int)(0.4 / h + 0.5); ++s) step(body, h);
                for (j = 0; j < 3 * b.nodes; ++j) {
                    const double u = sfem_body_displacement(body)[j];
                    if (fine < 0)
                        reference[j] = u;
                    else
                        error[fine] = fmax(error[fine], fabs(u - reference[j]));
                    size = fmax(size, fabs(u));
                }
                if (methods[k] == SFEM_NEWMARK && fine == 1) {
                    const sfem_energy e = sfem_body_energy(body);
                    assert_near(e.total, start, 0, 1e-3 * e.elastic);
                }
                sfem_body_free(body);
            }
            order = log(error[0] / error[1]) / log(2);
            assert_near(order, methods[k] == SFEM_BACKWARD_EULER ? 1 : 2, 0, 0.25);
            assert_true(error[1] < (methods[k] == SFEM_BACKWARD_EULER ? 0.1 : 2e-3) * size);
        }
        free(reference);
        sfem_model_free(b.model);
    }
}

/* A handle that moves a node is a pin that moves; and a point goes where it is told. */
static void handles_and_moved_pins_agree_on_nonlinear_bodies(void **state)
{
    static const double bary[4] = {0.4, 0.3, 0.2, 0.1};
    static const sfem_int pins[END + 1] = {0, 1, 2, 3, 4, 5, 41};
    size_t i, k;
    (void)state;
    for (i = 0; i < 3; ++i)
        for (k = 0; k < 5; ++k) {
            beam b = plain_beam(laws[i], 1e5);
            sfem_body_def def = clamped(methods[k]);
            sfem_body *held, *pulled;
            sfem_int handle, point, other;
            sfem_real x[3], at[3];
            sfem_error err;
            double size = 0;
            int s;
            assert_int_equal(b.nodes, 42);
            def.newton.tolerance = 1e-12;
            def.gravity[2] = -3;
            pulled = make_body(b.model, &def);
            def.pins = pins;
            def.pin_count = END + 1;
            held = make_body(b.model, &def);
            assert_ok(sfem_body_grab_node(pulled, 41, &handle, &err), err);
            for (s = 0; s < 60; ++s) {
                const double t = (s + 1) * 0.01, p = (1 - cos(4 * t)) * (1 - cos(4 * t)) / 4;
                memcpy(x, sfem_model_mesh(b.model)->x + 3 * 41, sizeof x);
                x[0] -= 0.3 * p;
                x[1] += 0.2 * p;
                assert_ok(sfem_body_move_pin(held, 41, x, &err), err);
                assert_ok(sfem_body_move_handle(pulled, handle, x, &err), err);
                if (s == 30) {
                    assert_ok(sfem_body_grab_point(pulled, 50, bary, &point, &err), err);
                    assert_ok(sfem_body_grab_point(held, 50, bary, &other, &err), err);
                    assert_int_equal(point, handle + 1);
                }
                step(held, 0.01);
                step(pulled, 0.01);
                sfem_body_handle_position(pulled, handle, at);
                assert_all_near(x, at, 3, 1e-11, 0);
                assert_true(difference(pulled, held, b.nodes, &size) <= 1e-7 * size);
            }
            assert_true(size > 0.2);
            sfem_body_free(held);
            sfem_body_free(pulled);
            sfem_model_free(b.model);
        }
}

/* Statics with a node pulled by a handle, by a pin, and a point. */
static void statics_hold_pins_nodes_and_points(void **state)
{
    static const double bary[4] = {0.4, 0.3, 0.2, 0.1};
    static const sfem_int pins[END + 1] = {0, 1, 2, 3, 4, 5, 41};
    const double g[3] = {0, 0, -5};
    size_t i;
    (void)state;
    for (i = 0; i < 3; ++i) {
        beam b = plain_beam(laws[i], 5e4);
        sfem_body_def def = clamped(SFEM_NEWMARK);
        sfem_body *held, *pulled;
        sfem_int handle, point, other, node;
        sfem_real x[3], y[3], at[3], f[3], sum[3] = {0, 0, 0}, p0[3], *load, *r;
        sfem_error err;
        double size = 0;
        int k, c;
        load = (sfem_real *)calloc((size_t)(6 * b.nodes), sizeof *load);
        r = load + 3 * b.nodes;
        def.newton.tolerance = 1e-12;
        memcpy(def.gravity, g, sizeof g);
        pulled = make_body(b.model, &def);
        def.pins = pins;
        def.pin_count = END + 1;
        held = make_body(b.model, &def);
        memcpy(x, sfem_model_mesh(b.model)->x + 3 * 41, sizeof x);
        x[0] -= 0.2;
        x[1] += 0.15;
        assert_ok(sfem_body_grab_node(pulled, 41, &handle, &err), err);
        assert_ok(sfem_body_grab_point(pulled, 50, bary, &point, &err), err);
        assert_ok(sfem_body_grab_point(held, 50, bary, &other, &err), err);
        sfem_body_handle_position(held, other, p0);
        memcpy(y, p0, sizeof y);
        y[2] += 0.03;
        assert_ok(sfem_body_move_pin(held, 41, x, &err), err);
        assert_ok(sfem_body_move_handle(pulled, handle, x, &err), err);
        assert_ok(sfem_body_move_handle(pulled, point, y, &err), err);
        assert_ok(sfem_body_move_handle(held, other, y, &err), err);
        assert_ok(sfem_body_solve_static(held, &err), err);
        assert_ok(sfem_body_solve_static(pulled, &err), err);
        assert_true(difference(pulled, held, b.nodes, &size) <= 1e-8 * size);
        assert_true(size > 0.1);
        sfem_body_handle_position(pulled, point, at);
        assert_all_near(y, at, 3, 1e-11, 0);
        /* the hands' forces balance the body, with the node's force where the pin has its reaction */
        sfem_body_handle_force(pulled, handle, f);
        for (c = 0; c < 3; ++c) load[3 * 41 + c] = f[c];
        sfem_body_reactions(held, r);
        assert_all_near(r + 3 * 41, f, 3, 1e-6, 0);
        sfem_body_handle_force(pulled, point, f);
        for (k = 0; k < 4; ++k) {
            node = sfem_model_mesh(b.model)->tet[4 * 50 + k];
            for (c = 0; c < 3; ++c) load[3 * node + c] += bary[k] * f[c];
        }
        assert_true(out_of_balance(&b, pulled, g, load, END) < 1e-9);
        sfem_body_reactions(pulled, r); /* and with the supports, the whole */
        for (k = 0; k < 3 * b.nodes; ++k)
            sum[k % 3] += r[k] + load[k] + sfem_model_node_mass(b.model)[k / 3] * g[k % 3];
        for (c = 0; c < 3; ++c) assert_near(sum[c], 0, 0, 1e-7);
        sfem_body_free(held);
        sfem_body_free(pulled);
        sfem_model_free(b.model);
        free(load);
    }
}

/* The same place with the projected and the frozen tangent, in more iterations. */
static void every_tangent_leads_to_the_same_place(void **state)
{
    size_t i;
    (void)state;
    for (i = 0; i < 3; ++i) {
        beam b = plain_beam(laws[i], 5e4);
        sfem_body *body[3];
        double size = 0;
        int k, s;
        for (k = 0; k < 3; ++k) {
            sfem_body_def def = clamped(SFEM_NEWMARK);
            def.gravity[2] = -9.81;
            def.newton.iterations = 100;
            def.newton.tolerance = 1e-12;
            def.newton.tangent = (sfem_tangent)k;
            body[k] = make_body(b.model, &def);
            for (s = 0; s < 20; ++s) step(body[k], 0.02);
            assert_true(difference(body[k], body[0], b.nodes, &size) <= 1e-8 * size);
        }
        assert_true(size > 0.2);
        for (k = 0; k < 3; ++k) sfem_body_free(body[k]);
        sfem_model_free(b.model);
    }
}

static uint64_t run_on_threads(sfem_exec exec, sfem_law law, sfem_integrator method)
{
    beam b = plain_beam(law, 5e4);
    sfem_body_def def = clamped(method);
    sfem_body *body;
    sfem_int handle;
    sfem_error err;
    uint64_t hash;
    int s;
    def.exec = exec;
    def.gravity[2] = -9.81;
    def.stiffness_damping = 0.003;
    body = make_body(b.model, &def);
    for (s = 0; s < 8; ++s) {
        step(body, 0.02);
        if (s == 4) assert_ok(sfem_body_grab_node(body, b.nodes - 1, &handle, &err), err);
    }
    assert_ok(sfem_body_solve_static(body, &err), err);
    hash = hash_reals(sfem_body_displacement(body), (size_t)(3 * b.nodes));
    sfem_body_free(body);
    sfem_model_free(b.model);
    return hash;
}

static void bits_do_not_depend_on_threads(void **state)
{
    static const sfem_integrator some[2] = {SFEM_NEWMARK, SFEM_BATHE};
    size_t i, k;
    sfem_int threads;
    (void)state;
    for (i = 0; i < 3; ++i)
        for (k = 0; k < 2; ++k) {
            const uint64_t alone = run_on_threads(openmp_exec(1), laws[i], some[k]);
            for (threads = 2; threads < 6; ++threads) {
                assert_true(run_on_threads(thread_exec(threads), laws[i], some[k]) == alone);
                assert_true(run_on_threads(openmp_exec(threads), laws[i], some[k]) == alone);
            }
        }
}

/* A thread pool that is gone once `open` is 0. */
typedef struct pool {
    int open, calls, calls_closed;
} pool;

static void pool_for(sfem_int count, sfem_task task, void *data, void *user)
{
    pool *p = (pool *)user;
    sfem_int i;
    ++*(p->open ? &p->calls : &p->calls_closed);
    for (i = 0; i < count; ++i) task(data, i);
}

/* The factor that Newton's iteration makes anew shares the analysis of the other body's, and nothing else. */
static void a_body_never_calls_the_threads_of_another(void **state)
{
    block b = make_block(14, 6, 6, SFEM_MASS_LUMPED, 0, 0);
    sfem_body_def def = exact_body_def();
    sfem_body *first, *second;
    pool p = {1, 0, 0}, q = {1, 0, 0};
    sfem_error err;
    drag d;
    int k;
    (void)state;
    memset(&d, 0, sizeof d);
    d.c = 0.1;
    d.linear = 1;
    d.nodes = b.nodes;
    def.gravity[2] = -9.81;
    def.pins = b.pins;
    def.pin_count = b.pin_count;
    def.exec = thread_exec(2);
    def.exec.parallel_for = pool_for;
    def.exec.user = &p;
    first = make_body(b.model, &def);
    step(first, 0.01);
    def.integrator = SFEM_NEWMARK;
    def.damping_force.force = drag_force;
    def.damping_force.tangent = drag_tangent;
    def.damping_force.user = &d;
    def.exec.user = &q;
    second = make_body(b.model, &def);
    assert_ok(sfem_body_prepare(second, 0.02, &err), err);
    sfem_body_free(first);
    p.open = 0;
    for (k = 0; k < 3; ++k) step(second, 0.02);
    assert_int_equal(p.calls_closed, 0);
    assert_true(q.calls > 0);
    sfem_body_free(second);
    sfem_model_free(b.model);
}

/* --------------------------------------------------------------------------------------------
 * memory, misuse
 * -------------------------------------------------------------------------------------------- */

static void steps_allocate_nothing_once_prepared(void **state)
{
    size_t k, l;
    (void)state;
    for (l = 0; l < 2; ++l)
        for (k = 0; k < 5; ++k) {
            test_memory memory = {0};
            beam b = make_beam(l ? SFEM_COROTATIONAL : SFEM_LINEAR, 1e5, 0.1, 0.001, NULL,
                               test_allocator(&memory));
            sfem_body_def def = clamped(methods[k]);
            sfem_body *body;
            sfem_int handle;
            sfem_error err;
            size_t calls;
            int s;
            def.allocator = test_allocator(&memory);
            def.may_allocate = 0;
            def.gravity[2] = -9.81;
            body = make_body(b.model, &def);
            assert_status(sfem_body_step(body, 0.01, &err), SFEM_NOT_PREPARED);
            assert_ok(sfem_body_prepare(body, 0.01, &err), err);
            calls = memory.calls;
            for (s = 0; s < 10; ++s) {
                if (s == 5) {
                    assert_ok(sfem_body_grab_node(body, b.nodes - 1, &handle, &err), err);
                    assert_ok(sfem_body_prepare(body, 0.01, &err), err);
                }
                step(body, 0.01);
            }
            if (l) { /* one factor serves every step */
                step(body, 0.02);
                step(body, 0.003);
                assert_int_equal(sfem_body_get_info(body).factors_made, 1);
            } else {
                assert_status(sfem_body_step(body, 0.02, &err), SFEM_NOT_PREPARED);
            }
            assert_int_equal(memory.calls, calls);
            sfem_body_free(body);
            sfem_model_free(b.model);
            assert_no_leak(memory);
        }
}

typedef struct memory_case {
    sfem_law law;
    sfem_integrator method;
    int of_model; /* the model's allocator fails, too */
} memory_case;

static sfem_status attempt_steps(sfem_allocator allocator, void *user, sfem_error *err)
{
    static const double bary[4] = {0.1, 0.2, 0.3, 0.4};
    static const sfem_int pins[2] = {0, 1};
    const memory_case *c = (const memory_case *)user;
    const sfem_allocator standard = {NULL, NULL, NULL};
    test_memory *memory = (test_memory *)allocator.user;
    const size_t fail_at = memory->fail_at;
    sfem_body_def def = clamped(c->method);
    sfem_body *body = NULL;
    sfem_int handle;
    sfem_status status;
    drag d = {0, 1, 0, 0};
    beam b;
    memory->fail_at = 0;
    b = make_beam(c->law, 1e5, 0, 0, NULL, c->of_model ? allocator : standard);
    memory->calls = 0;
    memory->fail_at = fail_at;
    d.nodes = b.nodes;
    def.allocator = allocator;
    def.gravity[2] = -1;
    def.damping_force.force = drag_force;
    def.damping_force.tangent = c->law == SFEM_LINEAR ? NULL : drag_tangent;
    def.damping_force.user = &d;
    status = sfem_body_create(b.model, &def, &body, err);
    if (status == SFEM_OK) status = sfem_body_step(body, 0.01, err);
    if (status == SFEM_OK) status = sfem_body_grab_point(body, 30, bary, &handle, err);
    if (status == SFEM_OK) status = sfem_body_step(body, 0.01, err);
    if (status == SFEM_OK) status = sfem_body_step(body, 0.02, err);
    if (status == SFEM_OK) {
        status = sfem_body_set_pins(body, 2, pins, NULL, err);
        if (status == SFEM_OK) status = sfem_body_step(body, 0.01, err);
    }
    if (status == SFEM_OK) status = sfem_body_set_pins(body, END, def.pins, NULL, err);
    if (status == SFEM_OK) status = sfem_body_solve_static(body, err);
    if (status == SFEM_OK) status = sfem_body_step(body, 0.01, err);
    memory->fail_at = 0;
    if (status != SFEM_OK && body) { /* once there is memory it goes on */
        sfem_error again;
        assert_ok(sfem_body_step(body, 0.005, &again), again);
    }
    sfem_body_free(body);
    sfem_model_free(b.model);
    return status;
}

static void every_allocation_may_fail(void **state)
{
    static memory_case cases[] = {
        {SFEM_LINEAR, SFEM_BATHE, 0},       {SFEM_COROTATIONAL, SFEM_NEWMARK, 0},
        {SFEM_LINEAR, SFEM_BATHE, 1},       {SFEM_COROTATIONAL, SFEM_BATHE, 1},
        {SFEM_NEOHOOKEAN, SFEM_NEWMARK, 1}, {SFEM_LINEAR, SFEM_NEWMARK, 1}};
    size_t i;
    (void)state;
    for (i = 0; i < TEST_COUNT(cases); ++i)
        assert_true(fail_every_allocation(attempt_steps, cases + i) > 10);
}

static void parameters_out_of_range_are_refused(void **state)
{
    static const char *const words[] = {"rho_inf", "alpha",      "iterations", "tolerance",
                                        "tangent", "load_steps", "no force",   "integrator"};
    beam b = plain_beam(SFEM_COROTATIONAL, 1e5);
    size_t i;
    (void)state;
    for (i = 0; i < TEST_COUNT(words); ++i) {
        sfem_body_def def = clamped(SFEM_NEWMARK);
        sfem_body *body = NULL;
        sfem_error err;
        if (i == 0) def.rho_inf = 1.1;
        if (i == 1) def.hht_alpha = 0.4;
        if (i == 2) def.newton.iterations = 0;
        if (i == 3) def.newton.tolerance = -1;
        if (i == 4) def.newton.tangent = (sfem_tangent)9;
        if (i == 5) def.newton.load_steps = 0;
        if (i == 6) def.damping_force.tangent = drag_tangent;
        if (i == 7) {
            def.integrator = SFEM_PQR; /* which corrects where there is such a force: one solve does not */
            def.accuracy = 1;
            def.damping_force.force = drag_force;
        }
        assert_status(sfem_body_create(b.model, &def, &body, &err), SFEM_BAD_ARGUMENT);
        assert_names(err, words[i]);
        assert_null(body);
    }
    sfem_model_free(b.model);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(radius_period_and_damping_are_those_of_the_table),
        cmocka_unit_test(parameters_reach_their_limits),
        cmocka_unit_test(observed_order_is_two_but_for_backward_euler),
        cmocka_unit_test(quadratic_drag_follows_its_closed_form),
        cmocka_unit_test(newton_on_a_linear_body_is_linear_newmark),
        cmocka_unit_test(newton_converges_quadratically),
        cmocka_unit_test(a_sagging_cantilever_is_in_equilibrium),
        cmocka_unit_test(a_turned_problem_has_the_turned_solution),
        cmocka_unit_test(a_free_body_keeps_its_momentum),
        cmocka_unit_test(one_iteration_is_the_semi_implicit_step),
        cmocka_unit_test(a_step_that_does_not_converge_leaves_no_trace),
        cmocka_unit_test(steps_without_a_length_are_refused),
        cmocka_unit_test(a_static_solution_that_fails_leaves_no_trace),
        cmocka_unit_test(damping_nearly_spares_rigid_rotation),
        cmocka_unit_test(methods_agree_as_the_step_falls),
        cmocka_unit_test(handles_and_moved_pins_agree_on_nonlinear_bodies),
        cmocka_unit_test(statics_hold_pins_nodes_and_points),
        cmocka_unit_test(every_tangent_leads_to_the_same_place),
        cmocka_unit_test(bits_do_not_depend_on_threads),
        cmocka_unit_test(a_body_never_calls_the_threads_of_another),
        cmocka_unit_test(steps_allocate_nothing_once_prepared),
        cmocka_unit_test(every_allocation_may_fail),
        cmocka_unit_test(parameters_out_of_range_are_refused),
    };
    return run_all_tests(tests);
}
