/* Integrators, loads, state and threads of linear bodies. Handles have tests of their own. */
#include "oscillator.h"
#include "linear.h"
#include "blocks.h"

/* --------------------------------------------------------------------------------------------
 * scenes
 * -------------------------------------------------------------------------------------------- */

/* A clamped block, jittered so that no symmetry hides a mistake. */
typedef struct block {
    sfem_model *model;
    sfem_int pins[64], pin_count, nodes;
} block;

static block make_block(sfem_int nx, sfem_int ny, sfem_int nz, sfem_mass mass, double alpha,
                        double beta, const sfem_matrix *damping)
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
    def.damping = damping;
    assert_ok(sfem_model_create(&def, &b.model, &err), err);
    b.nodes = mesh.nodes;
    sfem_mesh_free(&mesh);
    return b;
}

static sfem_body *block_body(const block *b, sfem_body_def def)
{
    def.pins = b->pins;
    def.pin_count = b->pin_count;
    return make_body(b->model, &def);
}

/* A smooth bend and its velocity. */
static void bend(const block *b, double scale, sfem_real *u, sfem_real *v)
{
    const sfem_real *x = sfem_model_mesh(b->model)->x;
    sfem_int i;
    for (i = 0; i < b->nodes; ++i) {
        const double t = x[3 * i];
        u[3 * i] = v[3 * i] = scale * 0.1 * t * t;
        u[3 * i + 1] = scale * t * t;
        u[3 * i + 2] = -scale * 0.5 * t * t;
        v[3 * i + 1] = scale * 2 * t;
        v[3 * i + 2] = scale * t;
    }
    for (i = 0; i < b->pin_count; ++i)
        memset(v + 3 * b->pins[i], 0, 3 * sizeof *v), memset(u + 3 * b->pins[i], 0, 3 * sizeof *u);
}

/* The load of a test that varies in time and space. */
static void wave_load(const block *b, double t, sfem_real *f)
{
    sfem_int i;
    for (i = 0; i < 3 * b->nodes; ++i) f[i] = 0.3 * sin(7 * t + 0.1 * i) + 0.1 * cos(31 * t);
}

/* --------------------------------------------------------------------------------------------
 * equivalence
 * -------------------------------------------------------------------------------------------- */

/* Runs Newmark(p, 1/2) beside (p,1,1) under a load that varies; returns the largest difference of
 * displacement over the largest displacement. */
static double newmark_against_pqr(const block *b, double p, double h, int steps, double alpha,
                                  double beta)
{
    const size_t n = 3 * (size_t)b->nodes;
    sfem_body_def def = exact_body_def();
    sfem_real *u = (sfem_real *)malloc(3 * n * sizeof *u), *v = u + n, *f = u + 2 * n;
    sfem_body *newmark, *pqr;
    double worst = 0, size = 0;
    sfem_error err;
    int k;
    size_t i;
    def.mass_damping = alpha;
    def.stiffness_damping = beta;
    def.gravity[1] = -3;
    def.p = def.beta = p;
    pqr = block_body(b, def);
    def.integrator = SFEM_NEWMARK;
    newmark = block_body(b, def);
    bend(b, 0.1, u, v);
    wave_load(b, 0, f);
    assert_ok(sfem_body_set_state(pqr, u, v, &err), err);
    assert_ok(sfem_body_set_state(newmark, u, v, &err), err);
    assert_ok(sfem_body_set_lasting_force(pqr, f, &err), err);
    assert_ok(sfem_body_set_lasting_force(newmark, f, &err), err);
    sfem_body_start(pqr);
    sfem_body_start(newmark);
    for (k = 0; k < steps; ++k) {
        wave_load(b, (k + 1) * h, f);
        assert_ok(sfem_body_set_lasting_force(pqr, f, &err), err);
        assert_ok(sfem_body_set_lasting_force(newmark, f, &err), err);
        step(pqr, h);
        step(newmark, h);
        for (i = 0; i < n; ++i) {
            const double a = sfem_body_displacement(pqr)[i], c = sfem_body_displacement(newmark)[i];
            worst = fmax(worst, fabs(a - c));
            size = fmax(size, fabs(c));
        }
    }
    assert_int_equal(sfem_body_get_info(pqr).factor_users, 2); /* they share one factor */
    sfem_body_free(pqr);
    sfem_body_free(newmark);
    free(u);
    return worst / size;
}

static void pqr_with_q_and_r_one_is_newmark(void **state)
{
    block lumped = make_block(4, 1, 1, SFEM_MASS_LUMPED, 0, 0, NULL);
    block consistent = make_block(4, 1, 1, SFEM_MASS_CONSISTENT, 0, 0, NULL);
    (void)state;
    assert_true(newmark_against_pqr(&lumped, 0.25, 0.01, 1000, 0, 0) < 1e-12);
    assert_true(newmark_against_pqr(&lumped, 0.25, 0.01, 1000, 0.7, 0.002) < 1e-12);
    /* p other than 1/4: not with damping by K, whose part of Newmark's start makes energy of stiff modes */
    assert_true(newmark_against_pqr(&lumped, 0.4, 0.01, 1000, 0.7, 0) < 1e-12);
    assert_true(newmark_against_pqr(&lumped, 1.0 / 12, 1e-3, 1000, 0.7, 0) < 1e-12);
    assert_true(newmark_against_pqr(&consistent, 0.25, 0.01, 1000, 0.7, 0.002) < 1e-12);
    assert_true(newmark_against_pqr(&consistent, 0.5, 0.01, 1000, 0.7, 0) < 1e-12);
    sfem_model_free(lumped.model);
    sfem_model_free(consistent.model);
}

static void pqr_is_newmark_with_any_damping_matrix_too(void **state)
{
    block plain = make_block(3, 1, 1, SFEM_MASS_LUMPED, 0, 0, NULL), damped;
    test_random random = {3};
    sfem_error err;
    sfem_matrix d;
    sfem_int i, k;
    (void)state;
    /* a random positive definite D that has nothing of K: diagonally dominant, full blocks */
    assert_ok(sfem_model_combine(plain.model, 0, 0, 0, NULL, &d, &err), err);
    for (i = 0; i < 9 * d.row[d.n]; ++i) d.val[i] = random_uniform(&random, -0.1, 0.1);
    for (i = 0; i < d.n; ++i)
        for (k = 0; k < 3; ++k) {
            sfem_real *block9 = d.val + 9 * (d.row[i + 1] - 1);
            block9[3 * k + (k + 1) % 3] = block9[3 * ((k + 1) % 3) + k];
            block9[4 * k] = 6 + k;
        }
    damped = make_block(3, 1, 1, SFEM_MASS_LUMPED, 0.2, 0.001, &d);
    assert_true(newmark_against_pqr(&damped, 0.25, 0.01, 1000, 0, 0) < 1e-12);
    assert_true(newmark_against_pqr(&damped, 0.25, 0.01, 1000, 0.1, 0.001) < 1e-12);
    sfem_matrix_free(&d);
    sfem_model_free(plain.model);
    sfem_model_free(damped.model);
}

