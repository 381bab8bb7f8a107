/* Modal bodies: the reduced model, oscillators, warping, handles, frames, views, blocks. */
#include "support.h"
#include "linear.h"

#define BEAM_MODES 20

typedef struct scene {
    sfem_model *model;
    sfem_modes modes;
    sfem_reduced *reduced;
    sfem_reduced_view *view; /* all nodes */
    sfem_int nodes, pins;
} scene;

/* A bar of six-tet cells along x, clamped at x = 0 or free. modes < 0: all of them. */
static scene make_bar(const sfem_int cells[3], sfem_real length, int clamped, sfem_int count,
                      sfem_law law, const sfem_reduced_def *given)
{
    const sfem_real size[3] = {length, 1, 1};
    sfem_model_def model_def = linear_model_def();
    sfem_modes_def modes_def = sfem_default_modes_def();
    sfem_reduced_def def = sfem_default_reduced_def();
    sfem_int pins[64], i;
    sfem_mesh mesh;
    sfem_error err;
    scene s;
    memset(&s, 0, sizeof s);
    if (given) def = *given;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_6_TETS, NULL, &mesh, &err), err);
    model_def.mesh = &mesh;
    model_def.material.law = law;
    assert_ok(sfem_model_create(&model_def, &s.model, &err), err);
    s.nodes = mesh.nodes;
    s.pins = clamped ? (cells[1] + 1) * (cells[2] + 1) : 0;
    for (i = 0; i < s.pins; ++i) pins[i] = i;
    modes_def.pins = pins;
    modes_def.pin_count = s.pins;
    modes_def.modes = count < 0 ? 3 * (s.nodes - s.pins) : count;
    modes_def.dense = count < 0;
    if (!clamped) def.free = 1;
    assert_ok(sfem_modes_create(s.model, &modes_def, &s.modes, &err), err);
    assert_ok(sfem_reduced_create(s.model, &s.modes, &def, &s.reduced, &err), err);
    assert_ok(sfem_reduced_view_create(s.reduced, 0, NULL, SFEM_DOUBLE, &s.view, &err), err);
    sfem_mesh_free(&mesh);
    return s;
}

static scene make_beam(int clamped)
{
    const sfem_int cells[3] = {10, 2, 2};
    return make_bar(cells, 5, clamped, BEAM_MODES, SFEM_LINEAR, NULL);
}

static void free_scene(scene *s)
{
    sfem_reduced_view_free(s->view);
    sfem_reduced_free(s->reduced);
    sfem_modes_free(&s->modes);
    sfem_model_free(s->model);
}

static sfem_modal *make_modal(const scene *s, const sfem_modal_def *def)
{
    sfem_modal *b = NULL;
    sfem_error err;
    assert_ok(sfem_modal_create(s->reduced, def, &b, &err), err);
    return b;
}

static sfem_modal *plain_modal(const scene *s, sfem_warp warp)
{
    sfem_modal_def def = sfem_default_modal_def();
    def.warp = warp;
    return make_modal(s, &def);
}

static void step(sfem_modal *b, double h)
{
    sfem_error err;
    assert_ok(sfem_modal_step(b, h, &err), err);
}

static double distance(const double *a, const double *b)
{
    return sqrt((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) +
                (a[2] - b[2]) * (a[2] - b[2]));
}

/* q with random entries whose modes move nodes by some `size` metres */
static void random_coordinates(const scene *s, test_random *random, double size, double *q)
{
    const sfem_reduced_info info = sfem_reduced_get_info(s->reduced);
    sfem_int k;
    for (k = 0; k < info.modes; ++k)
        q[k] = random_uniform(random, -1, 1) * size * sqrt(info.mass) / (1 + k);
}

/* --------------------------------------------------------------------------------------------
 * the reduced model
 * -------------------------------------------------------------------------------------------- */

/* Modes that are linear fields u = A X: Psi must be half their curl at every node. */
static void psi_is_half_the_curl_of_linear_fields(void **state)
{
    const sfem_int cells[3] = {3, 2, 2};
    sfem_modes_def modes_def = sfem_default_modes_def();
    sfem_reduced_def def = sfem_default_reduced_def();
    test_random random = {3};
    sfem_model_def model_def = linear_model_def();
    const sfem_real size[3] = {1.5, 1, 0.7};
    sfem_reduced *reduced;
    sfem_model *model;
    sfem_modes modes;
    sfem_mesh mesh;
    sfem_error err;
    double a[8][9], phi[24], psi[24];
    sfem_int i, k, m;
    int c;
    (void)state;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
    model_def.mesh = &mesh;
    assert_ok(sfem_model_create(&model_def, &model, &err), err);
    modes_def.modes = 2;
    modes_def.rigid = 1;
    assert_ok(sfem_modes_create(model, &modes_def, &modes, &err), err);
    m = modes.count;
    assert_int_equal(m, 8);
    for (k = 0; k < m; ++k) {
        random_fill(&random, a[k], 9, -1, 1);
        for (i = 0; i < mesh.nodes; ++i)
            for (c = 0; c < 3; ++c)
                modes.phi[3 * (k * mesh.nodes + i) + c] = a[k][3 * c] * mesh.x[3 * i] +
                                                          a[k][3 * c + 1] * mesh.x[3 * i + 1] +
                                                          a[k][3 * c + 2] * mesh.x[3 * i + 2];
    }
    def.free = 0;
    assert_ok(sfem_reduced_create(model, &modes, &def, &reduced, &err), err);
    for (i = 0; i < mesh.nodes; ++i) {
        sfem_reduced_node_modes(reduced, i, phi, psi);
        for (k = 0; k < m; ++k) {
            assert_near(psi[k], (a[k][7] - a[k][5]) / 2, 0, 1e-14);
            assert_near(psi[m + k], (a[k][2] - a[k][6]) / 2, 0, 1e-14);
            assert_near(psi[2 * m + k], (a[k][3] - a[k][1]) / 2, 0, 1e-14);
            assert_near(phi[k], modes.phi[3 * (k * mesh.nodes + i)], 0, 0);
        }
    }
    sfem_reduced_free(reduced);
    sfem_modes_free(&modes);
    sfem_model_free(model);
    sfem_mesh_free(&mesh);
}

