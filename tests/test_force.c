/* Forces that act during one step alone: they change the momentum by f h, in every method, whatever becomes of the step. */
#include "support.h"
#include "blocks.h"
#include "linear.h"

enum { MAX_NODES = 128 };

typedef struct bar {
    sfem_mesh mesh;
    sfem_model *model;
} bar;

static bar make_bar(sfem_law law, sfem_mass mass, double damping)
{
    static const sfem_int cells[3] = {5, 1, 1};
    static const sfem_real size[3] = {1, 0.2, 0.2};
    sfem_model_def def = sfem_default_model_def();
    uint64_t random = 7;
    sfem_error err;
    bar b;
    assert_ok(block_mesh(cells, size, 0.02, &random, &b.mesh, &err), err);
    assert_true(b.mesh.nodes <= MAX_NODES);
    def.mesh = &b.mesh;
    def.mass = mass;
    def.material.young = 1e5;
    def.material.law = law;
    def.material.stiffness_damping = damping;
    assert_ok(sfem_model_create(&def, &b.model, &err), err);
    return b;
}

static void drop_bar(bar *b)
{
    sfem_model_free(b->model);
    sfem_mesh_free(&b->mesh);
}

static sfem_body *make_body(const bar *b, const sfem_body_def *def)
{
    sfem_body *body = NULL;
    sfem_error err;
    assert_ok(sfem_body_create(b->model, def, &body, &err), err);
    return body;
}

/* sum m v */
static void momentum(const bar *b, const double *v, double p[3])
{
    const double *mass = sfem_model_node_mass(b->model);
    sfem_int i;
    int c;
    for (c = 0; c < 3; ++c)
        for (p[c] = 0, i = 0; i < b->mesh.nodes; ++i) p[c] += mass[i] * v[3 * i + c];
}

/* m d(centre)/dt of a step of h: what the positions say, no field of the body. */
static void moved(const bar *b, sfem_body *body, double h, double p[3])
{
    double x[3 * MAX_NODES], y[3 * MAX_NODES];
    sfem_error err;
    int i;
    sfem_body_positions(body, x);
    assert_ok(sfem_body_step(body, h, &err), err);
    sfem_body_positions(body, y);
    for (i = 0; i < 3 * b->mesh.nodes; ++i) y[i] = (y[i] - x[i]) / h;
    momentum(b, y, p);
}

static const sfem_integrator every[] = {SFEM_PQR, SFEM_NEWMARK, SFEM_CENTRAL, SFEM_BACKWARD_EULER, SFEM_HHT, SFEM_GENERALIZED_ALPHA,
                                        SFEM_BATHE, SFEM_KR_ALPHA, SFEM_GUI, SFEM_CHANG};