static void a_step_equals_the_dense_solution_of_its_equation(void **state)
{
    block b = make_block(3, 1, 2, SFEM_MASS_CONSISTENT, 0.3, 0.004, NULL);
    const double h = 0.02, p = 0.3, q = 1.2, r = 1.5;
    const int n = 3 * b.nodes, held = 3 * b.pin_count, m = n - held; /* the pins come first */
    sfem_body_def def = exact_body_def();
    sfem_body *body;
    sfem_matrix a;
    sfem_error err;
    double *dense, *rhs, *u, *v, *ku, *dw, *before;
    sfem_int i, k, c, s;
    (void)state;
    dense = (double *)calloc((size_t)(m * m + 6 * n), sizeof *dense);
    rhs = dense + m * m;
    u = rhs + n;
    v = u + n;
    ku = v + n;
    dw = ku + n;
    before = dw + n;
    def.p = p;
    def.q = q;
    def.r = r;
    body = block_body(&b, def);
    bend(&b, 0.1, u, v);
    assert_ok(sfem_body_set_state(body, u, v, &err), err);
    memcpy(before, u, (size_t)n * sizeof *u);
    step(body, h);
    memcpy(u, sfem_body_displacement(body), (size_t)n * sizeof *u);
    step(body, h);
    /* A (w' - w)/h = -K u - D w from displacements alone */
    assert_ok(sfem_model_combine(b.model, p * h * h, r, q / 2 * h, NULL, &a, &err), err);
    for (i = 0; i < a.n; ++i)
        for (k = a.row[i]; k < a.row[i + 1]; ++k)
            for (c = 0; c < 3; ++c)
                for (s = 0; s < 3; ++s) {
                    const int row = 3 * i + c - held, col = 3 * a.col[k] + s - held;
                    if (row < 0 || col < 0) continue;
                    dense[row * m + col] = dense[col * m + row] = a.val[9 * k + 3 * c + s];
                }
    for (i = 0; i < n; ++i) v[i] = (u[i] - before[i]) / h;
    sfem_model_multiply_stiffness(b.model, u, ku, NULL);
    sfem_model_multiply_damping(b.model, v, dw, NULL);
    for (i = 0; i < m; ++i) rhs[i] = -ku[held + i] - dw[held + i];
    solve_dense(dense, rhs, m);
    for (i = 0; i < m; ++i) rhs[i] = u[held + i] + h * (v[held + i] + h * rhs[i]);
    assert_all_near(rhs, sfem_body_displacement(body) + held, m, 1e-11, 0);
    sfem_matrix_free(&a);
    sfem_body_free(body);
    sfem_model_free(b.model);
    free(dense);
}

/* --------------------------------------------------------------------------------------------
 * one degree of freedom: amplification, period, order
 * -------------------------------------------------------------------------------------------- */

/* u_{n+1} = a u_n + b u_{n-1} fitted to four displacements: |lambda| and the angle of the pair. */
static void amplification(sfem_body *body, double h, double *radius, double *angle)
{
    double x[4], det, a, b;
    int i;
    for (i = 0; i < 4; ++i) {
        step(body, h);
        x[i] = node1(body);
    }
    det = x[1] * x[1] - x[2] * x[0];
    a = (x[2] * x[1] - x[3] * x[0]) / det;
    b = (x[1] * x[3] - x[2] * x[2]) / det;
    *radius = sqrt(-b);
    *angle = atan2(sqrt(-b - a * a / 4), a / 2);
}

/* The undamped table: period elongation and numerical damping of the methods this library has, from
 * their amplification matrices, to the digits given. */
static void radius_period_and_damping_are_those_of_the_table(void **state)
{
    static const double omega_h[4] = {0.5, 1, 2, 10};
    static const struct {
        const char *name;
        sfem_integrator integrator;
        double p, elongation[4];
    } row[] = {
        {"trapezoidal rule", SFEM_NEWMARK, 0.25, {.0205, .0784, .2732, 2.64}},
        {"(1/4,1,1)", SFEM_PQR, 0.25, {.0205, .0784, .2732, 2.64}},
        {"(1/12,1,1)", SFEM_PQR, 1.0 / 12, {-.0001, -.0022, -.0451, 0}},
        {"(1/2,1,1)", SFEM_PQR, 0.5, {.0507, .1890, .6247, 5.45}},
    };
    static const double digit[4] = {6e-5, 6e-5, 6e-5, 6e-3};
    oscillator o = make_oscillator(1e6, SFEM_MASS_LUMPED);
    const double w = sqrt(o.k / o.m);
    size_t i, j;
    (void)state;
    for (i = 0; i < TEST_COUNT(row); ++i) {
        for (j = 0; j < 4; ++j) {
            sfem_body_def def = exact_body_def();
            double radius, angle;
            sfem_body *body;
            sfem_error err;
            def.integrator = row[i].integrator;
            def.p = def.beta = row[i].p;
            body = oscillator_body(&o, def);
            set_node1(body, 0.01, 0.02);
            if (row[i].p < 0.25 && j == 3) {
                assert_status(sfem_body_step(body, omega_h[j] / w, &err), SFEM_UNSTABLE);
            } else {
                amplification(body, omega_h[j] / w, &radius, &angle);
                assert_near(radius, 1, 1e-10, 0);
                assert_near(omega_h[j] / angle - 1, row[i].elongation[j], 0, digit[j]);
            }
            sfem_body_free(body);
        }
    }
    sfem_model_free(o.model);
}

/* With damping: lambda^2 - a lambda - b = 0 with a = 2 - (W^2 + 2 W xi)/A, b = 2 W xi/A - 1 and
 * A = p W^2 + q W xi + r, the source's eqs. 14-18. */
static void damped_amplification_is_that_of_the_matrix(void **state)
{
    static const double xi[] = {0.05, 0.2}, omega_h[] = {0.3, 1, 3};
    static const double pqr[][3] = {{0.25, 1, 1}, {0.3, 1.4, 1}, {0.5, 1, 3}};
    oscillator o = make_oscillator(1e6, SFEM_MASS_LUMPED);
    const double w = sqrt(o.k / o.m);
    size_t i, j, k;
    (void)state;
    for (i = 0; i < TEST_COUNT(xi); ++i)
        for (j = 0; j < TEST_COUNT(omega_h); ++j)
            for (k = 0; k < TEST_COUNT(pqr); ++k) {
                const double W = omega_h[j], *c = pqr[k];
                const double A = c[0] * W * W + c[1] * W * xi[i] + c[2];
                const double b = 1 - 2 * W * xi[i] / A, a = 2 - (W * W + 2 * W * xi[i]) / A;
                sfem_body_def def = exact_body_def();
                double radius, angle;
                sfem_body *body;
                def.p = c[0];
                def.q = c[1];
                def.r = c[2];
                def.mass_damping = xi[i] * w; /* xi = alpha/(2 w) + beta w/2, half from each */
                def.stiffness_damping = xi[i] / w;
                body = oscillator_body(&o, def);
                set_node1(body, 0.01, 0.02);
                step(body, W / w);
                amplification(body, W / w, &radius, &angle);
                assert_near(radius, sqrt(b), 1e-9, 0);
                assert_near(angle, atan2(sqrt(b - a * a / 4), a / 2), 1e-8, 0);
                sfem_body_free(body);
            }
    sfem_model_free(o.model);
}