static void what_does_not_belong_together_is_refused(void **state)
{
    const sfem_int cells[3] = {2, 1, 1};
    scene s = make_bar(cells, 2, 1, 5, SFEM_LINEAR, NULL), other = make_beam(1);
    sfem_reduced_def def = sfem_default_reduced_def();
    sfem_modal_def modal_def = sfem_default_modal_def();
    const double ratio[5] = {0.1, 0.1, -0.1, 0, 0};
    const sfem_int outside = s.nodes;
    sfem_reduced *reduced = NULL;
    sfem_reduced_view *view = NULL;
    sfem_modal *b = NULL;
    sfem_error err;
    double keep;
    (void)state;
    assert_status(sfem_reduced_create(other.model, &s.modes, &def, &reduced, &err), SFEM_MISMATCH);
    def.free = 1;
    assert_status(sfem_reduced_create(s.model, &s.modes, &def, &reduced, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "moves the body as a whole");
    def.free = -1;
    def.ratio = ratio;
    assert_status(sfem_reduced_create(s.model, &s.modes, &def, &reduced, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "mode 2");
    def.ratio = NULL;
    def.mass_damping = -1;
    assert_status(sfem_reduced_create(s.model, &s.modes, &def, &reduced, &err), SFEM_BAD_ARGUMENT);
    def.mass_damping = 0;
    keep = s.modes.phi[3 * s.nodes + 20];
    s.modes.phi[3 * s.nodes + 20] = NAN;
    assert_status(sfem_reduced_create(s.model, &s.modes, &def, &reduced, &err), SFEM_NOT_FINITE);
    assert_names(err, "mode 1");
    s.modes.phi[3 * s.nodes + 20] = keep;
    assert_status(sfem_reduced_view_create(s.reduced, 1, &outside, SFEM_DOUBLE, &view, &err),
                  SFEM_BAD_ARGUMENT);
    assert_int_equal(err.node, outside);
    modal_def.beta = 0;
    assert_status(sfem_modal_create(s.reduced, &modal_def, &b, &err), SFEM_BAD_ARGUMENT);
    modal_def.beta = 0.25;
    modal_def.tolerance = NAN;
    assert_status(sfem_modal_create(s.reduced, &modal_def, &b, &err), SFEM_NOT_FINITE);
    assert_null(reduced);
    assert_null(view);
    assert_null(b);
    free_scene(&s);
    free_scene(&other);
}

static void a_saved_model_moves_as_the_one_it_was_saved_from(void **state)
{
    scene s = make_beam(1);
    const size_t bytes = sfem_reduced_size(s.reduced);
    unsigned char *block = (unsigned char *)malloc(bytes);
    const double g[3] = {0, 0, -9.81}, f[3] = {3, 100, 0};
    sfem_modal *a = plain_modal(&s, SFEM_WARP_PATH), *b = NULL;
    sfem_modal_def def = sfem_default_modal_def();
    sfem_reduced_view *view;
    sfem_reduced *loaded;
    double *x = (double *)malloc(48 * (size_t)s.nodes), *y = x + 3 * s.nodes;
    sfem_error err;
    int i;
    (void)state;
    sfem_reduced_save(s.reduced, block);
    assert_ok(sfem_reduced_load(block, bytes, NULL, &loaded, &err), err);
    memset(block, 0, bytes);
    assert_ok(sfem_modal_create(loaded, &def, &b, &err), err);
    assert_ok(sfem_reduced_view_create(loaded, 0, NULL, SFEM_DOUBLE, &view, &err), err);
    sfem_reduced_free(loaded); /* body and view hold it */
    assert_ok(sfem_modal_set_gravity(a, g, &err), err);
    assert_ok(sfem_modal_set_gravity(b, g, &err), err);
    assert_ok(sfem_modal_add_lasting_force(a, s.nodes - 1, f, &err), err);
    assert_ok(sfem_modal_add_lasting_force(b, s.nodes - 1, f, &err), err);
    for (i = 0; i < 50; ++i) step(a, 0.01), step(b, 0.01);
    sfem_modal_positions(a, s.view, x);
    sfem_modal_positions(b, view, y);
    assert_memory_equal(x, y, 24 * (size_t)s.nodes);
    sfem_modal_free(a);
    sfem_modal_free(b);
    sfem_reduced_view_free(view);
    free(x);
    free(block);
    free_scene(&s);
}

static void damaged_blocks_are_refused(void **state)
{
    const sfem_int cells[3] = {1, 1, 1};
    scene s = make_bar(cells, 1, 1, 3, SFEM_LINEAR, NULL);
    const size_t bytes = sfem_reduced_size(s.reduced);
    sfem_modal *b = plain_modal(&s, SFEM_WARP_PATH);
    const size_t state_bytes = sfem_modal_state_size(b);
    unsigned char *block = (unsigned char *)malloc(bytes + state_bytes);
    sfem_reduced *loaded = NULL;
    sfem_error err;
    size_t i;
    (void)state;
    sfem_reduced_save(s.reduced, block);
    for (i = 0; i < bytes; ++i) {
        block[i] ^= (unsigned char)(1 << i % 8);
        assert_status(sfem_reduced_load(block, bytes, NULL, &loaded, &err), SFEM_FORMAT);
        block[i] ^= (unsigned char)(1 << i % 8);
    }
    for (i = 0; i < bytes; i += 37)
        assert_status(sfem_reduced_load(block, i, NULL, &loaded, &err), SFEM_FORMAT);
    assert_ok(sfem_reduced_load(block, bytes, NULL, &loaded, &err), err);
    sfem_reduced_free(loaded);
    sfem_modal_save_state(b, block);
    for (i = 0; i < state_bytes; ++i) {
        block[i] ^= (unsigned char)(1 << i % 8);
        assert_status(sfem_modal_load_state(b, block, state_bytes, &err), SFEM_FORMAT);
        block[i] ^= (unsigned char)(1 << i % 8);
    }
    assert_status(sfem_modal_load_state(b, block, state_bytes - 1, &err), SFEM_FORMAT);
    assert_ok(sfem_modal_load_state(b, block, state_bytes, &err), err);
    sfem_modal_free(b);
    free(block);
    free_scene(&s);
}

/* --------------------------------------------------------------------------------------------
 * integrators
 * -------------------------------------------------------------------------------------------- */

static void newmark_in_all_modes_is_newmark_in_full_space(void **state)
{
    const sfem_int cells[3] = {4, 1, 1};
    static const double parameter[2][2] = {{0.25, 0.5}, {0.3025, 0.6}};
    sfem_reduced_def reduced_def = sfem_default_reduced_def();
    scene s;
    sfem_int pins[4] = {0, 1, 2, 3};
    double force[60] = {0}, u[60];
    sfem_error err;
    int k, i;
    (void)state;
    reduced_def.mass_damping = 0.3;
    reduced_def.stiffness_damping = 0.002;
    s = make_bar(cells, 4, 1, -1, SFEM_LINEAR, &reduced_def);
    for (k = 0; k < 2; ++k) {
        sfem_body_def body_def = sfem_default_body_def();
        sfem_modal_def def = sfem_default_modal_def();
        sfem_body *body = NULL;
        sfem_modal *b;
        body_def.integrator = SFEM_NEWMARK;
        def.integrator = SFEM_MODAL_NEWMARK;
        body_def.beta = def.beta = parameter[k][0];
        body_def.gamma = def.gamma = parameter[k][1];
        body_def.mass_damping = 0.3;
        body_def.stiffness_damping = 0.002;
        body_def.pins = pins;
        body_def.pin_count = 4;
        body_def.gravity[2] = def.gravity[2] = -9.81;
        def.warp = SFEM_WARP_NONE;
        assert_ok(sfem_body_create(s.model, &body_def, &body, &err), err);
        b = make_modal(&s, &def);
        for (i = 0; i < 200; ++i) {
            /* by other parameters a body rescales its momentum where the step changes, modes do not */
            const double h = i < 100 || k ? 0.01 : 0.023;
            force[3 * 17 + 1] = 2000 * sin(0.1 * i);
            force[3 * 9] = i < 50 ? 500 : 0;
            assert_ok(sfem_body_set_lasting_force(body, force, &err), err);
            assert_ok(sfem_modal_set_lasting_force(b, force, &err), err);
            assert_ok(sfem_body_step(body, h, &err), err);
            step(b, h);
            sfem_modal_displacements(b, s.view, u);
            assert_all_near(u, sfem_body_displacement(body), 60, 1e-9, 0);
        }
        assert_near(sfem_modal_time(b), sfem_body_time(body), 1e-14, 0);
        sfem_modal_free(b);
        sfem_body_free(body);
    }
    free_scene(&s);
}

/* One mode whose lambda and c are set at will, its load linear in each step: q and q' by an independent
 * route, the exponential of the 4x4 matrix of (q, q', f, slope) in long double. */
static void exponential(long double lambda, long double c, long double h, long double e[4][4])
{
    long double a[4][4] = {{0, 1, 0, 0}, {-lambda, -c, 1, 0}, {0, 0, 0, 1}, {0, 0, 0, 0}}, t[4][4],
                p[4][4];
    int i, j, k, n, halvings = 0;
    while ((fabsl(lambda) + c + 2) * h > 0.25L) h /= 2, ++halvings;
    memset(e, 0, sizeof t);
    memset(t, 0, sizeof t);
    for (i = 0; i < 4; ++i) e[i][i] = t[i][i] = 1;
    for (n = 1; n < 30; ++n) {
        for (i = 0; i < 4; ++i)
            for (j = 0; j < 4; ++j)
                for (p[i][j] = 0, k = 0; k < 4; ++k) p[i][j] += t[i][k] * a[k][j] * h / n;
        memcpy(t, p, sizeof t);
        for (i = 0; i < 4; ++i)
            for (j = 0; j < 4; ++j) e[i][j] += t[i][j];
    }
    for (; halvings > 0; --halvings) {
        for (i = 0; i < 4; ++i)
            for (j = 0; j < 4; ++j)
                for (p[i][j] = 0, k = 0; k < 4; ++k) p[i][j] += e[i][k] * e[k][j];
        memcpy(e, p, sizeof p);
    }
}

/* A tet with one free axis is one oscillator; its modes are given lambda and c by hand. */
static sfem_reduced *one_oscillator(const scene *s, double lambda, double c)
{
    sfem_reduced_def def = sfem_default_reduced_def();
    sfem_modes modes = s->modes;
    sfem_reduced *r = NULL;
    sfem_error err;
    modes.count = 1;
    modes.lambda = &lambda;
    def.mass_damping = c;
    def.free = 0;
    assert_ok(sfem_reduced_create(s->model, &modes, &def, &r, &err), err);
    return r;
}

static void the_exact_oscillator_is_exact_at_any_step(void **state)
{
    static const double ratios[] = {0,         0.01,  0.3,  0.9, 0.999, 0.9999999, 1,
                                    1.0000001, 1.001, 1.05, 1.2, 3,     40};
    static const double omegas[] = {0, 1e-6, 1e-3, 0.1, 1, 7, 60};
    static const double steps[] = {1e-4, 0.03, 0.4, 1, 5};
    const sfem_int cells[3] = {1, 1, 1};
    scene s = make_bar(cells, 1, 1, 1, SFEM_LINEAR, NULL);
    sfem_modal_def def = sfem_default_modal_def();
    size_t i, j, k;
    (void)state;
    def.integrator = SFEM_MODAL_EXACT;
    def.warp = SFEM_WARP_NONE;
    for (i = 0; i < TEST_COUNT(omegas); ++i)
        for (j = 0; j < TEST_COUNT(ratios); ++j)
            for (k = 0; k < TEST_COUNT(steps); ++k) {
                const double omega = omegas[i], h = steps[k];
                const double c = omega > 0 ? 2 * ratios[j] * omega : ratios[j];
                sfem_reduced *r;
                long double e[4][4], y[4] = {0.7L, -0.4L, 0, 0}, z[4];
                double q = 0.7, v = -0.4, size, phi[3], force[3] = {0, 0, 0};
                sfem_modal *b = NULL;
                sfem_error err;
                int n, p, o;
                if ((omega + c) * h > 400) continue; /* the reference loses its digits */
                r = one_oscillator(&s, omega * omega, c);
                assert_ok(sfem_modal_create(r, &def, &b, &err), err);
                assert_ok(sfem_modal_set_coordinates(b, &q, &v, NULL, &err), err);
                sfem_reduced_node_modes(r, s.nodes - 1, phi, NULL);
                sfem_modal_start(b);
                exponential((long double)omega * omega, c, h, e);
                for (n = 0; n < 3; ++n) {
                    force[1] = 2.5 - n * n; /* at the end of the step */
                    assert_ok(sfem_modal_set_lasting_force(b, NULL, &err), err);
                    assert_ok(sfem_modal_add_lasting_force(b, s.nodes - 1, force, &err), err);
                    y[3] = ((long double)force[1] * phi[1] - y[2]) / h;
                    for (p = 0; p < 4; ++p)
                        for (z[p] = 0, o = 0; o < 4; ++o) z[p] += e[p][o] * y[o];
                    memcpy(y, z, sizeof y);
                    step(b, h);
                    size = 0.7 + 0.4 * fmin(h, 1 / fmax(omega, 1e-9)) + fabs(phi[1]) * h * h;
                    assert_near(sfem_modal_coordinates(b)[0], y[0], 1e-12, 3e-13 * size);
                    assert_near(sfem_modal_coordinate_velocities(b)[0], y[1], 1e-12,
                                3e-13 * (0.4 + 0.7 * omega + fabs(phi[1]) * h));
                }
                sfem_modal_free(b);
                sfem_reduced_free(r);
            }
    free_scene(&s);
}

/* no period error: free vibration is a cosine at any number of steps a period */
/* Free motion of one mode obeys q2 = S q1 - E q0 from step to step: with the fitted mass and damping E is e^-ch,
 * and of real roots S is exact, too, whatever h. What Newmark makes of a fast mode rings on. */
static void fitted_oscillators_die_as_the_exact_ones(void **state)
{
    const sfem_int cells[3] = {1, 1, 1};
    static const double omega_h[8] = {1e-2, 0.3, 1, 3, 30, 1e3, 1e4, 0};
    static const double xi[6] = {1e-3, 0.02, 0.3, 0.999999, 1.5, 40};
    scene s = make_bar(cells, 4, 1, -1, SFEM_LINEAR, NULL);
    const double h = 0.01, f = 3;
    int i, j, k;
    (void)state;
    for (i = 0; i < 8; ++i)
        for (j = 0; j < 6; ++j) {
            const double omega = omega_h[i] / h, c = omega > 0 ? 2 * xi[j] * omega : 2 * xi[j];
            const double root = sqrt(fabs(c * c / 4 - omega * omega)) * h, half = c * h / 2;
            sfem_reduced *r = one_oscillator(&s, omega * omega, c);
            sfem_modal_def def = sfem_default_modal_def();
            double q[5], q0 = 1, v0 = 0.1 * omega, load[3] = {0, 0, 0}, phi[3], most = 0;
            double wanted, sum, left;
            sfem_modal *b;
            sfem_error err;
            def.warp = SFEM_WARP_NONE;
            assert_ok(sfem_modal_create(r, &def, &b, &err), err);
            assert_ok(sfem_modal_set_coordinates(b, &q0, &v0, NULL, &err), err);
            for (k = 0; k < 5; ++k) {
                q[k] = sfem_modal_coordinates(b)[0];
                most = fmax(most, fabs(q[k]));
                step(b, h);
            }
            wanted = xi[j] < 1 && omega > 0
                         ? 2 * exp(-half) * (1 - root * root / 4) / (1 + root * root / 4)
                         : exp(-half + root) + exp(-half - root);
            left = q[2] - wanted * q[1] + exp(-2 * half) * q[0];
            assert_near(left, 0, 0, 1e-13 * most * fmax(1, omega_h[i]));
            /* under a load at rest at f/omega^2, all the same */
            if (omega > 0) {
                sfem_reduced_node_modes(r, s.nodes - 1, phi, NULL);
                for (k = 0; k < 3; ++k) load[k] = f * phi[k];
                sum = phi[0] * load[0] + phi[1] * load[1] + phi[2] * load[2];
                q0 = sum / (omega * omega), v0 = 0;
                assert_ok(sfem_modal_add_lasting_force(b, s.nodes - 1, load, &err), err);
                assert_ok(sfem_modal_set_coordinates(b, &q0, &v0, NULL, &err), err);
                for (k = 0; k < 20; ++k) step(b, k < 10 ? h : 3 * h);
                assert_near(sfem_modal_coordinates(b)[0], q0, 1e-9, 0);
            }
            sfem_modal_free(b);
            sfem_reduced_free(r);
        }
    free_scene(&s);
}

/* A fast mode with a tenth of critical damping, pulled and let go: dead at once, whether the step stays or
 * changes, whether it starts by itself or has been started for a step; but Newmark's rings on. */
static void fast_damped_modes_do_not_ring(void **state)
{
    const sfem_int cells[3] = {1, 1, 1};
    scene s = make_bar(cells, 4, 1, -1, SFEM_LINEAR, NULL);
    const double h = 0.01, omega = 1e3 / h, c = 0.2 * omega;
    sfem_reduced *r = one_oscillator(&s, omega * omega, c);
    int kind, k;
    (void)state;
    for (kind = 0; kind < 5; ++kind) {
        sfem_modal_def def = sfem_default_modal_def();
        double q = 1, v = 0, left;
        sfem_modal *b;
        sfem_error err;
        def.warp = SFEM_WARP_NONE;
        if (kind == 0) def.integrator = SFEM_MODAL_NEWMARK;
        if (kind > 2) def.h = h;
        assert_ok(sfem_modal_create(r, &def, &b, &err), err);
        assert_ok(sfem_modal_set_coordinates(b, &q, &v, NULL, &err), err);
        if (kind > 1) sfem_modal_start(b); /* 2: for no step */
        for (k = 0; k < 10; ++k) step(b, kind == 4 && k > 4 ? 2.7 * h : h);
        left = fabs(sfem_modal_coordinates(b)[0]);
        if (kind == 0)
            assert_true(left > 0.9);
        else
            assert_true(left < 1e-12);
        sfem_modal_free(b);
    }
    sfem_reduced_free(r);
    free_scene(&s);
}

/* Driven within the step's reach, both are of second order, and alike for little damping; without any they are
 * the same to the bit. (Fitted to its free motion, a mode of ratio 1 and more follows its load with twice the
 * error, of what is little to begin with.) */
static void fitted_oscillators_are_of_second_order(void **state)
{
    const sfem_int cells[3] = {1, 1, 1};
    static const double xi[5] = {0, 0.05, 0.3, 1, 4};
    scene s = make_bar(cells, 4, 1, -1, SFEM_LINEAR, NULL);
    int i, kind, level, k;
    (void)state;
    for (i = 0; i < 5; ++i) {
        const double omega = 10, c = 2 * xi[i] * omega;
        sfem_reduced *r = one_oscillator(&s, omega * omega, c);
        double off[2][3] = {{0}};
        for (kind = 0; kind < 2; ++kind)
            for (level = 0; level < 3; ++level) {
                const int count = 100 << level; /* omega h from .3 to .075 */
                sfem_modal_def def = sfem_default_modal_def();
                sfem_modal *b[2];
                double q0 = 1, v0 = -3, f[3] = {0, 0, 0};
                sfem_error err;
                def.warp = SFEM_WARP_NONE;
                def.integrator = kind ? SFEM_MODAL_FITTED : SFEM_MODAL_NEWMARK;
                assert_ok(sfem_modal_create(r, &def, &b[0], &err), err);
                def.integrator = SFEM_MODAL_EXACT;
                assert_ok(sfem_modal_create(r, &def, &b[1], &err), err);
                for (k = 0; k < 2; ++k)
                    assert_ok(sfem_modal_set_coordinates(b[k], &q0, &v0, NULL, &err), err);
                for (k = 0; k < count * 8; ++k) { /* the exact one takes eight to one */
                    f[2] = 300 * sin(7 * 3.0 * (k + 1) / (8 * count));
                    assert_ok(sfem_modal_set_lasting_force(b[1], NULL, &err), err);
                    assert_ok(sfem_modal_add_lasting_force(b[1], s.nodes - 1, f, &err), err);
                    step(b[1], 3.0 / (8 * count));
                    if (k % 8 != 7) continue;
                    assert_ok(sfem_modal_set_lasting_force(b[0], NULL, &err), err);
                    assert_ok(sfem_modal_add_lasting_force(b[0], s.nodes - 1, f, &err), err);
                    step(b[0], 3.0 / count);
                    off[kind][level] =
                        fmax(off[kind][level], fabs(sfem_modal_coordinates(b[0])[0] -
                                                    sfem_modal_coordinates(b[1])[0]));
                }
                sfem_modal_free(b[0]);
                sfem_modal_free(b[1]);
            }
        print_message("ratio %-4g  Newmark %.2e %.2e %.2e, fitted %.2e %.2e %.2e\n", xi[i],
                      off[0][0], off[0][1], off[0][2], off[1][0], off[1][1], off[1][2]);
        assert_near(off[1][1] / off[1][2], 4, 0.15, 0);
        assert_true(off[1][2] < (xi[i] < 0.2 ? 1.1 : 3) * off[0][2]);

        if (i == 0) assert_memory_equal(off[0], off[1], sizeof off[0]);
        sfem_reduced_free(r);
    }
    free_scene(&s);
}

static void the_exact_oscillator_has_no_period_error(void **state)
{
    scene s = make_beam(1);
    sfem_modal_def def = sfem_default_modal_def();
    const double omega = sqrt(s.modes.lambda[0]), h = 1.9 / omega;
    double q[BEAM_MODES] = {1};
    sfem_modal *b;
    sfem_error err;
    int i;
    (void)state;
    def.integrator = SFEM_MODAL_EXACT;
    b = make_modal(&s, &def);
    assert_ok(sfem_modal_set_coordinates(b, q, NULL, NULL, &err), err);
    for (i = 1; i <= 1000; ++i) {
        step(b, h);
        assert_near(sfem_modal_coordinates(b)[0], cos(1.9 * i), 0, 1e-12);
    }
    sfem_modal_free(b);
    free_scene(&s);
}

/* A receiver with the sender's accelerations has the sender's motion; with one of them zero, the
 * distortions of the source's theorem, to rounding. */
static void a_receiver_integrates_accelerations(void **state)
{
    scene s = make_beam(1);
    const double g[3] = {0, 0, -9.81};
    const double h = 1 / 60.0;
    sfem_modal *sender = plain_modal(&s, SFEM_WARP_PATH),
               *receiver = plain_modal(&s, SFEM_WARP_PATH);
    sfem_modal *lossy = plain_modal(&s, SFEM_WARP_PATH);
    const double zero[BEAM_MODES] = {0};
    double lost[BEAM_MODES] = {0};
    sfem_error err;
    int i, k;
    (void)state;
    assert_ok(sfem_modal_set_gravity(sender, g, &err), err);
    sfem_modal_start(sender);
    assert_ok(
        sfem_modal_set_coordinates(receiver, NULL, NULL, sfem_modal_coordinate_accelerations(sender), &err),
        err);
    assert_ok(sfem_modal_set_coordinates(lossy, NULL, NULL, sfem_modal_coordinate_accelerations(sender), &err),
              err);
    for (i = 0; i < 60; ++i) {
        const double *a = sfem_modal_coordinate_accelerations(sender);
        const sfem_modal_info info = sfem_modal_get_info(sender);
        step(sender, h);
        assert_ok(sfem_modal_step_with(receiver, a, h, info.beta, info.gamma, &err), err);
        assert_ok(sfem_modal_step_with(lossy, i == 20 ? zero : a, h, info.beta, info.gamma, &err),
                  err);
        if (i == 20) memcpy(lost, a, sizeof lost);
        for (k = 0; k < BEAM_MODES; ++k) {
            const double q = sfem_modal_coordinates(sender)[k],
                         v = sfem_modal_coordinate_velocities(sender)[k];
            const double dv = i < 20 ? 0 : i == 20 ? h / 2 * lost[k] : h * lost[k];
            const double dq = i < 20    ? 0
                              : i == 20 ? h * h / 4 * lost[k]
                                        : (i - 20) * h * h * lost[k];
            assert_near(sfem_modal_coordinates(receiver)[k], q, 1e-13, 1e-13);
            assert_near(sfem_modal_coordinate_velocities(receiver)[k], v, 1e-13, 1e-12);
            assert_near(q - sfem_modal_coordinates(lossy)[k], dq, 1e-12, 2e-13 * 30);
            assert_near(v - sfem_modal_coordinate_velocities(lossy)[k], dv, 1e-12, 2e-12 * 30);
        }
    }
    sfem_modal_free(sender);
    sfem_modal_free(receiver);
    sfem_modal_free(lossy);
    free_scene(&s);
}

static void sleeping_modes_stay_within_the_tolerance_and_wake(void **state)
{
    const double tolerance = 1e-4, h = 0.01, f[3] = {0, 30, 200};
    sfem_reduced_def reduced_def = sfem_default_reduced_def();
    const sfem_int cells[3] = {10, 2, 2};
    sfem_modal_def def = sfem_default_modal_def();
    sfem_modal *all, *some;
    double ratio[BEAM_MODES], *x, *y, worst = 0;
    sfem_int i, k, fewest = BEAM_MODES;
    sfem_error err;
    scene s;
    (void)state;
    for (k = 0; k < BEAM_MODES; ++k) ratio[k] = 0.3;
    reduced_def.ratio = ratio;
    s = make_bar(cells, 5, 1, BEAM_MODES, SFEM_LINEAR, &reduced_def);
    x = (double *)malloc(48 * (size_t)s.nodes);
    y = x + 3 * s.nodes;
    all = make_modal(&s, &def);
    def.tolerance = tolerance;
    some = make_modal(&s, &def);
    step(all, h), step(some, h);
    assert_int_equal(sfem_modal_get_info(all).awake,
                     0); /* at rest and unloaded: even without a tolerance */
    for (i = 0; i < 6000; ++i) {
        const int loaded = i % 3000 < 30;
        assert_ok(sfem_modal_set_lasting_force(all, NULL, &err), err);
        assert_ok(sfem_modal_set_lasting_force(some, NULL, &err), err);
        if (loaded) {
            assert_ok(sfem_modal_add_lasting_force(all, s.nodes - 1, f, &err), err);
            assert_ok(sfem_modal_add_lasting_force(some, s.nodes - 1, f, &err), err);
        }
        step(all, h), step(some, h);
        if (loaded) assert_true(sfem_modal_get_info(some).awake > 0);
        if (sfem_modal_get_info(some).awake < fewest) fewest = sfem_modal_get_info(some).awake;
        sfem_modal_positions(all, s.view, x);
        sfem_modal_positions(some, s.view, y);
        for (k = 0; k < s.nodes; ++k) worst = fmax(worst, distance(x + 3 * k, y + 3 * k));
    }
    assert_true(worst <= tolerance); /* swings of .1 m */
    assert_true(worst > 1e-8);       /* it did leave something out */
    assert_int_equal(fewest, 0);
    assert_int_equal(sfem_modal_get_info(some).drawn, 0);
    sfem_modal_free(all);
    sfem_modal_free(some);
    free(x);
    free_scene(&s);
}

/* --------------------------------------------------------------------------------------------
 * warping
 * -------------------------------------------------------------------------------------------- */

/* R and Rt by their definitions, in long steps of code: scaled products and a quadrature. */
static void reference_warp(sfem_warp warp, const double w[3], const double u[3], double out[3])
{
    static const double at[5] = {-0.9061798459386640, -0.5384693101056831, 0, 0.5384693101056831,
                                 0.9061798459386640};
    static const double share[5] = {0.2369268850561891, 0.4786286704993665, 0.5688888888888889,
                                    0.4786286704993665, 0.2369268850561891};
    const double th = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
    int piece, k, c;
    memset(out, 0, 3 * sizeof *out);
    if (warp == SFEM_WARP_NONE || th == 0) {
        memcpy(out, u, 3 * sizeof *out);
        return;
    }
    for (piece = 0; piece < (warp == SFEM_WARP_PATH ? 64 : 1); ++piece)
        for (k = 0; k < (warp == SFEM_WARP_PATH ? 5 : 1); ++k) { /* Gauss, or the end */
            const double t = warp == SFEM_WARP_PATH ? (piece + (1 + at[k]) / 2) / 64 : 1;
            const double part = warp == SFEM_WARP_PATH ? share[k] / 128 : 1;
            const double n[3] = {w[0] / th, w[1] / th, w[2] / th}, s = sin(t * th), o = cos(t * th);
            const double nu = n[0] * u[0] + n[1] * u[1] + n[2] * u[2];
            const double cross[3] = {n[1] * u[2] - n[2] * u[1], n[2] * u[0] - n[0] * u[2],
                                     n[0] * u[1] - n[1] * u[0]};
            for (c = 0; c < 3; ++c)
                out[c] += part * (o * u[c] + s * cross[c] + (1 - o) * nu * n[c]);
        }
}

static void multiply(const scene *s, sfem_int node, const double *q, double u[3], double w[3])
{
    double phi[3 * BEAM_MODES], psi[3 * BEAM_MODES];
    int c, k;
    sfem_reduced_node_modes(s->reduced, node, phi, psi);
    for (c = 0; c < 3; ++c)
        for (u[c] = w[c] = 0, k = 0; k < BEAM_MODES; ++k) {
            u[c] += phi[BEAM_MODES * c + k] * q[k];
            w[c] += psi[BEAM_MODES * c + k] * q[k];
        }
}

static void views_reconstruct_what_the_formulas_say(void **state)
{
    scene s = make_beam(1);
    const sfem_reduced_info info = sfem_reduced_get_info(s.reduced);
    static const double sizes[] = {0, 1e-9, 1e-3, 0.3, 3, 20};
    test_random random = {11};
    sfem_reduced_view *surface, *surface32, *few;
    sfem_int list[3] = {90, 7, 90}, i;
    double q[BEAM_MODES], u[3], w[3], want[3], *x = (double *)malloc(24 * (size_t)s.nodes);
    float *f = (float *)malloc(20 * (size_t)s.nodes);
    sfem_error err;
    size_t k;
    int warp, c, turned = 0;
    (void)state;
    assert_ok(sfem_reduced_view_surface(s.reduced, SFEM_DOUBLE, &surface, &err), err);
    assert_ok(sfem_reduced_view_surface(s.reduced, SFEM_MIXED, &surface32, &err), err);
    assert_ok(sfem_reduced_view_create(s.reduced, 3, list, SFEM_DOUBLE, &few, &err), err);
    assert_int_equal(sfem_reduced_view_count(surface), info.surface_nodes);
    for (warp = 0; warp < 3; ++warp) {
        sfem_modal *b = plain_modal(&s, (sfem_warp)warp);
        for (k = 0; k < TEST_COUNT(sizes); ++k) {
            random_coordinates(&s, &random, sizes[k], q);
            assert_ok(sfem_modal_set_coordinates(b, q, NULL, NULL, &err), err);
            sfem_modal_displacements(b, s.view, x);
            for (i = 0; i < s.nodes; ++i) {
                multiply(&s, i, q, u, w);
                turned |= sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]) > 3.5;
                reference_warp((sfem_warp)warp, w, u, want);
                for (c = 0; c < 3; ++c) assert_near(x[3 * i + c], want[c], 0, 2e-13 * sizes[k] * 5);
                sfem_modal_node(b, i, u, NULL, w);
                for (c = 0; c < 3; ++c)
                    assert_near(u[c], info.x[3 * i + c] + want[c], 0,
                                1e-14 * (10 + 100 * sizes[k]));
            }
            sfem_modal_positions(b, few, x);
            sfem_modal_node(b, 7, u, NULL, NULL);
            assert_true(distance(u, x + 3) <= 1e-14 * (10 + 100 * sizes[k]));
            assert_memory_equal(x, x + 6, 3 * sizeof *x);
            sfem_modal_positions(b, surface, x);
            sfem_modal_to_floats(b, surface32, f, 20);
            for (i = 0; i < info.surface_nodes; ++i) {
                sfem_modal_node(b, info.surface_node[i], u, NULL, NULL);
                assert_true(distance(u, x + 3 * i) <= 1e-14 * (10 + 100 * sizes[k]));
                for (c = 0; c < 3; ++c)
                    assert_near(f[5 * i + c], u[c], 0, 1e-6 * (5 + 20 * sizes[k]));
            }
        }
        sfem_modal_free(b);
    }
    assert_true(turned); /* also beyond the reach of the polynomial */
    sfem_reduced_view_free(surface);
    sfem_reduced_view_free(surface32);
    sfem_reduced_view_free(few);
    free(x);
    free(f);
    free_scene(&s);
}

