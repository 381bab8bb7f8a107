/* How far (p,q,r) goes: springs and dampers that change under a constant factor, corrections up to the implicit
 * solution, a soft bar that swings. */
#include "support.h"
#include "linear.h"

static void step(sfem_body *body, double h)
{
    sfem_error err;
    assert_ok(sfem_body_step(body, h, &err), err);
}

/* --------------------------------------------------------------------------------------------
 * one degree of freedom whose spring and damper are not those of the factor
 * -------------------------------------------------------------------------------------------- */

typedef struct oscillator {
    sfem_model *model;
    sfem_body *body;
    double k, m;
} oscillator;

/* One tet of which node 1 may move along x only. */
static oscillator make_oscillator(sfem_body_def def)
{
    static sfem_real x[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
    static sfem_int tet[4] = {0, 1, 2, 3};
    static const sfem_int pins[4] = {0, 2, 3, 1};
    static const unsigned char axes[4] = {7, 7, 7, SFEM_AXIS_Y | SFEM_AXIS_Z};
    sfem_model_def model = linear_model_def();
    oscillator o;
    sfem_mesh mesh;
    sfem_error err;
    memset(&mesh, 0, sizeof mesh);
    mesh.nodes = 4;
    mesh.tets = 1;
    mesh.x = x;
    mesh.tet = tet;
    model.mesh = &mesh;
    assert_ok(sfem_model_create(&model, &o.model, &err), err);
    def.pins = pins;
    def.pin_axes = axes;
    def.pin_count = 4;
    assert_ok(sfem_body_create(o.model, &def, &o.body, &err), err);
    o.k = sfem_model_stiffness(o.model)->val[9 * 2];
    o.m = sfem_model_node_mass(o.model)[1];
    return o;
}

static void drop_oscillator(oscillator *o)
{
    sfem_body_free(o->body);
    sfem_model_free(o->model);
}

/* A law of slope 1 at rest that goes over to `ratio` within `knee`. */
static double bent(double x, double ratio, double knee)
{
    return ratio * x + (1 - ratio) * knee * tanh(x / knee);
}

/* The most that |u| exceeds its start by, where the spring is `spring` times k0 and the damper `damper` times d0
 * beyond the knee, at h = omega_h sqrt(m/k) and d0 = damping m/h. The difference to the body's own spring and
 * damper comes in through the right side. */
static double growth(double p, double q, double omega_h, double damping, double spring,
                     double damper, double knee, int steps)
{
    sfem_body_def def = sfem_default_body_def();
    double u[12] = {0}, before, most = 0, h;
    oscillator o;
    sfem_error err;
    int k;
    def.p = p;
    def.q = q;
    o = make_oscillator(def);
    h = omega_h * sqrt(o.m / o.k);
    drop_oscillator(&o);
    def.mass_damping = damping / h;
    o = make_oscillator(def);
    u[3] = 1;
    assert_ok(sfem_body_set_state(o.body, u, NULL, &err), err);
    before = u[3];
    for (k = 0; k < steps && most < 1e6; ++k) {
        const double now = sfem_body_displacement(o.body)[3], w = (now - before) / h;
        assert_ok(sfem_body_predict(o.body, h, &err), err);
        sfem_body_rhs(o.body)[3] -= o.k * (bent(now, spring, knee) - now) +
                                    def.mass_damping * o.m * (bent(w, damper, knee / h) - w);
        assert_ok(sfem_body_solve(o.body, &err), err);
        assert_ok(sfem_body_finish(o.body, &err), err);
        before = now;
        most = fmax(most, fabs(sfem_body_displacement(o.body)[3]));
    }
    drop_oscillator(&o);
    return most;
}

/* k_i/k_0 = 4 p where the step leaves the spring far behind [eq. 25 of the source]; at finite Omega the mass
 * adds 4 r/Omega^2. */
static void springs_may_harden_up_to_four_p(void **state)
{
    static const double p[] = {0.25, 0.3, 0.5, 1}, omega_h[] = {3, 1e3};
    size_t i, j;
    (void)state;
    for (i = 0; i < TEST_COUNT(p); ++i)
        for (j = 0; j < TEST_COUNT(omega_h); ++j) {
            const double limit = 4 * p[i] + 4 / (omega_h[j] * omega_h[j]);
            /* a spring that is harder, or softer, throughout */
            assert_true(growth(p[i], 1, omega_h[j], 0, .999 * limit, 1, 1e-9, 20000) < 100);
            assert_true(growth(p[i], 1, omega_h[j], 0, 1.001 * limit, 1, 1e-9, 20000) > 1e6);
            assert_true(growth(p[i], 1, omega_h[j], 0, 1e-3, 1, 1e-9, 20000) < 3e3);
            /* one that hardens, or softens, on the way */
            assert_true(growth(p[i], 1, omega_h[j], 0, .999 * limit, 1, 0.3, 20000) < 100);
            assert_true(growth(p[i], 1, omega_h[j], 0, 1.01 * limit, 1, 0.01, 20000) > 1e6);
            assert_true(growth(p[i], 1, omega_h[j], 0, 0.1, 1, 0.3, 20000) < 100);
        }
}

/* d_i/d_0 = q where the damper leaves the mass far behind; the mass adds 2 r/(h d_0/m). */
static void dampers_may_harden_up_to_q(void **state)
{
    static const double q[] = {1, 1.5, 3}, damping[] = {2, 1e4};
    size_t i, j;
    (void)state;
    for (i = 0; i < TEST_COUNT(q); ++i)
        for (j = 0; j < TEST_COUNT(damping); ++j) {
            const double limit = q[i] + 2 / damping[j], omega_h = 1e-2;
            assert_true(growth(.25, q[i], omega_h, damping[j], 1, .999 * limit, 1e-12, 20000) < 10);
            assert_true(growth(.25, q[i], omega_h, damping[j], 1, 1.002 * limit, 1e-12, 20000) >
                        1e3);
            assert_true(growth(.25, q[i], omega_h, damping[j], 1, .999 * limit, 1e-3, 20000) < 10);
            assert_true(growth(.25, q[i], omega_h, damping[j], 1, .01, 1e-3, 20000) < 10);
        }
}

/* Spring and damper at once: h^2 k_i + 2 h d_i <= 4 A. */
static void springs_and_dampers_share_what_there_is(void **state)
{
    const double p = .3, q = 1.2, omega_h = 20, damping = 50;
    const double room = 4 * p * omega_h * omega_h + 2 * q * damping + 4;
    double share;
    (void)state;
    for (share = 0.1; share < 1; share += 0.2) {
        const double spring = share * room / (omega_h * omega_h),
                     damper = (1 - share) * room / (2 * damping);
        assert_true(growth(p, q, omega_h, damping, .999 * spring, .999 * damper, 1e-9, 20000) <
                    100);
        assert_true(growth(p, q, omega_h, damping, 1.001 * spring, 1.001 * damper, 1e-9, 40000) >
                    1e6);
    }
}

/* --------------------------------------------------------------------------------------------
 * a bar
 * -------------------------------------------------------------------------------------------- */

enum { MAX_NODES = 200 };

typedef struct bar {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_int pins[16], pin_count, tip;
} bar;

/* A cantilever of 1 m, 5:1 at rest. */
static bar make_bar(sfem_int nx, sfem_int ny, double young, double alpha)
{
    const sfem_int cells[3] = {nx, ny, ny};
    const sfem_real size[3] = {1, 0.2, 0.2};
    sfem_model_def def = linear_model_def();
    sfem_error err;
    sfem_int i;
    bar b;
    memset(&b, 0, sizeof b);
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &b.mesh, &err), err);
    assert_true(b.mesh.nodes <= MAX_NODES);
    for (i = 0; i < b.mesh.nodes; ++i)
        if (b.mesh.x[3 * i] < 1e-9) b.pins[b.pin_count++] = i;
    b.tip = b.mesh.nodes - 1;
    def.mesh = &b.mesh;
    def.material.young = young;
    def.material.law = SFEM_COROTATIONAL;
    def.material.mass_damping = alpha;
    assert_ok(sfem_model_create(&def, &b.model, &err), err);
    return b;
}