/* Random forces in every third step or so, steps of one length or of many, at the first step too. */
static void a_step_force_gives_the_momentum_f_h(void **state)
{
    static const struct {
        sfem_law law;
        sfem_mass mass;
        double damping;
    } kind[] = {{SFEM_LINEAR, SFEM_MASS_LUMPED, 0},         {SFEM_LINEAR, SFEM_MASS_CONSISTENT, 1e-3},
                {SFEM_LINEAR, SFEM_MASS_LUMPED, 5e-2},      {SFEM_COROTATIONAL, SFEM_MASS_LUMPED, 0},
                {SFEM_COROTATIONAL, SFEM_MASS_LUMPED, 1e-3}};
    size_t k, l;
    int changing, i, c, immediate;
    (void)state;
    for (l = 0; l < TEST_COUNT(kind); ++l)
        for (k = 0; k < TEST_COUNT(every); ++k)
            for (changing = 0; changing < 2; ++changing) {
                const sfem_integrator method = every[k];
                const double long_step = method == SFEM_CENTRAL ? 1e-4 : 1.0 / 60;
                sfem_body_def def = sfem_default_body_def();
                test_random random = {3};
                double v[3 * MAX_NODES], p[3], given[3] = {0, 0, 0}, most = 0;
                bar b;
                sfem_body *body;
                sfem_error err;
                if (kind[l].damping > 0 && method == SFEM_CENTRAL) continue;
                b = make_bar(kind[l].law, kind[l].mass, kind[l].damping);
                def.integrator = method;
                def.newton.tolerance = 1e-11;
                if (kind[l].mass == SFEM_MASS_CONSISTENT && method == SFEM_CENTRAL) def.integrator = SFEM_PQR;
                body = make_body(&b, &def);
                immediate = method == SFEM_NEWMARK || (method >= SFEM_BACKWARD_EULER && method <= SFEM_BATHE);
                for (i = 0; i < 40; ++i) {
                    const double h = changing ? long_step * random_uniform(&random, 0.5, 1.5) : long_step;
                    if (i % 3 == 0 || i % 7 == 1) {
                        double f[3];
                        for (c = 0; c < 3; ++c) f[c] = random_uniform(&random, -20, 30);
                        assert_ok(sfem_body_add_step_force(body, i % b.mesh.nodes, f, &err), err);
                        assert_ok(sfem_body_add_step_force(body, (i + 5) % b.mesh.nodes, f, &err), err);
                        for (c = 0; c < 3; ++c) given[c] += 2 * f[c] * h;
                    }
                    assert_ok(sfem_body_step(body, h, &err), err);
                    for (c = 0; c < 3; ++c) most = fmax(most, fabs(given[c]));
                    sfem_body_velocities(body, v);
                    momentum(&b, v, p);
                    for (c = 0; immediate && c < 3; ++c) assert_near(p[c], given[c], 0, 1e-9 * most);
                }
                assert_ok(sfem_body_step(body, long_step, &err), err); /* velocities in the middle of steps have all of it now */
                moved(&b, body, long_step, p);
                for (c = 0; c < 3; ++c) assert_near(p[c], given[c], 0, 1e-9 * most);
                sfem_body_velocities(body, v);
                momentum(&b, v, p);
                for (c = 0; c < 3; ++c) assert_near(p[c], given[c], 0, 1e-9 * most);
                sfem_body_free(body);
                drop_bar(&b);
            }
}

/* Impulses before and after solve, in steps of many lengths, on bodies whose next step looks back at the last acceleration
 * and on those whose does not. */
static void impulses_give_their_momentum(void **state)
{
    static const sfem_integrator method[] = {SFEM_PQR, SFEM_KR_ALPHA, SFEM_GUI, SFEM_CHANG};
    static const sfem_mass mass[] = {SFEM_MASS_LUMPED, SFEM_MASS_CONSISTENT};
    size_t k, m;
    int changing, i, c;
    (void)state;
    for (k = 0; k < TEST_COUNT(method); ++k)
        for (m = 0; m < TEST_COUNT(mass); ++m)
            for (changing = 0; changing < 2; ++changing) {
                bar b = make_bar(SFEM_LINEAR, mass[m], 0);
                sfem_body_def def = sfem_default_body_def();
                test_random random = {7};
                double p[3], given[3] = {0, 0, 0}, most = 0;
                sfem_body *body;
                sfem_error err;
                def.integrator = method[k];
                body = make_body(&b, &def);
                for (i = 0; i < 20; ++i) {
                    double j[3];
                    assert_ok(sfem_body_predict(body, changing ? random_uniform(&random, 0.5, 1.5) / 60 : 1.0 / 60, &err), err);
                    for (c = 0; c < 3; ++c) given[c] += j[c] = random_uniform(&random, -2, 3);
                    if (i % 2) assert_ok(sfem_body_add_impulse(body, i % b.mesh.nodes, j, &err), err);
                    assert_ok(sfem_body_solve(body, &err), err);
                    if (i % 3) { /* as many as there are */
                        for (c = 0; c < 3; ++c) given[c] += j[c];
                        assert_ok(sfem_body_add_impulse(body, (i + 5) % b.mesh.nodes, j, &err), err);
                    }
                    if (i % 2 == 0)
                        for (c = 0; c < 3; ++c) given[c] -= j[c];
                    assert_ok(sfem_body_finish(body, &err), err);
                    for (c = 0; c < 3; ++c) most = fmax(most, fabs(given[c]));
                }
                moved(&b, body, 1.0 / 60, p);
                for (c = 0; c < 3; ++c) assert_near(p[c], given[c], 0, 1e-9 * most);
                sfem_body_free(body);
                drop_bar(&b);
            }
}