/* Error at t = T of u and v under u0, v0, damping xi and a load F cos(nu t), against the closed form. */
static double oscillator_error(const oscillator *o, sfem_body_def def, double xi, double load,
                               int steps, double *velocity_error)
{
    const double w = sqrt(o->k / o->m), T = 7 / w, nu = 0.6 * w, wd = w * sqrt(1 - xi * xi);
    /* particular solution C cos(nu t) + S sin(nu t) of u'' + 2 xi w u' + w^2 u = load w^2 cos(nu t) */
    const double a = w * w - nu * nu, b = 2 * xi * w * nu, g = load * w * w / (a * a + b * b);
    const double C = g * a, S = g * b, u0 = 0.01, v0 = 0.02 * w;
    const double A = u0 - C, B = (v0 - S * nu + xi * w * A) / wd;
    const double e = exp(-xi * w * T),
                 u = e * (A * cos(wd * T) + B * sin(wd * T)) + C * cos(nu * T) + S * sin(nu * T);
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
    for (i = 0; i <= steps; ++i) {
        f[3] = load * o->k * cos(nu * i * h);
        if (load != 0) assert_ok(sfem_body_set_lasting_force(body, f, &err), err);
        sfem_body_start(body);
        if (i < steps && i > 0) step(body, h);
        if (i == steps) step(body, h);
    }
    error = fabs(node1(body) - u) / u0;
    if (velocity_error) *velocity_error = fabs(node1_velocity(body) - v) / (u0 * w);
    sfem_body_free(body);
    return error;
}

static void observe_order(const oscillator *o, sfem_body_def def, double xi, double load, int steps,
                          double order, double velocity_order)
{
    double v1, v2;
    const double e1 = oscillator_error(o, def, xi, load, steps, &v1);
    const double e2 = oscillator_error(o, def, xi, load, 2 * steps, &v2);
    assert_near(log2(e1 / e2), order, 0, 0.15);
    assert_near(log2(v1 / v2), velocity_order, 0, 0.15);
}

static void newmark_and_pqr_are_of_second_order(void **state)
{
    oscillator o = make_oscillator(1e6, SFEM_MASS_CONSISTENT);
    sfem_body_def def = exact_body_def();
    (void)state;
    observe_order(&o, def, 0, 0, 200, 2, 2);
    observe_order(&o, def, 0.1, 0.005, 200, 2, 2);
    def.p = 0.4;
    observe_order(&o, def, 0.1, 0.005, 200, 2, 2);
    def.p = 0.25;
    def.plain_load = 1;
    observe_order(&o, def, 0.1, 0.005, 400, 2, 2);
    def = exact_body_def();
    def.integrator = SFEM_CENTRAL;
    observe_order(&o, def, 0.1, 0.005, 200, 2, 2);
    def.integrator = SFEM_NEWMARK;
    observe_order(&o, def, 0.1, 0.005, 200, 2, 2);
    def.gamma = 0.6; /* known to be of first order */
    def.beta = 0.3025;
    observe_order(&o, def, 0.1, 0.005, 800, 1, 1);
    sfem_model_free(o.model);
}

static void q_other_than_one_is_of_first_order_and_adds_mass(void **state)
{
    oscillator o = make_oscillator(1e6, SFEM_MASS_LUMPED);
    sfem_body_def def = exact_body_def();
    (void)state;
    def.q = 1.5;
    observe_order(&o, def, 0.1, 0, 800, 1, 1);
    sfem_model_free(o.model);
}

static void p_one_twelfth_is_of_fourth_order_in_displacement(void **state)
{
    oscillator o = make_oscillator(1e6, SFEM_MASS_LUMPED);
    sfem_body_def def = exact_body_def();
    double e1, e2;
    (void)state;
    def.p = 1.0 / 12;
    def.start = SFEM_START_FOURTH_ORDER;
    e1 = oscillator_error(&o, def, 0, 0, 40, NULL);
    e2 = oscillator_error(&o, def, 0, 0, 80, NULL);
    assert_near(log2(e1 / e2), 4, 0, 0.15);
    assert_true(e1 < 1e-4);
    sfem_model_free(o.model);
}

static void p_chooses_itself_from_what_is_resolved(void **state)
{
    oscillator o = make_oscillator(1e6, SFEM_MASS_LUMPED);
    const double w = sqrt(o.k / o.m);
    sfem_body_def def = exact_body_def();
    sfem_body *body;
    (void)state;
    def.p = SFEM_P_AUTO;
    body = oscillator_body(&o, def);
    set_node1(body, 0.01, 0);
    step(body, 1.9 / w);
    assert_near(sfem_body_get_info(body).p, 1.0 / 12, 1e-15, 0);
    assert_near(sfem_body_get_info(body).omega_max, w, 1e-9, 0);
    step(body, 2.1 / w);
    assert_near(sfem_body_get_info(body).p, 0.25, 0, 0);
    sfem_body_free(body);
    sfem_model_free(o.model);
}

/* --------------------------------------------------------------------------------------------
 * physics
 * -------------------------------------------------------------------------------------------- */

static double fall(sfem_integrator integrator, sfem_mass mass, double r, double h, int steps)
{
    block b = make_block(2, 1, 1, mass, 0, 0, NULL);
    sfem_body_def def = exact_body_def();
    sfem_body *body;
    double first, worst = 0;
    sfem_int i;
    def.integrator = integrator;
    def.r = r;
    def.gravity[2] = -9.81;
    body = make_body(b.model, &def);
    for (i = 0; i < steps; ++i) step(body, h);
    first = sfem_body_displacement(body)[2];
    for (i = 0; i < b.nodes; ++i)
        worst = fmax(worst, fabs(sfem_body_displacement(body)[3 * i + 2] - first));
    assert_true(worst < 1e-9 * fabs(first)); /* a free body falls without deforming */
    sfem_body_free(body);
    sfem_model_free(b.model);
    return first;
}