static void drop_bar(bar *b)
{
    sfem_model_free(b->model);
    sfem_mesh_free(&b->mesh);
}

static sfem_body *bar_body(const bar *b, sfem_body_def def)
{
    sfem_body *body = NULL;
    sfem_error err;
    def.pins = b->pins;
    def.pin_count = b->pin_count;
    assert_ok(sfem_body_create(b->model, &def, &body, &err), err);
    return body;
}

/* Corrected to convergence, the two methods solve one equation: with a start from motion, mass damping and a load
 * that changes. (Stiffness damping differs: that of (p,q,r) turns with the frame.) */
static void corrected_to_convergence_it_is_implicit_newmark(void **state)
{
    bar b = make_bar(5, 1, 1e5, 0.5);
    const size_t n = 3 * (size_t)b.mesh.nodes;
    sfem_body_def def = sfem_default_body_def();
    sfem_real u[3 * MAX_NODES], v[3 * MAX_NODES], f[3 * MAX_NODES];
    sfem_body *body[2];
    double difference = 0, size = 0;
    sfem_error err;
    size_t i;
    int k, j;
    (void)state;
    def.gravity[2] = -9.81;
    def.safeguard = 0;
    def.accuracy = 1e-20;
    def.dissipation = 0;
    def.newton.tolerance = 1e-13;
    body[0] = bar_body(&b, def);
    def.integrator = SFEM_NEWMARK;
    body[1] = bar_body(&b, def);
    for (i = 0; i < n; ++i) {
        u[i] = 0;
        v[i] = i % 3 == 1 ? 2 * b.mesh.x[i - 1] * b.mesh.x[i - 1] : 0;
    }
    for (j = 0; j < 2; ++j) assert_ok(sfem_body_set_state(body[j], u, v, &err), err);
    for (k = 0; k < 60; ++k) {
        for (i = 0; i < n; ++i)
            f[i] = 0.3 * sin(0.2 * k + 0.1 * (double)i) - 0.3 * sin(0.1 * (double)i);
        for (j = 0; j < 2; ++j) {
            if (k == 0) sfem_body_start(body[j]);
            assert_ok(sfem_body_set_lasting_force(body[j], f, &err), err);
            step(body[j], 1.0 / 60);
        }
        assert_in_range(sfem_body_get_info(body[0]).corrections, 1,
                        39); /* 40 are the most that are made */
        for (i = 0; i < n; ++i) {
            const double x = sfem_body_displacement(body[1])[i];
            difference = fmax(difference, fabs(sfem_body_displacement(body[0])[i] - x));
            size = fmax(size, fabs(x));
        }
    }
    print_message("    difference %.2g of %.2g m\n", difference, size);
    assert_true(size > 0.3);
    assert_near(difference, 0, 0, 1e-9 * size);
    for (j = 0; j < 2; ++j) sfem_body_free(body[j]);
    drop_bar(&b);
}