/* Where a force is constant for many steps, a step force each step is what a lasting force is, to the order of the method. */
static void step_forces_that_follow_each_other_are_a_lasting_force(void **state)
{
    size_t k;
    int n, way, i, c;
    (void)state;
    for (k = 0; k < TEST_COUNT(every); ++k) {
        double error[2];
        for (n = 0; n < 2; ++n) {
            const double h = 1e-4 / (1 + n);
            double u[2][3 * MAX_NODES], most = 0;
            bar b = make_bar(SFEM_LINEAR, SFEM_MASS_LUMPED, 0);
            sfem_body_def def = sfem_default_body_def();
            sfem_int pins[4];
            def.integrator = every[k];
            for (i = 0; i < 4; ++i) pins[i] = i;
            def.pins = pins;
            def.pin_count = 4;
            for (way = 0; way < 2; ++way) {
                const double f[3] = {3, -2, 5};
                sfem_body *body = make_body(&b, &def);
                sfem_error err;
                if (!way) assert_ok(sfem_body_add_lasting_force(body, b.mesh.nodes - 1, f, &err), err);
                for (i = 0; i < 200 * (1 + n); ++i) {
                    if (way) assert_ok(sfem_body_add_step_force(body, b.mesh.nodes - 1, f, &err), err);
                    assert_ok(sfem_body_step(body, h, &err), err);
                }
                memcpy(u[way], sfem_body_displacement(body), 3 * (size_t)b.mesh.nodes * sizeof(double));
                sfem_body_free(body);
            }
            for (error[n] = 0, c = 0; c < 3 * b.mesh.nodes; ++c) {
                most = fmax(most, fabs(u[0][c]));
                error[n] = fmax(error[n], fabs(u[0][c] - u[1][c]));
            }
            error[n] /= most;
            drop_bar(&b);
        }
        print_message("    method %d: %.1e, with half the step %.1e\n", (int)every[k], error[0], error[1]);
        if (every[k] == SFEM_NEWMARK || (every[k] >= SFEM_BACKWARD_EULER && every[k] <= SFEM_BATHE))
            assert_true(error[1] < 1e-10); /* the same step */
        else
            assert_true(error[0] < 0.02 && error[1] < 0.6 * error[0]); /* an impulse at the start of each */
    }
}

static void step_forces_are_whole_in_rejected_steps(void **state)
{
    static const sfem_integrator integrator[] = {SFEM_PQR, SFEM_KR_ALPHA, SFEM_CHANG};
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(integrator); ++k) {
        bar b = make_bar(SFEM_NEOHOOKEAN, SFEM_MASS_LUMPED, 0);
        sfem_body_def def = sfem_default_body_def();
        test_random random = {3};
        double v[3 * MAX_NODES], p[3], given[3];
        sfem_body *body;
        sfem_error err;
        int64_t rejected;
        int i, c, hit = 0;
        def.integrator = integrator[k];
        def.rho_inf = 0.8;
        def.accuracy = 1;
        body = make_body(&b, &def);
        for (i = 0; i < 3 * b.mesh.nodes; ++i) v[i] = random_uniform(&random, -20, 20);
        assert_ok(sfem_body_set_state(body, NULL, v, &err), err);
        momentum(&b, v, given);
        for (i = 0; i < 60; ++i) {
            const double h = random_uniform(&random, .5, 1.5) / 30;
            double f[3];
            for (c = 0; c < 3; ++c) given[c] += h * (f[c] = random_uniform(&random, -600, 900));
            assert_ok(sfem_body_add_step_force(body, i % b.mesh.nodes, f, &err), err);
            rejected = sfem_body_get_info(body).rejected;
            assert_ok(sfem_body_step(body, h, &err), err);
            hit += sfem_body_get_info(body).rejected > rejected;
        }
        assert_true(hit > 5);
        do { /* the mean velocity of a step that is not rejected */
            rejected = sfem_body_get_info(body).rejected;
            moved(&b, body, 1. / 240, p);
        } while (sfem_body_get_info(body).rejected > rejected);
        for (c = 0; c < 3; ++c) assert_near(p[c], given[c], 0, 1e-8);
        sfem_body_free(body);
        drop_bar(&b);
    }
}