static void a_free_body_falls_at_g_and_at_a_third_of_it_for_r_three(void **state)
{
    const double h = 0.01, t = 50 * h, exact = -9.81 * t * t / 2;
    (void)state;
    assert_near(fall(SFEM_PQR, SFEM_MASS_LUMPED, 1, h, 50), exact, 1e-9, 0);
    assert_near(fall(SFEM_PQR, SFEM_MASS_CONSISTENT, 1, h, 50), exact, 1e-9, 0);
    assert_near(fall(SFEM_NEWMARK, SFEM_MASS_LUMPED, 1, h, 50), exact, 1e-9, 0);
    assert_near(fall(SFEM_NEWMARK, SFEM_MASS_CONSISTENT, 1, h, 50), exact, 1e-9, 0);
    assert_near(fall(SFEM_CENTRAL, SFEM_MASS_LUMPED, 1, 1e-4, 50), -9.81 * 25e-6 / 2, 1e-9, 0);
    assert_near(fall(SFEM_PQR, SFEM_MASS_LUMPED, 3, h, 50), exact / 3, 1e-9, 0);
}

/* Largest relative change of the conserved energy over the steps. */
static double energy_drift(sfem_integrator integrator, double p, sfem_mass mass, double h,
                           int steps)
{
    block b = make_block(2, 1, 1, mass, 0, 0, NULL);
    sfem_body_def def = exact_body_def();
    sfem_real u[64 * 3], v[64 * 3];
    double start, worst = 0;
    sfem_body *body;
    sfem_error err;
    int k;
    def.integrator = integrator;
    def.p = p;
    if (p > 0) def.beta = p;
    def.gravity[1] = -2;
    body = block_body(&b, def);
    bend(&b, 0.1, u, v);
    assert_ok(sfem_body_set_state(body, u, v, &err), err);
    step(body, h);
    start = sfem_body_energy(body).conserved;
    for (k = 0; k < steps; ++k) {
        step(body, h);
        if (k % 97 == 0 || k == steps - 1)
            worst = fmax(worst, fabs(sfem_body_energy(body).conserved - start));
    }
    sfem_body_free(body);
    sfem_model_free(b.model);
    return worst / fabs(start);
}

/* P and L about the centre at rest of the mean velocity (u1 - u0)/h, with the body's own mass matrix. */
static void rest_momentum(const block *b, const double *u0, const double *u1, double h, double p[6])
{
    const sfem_real *x = sfem_model_mesh(b->model)->x, *mass = sfem_model_node_mass(b->model);
    const double whole = sfem_model_total_mass(b->model);
    double w[3 * 64], mw[3 * 64], centre[3] = {0, 0, 0};
    sfem_int i;
    int c;
    assert_true(b->nodes <= 64);
    for (i = 0; i < 3 * b->nodes; ++i) {
        w[i] = (u1[i] - u0[i]) / h;
        centre[i % 3] += mass[i / 3] * x[i] / whole;
    }
    sfem_model_multiply_mass(b->model, w, mw, NULL);
    memset(p, 0, 6 * sizeof *p);
    for (i = 0; i < b->nodes; ++i)
        for (c = 0; c < 3; ++c) {
            const int d = (c + 1) % 3, e = (c + 2) % 3;
            p[c] += mw[3 * i + c];
            p[3 + c] += (x[3 * i + d] - centre[d]) * mw[3 * i + e] -
                        (x[3 * i + e] - centre[e]) * mw[3 * i + d];
        }
}

/* A body at h omega = 1e5, which goes fifty of its lengths: its momenta change by what its loads give, though
 * rounding of internal forces adds up to more. By hand: the force comes through sfem_body_rhs. */
static void check_momenta(sfem_mass mass, sfem_body_def def, double load, int by_hand)
{
    const double h = 300, speed = 1e-3;
    block b = make_block(4, 1, 1, mass, 0, 0, NULL);
    const size_t n = 3 * (size_t)b.nodes;
    const double brake = 1 + def.mass_damping * h / 2, m = sfem_model_total_mass(b.model);
    test_random random = {5};
    double v[3 * 64], f[3 * 64], before[3 * 64], zero[3 * 64] = {0};
    double p[6], last[6] = {0}, push[6], size[2] = {0, 0};
    sfem_body *body;
    sfem_error err;
    size_t i;
    int k, c;
    def.gravity[1] = load * speed / h;
    body = make_body(b.model, &def);
    random_fill(&random, v, n, -speed, speed);
    random_fill(&random, f, n, -load * speed / h, load * speed / h);
    rest_momentum(&b, zero, f, 1, push); /* of M f: the force on each node */
    sfem_model_multiply_mass(b.model, f, before, NULL);
    memcpy(f, before, sizeof f);
    push[1] += m * def.gravity[1];
    assert_ok(sfem_body_set_state(body, NULL, v, &err), err);
    if (!by_hand) assert_ok(sfem_body_set_lasting_force(body, f, &err), err);
    for (k = 0; k < 200; ++k) {
        memcpy(before, sfem_body_displacement(body), n * sizeof *before);
        assert_ok(sfem_body_predict(body, h, &err), err);
        for (i = 0; by_hand && i < n; ++i) sfem_body_rhs(body)[i] += f[i];
        assert_ok(sfem_body_solve(body, &err), err);
        assert_ok(sfem_body_finish(body, &err), err);
        rest_momentum(&b, before, sfem_body_displacement(body), h, p);
        for (c = 0; c < 6; ++c) size[c / 3] = fmax(size[c / 3], fabs(p[c]) + 0.2 * m * speed);
        for (c = 0; k > 0 && c < 6; ++c)
            assert_near(p[c] - last[c], h * (push[c] - def.mass_damping * last[c]) / brake, 0,
                        (by_hand ? 1e-9 : 2e-13) * size[c / 3]);
        memcpy(last, p, sizeof last);
    }
    sfem_body_free(body);
    sfem_model_free(b.model);
}

static void momenta_of_a_stiff_free_body_are_what_its_loads_give(void **state)
{
    const sfem_mass mass[2] = {SFEM_MASS_LUMPED, SFEM_MASS_CONSISTENT};
    int k;
    (void)state;
    for (k = 0; k < 2; ++k) {
        sfem_body_def def = exact_body_def();
        check_momenta(mass[k], def, 0, 0);
        check_momenta(mass[k], def, 0.1, 0);
        check_momenta(mass[k], def, 0.1, 1);
        def.frame = SFEM_FRAME_REST; /* means nothing here */
        def.p = 0.4;
        def.mass_damping = 1e-4;
        check_momenta(mass[k], def, 0.1, 0);
        def = exact_body_def();
        def.integrator = SFEM_NEWMARK;
        check_momenta(mass[k], def, 0, 0);
        check_momenta(mass[k], def, 0.1, 0);
        def.integrator = SFEM_KR_ALPHA;
        def.rho_inf = 0.8;
        check_momenta(mass[k], def, 0, 0);
    }
}