static void velocities_are_the_rate_of_positions(void **state)
{
    scene s[2];
    test_random random = {5};
    double q[BEAM_MODES], v[BEAM_MODES], moved[BEAM_MODES], x[2][3], rate[3], unused[3];
    sfem_error err;
    int warp, free_body, k, c, side;
    (void)state;
    s[0] = make_beam(1);
    s[1] = make_beam(0);
    for (free_body = 0; free_body < 2; ++free_body)
        for (warp = 0; warp < 3; ++warp) {
            const double h = 1e-5, tip = 90;
            sfem_modal *b = plain_modal(&s[free_body], (sfem_warp)warp);
            for (k = 0; k < 4; ++k) {
                random_coordinates(&s[free_body], &random, k == 3 ? 10 : 0.5 * k, q);
                random_coordinates(&s[free_body], &random, 1, v);
                assert_ok(sfem_modal_set_coordinates(b, q, v, NULL, &err), err);
                sfem_modal_node(b, (sfem_int)tip, unused, rate, NULL);
                for (side = 0; side < 2; ++side) {
                    for (c = 0; c < BEAM_MODES; ++c) moved[c] = q[c] + (side ? h : -h) * v[c];
                    assert_ok(sfem_modal_set_coordinates(b, moved, v, NULL, &err), err);
                    sfem_modal_node(b, (sfem_int)tip, x[side], NULL, NULL);
                }
                for (c = 0; c < 3; ++c)
                    assert_near(rate[c], (x[1][c] - x[0][c]) / (2 * h), 1e-6, 1e-7);
            }
            sfem_modal_free(b);
        }
    free_scene(&s[0]);
    free_scene(&s[1]);
}