/* A step that fails leaves the force for the next one; predict called twice adds it once; what is added by hand besides
 * after solve, and solves the step again, does not double it. */
static void a_step_force_waits_for_a_step_that_succeeds(void **state)
{
    static const sfem_integrator integrator[] = {SFEM_PQR, SFEM_NEWMARK, SFEM_BATHE};
    const double f[3] = {10, 20, -30}, j[3] = {1, 0, 0}, h = 0.01;
    int law, c;
    size_t k;
    (void)state;
    for (law = 0; law < 2; ++law)
        for (k = 0; k < TEST_COUNT(integrator); ++k) {
            bar b = make_bar(law ? SFEM_COROTATIONAL : SFEM_LINEAR, SFEM_MASS_LUMPED, 0);
            sfem_body_def def = sfem_default_body_def();
            double p[3];
            sfem_body *body;
            sfem_error err;
            def.integrator = integrator[k];
            def.newton.tolerance = 1e-11;
            body = make_body(&b, &def);
            assert_ok(sfem_body_add_step_force(body, 3, f, &err), err);
            assert_status(sfem_body_step(body, -1, &err), SFEM_BAD_ARGUMENT);
            assert_ok(sfem_body_predict(body, h, &err), err);
            sfem_body_rhs(body)[0] = NAN;
            assert_int_not_equal(sfem_body_solve(body, &err), SFEM_OK);
            assert_ok(sfem_body_predict(body, h, &err), err);
            assert_status(sfem_body_add_step_force(body, 3, f, &err), SFEM_BAD_ARGUMENT);
            assert_names(err, "sfem_body_rhs");
            assert_ok(sfem_body_predict(body, h, &err), err);
            assert_ok(sfem_body_solve(body, &err), err);
            assert_ok(sfem_body_add_impulse(body, 2, j, &err), err);
            assert_ok(sfem_body_finish(body, &err), err);
            assert_ok(sfem_body_step(body, h, &err), err);
            moved(&b, body, h, p);
            for (c = 0; c < 3; ++c) assert_near(p[c], h * f[c] + j[c], 0, 1e-9);
            sfem_body_free(body);
            drop_bar(&b);
        }
}

/* The force and its wait belong to the saved state: the same bits go on. */
static void a_saved_state_has_the_step_force_in_it(void **state)
{
    static const sfem_integrator integrator[] = {SFEM_PQR, SFEM_NEWMARK};
    const double f[3] = {10, 20, -30};
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(integrator); ++k) {
        bar b = make_bar(SFEM_LINEAR, SFEM_MASS_LUMPED, 0);
        sfem_body_def def = sfem_default_body_def();
        sfem_body *body[2];
        sfem_error err;
        void *memory;
        size_t bytes;
        int i;
        def.integrator = integrator[k];
        for (i = 0; i < 2; ++i) body[i] = make_body(&b, &def);
        bytes = sfem_body_state_size(body[0]);
        memory = malloc(bytes);
        assert_non_null(memory);
        for (i = 0; i < 3; ++i) assert_ok(sfem_body_step(body[0], 0.01, &err), err);
        assert_ok(sfem_body_add_step_force(body[0], 3, f, &err), err);
        sfem_body_save_state(body[0], memory);
        assert_ok(sfem_body_load_state(body[1], memory, bytes, &err), err);
        for (i = 0; i < 5; ++i) {
            assert_ok(sfem_body_step(body[0], 0.01, &err), err);
            assert_ok(sfem_body_step(body[1], 0.01, &err), err);
        }
        assert_true(fabs(sfem_body_displacement(body[0])[9]) > 1e-5);
        assert_memory_equal(sfem_body_displacement(body[0]), sfem_body_displacement(body[1]),
                            3 * (size_t)b.mesh.nodes * sizeof(double));
        free(memory);
        for (i = 0; i < 2; ++i) sfem_body_free(body[i]);
        drop_bar(&b);
    }
}