/* A piece that is held gets no such thing, one that is let go does. */
static void momentum_is_kept_from_when_a_body_is_let_go(void **state)
{
    const double h = 300;
    block b = make_block(4, 1, 1, SFEM_MASS_LUMPED, 0, 0, NULL);
    const size_t bytes = 3 * (size_t)b.nodes * sizeof(double);
    sfem_body_def def = exact_body_def();
    double before[3 * 64], x[3], p[6], first[6] = {0};
    sfem_body *body = block_body(&b, def);
    sfem_int handle;
    sfem_error err;
    int k, c;
    (void)state;
    assert_ok(sfem_body_set_pins(body, 0, NULL, NULL, &err), err);
    assert_ok(sfem_body_grab_node(body, b.nodes - 1, &handle, &err), err);
    for (k = 0; k < 100; ++k) {
        if (k < 50) {
            sfem_body_handle_position(body, handle, x);
            for (c = 0; c < 3; ++c) x[c] += 0.1 * (c + 1);
            assert_ok(sfem_body_move_handle(body, handle, x, &err), err);
        }
        if (k == 50) sfem_body_release_handle(body, handle);
        memcpy(before, sfem_body_displacement(body), bytes);
        step(body, h);
        if (k < 50) {
            double now[3];
            sfem_body_handle_position(body, handle, now);
            assert_all_near(now, x, 3, 1e-12, 1e-12);
            continue;
        }
        rest_momentum(&b, before, sfem_body_displacement(body), h, p);
        if (k == 50) memcpy(first, p, sizeof first);
        assert_true(fabs(first[0]) > 1e-3 * sfem_model_total_mass(b.model) / h);
        assert_all_near(p, first, 3, 1e-12, 0);
        assert_all_near(p + 3, first + 3, 3, 0, 1e-12 * fabs(first[0]));
    }
    sfem_body_free(body);
    sfem_model_free(b.model);
}

static void the_conserved_energy_drifts_by_rounding_only(void **state)
{
    (void)state;
    assert_true(energy_drift(SFEM_PQR, 0.25, SFEM_MASS_LUMPED, 0.01, 100000) < 1e-10);
    assert_true(energy_drift(SFEM_PQR, 0.4, SFEM_MASS_CONSISTENT, 0.01, 10000) < 1e-10);
    assert_true(energy_drift(SFEM_PQR, 1.0 / 12, SFEM_MASS_LUMPED, 2e-3, 10000) < 1e-10);
    assert_true(energy_drift(SFEM_NEWMARK, 0.25, SFEM_MASS_LUMPED, 0.01, 10000) < 1e-10);
    assert_true(energy_drift(SFEM_NEWMARK, 0.35, SFEM_MASS_CONSISTENT, 0.01, 10000) < 1e-10);
    assert_true(energy_drift(SFEM_CENTRAL, 0, SFEM_MASS_LUMPED, 2e-3, 10000) < 1e-10);
}

/* The (p,q,r) form holds its energy to rounding at any step; in accelerations Newmark loses digits as
 * (omega h)^2, here 1e12 at the largest step. */
static void unconditional_stability_holds_at_any_step(void **state)
{
    static const double h[] = {1e-3, 0.1, 10, 1000};
    static const double newmark[] = {1e-11, 1e-11, 1e-7, 1e-3};
    size_t i;
    (void)state;
    for (i = 0; i < TEST_COUNT(h); ++i) {
        assert_true(energy_drift(SFEM_PQR, 0.25, SFEM_MASS_LUMPED, h[i], 2000) < 1e-11);
        assert_true(energy_drift(SFEM_NEWMARK, 0.25, SFEM_MASS_LUMPED, h[i], 2000) < newmark[i]);
    }
}

/* The largest omega by power iteration, slowly and surely: the reported limit lies just below. */
static void the_stable_step_is_found_and_kept(void **state)
{
    block b = make_block(3, 2, 2, SFEM_MASS_LUMPED, 0, 0, NULL);
    const sfem_real *mass = sfem_model_node_mass(b.model);
    const size_t n = 3 * (size_t)b.nodes;
    sfem_body_def def = exact_body_def();
    sfem_real u[64 * 3], v[64 * 3], ku[64 * 3];
    double w2 = 0, limit;
    sfem_body *body;
    sfem_body_info info;
    sfem_error err;
    test_random random = {5};
    size_t i;
    int k;
    (void)state;
    random_fill(&random, u, n, -1, 1);
    for (k = 0; k < 20000; ++k) {
        double norm = 0;
        for (i = 0; i < 3 * (size_t)b.pin_count; ++i) u[i] = 0;
        sfem_model_multiply_stiffness(b.model, u, ku, NULL);
        for (i = 0; i < n; ++i) u[i] = ku[i] / mass[i / 3];
        for (i = 3 * (size_t)b.pin_count; i < n; ++i) norm += u[i] * u[i];
        for (i = 0; i < n; ++i) u[i] /= sqrt(norm);
        w2 = sqrt(norm);
    }
    limit = 2 / sqrt(w2);
    def.integrator = SFEM_CENTRAL;
    body = block_body(&b, def);
    assert_status(sfem_body_step(body, 1.001 * limit, &err), SFEM_UNSTABLE);
    assert_names(err, "stable");
    assert_near(sfem_body_time(body), 0, 0, 0);
    bend(&b, 0.1, u, v);
    assert_ok(sfem_body_set_state(body, u, v, &err), err);
    for (k = 0; k < 2000; ++k) step(body, 0.999 * limit);
    info = sfem_body_get_info(body);
    assert_near(info.stable_step, limit, 1e-3, 0);
    assert_true(info.stable_step <= limit * (1 + 1e-9));
    assert_true(info.diagonal);
    for (i = 0; i < n; ++i) assert_true(fabs(sfem_body_displacement(body)[i]) < 1);
    sfem_body_free(body);
    def.stiffness_damping = 1e-3; /* stiffness damping: no longer diagonal, still stable up to the same step */
    body = block_body(&b, def);
    assert_ok(sfem_body_set_state(body, u, v, &err), err);
    for (k = 0; k < 2000; ++k) step(body, 0.999 * limit);
    assert_false(sfem_body_get_info(body).diagonal);
    for (i = 0; i < n; ++i) assert_true(fabs(sfem_body_displacement(body)[i]) < 1e-3);
    sfem_body_free(body);
    sfem_model_free(b.model);
}

/* Steps of changing length: second order, and no growth at p = 1/4. */
static double varying_step_error(const oscillator *o, int steps, double p, double beta)
{
    const double w = sqrt(o->k / o->m), T = 7 / w;
    sfem_body_def def = exact_body_def();
    double t = 0, xi = beta * w / 2, wd = w * sqrt(1 - xi * xi);
    sfem_body *body;
    int i;
    def.p = p;
    def.stiffness_damping = beta;
    body = oscillator_body(o, def);
    set_node1(body, 0.01, 0);
    for (i = 0; i < steps; ++i) {
        const double h = T / steps * (i % 2 ? 1.5 : 0.5);
        step(body, h);
        t += h;
    }
    t = fabs(node1(body) - 0.01 * exp(-xi * w * t) * (cos(wd * t) + xi * w / wd * sin(wd * t)));
    sfem_body_free(body);
    return t;
}