/* The bar of the source: 10 x 1 x 1, 24 x 3 x 3 cells, E = 1e6, nu = .3, 30 modes, hung from its end with its
 * weight spread as the mass is; errors are RMS distances to the nonlinear solution of the same mesh. */
typedef struct hanging {
    scene s;
    double *force, *exact, *u;
} hanging;

static hanging make_hanging(void)
{
    const sfem_int cells[3] = {24, 3, 3};
    hanging g;
    g.s = make_bar(cells, 10, 1, 30, SFEM_STVK, NULL);
    g.force = (double *)calloc(9 * (size_t)g.s.nodes, sizeof(double));
    g.exact = g.force + 3 * g.s.nodes;
    g.u = g.exact + 3 * g.s.nodes;
    return g;
}

static void free_hanging(hanging *g)
{
    free(g->force);
    free_scene(&g->s);
}

static double mean_drop(const hanging *g, const double *u) /* of the end face */
{
    double drop = 0;
    sfem_int i;
    for (i = g->s.nodes - 16; i < g->s.nodes; ++i) drop -= u[3 * i + 2] / 16;
    return drop;
}

static double hang(hanging *g, double weight)
{
    const double *mass = sfem_model_node_mass(g->s.model);
    sfem_body_def def = sfem_default_body_def();
    sfem_int pins[16], i;
    sfem_body *body = NULL;
    sfem_error err;
    for (i = 0; i < 16; ++i) pins[i] = i;
    def.pins = pins;
    def.pin_count = 16;
    for (i = 0; i < g->s.nodes; ++i)
        g->force[3 * i + 2] = -weight * mass[i] / sfem_model_total_mass(g->s.model);
    assert_ok(sfem_body_create(g->s.model, &def, &body, &err), err);
    assert_ok(sfem_body_set_lasting_force(body, g->force, &err), err);
    assert_ok(sfem_body_solve_static(body, &err), err);
    memcpy(g->exact, sfem_body_displacement(body), 24 * (size_t)g->s.nodes);
    sfem_body_free(body);
    return mean_drop(g, g->exact);
}

static double hang_warped(hanging *g, sfem_warp warp)
{
    sfem_modal *b = plain_modal(&g->s, warp);
    double sum = 0;
    sfem_error err;
    sfem_int i;
    assert_ok(sfem_modal_set_lasting_force(b, g->force, &err), err);
    assert_ok(sfem_modal_solve_static(b, NULL, &err), err);
    sfem_modal_displacements(b, g->s.view, g->u);
    for (i = 0; i < g->s.nodes; ++i) sum += pow(distance(g->u + 3 * i, g->exact + 3 * i), 2);
    sfem_modal_free(b);
    return sqrt(sum / g->s.nodes);
}