enum { SAMPLES = 120 }; /* a sixtieth of a second apart */

/* The tip's path. */
static sfem_body_info swing(const bar *b, sfem_body_def def, int steps_a_sample,
                            double path[3 * SAMPLES])
{
    const double h = 1.0 / 60 / steps_a_sample;
    sfem_body *body;
    sfem_body_info info;
    int i, k;
    def.gravity[2] = -9.81;
    body = bar_body(b, def);
    for (i = 0; i < SAMPLES; ++i) {
        for (k = 0; k < steps_a_sample; ++k) step(body, h);
        memcpy(path + 3 * i, sfem_body_displacement(body) + 3 * b->tip, 3 * sizeof *path);
    }
    info = sfem_body_get_info(body);
    sfem_body_free(body);
    return info;
}

static double rms(const double *a, const double *b)
{
    double sum = 0;
    int i;
    for (i = 0; i < 3 * SAMPLES; ++i) sum += (a[i] - b[i]) * (a[i] - b[i]);
    return sqrt(sum / SAMPLES);
}

/* A soft bar let go: RMS error of the tip over 2 s, against central difference at 1/15360 s, over that of the
 * trapezoidal rule: by one solve, by default, and without dissipation to a higher accuracy. */
static void a_swinging_bar_is_nearly_as_good_as_by_newton(void **state)
{
    static const double young[3] = {2e5, 1e6, 1e5};
    static const int steps[3] = {1, 4, 16};
    static const double zero[3 * SAMPLES] = {0};
    double reference[3 * SAMPLES], path[3 * SAMPLES], error[4];
    size_t i, j;
    int k;
    (void)state;
    for (i = 0; i < (TEST_SANITIZED ? 1 : TEST_COUNT(young)); ++i) {
        bar b = make_bar(10, 2, young[i], 0);
        sfem_body_def def = sfem_default_body_def();
        double amplitude;
        def.integrator = SFEM_CENTRAL;
        swing(&b, def, 256, reference);
        amplitude = rms(reference, zero);
        for (j = 0; j < TEST_COUNT(steps); ++j) {
            int64_t rejected[3], solves[3];
            def = sfem_default_body_def();
            def.integrator = SFEM_NEWMARK;
            swing(&b, def, steps[j], path);
            error[3] = rms(path, reference);
            def.integrator = SFEM_PQR;
            for (k = 0; k < 3; ++k) {
                sfem_body_info info;
                def.accuracy = k == 0 ? 1 : k == 1 ? 1e-6 : 1e-12;
                def.dissipation = k < 2 ? 0.2 : 0;
                info = swing(&b, def, steps[j], path);
                error[k] = rms(path, reference);
                rejected[k] = info.rejected;
                solves[k] = info.solves;
            }
            print_message("    Y %.0e Pa, h 1/%d s: trapezoidal %.5f of %.2f m; one solve %.2f "
                          "times that (%d rejected), "
                          "default %.2f (%.2f solves a step), without dissipation %.3f\n",
                          young[i], 60 * steps[j], error[3], amplitude, error[0] / error[3],
                          (int)rejected[0], error[1] / error[3],
                          (double)solves[1] / (SAMPLES * steps[j]), error[2] / error[3]);
            assert_int_equal(rejected[1], 0);
            assert_int_equal(rejected[2], 0);
            assert_true(error[0] <= 2.5 * error[3]);
            assert_true(error[1] <= fmax(2 * error[3], 0.002 * amplitude));
            assert_true(error[2] <= 1.1 * error[3]);
        }
        drop_bar(&b);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(springs_may_harden_up_to_four_p),
        cmocka_unit_test(dampers_may_harden_up_to_q),
        cmocka_unit_test(springs_and_dampers_share_what_there_is),
        cmocka_unit_test(corrected_to_convergence_it_is_implicit_newmark),
        cmocka_unit_test(a_swinging_bar_is_nearly_as_good_as_by_newton),
    };
    return run_all_tests(tests);
}