static void a_change_of_step_keeps_the_order(void **state)
{
    oscillator o = make_oscillator(1e6, SFEM_MASS_LUMPED);
    (void)state;
    assert_near(log2(varying_step_error(&o, 200, .25, 0) / varying_step_error(&o, 400, .25, 0)), 2,
                0, .1);
    assert_near(log2(varying_step_error(&o, 200, .35, 0) / varying_step_error(&o, 400, .35, 0)), 2,
                0, .1);
    assert_near(
        log2(varying_step_error(&o, 400, .35, 1e-3) / varying_step_error(&o, 800, .35, 1e-3)), 2, 0,
        .1);
    sfem_model_free(o.model);
}

/* --------------------------------------------------------------------------------------------
 * the pipeline
 * -------------------------------------------------------------------------------------------- */

static void three_parts_make_one_step_and_a_force_in_between_acts(void **state)
{
    block b = make_block(3, 1, 1, SFEM_MASS_LUMPED, 0.1, 0.001, NULL);
    sfem_body_def def = exact_body_def();
    sfem_body *whole, *parts;
    sfem_real f[64 * 3] = {0};
    sfem_error err;
    int k;
    (void)state;
    def.gravity[1] = -9.81;
    def.plain_load = 1;
    whole = block_body(&b, def);
    parts = block_body(&b, def);
    for (k = 0; k < 50; ++k) {
        step(whole, 0.01);
        assert_ok(sfem_body_predict(parts, 0.01, &err), err);
        assert_ok(sfem_body_predict(parts, 0.01, &err), err); /* giving a step up costs nothing */
        assert_ok(sfem_body_solve(parts, &err), err);
        assert_ok(sfem_body_finish(parts, &err), err);
    }
    assert_int_equal(hash_reals(sfem_body_displacement(whole), 3 * (size_t)b.nodes),
                     hash_reals(sfem_body_displacement(parts), 3 * (size_t)b.nodes));
    f[3 * (b.nodes - 1) + 1] = 5;
    assert_ok(sfem_body_set_lasting_force(whole, f, &err), err);
    step(whole, 0.01); /* with plain_load, F acts from the next step on */
    step(parts, 0.01);
    for (k = 0; k < 50; ++k) {
        step(whole, 0.01);
        assert_ok(sfem_body_predict(parts, 0.01, &err), err);
        sfem_body_rhs(parts)[3 * (b.nodes - 1) + 1] += 5;
        assert_ok(sfem_body_solve(parts, &err), err);
        assert_ok(sfem_body_finish(parts, &err), err);
    }
    assert_all_near(sfem_body_displacement(whole), sfem_body_displacement(parts), 3 * b.nodes,
                    1e-12, 0);
    sfem_body_free(whole);
    sfem_body_free(parts);
    sfem_model_free(b.model);
}

static void a_force_that_is_not_finite_leaves_the_state_as_it_was(void **state)
{
    block b = make_block(2, 1, 1, SFEM_MASS_LUMPED, 0, 0, NULL);
    sfem_body_def def = exact_body_def();
    sfem_real f[64 * 3] = {0};
    sfem_body *body;
    sfem_error err;
    void *before, *after;
    size_t bytes;
    (void)state;
    def.gravity[1] = -9.81;
    body = block_body(&b, def);
    step(body, 0.01);
    bytes = sfem_body_state_size(body);
    before = calloc(2, bytes);
    after = (char *)before + bytes;
    sfem_body_save_state(body, before);
    f[3 * 9 + 1] = NAN;
    assert_status(sfem_body_set_lasting_force(body, f, &err), SFEM_NOT_FINITE);
    assert_names(err, "node 9");
    assert_int_equal(err.node, 9);
    assert_ok(sfem_body_predict(body, 0.01, &err), err);
    sfem_body_rhs(body)[30] = INFINITY;
    assert_status(sfem_body_solve(body, &err), SFEM_NOT_FINITE);
    sfem_body_save_state(body, after);
    assert_memory_equal(before, after, bytes);
    assert_status(sfem_body_step(body, 0, &err), SFEM_BAD_ARGUMENT);
    assert_status(sfem_body_step(body, NAN, &err), SFEM_BAD_ARGUMENT);
    assert_status(sfem_body_step(body, -1, &err), SFEM_BAD_ARGUMENT);
    sfem_body_save_state(body, after);
    assert_memory_equal(before, after, bytes);
    step(body, 0.01);
    free(before);
    sfem_body_free(body);
    sfem_model_free(b.model);
}

static void a_hundred_bodies_share_one_factor(void **state)
{
    block b = make_block(3, 1, 1, SFEM_MASS_LUMPED, 0, 0, NULL);
    sfem_body_def def = exact_body_def();
    sfem_body *body[100];
    sfem_int made = 0;
    sfem_error err;
    int i;
    (void)state;
    for (i = 0; i < 100; ++i) {
        body[i] = block_body(&b, def);
        assert_int_equal(sfem_body_get_info(body[i]).factor_users,
                         0); /* nothing before it is needed */
        assert_ok(sfem_body_prepare(body[i], 0.01, &err), err);
        made += sfem_body_get_info(body[i]).factors_made;
    }
    assert_int_equal(made, 1);
    assert_int_equal(sfem_body_get_info(body[0]).factor_users, 100);
    step(body[5], 0.02); /* another h: its own */
    assert_int_equal(sfem_body_get_info(body[0]).factor_users, 99);
    assert_int_equal(sfem_body_get_info(body[5]).factors_made, 1);
    sfem_model_free(b.model); /* the bodies hold it */
    for (i = 0; i < 100; ++i) {
        step(body[i], 0.01);
        sfem_body_free(body[i]);
    }
}

static void without_allocation_an_unprepared_step_says_so(void **state)
{
    block b = make_block(2, 1, 1, SFEM_MASS_LUMPED, 0, 0, NULL);
    sfem_body_def def = exact_body_def();
    test_memory memory = {0};
    sfem_body *body;
    sfem_error err;
    size_t calls;
    int k;
    (void)state;
    def.may_allocate = 0;
    def.allocator = test_allocator(&memory);
    body = block_body(&b, def);
    assert_status(sfem_body_step(body, 0.01, &err), SFEM_NOT_PREPARED);
    assert_ok(sfem_body_prepare(body, 0.01, &err), err);
    calls = memory.calls;
    for (k = 0; k < 10; ++k) step(body, 0.01);
    assert_int_equal(memory.calls, calls);
    assert_status(sfem_body_step(body, 0.02, &err), SFEM_NOT_PREPARED);
    step(body, 0.01);
    sfem_body_free(body);
    assert_no_leak(memory);
    sfem_model_free(b.model);
}