/* length of the axis of the bar */
static double axis_length(const scene *s, const double *u)
{
    const double *x = sfem_model_mesh(s->model)->x;
    double length = 0, last[3] = {0, 0, 0};
    sfem_int i;
    int c, k;
    for (i = 0; i < s->nodes; i += 16) {
        double middle[3] = {0, 0, 0};
        for (k = 0; k < 16; ++k)
            for (c = 0; c < 3; ++c) middle[c] += (x[3 * (i + k) + c] + u[3 * (i + k) + c]) / 16;
        if (i) length += distance(middle, last);
        memcpy(last, middle, sizeof last);
    }
    return length;
}

static void warping_errors_are_those_of_the_theory(void **state)
{
    static const double weight[3] = {2000, 5000, 10000}, drop[3] = {1.91, 4.21, 6.42};
    static const double error[3][3] = {
        {0.108, 0.143, 0.022}, {0.638, 0.693, 0.130}, {2.20, 1.66, 0.369}};
    static const double digits[3] = {0.0005, 0.0005, 0.005};
    hanging g = make_hanging();
    int i, w;
    (void)state;
    for (i = 0; i < 3; ++i) {
        assert_near(hang(&g, weight[i]), drop[i], 0, 0.0051);
        for (w = 0; w < 3; ++w)
            assert_near(hang_warped(&g, (sfem_warp)w), error[i][w], 0,
                        w == 2 ? 0.00051 : 1.01 * digits[i]);
    }
    free_hanging(&g);
}

static void a_warped_bar_keeps_its_length(void **state)
{
    hanging g = make_hanging();
    (void)state;
    assert_near(hang(&g, 4650), 4, 0, 0.03); /* 40 % of its length */
    assert_near(axis_length(&g.s, g.exact), 10, 0.001, 0);
    hang_warped(&g, SFEM_WARP_PATH);
    assert_near(axis_length(&g.s, g.u), 10, 0.015, 0);
    hang_warped(&g, SFEM_WARP_NONE); /* what warping is for */
    assert_true(axis_length(&g.s, g.u) > 11);
    free_hanging(&g);
}

static void a_bar_bent_too_far_is_told(void **state)
{
    hanging g = make_hanging();
    sfem_modal *b = plain_modal(&g.s, SFEM_WARP_PATH);
    sfem_modal_static_info info;
    double q[30];
    sfem_error err;
    sfem_int i;
    (void)state;
    for (i = 0; i < g.s.nodes; ++i) g.force[3 * i + 2] = -1000000.0 / g.s.nodes;
    assert_ok(sfem_modal_set_lasting_force(b, g.force, &err), err);
    memset(q, 0, sizeof q);
    assert_status(sfem_modal_solve_static(b, &info, &err), SFEM_NOT_CONVERGED);
    assert_true(info.iterations > 1 && info.iterations <= 200);
    assert_memory_equal(sfem_modal_coordinates(b), q, sizeof q);
    sfem_modal_free(b);
    free_hanging(&g);
}

/* gravity by groups of nodes against each node for itself, where groups matter most */
static void gravity_in_groups_is_nearly_gravity_on_nodes(void **state)
{
    hanging g = make_hanging();
    const double a[3] = {0, 0, -5000 / sfem_model_total_mass(g.s.model)};
    sfem_modal *b = plain_modal(&g.s, SFEM_WARP_PATH);
    sfem_error err;
    sfem_int i;
    double worst = 0;
    (void)state;
    hang(&g, 5000);
    hang_warped(&g, SFEM_WARP_PATH);
    assert_ok(sfem_modal_set_gravity(b, a, &err), err);
    assert_ok(sfem_modal_solve_static(b, NULL, &err), err);
    sfem_modal_displacements(b, g.s.view, g.exact);
    for (i = 0; i < g.s.nodes; ++i) worst = fmax(worst, distance(g.u + 3 * i, g.exact + 3 * i));
    assert_true(worst < 0.01); /* the tip is 4 m down; warping's own error is .13 */
    sfem_modal_free(b);
    free_hanging(&g);
}

/* --------------------------------------------------------------------------------------------
 * handles
 * -------------------------------------------------------------------------------------------- */

static sfem_int grab(sfem_modal *b, sfem_int node)
{
    sfem_int handle = -1;
    sfem_error err;
    assert_ok(sfem_modal_grab_node(b, node, &handle, &err), err);
    return handle;
}

static void move_by(sfem_modal *b, sfem_int handle, const double from[3], double dx, double dy,
                    double dz)
{
    const double target[3] = {from[0] + dx, from[1] + dy, from[2] + dz};
    sfem_error err;
    assert_ok(sfem_modal_move_handle(b, handle, target, &err), err);
}

static void a_handle_holds_its_node_at_its_target(void **state)
{
    scene s[2];
    int kind, warp, i;
    (void)state;
    s[0] = make_beam(1);
    s[1] = make_beam(0);
    for (kind = 0; kind < 2; ++kind)
        for (warp = 0; warp < 3; ++warp) {
            sfem_modal_def def = sfem_default_modal_def();
            double x0[3], x[3], worst = 0;
            sfem_int handle;
            sfem_modal *b;
            def.warp = (sfem_warp)warp;
            def.compliance = 0;
            b = make_modal(&s[kind], &def);
            handle = grab(b, s[kind].nodes - 1);
            sfem_modal_handle_position(b, handle, x0);
            for (i = 0; i < 120; ++i) {
                const double t = fmin(i / 60.0, 1),
                             r = 1.5 * t * t * (3 - 2 * t); /* a third of its length */
                move_by(b, handle, x0, -r * r / 5, 0.2 * r, r);
                step(b, 1 / 60.0);
                sfem_modal_node(b, s[kind].nodes - 1, x, NULL, NULL);
                worst = fmax(worst, sfem_modal_get_info(b).handle_residual);
                assert_int_equal(sfem_modal_get_info(b).handle_rows_left, 0);
            }
            assert_near(x[2] - x0[2], 1.5, 0, kind || warp ? 1e-6 : 1e-13);
            assert_true(worst < (kind || warp ? 1e-5 : 1e-13));
            sfem_modal_free(b);
        }
    free_scene(&s[0]);
    free_scene(&s[1]);
}

/* With the source's rows f_q = J^T l on the modes, -l on nodes, related by Phi^T Rt^T f (R, I); and what
 * the modes feel is the residual of their equation of motion. */
static void the_force_of_a_frozen_handle_is_that_of_the_turned_nodes(void **state)
{
    scene s = make_beam(1);
    const sfem_int region[3] = {97, 98, 96};
    const double weight[3] = {0.5, 0.2, 0.3}, g[3] = {0, 1, -9.81};
    int warp, i, j, k, c;
    (void)state;
    for (warp = 0; warp < 3; ++warp) {
        sfem_modal_def def = sfem_default_modal_def();
        sfem_modal *b;
        double x0[2][3], load[BEAM_MODES], got[2][BEAM_MODES], want[2][BEAM_MODES], f[2][3];
        sfem_int handle[2];
        sfem_error err;
        def.warp = (sfem_warp)warp;
        def.frozen_rotations = 1;
        b = make_modal(&s, &def);
        /* turned loads would have to be known at the end of the step */
        if (!warp) assert_ok(sfem_modal_set_gravity(b, g, &err), err);
        for (i = 0; i < 20; ++i) step(b, 0.01);
        handle[0] = grab(b, s.nodes - 1);
        assert_ok(sfem_modal_grab_region(b, 3, region, weight, &handle[1], &err), err);
        for (j = 0; j < 2; ++j) sfem_modal_handle_position(b, handle[j], x0[j]);
        for (i = 1; i <= 200; ++i) {
            double before[BEAM_MODES];
            memcpy(before, sfem_modal_coordinates(b), sizeof before);
            for (j = 0; j < 2; ++j)
                move_by(b, handle[j], x0[j], 0, 0.001 * i, i < 150 ? 0.004 * i : 0.6);
            sfem_modal_load(b, load);
            step(b, 0.01);
            for (k = 0; k < BEAM_MODES; ++k) { /* A q'' + ... = load + sum of handles */
                const double left = sfem_modal_coordinate_accelerations(b)[k] +
                                    s.modes.lambda[k] * sfem_modal_coordinates(b)[k];
                double sum = load[k];
                sfem_modal_handle_modal_force(b, handle[0], got[0]);
                sfem_modal_handle_modal_force(b, handle[1], got[1]);
                sum += got[0][k] + got[1][k];
                assert_near(left, sum, 1e-9, 1e-9 * (1 + fabs(load[k])));
            }
        }
        for (j = 0; j < 2; ++j) {
            const sfem_int tip = s.nodes - 1;
            const sfem_int *node = j ? region : &tip;
            sfem_modal_handle_force(b, handle[j], f[j]);
            memset(want[j], 0, sizeof want[j]);
            for (i = 0; i < (j ? 3 : 1); ++i) {
                double phi[3 * BEAM_MODES], u[3], w[3], column[3], e[3], image[3];
                sfem_reduced_node_modes(s.reduced, node[i], phi, NULL);
                multiply(&s, node[i], sfem_modal_coordinates(b), u, w);
                for (k = 0; k < BEAM_MODES; ++k) {
                    for (c = 0; c < 3; ++c) column[c] = phi[BEAM_MODES * c + k];
                    memcpy(e, column, sizeof e);
                    reference_warp((sfem_warp)warp, w, e, image);
                    for (c = 0; c < 3; ++c) want[j][k] += (j ? weight[i] : 1) * f[j][c] * image[c];
                }
            }
            /* at rest by now, so the rotations of the last solve are those of q */
            assert_all_near(got[j], want[j], BEAM_MODES, 1e-3, 0);
        }
        /* pulled up, the hand pulls up */
        assert_true(f[0][2] + f[1][2] > 0);
        sfem_modal_free(b);
    }
    free_scene(&s);
}

/* What a hand does to the modes is its force times the derivative of the place that it holds, which
 * differences of that place give; in motion, too, it is what is missing in their equation. */
static void the_force_of_a_handle_is_work_conjugate(void **state)
{
    scene s = make_beam(1);
    const sfem_int region[3] = {97, 98, 96};
    const double weight[3] = {0.5, 0.2, 0.3};
    int warp, i, k, c;
    (void)state;
    for (warp = 0; warp < 3; ++warp) {
        sfem_modal *b = plain_modal(&s, (sfem_warp)warp), *other = plain_modal(&s, (sfem_warp)warp);
        double x0[3], f[3], got[BEAM_MODES], q[BEAM_MODES], x[2][3], size = 0;
        sfem_int handle, probe;
        sfem_error err;
        assert_ok(sfem_modal_grab_region(b, 3, region, weight, &handle, &err), err);
        assert_ok(sfem_modal_grab_region(other, 3, region, weight, &probe, &err), err);
        sfem_modal_handle_position(b, handle, x0);
        for (i = 1; i <= 100; ++i) {
            move_by(b, handle, x0, -0.002 * i, 0.004 * i, 0.01 * i);
            step(b, 0.01);
            sfem_modal_handle_modal_force(b, handle, got);
            for (k = 0; k < BEAM_MODES; ++k)
                assert_near(sfem_modal_coordinate_accelerations(b)[k] +
                                s.modes.lambda[k] * sfem_modal_coordinates(b)[k],
                            got[k], 1e-9, 1e-9);
        }
        assert_ok(sfem_modal_solve_static(b, NULL, &err), err);
        sfem_modal_handle_force(b, handle, f);
        sfem_modal_handle_modal_force(b, handle, got);
        memcpy(q, sfem_modal_coordinates(b), sizeof q);
        for (k = 0; k < BEAM_MODES; ++k) size = fmax(size, fabs(got[k]));
        for (k = 0; k < BEAM_MODES; ++k) {
            const double d = 1e-4, keep = q[k];
            double want = 0;
            for (i = 0; i < 2; ++i) {
                q[k] = keep + (i ? d : -d);
                assert_ok(sfem_modal_set_coordinates(other, q, NULL, NULL, &err), err);
                sfem_modal_handle_position(other, probe, x[i]);
            }
            q[k] = keep;
            for (c = 0; c < 3; ++c) want += f[c] * (x[1][c] - x[0][c]) / (2 * d);
            assert_near(got[k], want, 0, 1e-8 * size); /* d^2, and rounding over d */
        }
        sfem_modal_free(other);
        sfem_modal_free(b);
    }
    free_scene(&s);
}