static void a_step_force_wakes_a_sleeping_body(void **state)
{
    bar b = make_bar(SFEM_COROTATIONAL, SFEM_MASS_LUMPED, 0);
    sfem_body_def def = sfem_default_body_def();
    const double f[3] = {1000, 0, 0}, none[3] = {0, 0, 0}, bad[3] = {0, NAN, 0}, h = 1.0 / 60;
    double p[3];
    sfem_body *body;
    sfem_error err;
    int i;
    (void)state;
    def.sleep_tolerance = 0.02;
    body = make_body(&b, &def);
    for (i = 0; i < 120; ++i) assert_ok(sfem_body_step(body, h, &err), err);
    assert_true(sfem_body_is_asleep(body));
    assert_ok(sfem_body_add_step_force(body, 0, none, &err), err);
    assert_status(sfem_body_add_step_force(body, 0, bad, &err), SFEM_NOT_FINITE);
    assert_status(sfem_body_add_step_force(body, b.mesh.nodes, f, &err), SFEM_BAD_ARGUMENT);
    assert_ok(sfem_body_step(body, h, &err), err);
    assert_true(sfem_body_is_asleep(body));
    assert_ok(sfem_body_add_step_force(body, 0, f, &err), err);
    assert_ok(sfem_body_step(body, h, &err), err);
    assert_false(sfem_body_is_asleep(body));
    assert_ok(sfem_body_step(body, h, &err), err);
    moved(&b, body, h, p);
    assert_near(p[0], 1000 * h, 1e-9, 0);
    sfem_body_free(body);
    drop_bar(&b);
}

/* Held nodes take a step force up. */
static void pins_and_handles_carry_a_step_force(void **state)
{
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(every); ++k) {
        bar b = make_bar(SFEM_LINEAR, SFEM_MASS_LUMPED, 0);
        sfem_body_def def = exact_body_def();
        const sfem_int pins[4] = {0, 1, 2, 3};
        const double f[3] = {100, -50, 70};
        double x[3 * MAX_NODES];
        sfem_int handle;
        sfem_body *body;
        sfem_error err;
        int i;
        def.integrator = every[k];
        def.pins = pins;
        def.pin_count = 4;
        body = make_body(&b, &def);
        assert_ok(sfem_body_grab_node(body, 10, &handle, &err), err);
        assert_ok(sfem_body_add_step_force(body, 2, f, &err), err);
        assert_ok(sfem_body_add_step_force(body, 10, f, &err), err);
        for (i = 0; i < 5; ++i) assert_ok(sfem_body_step(body, 1e-4, &err), err);
        sfem_body_positions(body, x);
        assert_all_near(x, b.mesh.x, 3 * b.mesh.nodes, 0, 1e-12);
        sfem_body_free(body);
        drop_bar(&b);
    }
}

/* --------------------------------------------------------------------------------------------
 * modal bodies
 * -------------------------------------------------------------------------------------------- */

static const sfem_modal_integrator modal_method[] = {SFEM_MODAL_NEWMARK, SFEM_MODAL_EXACT, SFEM_MODAL_FITTED};