static void a_saved_state_continues_bit_for_bit(void **state)
{
    static const sfem_integrator kind[] = {SFEM_PQR, SFEM_NEWMARK};
    block b = make_block(3, 1, 1, SFEM_MASS_LUMPED, 0.2, 0.001, NULL);
    size_t j;
    (void)state;
    for (j = 0; j < 2; ++j) {
        sfem_body_def def = exact_body_def();
        sfem_body *one, *two;
        sfem_real f[64 * 3];
        sfem_error err;
        unsigned char *saved;
        size_t bytes, i;
        int k;
        def.integrator = kind[j];
        def.gravity[1] = -9.81;
        one = block_body(&b, def);
        two = block_body(&b, def);
        wave_load(&b, 0.3, f);
        assert_ok(sfem_body_set_lasting_force(one, f, &err), err);
        for (k = 0; k < 20; ++k) step(one, 0.01);
        wave_load(&b, 0.7, f);
        assert_ok(sfem_body_set_lasting_force(one, f, &err), err);
        step(one, 0.01);
        bytes = sfem_body_state_size(one);
        saved = (unsigned char *)malloc(bytes);
        sfem_body_save_state(one, saved);
        assert_ok(sfem_body_load_state(two, saved, bytes, &err), err);
        for (k = 0; k < 20; ++k) {
            step(one, 0.01);
            step(two, 0.01);
        }
        assert_memory_equal(sfem_body_displacement(one), sfem_body_displacement(two),
                            3 * (size_t)b.nodes * sizeof(sfem_real));
        assert_near(sfem_body_time(one), sfem_body_time(two), 0, 0);
        for (i = 0; i < bytes; i += 61) { /* any flipped bit is seen, and changes nothing */
            saved[i] ^= 4;
            assert_int_not_equal(sfem_body_load_state(two, saved, bytes, &err), SFEM_OK);
            saved[i] ^= 4;
        }
        assert_status(sfem_body_load_state(two, saved, bytes - 1, &err), SFEM_FORMAT);
        assert_status(sfem_body_load_state(two, saved, 3, &err), SFEM_FORMAT);
        assert_memory_equal(sfem_body_displacement(one), sfem_body_displacement(two),
                            3 * (size_t)b.nodes * sizeof(sfem_real));
        sfem_body_free(two);
        def.integrator = kind[1 - j];
        two = block_body(&b, def);
        assert_status(sfem_body_load_state(two, saved, bytes, &err), SFEM_MISMATCH);
        free(saved);
        sfem_body_free(one);
        sfem_body_free(two);
    }
    sfem_model_free(b.model);
}

static void floats_for_rendering_are_the_positions_and_velocities(void **state)
{
    block b = make_block(2, 1, 1, SFEM_MASS_LUMPED, 0, 0, NULL);
    sfem_body_def def = exact_body_def();
    sfem_real x[64 * 3], v[64 * 3];
    float vertex[64][8], velocity[64][8]; /* three of eight are ours */
    sfem_body *body;
    sfem_int i;
    int c;
    (void)state;
    def.gravity[1] = -9.81;
    body = block_body(&b, def);
    for (i = 0; i < 5; ++i) step(body, 0.01);
    sfem_body_positions(body, x);
    sfem_body_velocities(body, v);
    for (i = 0; i < b.nodes; ++i)
        for (c = 0; c < 8; ++c) vertex[i][c] = velocity[i][c] = 77;
    sfem_body_to_floats(body, vertex[0], NULL, sizeof vertex[0]);
    sfem_body_to_floats(body, NULL, velocity[0], sizeof velocity[0]);
    for (i = 0; i < b.nodes; ++i)
        for (c = 0; c < 8; ++c) {
            assert_near(vertex[i][c], c < 3 ? (double)(float)x[3 * i + c] : 77, 0, 0);
            assert_near(velocity[i][c], c < 3 ? (double)(float)v[3 * i + c] : 77, 0, 0);
        }
    sfem_body_free(body);
    sfem_model_free(b.model);
}

static void bad_definitions_are_refused(void **state)
{
    block b = make_block(1, 1, 1, SFEM_MASS_LUMPED, 0, 0, NULL);
    static const sfem_int far[1] = {99};
    static const unsigned char axes[1] = {8};
    sfem_body *body = (sfem_body *)&b;
    sfem_error err;
    sfem_body_def def;
    (void)state;
#define REFUSED(change, wanted, words)                                                             \
    def = exact_body_def();                                                                 \
    change;                                                                                        \
    assert_status(sfem_body_create(b.model, &def, &body, &err), wanted);                           \
    assert_names(err, words);                                                                      \
    assert_ptr_equal(body, &b)
    REFUSED(def.p = -0.5, SFEM_BAD_ARGUMENT, "p is");
    REFUSED(def.p = NAN, SFEM_BAD_ARGUMENT, "p is");
    REFUSED(def.q = -1, SFEM_BAD_ARGUMENT, "q is");
    REFUSED(def.r = 0, SFEM_BAD_ARGUMENT, "r is");
    REFUSED(def.beta = 0, SFEM_BAD_ARGUMENT, "beta");
    REFUSED(def.gamma = 0.4, SFEM_BAD_ARGUMENT, "gamma");
    REFUSED(def.mass_damping = -1, SFEM_BAD_ARGUMENT, "damping");
    REFUSED(def.stiffness_damping = INFINITY, SFEM_BAD_ARGUMENT, "damping");
    REFUSED(def.gravity[2] = NAN, SFEM_NOT_FINITE, "gravity");
    REFUSED(def.max_handles = -1, SFEM_BAD_ARGUMENT, "max_handles");
    REFUSED(def.integrator = (sfem_integrator)17, SFEM_BAD_ARGUMENT, "17");
    REFUSED((def.pins = far, def.pin_count = 1), SFEM_BAD_ARGUMENT, "node 99");
    REFUSED((def.pins = corner_pins, def.pin_axes = axes, def.pin_count = 1), SFEM_BAD_ARGUMENT,
            "axes 8");
    REFUSED(def.pin_count = 3, SFEM_BAD_ARGUMENT, "pin_count");
#undef REFUSED
    sfem_model_free(b.model);
}

static sfem_status build_and_step(sfem_allocator allocator, void *user, sfem_error *err)
{
    const sfem_int cells[3] = {2, 1, 1}, pins[3] = {0, 1, 2};
    const sfem_real size[3] = {2, 1, 1};
    sfem_model_def model_def = linear_model_def();
    sfem_body_def def = exact_body_def();
    sfem_mesh mesh;
    sfem_model *model = NULL;
    sfem_body *body = NULL;
    sfem_status status;
    memset(&mesh, 0, sizeof mesh);
    model_def.allocator = def.allocator = allocator;
    def.integrator = *(const sfem_integrator *)user;
    def.pins = pins;
    def.pin_count = 3;
    def.stiffness_damping = 1e-4;
    def.p = SFEM_P_AUTO;
    status = sfem_mesh_block(cells, size, SFEM_CELL_6_TETS, &allocator, &mesh, err);
    model_def.mesh = &mesh;
    if (status == SFEM_OK) status = sfem_model_create(&model_def, &model, err);
    if (status == SFEM_OK) status = sfem_body_create(model, &def, &body, err);
    if (status == SFEM_OK) {
        status = sfem_body_step(body, 1e-3, err);
        if (status != SFEM_OK) assert_near(sfem_body_time(body), 0, 0, 0);
    }
    if (status == SFEM_OK) status = sfem_body_step(body, 2e-3, err);
    if (status == SFEM_OK) status = sfem_body_set_pins(body, 2, pins, NULL, err);
    if (status == SFEM_OK) status = sfem_body_step(body, 2e-3, err);
    sfem_body_free(body);
    sfem_model_free(model);
    sfem_mesh_free(&mesh);
    return status;
}