/* Under turned loads, too, the error of Newmark and of the exact oscillators falls with the square of the step. */
static void warped_motion_is_of_second_order(void **state)
{
    scene s = make_beam(1);
    const double g[3] = {0, 0.3, -1};
    int kind, level, i, k;
    (void)state;
    for (kind = 0; kind < 2; ++kind) {
        double end[3][BEAM_MODES], coarse = 0, fine = 0;
        for (level = 0; level < 3; ++level) {
            const int count = level == 2 ? 6400 : 200 << level;
            sfem_modal_def def = sfem_default_modal_def();
            sfem_modal *b;
            sfem_error err;
            def.integrator = (sfem_modal_integrator)kind;
            b = make_modal(&s, &def);
            assert_ok(sfem_modal_set_gravity(b, g, &err), err);
            for (i = 0; i < count; ++i) step(b, 4.0 / count);
            memcpy(end[level], sfem_modal_coordinates(b), sizeof end[level]);
            sfem_modal_free(b);
        }
        for (k = 0; k < 3; ++k) { /* those that the step resolves */
            coarse += pow(end[0][k] - end[2][k], 2);
            fine += pow(end[1][k] - end[2][k], 2);
        }
        assert_near(sqrt(coarse / fine), 4, 0.15, 0);
    }
    free_scene(&s);
}

/* A body pulled slowly by a third of its length: the work of the hand, and of its force on the modes, is
 * the change of energy. */
static void the_work_of_a_hand_goes_into_the_body(void **state)
{
    scene s = make_beam(1);
    int warp, i, c, k;
    (void)state;
    for (warp = 0; warp < 3; ++warp) {
        sfem_modal *b = plain_modal(&s, (sfem_warp)warp);
        const double x0[3] = {5, 1, 1};
        double work = 0, hand = 0, f[3], last[3] = {0, 0, 0}, at[3], before[3];
        double fq[BEAM_MODES], last_fq[BEAM_MODES] = {0}, q[BEAM_MODES] = {0};
        const sfem_int handle = grab(b, s.nodes - 1);
        sfem_error err;
        sfem_modal_handle_position(b, handle, before);
        for (i = 1; i <= 400; ++i) {
            move_by(b, handle, x0, 0, 0, 1.5 * i / 400);
            assert_ok(sfem_modal_solve_static(b, NULL, &err), err);
            sfem_modal_handle_force(b, handle, f);
            sfem_modal_handle_position(b, handle, at);
            sfem_modal_handle_modal_force(b, handle, fq);
            for (c = 0; c < 3; ++c) hand += (f[c] + last[c]) / 2 * (at[c] - before[c]);
            for (k = 0; k < BEAM_MODES; ++k)
                work += (fq[k] + last_fq[k]) / 2 * (sfem_modal_coordinates(b)[k] - q[k]);
            memcpy(last, f, sizeof f);
            memcpy(last_fq, fq, sizeof fq);
            memcpy(before, at, sizeof at);
            memcpy(q, sfem_modal_coordinates(b), sizeof q);
        }
        assert_near(hand, sfem_modal_get_info(b).elastic, 1e-5, 0);
        assert_near(work, sfem_modal_get_info(b).elastic, 1e-5, 0);
        assert_true(hand > 0);
        sfem_modal_free(b);
    }
    free_scene(&s);
}

static double largest_displacement(const sfem_modal *b, const scene *s)
{
    double *u = (double *)malloc(24 * (size_t)s->nodes), most = 0;
    const double zero[3] = {0, 0, 0};
    sfem_int i;
    sfem_modal_displacements(b, s->view, u);
    for (i = 0; i < s->nodes; ++i) most = fmax(most, distance(u + 3 * i, zero));
    free(u);
    return most;
}

/* Seven nodes side by side, each target off by 1 % of the pull at random: the source's system asks modes for
 * thousands of metres; the compliance gives the pull. */
static void noisy_handles_are_eased_by_compliance(void **state)
{
    scene s = make_beam(1);
    int soft, i, k;
    (void)state;
    for (soft = 0; soft < 3; ++soft) {
        test_random random = {21};
        sfem_modal_def def = sfem_default_modal_def();
        double x0[3];
        sfem_int handle;
        sfem_modal *b;
        sfem_error err;
        def.warp = soft < 2 ? SFEM_WARP_NONE : SFEM_WARP_PATH;
        if (soft == 0) def.compliance = 1e-14;
        b = make_modal(&s, &def);
        for (k = 0; k < 7; ++k) {
            handle = grab(b, s.nodes - 1 - k);
            sfem_modal_handle_position(b, handle, x0);
            move_by(b, handle, x0, 0.001 * random_normal(&random), 0.001 * random_normal(&random),
                    0.1 + 0.001 * random_normal(&random));
        }
        assert_ok(sfem_modal_solve_static(b, NULL, &err), err);
        if (soft)
            assert_near(largest_displacement(b, &s), 0.104, 0.15, 0);
        else
            assert_true(largest_displacement(b, &s) > 1);
        /* and in motion, with new noise at each step */
        for (i = 0; soft && i < 100; ++i) {
            for (k = 0; k < 7; ++k) {
                const double *x = sfem_reduced_get_info(s.reduced).x + 3 * (s.nodes - 1 - k);
                move_by(b, k, x, 0.001 * random_normal(&random), 0.001 * random_normal(&random),
                        0.1 + 0.001 * random_normal(&random));
            }
            step(b, 0.02);
            assert_true(largest_displacement(b, &s) < 1);
        }
        sfem_modal_free(b);
    }
    free_scene(&s);
}

/* The same noise in every step, however short: what it makes the body swing with does not grow as steps shrink.
 * (Constraints hold noise at v = noise/h.) A free body, too. */
static void noise_does_not_grow_as_steps_shrink(void **state)
{
    scene s[2];
    int kind, level, i, k, c;
    (void)state;
    s[0] = make_beam(1);
    s[1] = make_beam(0);
    for (kind = 0; kind < 2; ++kind) {
        double swing[3], omega = sqrt(sfem_reduced_get_info(s[kind].reduced).lambda[0]);
        for (level = 0; level < 3; ++level) {
            test_random random = {5};
            const double h = 0.3 / omega * pow(0.1, level);
            sfem_modal_def def = sfem_default_modal_def();
            double x0[7][3];
            sfem_int handle[7];
            sfem_modal *b = make_modal(&s[kind], &def);
            for (k = 0; k < 7; ++k) {
                handle[k] = grab(b, s[kind].nodes - 1 - k);
                sfem_modal_handle_position(b, handle[k], x0[k]);
            }
            for (swing[level] = 0, i = 0; i < 400; ++i) {
                double noise[3];
                for (k = 0; k < 7; ++k) {
                    for (c = 0; c < 3; ++c) noise[c] = 0.001 * random_normal(&random);
                    move_by(b, handle[k], x0[k], noise[0], noise[1], noise[2]);
                }
                step(b, h);
                if (i >= 100) swing[level] += sfem_modal_get_info(b).kinetic / 300;
            }
            sfem_modal_free(b);
        }
        print_message("%s: kinetic energy %.3g, steps a tenth %.3g, a hundredth %.3g\n",
                      kind ? "free" : "held", swing[0], swing[1], swing[2]);
        assert_true(swing[1] < 10 * swing[0] && swing[2] < 10 * swing[0]);
    }
    free_scene(&s[0]);
    free_scene(&s[1]);
}

/* far more rows than modes, nodes held several times and by targets that contradict, and a fixed one */
static void handles_in_any_number_stay_finite(void **state)
{
    scene s = make_beam(1);
    sfem_modal_def def = sfem_default_modal_def();
    sfem_int handle[24], i, k;
    double x0[24][3], f[3];
    sfem_modal *b;
    sfem_error err;
    (void)state;
    def.max_handles = 24;
    b = make_modal(&s, &def);
    for (k = 0; k < 24; ++k) {
        handle[k] = grab(b, k < 23 ? s.nodes - 1 - k % 9 : 0);
        sfem_modal_handle_position(b, handle[k], x0[k]);
        move_by(b, handle[k], x0[k], 0, 0.01 * (k % 4), 0.2);
    }
    assert_status(sfem_modal_grab_node(b, 50, &i, &err), SFEM_FULL);
    for (i = 0; i < 200; ++i) step(b, 0.02);
    assert_true(largest_displacement(b, &s) <
                2); /* what least squares make of it without warping, too */
    sfem_modal_handle_force(b, handle[23], f); /* cannot follow, and pulls nobody's hand */
    assert_true(f[0] == 0 && f[1] == 0 && f[2] == 0);
    assert_int_equal(sfem_modal_get_info(b).handle_rows_left, 3);
    for (k = 0; k < 24; ++k) sfem_modal_release_handle(b, handle[k]);
    for (i = 0; i < 100; ++i) step(b, 0.02);
    assert_true(largest_displacement(b, &s) < 6);
    sfem_modal_free(b);
    free_scene(&s);
}

/* without compliance the dependent rows are left out */
static void redundant_handles_without_compliance_are_finite(void **state)
{
    scene s = make_beam(1);
    sfem_modal_def def = sfem_default_modal_def();
    sfem_int handle[10], i, k;
    double x[3];
    sfem_modal *b;
    (void)state;
    def.compliance = 0;
    b = make_modal(&s, &def);
    for (k = 0; k < 10; ++k) handle[k] = grab(b, k % 3 ? s.nodes - 1 - k : s.nodes - 1);
    for (i = 0; i < 60; ++i) {
        for (k = 0; k < 10; ++k) {
            sfem_modal_handle_position(b, handle[k], x);
            move_by(b, handle[k], x, 0, 0, 1e-4);
        }
        step(b, 0.02);
    }
    assert_true(sfem_modal_get_info(b).handle_rows_left >= 10);
    sfem_modal_free(b);
    free_scene(&s);
}