static sfem_reduced *make_reduced(int held)
{
    bar b = make_bar(SFEM_LINEAR, SFEM_MASS_LUMPED, 0);
    sfem_modes_def modes_def = sfem_default_modes_def();
    sfem_reduced_def def = sfem_default_reduced_def();
    const sfem_int pins[4] = {0, 1, 2, 3};
    sfem_reduced *reduced = NULL;
    sfem_modes modes;
    sfem_error err;
    modes_def.modes = 10;
    modes_def.pins = pins;
    modes_def.pin_count = held ? 4 : 0;
    def.free = !held;
    def.mass_damping = 0.5;
    def.stiffness_damping = 1e-3;
    assert_ok(sfem_modes_create(b.model, &modes_def, &modes, &err), err);
    assert_ok(sfem_reduced_create(b.model, &modes, &def, &reduced, &err), err);
    sfem_modes_free(&modes);
    drop_bar(&b);
    return reduced;
}

static sfem_modal *make_modal(sfem_reduced *reduced, sfem_modal_integrator integrator, sfem_warp warp)
{
    sfem_modal_def def = sfem_default_modal_def();
    sfem_modal *body = NULL;
    sfem_error err;
    def.integrator = integrator;
    def.warp = warp;
    assert_ok(sfem_modal_create(reduced, &def, &body, &err), err);
    return body;
}

static void a_free_modal_body_takes_the_momentum_f_h(void **state)
{
    sfem_reduced *reduced = make_reduced(0);
    const sfem_int nodes = sfem_reduced_get_info(reduced).nodes;
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(modal_method); ++k) {
        sfem_modal *body = make_modal(reduced, modal_method[k], SFEM_WARP_PATH);
        double linear[3] = {0, 0, 0}, angular[3] = {0, 0, 0}, p[3], l[3];
        test_random random = {9};
        sfem_error err;
        int i, c;
        for (i = 0; i < 60; ++i) {
            const double h = random_uniform(&random, 0.5, 1.5) / 60;
            const sfem_int node = i % nodes;
            double f[3], x[3], bad[3] = {0, NAN, 0};
            if (i % 3 != 1) {
                const sfem_rigid frame = sfem_modal_rigid(body);
                for (c = 0; c < 3; ++c) linear[c] += h * (f[c] = random_uniform(&random, -20, 30));
                sfem_modal_node(body, node, x, NULL, NULL);
                for (c = 0; c < 3; ++c) {
                    const int d = (c + 1) % 3, e = (c + 2) % 3;
                    angular[c] += h * ((x[d] - frame.x[d]) * f[e] - (x[e] - frame.x[e]) * f[d]);
                }
                assert_ok(sfem_modal_add_step_force(body, node, f, &err), err);
            }
            assert_status(sfem_modal_add_step_force(body, nodes, bad, &err), SFEM_BAD_ARGUMENT);
            assert_status(sfem_modal_add_step_force(body, node, bad, &err), SFEM_NOT_FINITE);
            assert_status(sfem_modal_step(body, 0, &err), SFEM_BAD_ARGUMENT);
            assert_ok(sfem_modal_step(body, h, &err), err);
            sfem_modal_momentum(body, p, l);
            assert_all_near(p, linear, 3, 1e-12, 0);
            assert_all_near(l, angular, 3, 1e-12, 0);
        }
        assert_true(sfem_modal_get_info(body).elastic > 1e-6); /* it bends, too */
        sfem_modal_free(body);
    }
    sfem_reduced_free(reduced);
}