static void every_allocation_may_fail(void **state)
{
    sfem_integrator kind[] = {SFEM_PQR, SFEM_NEWMARK, SFEM_CENTRAL};
    size_t i;
    (void)state;
    for (i = 0; i < TEST_COUNT(kind); ++i)
        assert_true(fail_every_allocation(build_and_step, kind + i) > 20);
}

/* --------------------------------------------------------------------------------------------
 * threads
 * -------------------------------------------------------------------------------------------- */

static uint64_t run_with_threads(sfem_exec exec)
{
    block b = make_block(12, 3, 3, SFEM_MASS_LUMPED, 0.2, 0.001, NULL);
    sfem_body_def def = exact_body_def();
    sfem_body *body;
    sfem_error err;
    uint64_t hash;
    sfem_int handle;
    int k;
    def.gravity[1] = -9.81;
    def.exec = exec;
    body = block_body(&b, def);
    for (k = 0; k < 20; ++k) step(body, 0.01);
    assert_ok(sfem_body_grab_node(body, b.nodes - 1, &handle, &err), err);
    for (k = 0; k < 20; ++k) step(body, 0.01);
    hash = hash_reals(sfem_body_displacement(body), 3 * (size_t)b.nodes);
    sfem_body_free(body);
    sfem_model_free(b.model);
    return hash;
}

static void any_number_of_threads_gives_the_same_bits(void **state)
{
    static const int threads[] = {2, 3, 4, 8};
    sfem_exec one;
    uint64_t hash;
    size_t i;
    (void)state;
    memset(&one, 0, sizeof one);
    hash = run_with_threads(one);
    for (i = 0; i < TEST_COUNT(threads); ++i) {
        assert_true(run_with_threads(thread_exec(threads[i])) == hash);
#ifdef _OPENMP
        one.threads = threads[i];
        assert_true(run_with_threads(one) == hash);
#endif
    }
}

static void *run_one_body(void *argument)
{
    sfem_body *body = (sfem_body *)argument;
    int k, failed = 0;
    for (k = 0; k < 100; ++k)
        failed |= sfem_body_step(body, k < 50 ? 0.01 : 0.005, NULL) != SFEM_OK;
    return failed ? body : NULL;
}

static void two_threads_step_two_bodies_of_one_model(void **state)
{
    block b = make_block(4, 2, 2, SFEM_MASS_LUMPED, 0, 0.001, NULL);
    sfem_body_def def = exact_body_def();
    sfem_body *body[3];
    pthread_t thread[2];
    void *failed[2];
    int i;
    (void)state;
    def.gravity[0] = 4;
    for (i = 0; i < 3; ++i) body[i] = block_body(&b, def);
    for (i = 0; i < 2; ++i)
        assert_int_equal(pthread_create(thread + i, NULL, run_one_body, body[i]), 0);
    for (i = 0; i < 2; ++i) pthread_join(thread[i], failed + i);
    assert_null(failed[0]);
    assert_null(failed[1]);
    assert_null(run_one_body(body[2]));
    for (i = 0; i < 2; ++i)
        assert_memory_equal(sfem_body_displacement(body[i]), sfem_body_displacement(body[2]),
                            3 * (size_t)b.nodes * sizeof(sfem_real));
    for (i = 0; i < 3; ++i) sfem_body_free(body[i]);
    sfem_model_free(b.model);
}

static void mixed_precision_stays_within_its_stated_accuracy(void **state)
{
    block b = make_block(12, 3, 3, SFEM_MASS_LUMPED, 0, 0, NULL);
    sfem_body_def def = exact_body_def();
    sfem_body *exact, *mixed;
    int k;
    (void)state;
    def.gravity[1] = -9.81;
    exact = block_body(&b, def);
    def.precision = SFEM_MIXED;
    mixed = block_body(&b, def);
    for (k = 0; k < 200; ++k) {
        step(exact, 0.01);
        step(mixed, 0.01);
    }
    assert_all_near(sfem_body_displacement(exact), sfem_body_displacement(mixed), 3 * b.nodes, 1e-4,
                    0);
    assert_true(hash_reals(sfem_body_displacement(exact), 3 * (size_t)b.nodes) !=
                hash_reals(sfem_body_displacement(mixed), 3 * (size_t)b.nodes));
    sfem_body_free(exact);
    sfem_body_free(mixed);
    sfem_model_free(b.model);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(pqr_with_q_and_r_one_is_newmark),
        cmocka_unit_test(pqr_is_newmark_with_any_damping_matrix_too),
        cmocka_unit_test(a_step_equals_the_dense_solution_of_its_equation),
        cmocka_unit_test(radius_period_and_damping_are_those_of_the_table),
        cmocka_unit_test(damped_amplification_is_that_of_the_matrix),
        cmocka_unit_test(newmark_and_pqr_are_of_second_order),
        cmocka_unit_test(q_other_than_one_is_of_first_order_and_adds_mass),
        cmocka_unit_test(p_one_twelfth_is_of_fourth_order_in_displacement),
        cmocka_unit_test(p_chooses_itself_from_what_is_resolved),
        cmocka_unit_test(a_free_body_falls_at_g_and_at_a_third_of_it_for_r_three),
        cmocka_unit_test(momenta_of_a_stiff_free_body_are_what_its_loads_give),
        cmocka_unit_test(momentum_is_kept_from_when_a_body_is_let_go),
        cmocka_unit_test(the_conserved_energy_drifts_by_rounding_only),
        cmocka_unit_test(unconditional_stability_holds_at_any_step),
        cmocka_unit_test(the_stable_step_is_found_and_kept),
        cmocka_unit_test(a_change_of_step_keeps_the_order),
        cmocka_unit_test(three_parts_make_one_step_and_a_force_in_between_acts),
        cmocka_unit_test(a_force_that_is_not_finite_leaves_the_state_as_it_was),
        cmocka_unit_test(a_hundred_bodies_share_one_factor),
        cmocka_unit_test(without_allocation_an_unprepared_step_says_so),
        cmocka_unit_test(a_saved_state_continues_bit_for_bit),
        cmocka_unit_test(floats_for_rendering_are_the_positions_and_velocities),
        cmocka_unit_test(bad_definitions_are_refused),
        cmocka_unit_test(every_allocation_may_fail),
        cmocka_unit_test(any_number_of_threads_gives_the_same_bits),
        cmocka_unit_test(two_threads_step_two_bodies_of_one_model),
        cmocka_unit_test(mixed_precision_stays_within_its_stated_accuracy),
    };
    return run_all_tests(tests);
}