/* accelerations of the grabbed node of a moving body: largest in the last fifth over the first */
static double ringing(const scene *s, double beta, double gamma, double compliance,
                      sfem_modal_integrator integrator)
{
    sfem_modal_def def = sfem_default_modal_def();
    double early = 0, late = 0, a[3], x[3];
    double phi[3 * BEAM_MODES];
    sfem_modal *b;
    sfem_error err;
    int i, c, k;
    def.warp = SFEM_WARP_NONE;
    def.handle_beta = beta;
    def.handle_gamma = gamma;
    def.compliance = compliance;
    def.integrator = integrator;
    b = make_modal(s, &def);
    assert_ok(sfem_modal_add_lasting_force(b, 50, (const double[3]){0, 3000, 9000}, &err), err);
    for (i = 0; i < 30; ++i) step(b, 0.01);
    assert_ok(sfem_modal_set_lasting_force(b, NULL, &err), err);
    grab(b, s->nodes - 1);
    sfem_reduced_node_modes(s->reduced, s->nodes - 1, phi, NULL);
    for (i = 0; i < 1000; ++i) {
        step(b, 0.01);
        for (c = 0; c < 3; ++c)
            for (a[c] = 0, k = 0; k < BEAM_MODES; ++k)
                a[c] += phi[BEAM_MODES * c + k] * sfem_modal_coordinate_accelerations(b)[k];
        if (i < 10) early = fmax(early, sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]));
        if (i >= 800) late = fmax(late, sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]));
    }
    sfem_modal_node(b, s->nodes - 1, x, NULL, NULL);
    (void)x;
    sfem_modal_free(b);
    return late / early;
}

static void a_moving_node_that_is_grabbed_does_not_ring(void **state)
{
    scene s = make_beam(1);
    const double bad = ringing(&s, 0.25, 0.5, 0, SFEM_MODAL_NEWMARK);
    int kind;
    (void)state;
    for (kind = 0; kind < 3; ++kind) { /* of that, 100 eps or so is what the hand itself gives */
        const double tight = ringing(&s, 0.3025, 0.6, 1e-5, (sfem_modal_integrator)kind);
        const double soft = ringing(&s, 0.3025, 0.6, 1e-4, (sfem_modal_integrator)kind);
        print_message(
            "|J q''| late over early: (1/4, 1/2), no hand %.3g; default %.3g, tighter %.3g\n", bad,
            soft, tight);
        assert_true(tight < 0.01 && soft < 0.02);
    }
    assert_true(bad > 10);
    free_scene(&s);
}

static void grabbing_takes_the_velocity_of_the_node_alone(void **state)
{
    scene s = make_beam(1);
    const double g[3] = {0, 0, -9.81};
    sfem_modal_def def = sfem_default_modal_def();
    double v[3], before[3], other[3], p[3];
    sfem_modal *b;
    sfem_error err;
    int i;
    (void)state;
    def.compliance = 0;
    def.warp = SFEM_WARP_NONE;
    b = make_modal(&s, &def);
    assert_ok(sfem_modal_set_gravity(b, g, &err), err);
    for (i = 0; i < 30; ++i) step(b, 0.01);
    sfem_modal_node(b, 50, p, before, NULL);
    grab(b, s.nodes - 1);
    sfem_modal_node(b, s.nodes - 1, p, v, NULL);
    sfem_modal_node(b, 50, p, other, NULL);
    assert_true(fabs(v[0]) + fabs(v[1]) + fabs(v[2]) < 1e-12);
    assert_true(fabs(other[2]) > 0.1 * fabs(before[2]));
    sfem_modal_free(b);
    free_scene(&s);
}

/* --------------------------------------------------------------------------------------------
 * free bodies
 * -------------------------------------------------------------------------------------------- */

static void a_tumbling_body_keeps_its_momenta(void **state)
{
    scene s = make_beam(0);
    const sfem_reduced_info info = sfem_reduced_get_info(s.reduced);
    int integrator, i, c;
    (void)state;
    assert_int_equal(info.free, 1);
    for (integrator = 0; integrator < 2; ++integrator) {
        sfem_modal_def def = sfem_default_modal_def();
        sfem_rigid rigid;
        double p0[3], l0[3], p[3], l[3], e0, worst = 0, product[9];
        sfem_modal *b;
        sfem_error err;
        def.integrator = (sfem_modal_integrator)integrator;
        b = make_modal(&s, &def);
        rigid = sfem_modal_rigid(b);
        rigid.v[0] = 1, rigid.v[2] = 2;
        rigid.w[0] = 0.7, rigid.w[1] = 5, rigid.w[2] = 1;
        assert_ok(sfem_modal_set_rigid(b, &rigid, &err), err);
        sfem_modal_momentum(b, p0, l0);
        e0 = sfem_modal_get_info(b).kinetic;
        for (i = 0; i < 2000; ++i) {
            step(b, 1 / 60.0);
            worst = fmax(worst, fabs(sfem_modal_get_info(b).kinetic / e0 - 1));
        }
        sfem_modal_momentum(b, p, l);
        assert_all_near(p, p0, 3, 1e-14, 0);
        assert_all_near(l, l0, 3, 1e-14, 0);
        assert_true(worst < 0.01);
        rigid = sfem_modal_rigid(b);
        assert_near(rigid.x[0], info.centre[0] + 2000 / 60.0, 1e-12, 0);
        for (i = 0; i < 3; ++i)
            for (c = 0; c < 3; ++c)
                product[3 * i + c] = rigid.r[3 * i] * rigid.r[3 * c] +
                                     rigid.r[3 * i + 1] * rigid.r[3 * c + 1] +
                                     rigid.r[3 * i + 2] * rigid.r[3 * c + 2];
        for (i = 0; i < 9; ++i) assert_near(product[i], i % 4 == 0, 0, 1e-14);
        sfem_modal_free(b);
    }
    free_scene(&s);
}

/* second order against a fine solution, and falling is exact */
static void the_frame_turns_and_falls_right(void **state)
{
    scene s = make_beam(0);
    const double g[3] = {0, 0, -10};
    double end[3][9];
    int level, i, c;
    (void)state;
    for (level = 0; level < 3; ++level) {
        const int count = level == 2 ? 4096 : 64 << level;
        sfem_modal *b = plain_modal(&s, SFEM_WARP_NONE);
        sfem_rigid rigid = sfem_modal_rigid(b);
        sfem_error err;
        rigid.w[0] = 1, rigid.w[1] = 3, rigid.w[2] = -0.5;
        assert_ok(sfem_modal_set_rigid(b, &rigid, &err), err);
        assert_ok(sfem_modal_set_gravity(b, g, &err), err);
        for (i = 0; i < count; ++i) step(b, 1.0 / count);
        rigid = sfem_modal_rigid(b);
        memcpy(end[level], rigid.r, sizeof rigid.r);
        assert_near(rigid.x[2], sfem_reduced_get_info(s.reduced).centre[2] - 5, 0, 1e-12);
        assert_near(rigid.v[2], -10, 1e-13, 0);
        sfem_modal_free(b);
    }
    {
        double coarse = 0, fine = 0;
        for (c = 0; c < 9; ++c) {
            coarse = fmax(coarse, fabs(end[0][c] - end[2][c]));
            fine = fmax(fine, fabs(end[1][c] - end[2][c]));
        }
        assert_near(coarse / fine, 4, 0.05, 0);
        assert_true(fine < 1e-3);
    }
    free_scene(&s);
}

/* a central push moves the frame, an eccentric one turns it, too; the modes feel both in the frame */
static void loads_on_a_free_body_move_its_frame(void **state)
{
    scene s = make_beam(0);
    const sfem_reduced_info info = sfem_reduced_get_info(s.reduced);
    const double f[3] = {0, 0, 100};
    sfem_modal *b = plain_modal(&s, SFEM_WARP_PATH);
    double p[3], l[3];
    sfem_error err;
    int i;
    (void)state;
    assert_ok(sfem_modal_add_lasting_force(b, s.nodes - 1, f, &err), err);
    for (i = 0; i < 10; ++i) step(b, 0.001);
    sfem_modal_momentum(b, p, l);
    assert_near(p[2], 1, 1e-12, 0);
    assert_near(l[1], -(info.x[3 * (s.nodes - 1)] - info.centre[0]) * 1, 1e-3, 0);
    assert_true(sfem_modal_get_info(b).elastic > 0);
    sfem_modal_free(b);
    free_scene(&s);
}

/* --------------------------------------------------------------------------------------------
 * state, memory, threads
 * -------------------------------------------------------------------------------------------- */

static void a_loaded_state_goes_on_as_the_saved_one(void **state)
{
    scene s[2];
    int kind, i;
    (void)state;
    s[0] = make_beam(1);
    s[1] = make_beam(0);
    for (kind = 0; kind < 2; ++kind) {
        sfem_modal_def def = sfem_default_modal_def();
        sfem_modal *a, *b;
        const double f[3] = {10, 20, -300};
        double x0[3];
        sfem_int handle;
        size_t bytes;
        void *block;
        sfem_error err;
        def.tolerance = 1e-6;
        a = make_modal(&s[kind], &def);
        b = make_modal(&s[kind], &def);
        bytes = sfem_modal_state_size(a);
        block = malloc(bytes);
        assert_ok(sfem_modal_add_lasting_force(a, 50, f, &err), err);
        assert_ok(sfem_modal_add_lasting_force(b, 20, f, &err), err);
        for (i = 0; i < 20; ++i) step(a, 0.01);
        handle = grab(a, s[kind].nodes - 1);
        sfem_modal_handle_position(a, handle, x0);
        move_by(a, handle, x0, 0.1, 0, 0.1);
        step(b, 0.02);
        step(a, 0.01);
        sfem_modal_save_state(a, block);
        assert_ok(sfem_modal_load_state(b, block, bytes, &err), err);
        for (i = 0; i < 20; ++i) {
            step(a, 0.01), step(b, 0.01);
            if (i == 10) sfem_modal_release_handle(a, handle), sfem_modal_release_handle(b, handle);
        }
        assert_memory_equal(sfem_modal_coordinates(a), sfem_modal_coordinates(b),
                            BEAM_MODES * sizeof(double));
        free(block);
        sfem_modal_free(a);
        sfem_modal_free(b);
    }
    {
        sfem_modal *a = plain_modal(&s[0], SFEM_WARP_PATH), *b = plain_modal(&s[1], SFEM_WARP_PATH);
        void *block = malloc(sfem_modal_state_size(a));
        sfem_error err;
        sfem_modal_save_state(a, block);
        assert_status(sfem_modal_load_state(b, block, sfem_modal_state_size(a), &err),
                      SFEM_MISMATCH);
        free(block);
        sfem_modal_free(a);
        sfem_modal_free(b);
    }
    free_scene(&s[0]);
    free_scene(&s[1]);
}