/* Of a body that does not warp a step force in each step is a lasting one, to rounding, in steps of any length. */
static void step_forces_on_modes_are_constant_over_the_step(void **state)
{
    sfem_reduced *reduced = make_reduced(1);
    const sfem_reduced_info info = sfem_reduced_get_info(reduced);
    const double f[3] = {3, -2, 5};
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(modal_method); ++k) {
        sfem_modal *body[2];
        test_random random = {9};
        sfem_error err;
        int i, way;
        for (way = 0; way < 2; ++way) body[way] = make_modal(reduced, modal_method[k], SFEM_WARP_NONE);
        assert_ok(sfem_modal_add_lasting_force(body[0], info.nodes - 1, f, &err), err);
        for (i = 0; i < 50; ++i) {
            const double h = random_uniform(&random, 0.5, 1.5) / 60;
            assert_ok(sfem_modal_add_step_force(body[1], info.nodes - 1, f, &err), err);
            for (way = 0; way < 2; ++way) assert_ok(sfem_modal_step(body[way], h, &err), err);
            assert_all_near(sfem_modal_coordinates(body[0]), sfem_modal_coordinates(body[1]), info.modes, 1e-11, 0);
            assert_all_near(sfem_modal_coordinate_velocities(body[0]), sfem_modal_coordinate_velocities(body[1]), info.modes, 1e-11, 1e-12);
        }
        for (i = 0; i < 2000; ++i) /* and is over when it is over */
            assert_ok(sfem_modal_step(body[1], 1.0 / 60, &err), err);
        assert_true(fabs(sfem_modal_coordinates(body[1])[0]) < 1e-3 * fabs(sfem_modal_coordinates(body[0])[0]));
        for (way = 0; way < 2; ++way) sfem_modal_free(body[way]);
    }
    sfem_reduced_free(reduced);
}

/* A force for one step, beside a lasting one that is set and taken away, in short steps; with a handle. */
static void a_step_force_goes_with_handles_and_saved_states(void **state)
{
    sfem_reduced *reduced = make_reduced(1);
    const sfem_reduced_info info = sfem_reduced_get_info(reduced);
    const double f[3] = {3000, -2000, 5000}, h = 1e-5;
    sfem_modal *body[3];
    sfem_error err;
    void *memory;
    int i, way;
    (void)state;
    for (way = 0; way < 3; ++way) {
        sfem_int handle;
        body[way] = make_modal(reduced, SFEM_MODAL_FITTED, SFEM_WARP_PATH);
        assert_ok(sfem_modal_grab_node(body[way], 12, &handle, &err), err);
        assert_ok(sfem_modal_step(body[way], h, &err), err);
    }
    assert_ok(sfem_modal_add_lasting_force(body[0], info.nodes - 1, f, &err), err);
    assert_ok(sfem_modal_add_step_force(body[1], info.nodes - 1, f, &err), err);
    memory = malloc(sfem_modal_state_size(body[1]));
    assert_non_null(memory);
    sfem_modal_save_state(body[1], memory);
    assert_ok(sfem_modal_load_state(body[2], memory, sfem_modal_state_size(body[1]), &err), err);
    free(memory);
    for (i = 0; i < 400; ++i) {
        for (way = 0; way < 3; ++way) assert_ok(sfem_modal_step(body[way], h, &err), err);
        assert_ok(sfem_modal_set_lasting_force(body[0], NULL, &err), err);
    }
    assert_all_near(sfem_modal_coordinates(body[0]), sfem_modal_coordinates(body[1]), info.modes, 0.01, 0);
    assert_memory_equal(sfem_modal_coordinates(body[1]), sfem_modal_coordinates(body[2]), (size_t)info.modes * sizeof(double));
    assert_true(fabs(sfem_modal_coordinates(body[1])[0]) > 1e-6);
    for (way = 0; way < 3; ++way) sfem_modal_free(body[way]);
    sfem_reduced_free(reduced);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_step_force_gives_the_momentum_f_h),
        cmocka_unit_test(impulses_give_their_momentum),
        cmocka_unit_test(step_forces_that_follow_each_other_are_a_lasting_force),
        cmocka_unit_test(step_forces_are_whole_in_rejected_steps),
        cmocka_unit_test(a_step_force_waits_for_a_step_that_succeeds),
        cmocka_unit_test(a_saved_state_has_the_step_force_in_it),
        cmocka_unit_test(a_step_force_wakes_a_sleeping_body),
        cmocka_unit_test(pins_and_handles_carry_a_step_force),
        cmocka_unit_test(a_free_modal_body_takes_the_momentum_f_h),
        cmocka_unit_test(step_forces_on_modes_are_constant_over_the_step),
        cmocka_unit_test(a_step_force_goes_with_handles_and_saved_states),
    };
    return run_all_tests(tests);
}