static void a_step_that_fails_leaves_the_state(void **state)
{
    scene s = make_beam(1);
    sfem_modal *b = plain_modal(&s, SFEM_WARP_NONE);
    double q[BEAM_MODES], bad[BEAM_MODES] = {0};
    const double huge[3] = {1e308, 1e308, 1e308}, not_a_number[3] = {0, NAN, 0},
                 small[3] = {0, 0, 1};
    sfem_error err;
    int i;
    (void)state;
    assert_ok(sfem_modal_add_lasting_force(b, 97, small, &err), err);
    for (i = 0; i < 5; ++i) step(b, 0.01);
    memcpy(q, sfem_modal_coordinates(b), sizeof q);
    assert_status(sfem_modal_step(b, 0, &err), SFEM_BAD_ARGUMENT);
    assert_status(sfem_modal_step(b, NAN, &err), SFEM_BAD_ARGUMENT);
    assert_status(sfem_modal_add_lasting_force(b, 97, not_a_number, &err), SFEM_NOT_FINITE);
    bad[3] = INFINITY;
    assert_status(sfem_modal_step_with(b, bad, 0.01, 0.25, 0.5, &err), SFEM_NOT_FINITE);
    assert_status(sfem_modal_set_coordinates(b, bad, NULL, NULL, &err), SFEM_NOT_FINITE);
    assert_ok(sfem_modal_add_lasting_force(b, 90, huge, &err), err);
    assert_status(sfem_modal_add_lasting_force(b, 90, huge, &err), SFEM_NOT_FINITE);
    assert_ok(sfem_modal_set_lasting_force(b, NULL, &err), err);
    bad[3] = 0;
    bad[BEAM_MODES - 1] = 1e308; /* times lambda is too much */
    assert_ok(sfem_modal_set_coordinates(b, bad, NULL, NULL, &err), err);
    assert_status(sfem_modal_step(b, 0.01, &err), SFEM_NOT_FINITE);
    assert_memory_equal(bad, sfem_modal_coordinates(b), sizeof q);
    assert_ok(sfem_modal_set_coordinates(b, q, NULL, NULL, &err), err);
    assert_memory_equal(q, sfem_modal_coordinates(b), sizeof q);
    assert_near(sfem_modal_time(b), 0.05, 1e-14, 0);
    assert_ok(sfem_modal_set_lasting_force(b, NULL, &err), err);
    step(b, 0.01);
    sfem_modal_free(b);
    free_scene(&s);
}

static sfem_status build_and_grab(sfem_allocator allocator, void *user, sfem_error *err)
{
    scene *s = (scene *)user;
    sfem_reduced_def reduced_def = sfem_default_reduced_def();
    sfem_modal_def def = sfem_default_modal_def();
    sfem_reduced *reduced = NULL, *loaded = NULL;
    sfem_reduced_view *view = NULL;
    sfem_modal *b = NULL;
    void *block = NULL;
    sfem_int handle;
    sfem_status status;
    reduced_def.allocator = def.allocator = allocator;
    status = sfem_reduced_create(s->model, &s->modes, &reduced_def, &reduced, err);
    if (status == SFEM_OK) {
        block = malloc(sfem_reduced_size(reduced));
        sfem_reduced_save(reduced, block);
        status = sfem_reduced_load(block, sfem_reduced_size(reduced), &allocator, &loaded, err);
    }
    if (status == SFEM_OK) status = sfem_reduced_view_surface(loaded, SFEM_MIXED, &view, err);
    if (status == SFEM_OK) status = sfem_modal_create(loaded, &def, &b, err);
    if (status == SFEM_OK) status = sfem_modal_grab_node(b, s->nodes - 1, &handle, err);
    free(block);
    sfem_modal_free(b);
    sfem_reduced_view_free(view);
    sfem_reduced_free(loaded);
    sfem_reduced_free(reduced);
    return status;
}

static void failed_allocations_leave_nothing_behind(void **state)
{
    scene s = make_beam(1);
    (void)state;
    assert_true(fail_every_allocation(build_and_grab, &s) > 10);
    free_scene(&s);
}

static void stepping_and_grabbing_allocate_nothing(void **state)
{
    scene s = make_beam(1);
    test_memory memory = {0};
    sfem_modal_def def = sfem_default_modal_def();
    const double g[3] = {0, 0, -9.81};
    double *x = (double *)malloc(24 * (size_t)s.nodes);
    sfem_modal *b;
    size_t calls;
    sfem_error err;
    int i;
    (void)state;
    def.allocator = test_allocator(&memory);
    b = make_modal(&s, &def);
    calls = memory.calls;
    assert_ok(sfem_modal_set_gravity(b, g, &err), err);
    for (i = 0; i < 20; ++i) {
        const sfem_int handle = grab(b, s.nodes - 1 - i);
        step(b, 0.01);
        sfem_modal_positions(b, s.view, x);
        if (i % 2) sfem_modal_release_handle(b, handle);
    }
    assert_int_equal(memory.calls, calls);
    sfem_modal_free(b);
    assert_no_leak(memory);
    free(x);
    free_scene(&s);
}

static void reconstruction_has_the_same_bits_for_any_number_of_threads(void **state)
{
    const sfem_int cells[3] = {30, 4, 4};
    scene s = make_bar(cells, 8, 1, 6, SFEM_LINEAR, NULL);
    const double g[3] = {0, 1, -9.81};
    uint64_t first = 0;
    double *x = (double *)malloc(24 * (size_t)s.nodes);
    sfem_int threads;
    (void)state;
    for (threads = 1; threads <= 4; ++threads) {
        sfem_modal_def def = sfem_default_modal_def();
        sfem_modal *b;
        sfem_error err;
        int i;
        def.exec = thread_exec(threads);
        b = make_modal(&s, &def);
        assert_ok(sfem_modal_set_gravity(b, g, &err), err);
        for (i = 0; i < 10; ++i) step(b, 0.02);
        sfem_modal_positions(b, s.view, x);
        if (threads == 1) first = hash_reals(x, 3 * (size_t)s.nodes);
        assert_true(first == hash_reals(x, 3 * (size_t)s.nodes));
        sfem_modal_free(b);
    }
    free(x);
    free_scene(&s);
}

/* Modes without pins, rigid ones left out as by default: the body is free, and falls. With pins it is held. */
static void a_body_of_modes_without_pins_is_free(void **state)
{
    const sfem_int cells[3] = {4, 1, 1}, pins[4] = {0, 1, 2, 3};
    const sfem_real size[3] = {4, 1, 1};
    int pinned, k;
    (void)state;
    for (pinned = 0; pinned < 2; ++pinned) {
        sfem_model_def model_def = linear_model_def();
        sfem_modes_def modes_def = sfem_default_modes_def();
        sfem_reduced_def reduced_def = sfem_default_reduced_def();
        sfem_modal_def def = sfem_default_modal_def();
        sfem_mesh mesh;
        sfem_model *model;
        sfem_modes modes;
        sfem_reduced *reduced;
        sfem_modal *modal;
        sfem_error err;
        sfem_real x[3];
        assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
        model_def.mesh = &mesh;
        assert_ok(sfem_model_create(&model_def, &model, &err), err);
        modes_def.modes = 4;
        if (pinned) modes_def.pins = pins, modes_def.pin_count = 4;
        assert_ok(sfem_modes_create(model, &modes_def, &modes, &err), err);
        assert_int_equal(modes.info.free, !pinned);
        assert_int_equal(modes.rigid, 0);
        assert_ok(sfem_reduced_create(model, &modes, &reduced_def, &reduced, &err), err);
        assert_int_equal(sfem_reduced_get_info(reduced).free, !pinned);
        def.gravity[2] = -10;
        assert_ok(sfem_modal_create(reduced, &def, &modal, &err), err);
        for (k = 0; k < 100; ++k) assert_ok(sfem_modal_step(modal, 0.01, &err), err);
        sfem_modal_node(modal, 0, x, NULL, NULL);
        if (pinned) assert_near(x[2], 0, 0, 1e-12);
        else assert_near(x[2], -5, 0.05, 0);
        sfem_modal_free(modal);
        sfem_reduced_free(reduced);
        sfem_modes_free(&modes);
        sfem_model_free(model);
        sfem_mesh_free(&mesh);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_body_of_modes_without_pins_is_free),
        cmocka_unit_test(psi_is_half_the_curl_of_linear_fields),
        cmocka_unit_test(what_does_not_belong_together_is_refused),
        cmocka_unit_test(a_saved_model_moves_as_the_one_it_was_saved_from),
        cmocka_unit_test(damaged_blocks_are_refused),
        cmocka_unit_test(newmark_in_all_modes_is_newmark_in_full_space),
        cmocka_unit_test(the_exact_oscillator_is_exact_at_any_step),
        cmocka_unit_test(fitted_oscillators_die_as_the_exact_ones),
        cmocka_unit_test(fast_damped_modes_do_not_ring),
        cmocka_unit_test(fitted_oscillators_are_of_second_order),
        cmocka_unit_test(the_exact_oscillator_has_no_period_error),
        cmocka_unit_test(a_receiver_integrates_accelerations),
        cmocka_unit_test(sleeping_modes_stay_within_the_tolerance_and_wake),
        cmocka_unit_test(views_reconstruct_what_the_formulas_say),
        cmocka_unit_test(velocities_are_the_rate_of_positions),
        cmocka_unit_test(warping_errors_are_those_of_the_theory),
        cmocka_unit_test(a_warped_bar_keeps_its_length),
        cmocka_unit_test(a_bar_bent_too_far_is_told),
        cmocka_unit_test(gravity_in_groups_is_nearly_gravity_on_nodes),
        cmocka_unit_test(a_handle_holds_its_node_at_its_target),
        cmocka_unit_test(the_force_of_a_frozen_handle_is_that_of_the_turned_nodes),
        cmocka_unit_test(the_force_of_a_handle_is_work_conjugate),
        cmocka_unit_test(the_work_of_a_hand_goes_into_the_body),
        cmocka_unit_test(warped_motion_is_of_second_order),
        cmocka_unit_test(noisy_handles_are_eased_by_compliance),
        cmocka_unit_test(noise_does_not_grow_as_steps_shrink),
        cmocka_unit_test(handles_in_any_number_stay_finite),
        cmocka_unit_test(redundant_handles_without_compliance_are_finite),
        cmocka_unit_test(a_moving_node_that_is_grabbed_does_not_ring),
        cmocka_unit_test(grabbing_takes_the_velocity_of_the_node_alone),
        cmocka_unit_test(a_tumbling_body_keeps_its_momenta),
        cmocka_unit_test(the_frame_turns_and_falls_right),
        cmocka_unit_test(loads_on_a_free_body_move_its_frame),
        cmocka_unit_test(a_loaded_state_goes_on_as_the_saved_one),
        cmocka_unit_test(a_step_that_fails_leaves_the_state),
        cmocka_unit_test(failed_allocations_leave_nothing_behind),
        cmocka_unit_test(stepping_and_grabbing_allocate_nothing),
        cmocka_unit_test(reconstruction_has_the_same_bits_for_any_number_of_threads),
    };
    return run_all_tests(tests);
}
