/* Pins and handles that are set, moved and released while a body runs. */
#include "support.h"
#include "linear.h"

typedef struct scheme {
    const char *name;
    sfem_integrator integrator;
    double p, beta, gamma;
    double alpha, beta_k;
    sfem_mass mass;
    int exact; /* a moved handle is a moved pin: positions follow from positions alone */
} scheme;

/* stiff Newmark with damping or a consistent mass sees the velocity of held nodes: it converges only */
static const scheme schemes[] = {
    {"pqr 1/4", SFEM_PQR, 0.25, 0.25, 0.5, 0, 0, SFEM_MASS_LUMPED, 1},
    {"pqr .3", SFEM_PQR, 0.3, 0.25, 0.5, 0, 0, SFEM_MASS_LUMPED, 1},
    {"pqr 1/4, damped", SFEM_PQR, 0.25, 0.25, 0.5, 0.7, 0.01, SFEM_MASS_LUMPED, 1},
    {"pqr .3, damped, consistent", SFEM_PQR, 0.3, 0.25, 0.5, 0.7, 0.01, SFEM_MASS_CONSISTENT, 1},
    {"pqr 1/4, consistent", SFEM_PQR, 0.25, 0.25, 0.5, 0, 0, SFEM_MASS_CONSISTENT, 1},
    {"central", SFEM_CENTRAL, 0, 0.25, 0.5, 0, 0, SFEM_MASS_LUMPED, 1},
    {"central, damped, consistent", SFEM_CENTRAL, 0, 0.25, 0.5, 0.7, 0.001, SFEM_MASS_CONSISTENT,
     1},
    {"newmark", SFEM_NEWMARK, 0.25, 0.25, 0.5, 0, 0, SFEM_MASS_LUMPED, 1},
    {"newmark .3025 .6", SFEM_NEWMARK, 0.25, 0.3025, 0.6, 0, 0, SFEM_MASS_LUMPED, 1},
    {"newmark, damped", SFEM_NEWMARK, 0.25, 0.25, 0.5, 0.7, 0.01, SFEM_MASS_LUMPED, 0},
    {"newmark, consistent", SFEM_NEWMARK, 0.25, 0.25, 0.5, 0, 0, SFEM_MASS_CONSISTENT, 0},
    {"newmark, damped, consistent", SFEM_NEWMARK, 0.25, 0.25, 0.5, 0.7, 0.01, SFEM_MASS_CONSISTENT,
     0},
    {"KR-alpha", SFEM_KR_ALPHA, 0, 0.25, 0.5, 0, 0, SFEM_MASS_LUMPED, 1},
    {"KR-alpha, damped", SFEM_KR_ALPHA, 0, 0.25, 0.5, 0.7, 0.01, SFEM_MASS_LUMPED, 1},
    {"KR-alpha, damped, consistent", SFEM_KR_ALPHA, 0, 0.25, 0.5, 0.7, 0.01, SFEM_MASS_CONSISTENT,
     1},
    {"gui 4, damped", SFEM_GUI, 0, 0.25, 0.5, 0.7, 0.01, SFEM_MASS_LUMPED, 1},
    {"chang, consistent", SFEM_CHANG, 0, 0.25, 0.5, 0, 0, SFEM_MASS_CONSISTENT, 1},
};

#define NODES 20 /* of the beam: 4 x 1 x 1 cells, 4 nodes a cross-section */
#define DOFS  (3 * NODES)
static const sfem_int clamp[6] = {0, 1,  2,
                                  3, 17, 14}; /* the end x = 0, then two nodes of the others */
enum { CLAMPED = 4, FIRST = 17, SECOND = 14 };

static sfem_model *make_beam(sfem_mass mass, sfem_allocator allocator)
{
    const sfem_int cells[3] = {4, 1, 1};
    const double size[3] = {4, 1, 1};
    sfem_model_def def = linear_model_def();
    sfem_model *model = NULL;
    sfem_mesh mesh;
    sfem_error err;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
    assert_int_equal(mesh.nodes, NODES);
    def.mesh = &mesh;
    def.material.young = 1e5; /* waves of 12 m/s, slowest mode below 1 Hz, fastest about 10 Hz */
    def.mass = mass;
    def.allocator = allocator;
    assert_ok(sfem_model_create(&def, &model, &err), err);
    sfem_mesh_free(&mesh);
    return model;
}

static sfem_model *beam_of(const scheme *s)
{
    const sfem_allocator malloc_and_free = {NULL, NULL, NULL};
    return make_beam(s->mass, malloc_and_free);
}

static sfem_body_def body_def_of(const scheme *s, sfem_int pin_count)
{
    sfem_body_def def = exact_body_def();
    def.integrator = s->integrator;
    def.p = s->p;
    def.beta = s->beta;
    def.gamma = s->gamma;
    def.mass_damping = s->alpha;
    def.stiffness_damping = s->beta_k;
    def.pins = clamp;
    def.pin_count = pin_count;
    return def;
}

static sfem_body *make_body(sfem_model *model, const sfem_body_def *def)
{
    sfem_body *body = NULL;
    sfem_error err;
    assert_ok(sfem_body_create(model, def, &body, &err), err);
    return body;
}

static void step(sfem_body *body, double h)
{
    sfem_error err;
    assert_ok(sfem_body_step(body, h, &err), err);
}

static sfem_int grab(sfem_body *body, sfem_int node)
{
    sfem_int handle = -1;
    sfem_error err;
    assert_ok(sfem_body_grab_node(body, node, &handle, &err), err);
    return handle;
}

/* rest position plus d */
static void place(const sfem_model *model, sfem_int node, const double d[3], double x[3])
{
    int c;
    for (c = 0; c < 3; ++c) x[c] = sfem_model_mesh(model)->x[3 * node + c] + d[c];
}

/* a smooth path that starts with position, velocity and acceleration zero */
static void path(double t, double d[3])
{
    const double s = (1 - cos(3 * t)) * (1 - cos(3 * t));
    d[0] = -0.05 * s;
    d[1] = 0.08 * s * sin(2 * t);
    d[2] = 0.1 * s;
}

static void same_displacement(const sfem_body *a, const sfem_body *b, double tolerance,
                              const char *name)
{
    const double *u = sfem_body_displacement(a), *v = sfem_body_displacement(b);
    double size = 0, difference = 0;
    int i;
    for (i = 0; i < DOFS; ++i) {
        size = fmax(size, fmax(fabs(u[i]), fabs(v[i])));
        difference = fmax(difference, fabs(u[i] - v[i]));
        if (!isfinite(u[i]) || !isfinite(v[i])) fail_msg("%s: not finite", name);
    }
    if (!(difference <= tolerance * size))
        fail_msg("%s: at t = %g displacements differ by %.3g of %.3g", name, sfem_body_time(a),
                 difference, size);
}

/* ---- against pins that are eliminated ---- */

static void resting_handles_equal_eliminated_pins(void **state)
{
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(schemes); ++k) {
        const scheme *s = schemes + k;
        sfem_model *model = beam_of(s);
        sfem_body_def def = body_def_of(s, CLAMPED + 2);
        sfem_body *pinned, *handled;
        sfem_error err;
        test_random r = {7};
        double u[DOFS], v[DOFS];
        int i;
        def.gravity[2] = -9.81;
        pinned = make_body(model, &def);
        def.pin_count = CLAMPED;
        handled = make_body(model, &def);
        random_fill(&r, u, DOFS, -0.02, 0.02);
        random_fill(&r, v, DOFS, -0.3, 0.3);
        for (i = 0; i < 3; ++i)
            u[3 * FIRST + i] = v[3 * FIRST + i] = u[3 * SECOND + i] = v[3 * SECOND + i] = 0;
        assert_ok(sfem_body_set_state(pinned, u, v, &err), err);
        assert_ok(sfem_body_set_state(handled, u, v, &err), err);
        grab(handled, FIRST);
        grab(handled, SECOND);
        for (i = 0; i < 200; ++i) {
            step(pinned, 0.01);
            step(handled, 0.01);
            same_displacement(pinned, handled, 1e-9, s->name);
        }
        sfem_body_free(pinned);
        sfem_body_free(handled);
        sfem_model_free(model);
    }
}

/* One body takes two nodes while it moves, carries them along and lets go; the other has them eliminated
 * from the start, and pulled along the path that the first one's take. */
static void handles_set_moved_and_released_equal_moved_pins(void **state)
{
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(schemes); ++k) {
        const scheme *s = schemes + k;
        sfem_model *model;
        sfem_body_def def = body_def_of(s, CLAMPED + 2);
        sfem_body *pinned, *handled;
        sfem_error err;
        double force[DOFS], x[DOFS], from[2][3] = {{0}}, d[3], at[3];
        sfem_int handle[2] = {-1, -1};
        const sfem_int node[2] = {FIRST, SECOND}, begin[2] = {50, 60}, end[2] = {100, 150};
        int i, j, c;
        if (!s->exact || s->integrator == SFEM_KR_ALPHA) continue; /* the one starts afresh */
        model = beam_of(s);
        pinned = make_body(model, &def);
        def.pin_count = CLAMPED;
        handled = make_body(model, &def);
        sfem_body_start(pinned); /* without load: nothing has an acceleration at time 0 */
        sfem_body_start(handled);
        for (i = 0; i < 200; ++i) {
            for (j = 0; j < DOFS; ++j) force[j] = 100 * sin(0.07 * i) * cos(1.3 * j);
            assert_ok(sfem_body_set_lasting_force(pinned, force, &err), err);
            assert_ok(sfem_body_set_lasting_force(handled, force, &err), err);
            for (j = 0; j < 2; ++j) {
                if (i == begin[j]) {
                    handle[j] = grab(handled, node[j]);
                    sfem_body_handle_position(handled, handle[j], from[j]);
                }
                if (i == end[j]) sfem_body_release_handle(handled, handle[j]);
                if (i <= begin[j] || i >= end[j]) continue;
                path(0.01 * (i - begin[j]), d);
                for (c = 0; c < 3; ++c) at[c] = from[j][c] + d[c];
                assert_ok(sfem_body_move_handle(handled, handle[j], at, &err), err);
            }
            step(handled, 0.01);
            sfem_body_positions(handled, x);
            for (j = 0; j < 2; ++j) {
                if (i > begin[j] && i < end[j]) {
                    path(0.01 * (i - begin[j]), d);
                    for (c = 0; c < 3; ++c)
                        assert_near(x[3 * node[j] + c], from[j][c] + d[c], 0, 1e-12);
                }
                assert_ok(sfem_body_move_pin(pinned, node[j], x + 3 * node[j], &err), err);
            }
            step(pinned, 0.01);
            same_displacement(pinned, handled, 1e-9, s->name);
        }
        sfem_body_free(pinned);
        sfem_body_free(handled);
        sfem_model_free(model);
    }
}

/* the largest difference, over a second, between a handle and a pin that are pulled along the path */
static double moving_difference(const scheme *s, double h)
{
    sfem_model *model = beam_of(s);
    sfem_body_def def = body_def_of(s, CLAMPED + 2);
    sfem_body *pinned, *handled;
    sfem_int handle[2];
    sfem_error err;
    double most = 0;
    int i, j, steps = (int)(1 / h + 0.5);
    pinned = make_body(model, &def);
    def.pin_count = CLAMPED;
    handled = make_body(model, &def);
    for (j = 0; j < 2; ++j) handle[j] = grab(handled, clamp[CLAMPED + j]);
    for (i = 1; i <= steps; ++i) {
        for (j = 0; j < 2; ++j) {
            double d[3], x[3];
            path(i * h, d);
            place(model, clamp[CLAMPED + j], d, x);
            assert_ok(sfem_body_move_pin(pinned, clamp[CLAMPED + j], x, &err), err);
            assert_ok(sfem_body_move_handle(handled, handle[j], x, &err), err);
        }
        step(pinned, h);
        step(handled, h);
        for (j = 0; j < DOFS; ++j)
            most = fmax(
                most, fabs(sfem_body_displacement(pinned)[j] - sfem_body_displacement(handled)[j]));
    }
    sfem_body_free(pinned);
    sfem_body_free(handled);
    sfem_model_free(model);
    return most;
}

static void moving_handles_of_damped_newmark_converge_to_moving_pins(void **state)
{
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(schemes); ++k) {
        double difference[3];
        int i;
        if (schemes[k].exact) continue;
        for (i = 0; i < 3; ++i) {
            difference[i] = moving_difference(schemes + k, 0.02 / (1 << i));
            if (i && !(difference[i - 1] / difference[i] > 1.8))
                fail_msg("%s, h = %g: difference %.3g, before %.3g", schemes[k].name,
                         0.02 / (1 << i), difference[i], difference[i - 1]);
        }
        assert_true(difference[2] < 0.004); /* m; the path is 0.4 m long */
    }
}

static void handles_follow_changes_of_the_step(void **state)
{
    static const double h[5] = {0.01, 0.005, 0.005, 0.008, 0.002};
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(schemes); ++k) {
        const scheme *s = schemes + k;
        sfem_model *model;
        sfem_body_def def = body_def_of(s, CLAMPED + 2);
        sfem_body *pinned, *handled;
        sfem_int handle[2];
        sfem_error err;
        int i, j;
        if (!s->exact) continue;
        model = beam_of(s);
        pinned = make_body(model, &def);
        def.pin_count = CLAMPED;
        handled = make_body(model, &def);
        for (j = 0; j < 2; ++j) handle[j] = grab(handled, clamp[CLAMPED + j]);
        for (i = 0; i < 200; ++i) {
            for (j = 0; j < 2; ++j) {
                double d[3], x[3];
                path(sfem_body_time(pinned) + h[i % 5], d);
                place(model, clamp[CLAMPED + j], d, x);
                assert_ok(sfem_body_move_pin(pinned, clamp[CLAMPED + j], x, &err), err);
                assert_ok(sfem_body_move_handle(handled, handle[j], x, &err), err);
            }
            step(pinned, h[i % 5]);
            step(handled, h[i % 5]);
            same_displacement(pinned, handled, 1e-9, s->name);
        }
        sfem_body_free(pinned);
        sfem_body_free(handled);
        sfem_model_free(model);
    }
}

/* A node pulled at a constant velocity keeps it whatever the steps are. */
static void velocity_of_what_is_pulled_survives_a_change_of_step(void **state)
{
    const scheme s = {"newmark", SFEM_NEWMARK, 0, 0.25, 0.5, 0.5, 0.01, SFEM_MASS_LUMPED, 0};
    sfem_model *model = beam_of(&s);
    sfem_body_def def = body_def_of(&s, CLAMPED + 1);
    sfem_body *body = make_body(model, &def);
    const sfem_int handle = grab(body, SECOND);
    sfem_error err;
    int i, c;
    (void)state;
    for (i = 0; i < 12; ++i) {
        const double h = i % 3 ? 0.01 : 0.002, t = sfem_body_time(body) + h;
        const double d[3] = {0.1 * t, -0.2 * t, 0.3 * t};
        double x[3], v[DOFS];
        place(model, SECOND, d, x);
        assert_ok(sfem_body_move_handle(body, handle, x, &err), err);
        place(model, FIRST, d, x);
        assert_ok(sfem_body_move_pin(body, FIRST, x, &err), err);
        step(body, h);
        sfem_body_velocities(body, v);
        for (c = 0; i && c < 3; ++c) {
            assert_near(v[3 * SECOND + c], d[c] / t, 1e-11, 0);
            assert_near(v[3 * FIRST + c], d[c] / t, 1e-11, 0);
        }
    }
    sfem_body_free(body);
    sfem_model_free(model);
}

/* Pins added at run time, to nodes that handles hold already, change nothing. */
static void pins_set_at_run_time_take_over_from_handles(void **state)
{
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(schemes); ++k) {
        const scheme *s = schemes + k;
        sfem_model *model = beam_of(s);
        sfem_body_def def = body_def_of(s, CLAMPED);
        sfem_body *body[2];
        sfem_error err;
        test_random r = {13};
        double u[DOFS];
        int i, j;
        def.gravity[1] = 5;
        random_fill(&r, u, DOFS, -0.02, 0.02);
        for (j = 0; j < 2; ++j) {
            body[j] = make_body(model, &def);
            assert_ok(sfem_body_set_state(body[j], u, NULL, &err), err);
            for (i = 0; i < 30; ++i) step(body[j], 0.01);
            assert_int_equal(grab(body[j], FIRST), 0);
            assert_int_equal(grab(body[j], SECOND), 1);
            for (i = 0; i < 12; ++i) step(body[j], 0.01); /* KR-alpha forgets by a tenth a step */
        }
        assert_ok(sfem_body_set_pins(body[1], CLAMPED + 2, clamp, NULL, &err), err);
        sfem_body_release_handle(body[1], 0);
        sfem_body_release_handle(body[1], 1);
        if (s->integrator == SFEM_KR_ALPHA) /* starts afresh: so must the other one */
            assert_ok(sfem_body_set_pins(body[0], CLAMPED, clamp, NULL, &err), err);
        for (i = 0; i < 50; ++i) {
            for (j = 0; j < 2; ++j) step(body[j], 0.01);
            same_displacement(body[0], body[1], 1e-9, s->name);
        }
        assert_ok(sfem_body_set_pins(body[1], CLAMPED, clamp, NULL, &err), err);
        for (j = 0; j < 2; ++j) sfem_body_release_handle(body[0], j); /* and both let go */
        for (i = 0; i < 50; ++i) {
            for (j = 0; j < 2; ++j) step(body[j], 0.01);
            same_displacement(body[0], body[1], 1e-9, s->name);
        }
        for (j = 0; j < 2; ++j) sfem_body_free(body[j]);
        sfem_model_free(model);
    }
}

/* set_pins on a moving body is creating one with those pins and giving it the state. For (p,q,r) the state
 * stands half a step off the mean velocity that it keeps: there the two agree before the first step. */
static void pins_set_at_run_time_equal_pins_from_the_start(void **state)
{
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(schemes); ++k) {
        const scheme *s = schemes + k;
        const int steps = s->integrator == SFEM_NEWMARK && s->exact ? 37 : 0;
        sfem_model *model = beam_of(s);
        sfem_body_def def = body_def_of(s, CLAMPED);
        sfem_body *changed, *fresh;
        sfem_error err;
        test_random r = {19};
        double u[DOFS], v[DOFS], x[3];
        int i, c;
        def.gravity[2] = 3;
        changed = make_body(model, &def);
        random_fill(&r, u, DOFS, -0.02, 0.02);
        random_fill(&r, v, DOFS, -0.3, 0.3);
        assert_ok(sfem_body_set_state(changed, u, v, &err), err);
        for (i = 0; i < steps; ++i) step(changed, 0.01);
        memcpy(u, sfem_body_displacement(changed), sizeof u);
        sfem_body_velocities(changed, v);
        assert_ok(sfem_body_set_pins(changed, CLAMPED + 2, clamp, NULL, &err), err);
        def.pin_count = CLAMPED + 2;
        fresh = make_body(model, &def);
        for (i = CLAMPED; i < CLAMPED + 2;
             ++i) { /* its pins are at rest positions: bring them along */
            for (c = 0; c < 3; ++c)
                x[c] = sfem_model_mesh(model)->x[3 * clamp[i] + c] + u[3 * clamp[i] + c];
            assert_ok(sfem_body_move_pin(fresh, clamp[i], x, &err), err);
        }
        assert_ok(sfem_body_solve_static(fresh, &err), err);
        assert_ok(sfem_body_set_state(fresh, u, v, &err), err);
        for (i = 0; i < 60; ++i) {
            step(changed, 0.01);
            step(fresh, 0.01);
            same_displacement(changed, fresh, 1e-9, s->name);
        }
        assert_int_equal(sfem_body_get_info(changed).free_nodes, NODES - CLAMPED - 2);
        sfem_body_free(changed);
        sfem_body_free(fresh);
        sfem_model_free(model);
    }
}

static void only_pinned_nodes_can_be_moved(void **state)
{
    const double x[3] = {1, 2, 3}, bad[3] = {1, NAN, 3};
    sfem_model *model = beam_of(schemes);
    sfem_body_def def = body_def_of(schemes, CLAMPED);
    sfem_body *body = make_body(model, &def);
    const sfem_int none[1] = {NODES};
    const unsigned char axes[1] = {8};
    sfem_error err;
    (void)state;
    assert_status(sfem_body_move_pin(body, FIRST, x, &err), SFEM_BAD_ARGUMENT);
    assert_string_equal(err.text, "node 17 is not pinned");
    assert_int_equal(err.node, FIRST);
    assert_status(sfem_body_move_pin(body, NODES, x, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "node 20");
    assert_status(sfem_body_move_pin(body, 0, bad, &err), SFEM_NOT_FINITE);
    assert_names(err, "node 0");
    assert_ok(sfem_body_move_pin(body, 0, x, &err), err);
    assert_status(sfem_body_set_pins(body, 1, none, NULL, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "node 20");
    assert_status(sfem_body_set_pins(body, 1, clamp, axes, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "axes 8");
    assert_int_equal(sfem_body_get_info(body).free_nodes, NODES - CLAMPED);
    sfem_body_free(body);
    sfem_model_free(model);
}

/* ---- forces ---- */

/* Held at rest, a body's weight is on the handles from the very first step, at any step. */
static void handles_carry_the_weight(void **state)
{
    static const double h[4] = {0.01, 0.01, 0.004, 0.008};
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(schemes); ++k) {
        const scheme *s = schemes + k;
        sfem_model *model = beam_of(s);
        sfem_body_def def = body_def_of(s, 0);
        sfem_body *body;
        sfem_int handle[4];
        sfem_error err;
        int i, j, c;
        def.gravity[0] = -9.81;
        body = make_body(model, &def);
        for (j = 0; j < 4; ++j) handle[j] = grab(body, 16 + j); /* it hangs from the end x = 4 */
        assert_ok(sfem_body_solve_static(body, &err), err);
        for (i = -1; i < 12; ++i) { /* -1: by the static solution */
            double sum[3] = {0, 0, 0}, f[3];
            if (i >= 0) step(body, h[i % 4]);
            for (j = 0; j < 4; ++j) {
                sfem_body_handle_force(body, handle[j], f);
                for (c = 0; c < 3; ++c) sum[c] += f[c];
            }
            for (c = 0; c < 3; ++c) {
                const double wanted = c ? 0 : 9.81 * 4000;
                if (!(fabs(sum[c] - wanted) < 1e-8 * 4e4))
                    fail_msg("%s, step %d, axis %d: the handles carry %g, the weight is %g",
                             s->name, i, c, sum[c], wanted);
            }
        }
        sfem_body_free(body);
        sfem_model_free(model);
    }
}

/* Dropped onto one handle above its middle, a body comes to rest, and the handle carries it. */
static void a_handle_carries_a_body_that_comes_to_rest(void **state)
{
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(schemes); ++k) {
        scheme s = schemes[k];
        const double h = s.integrator == SFEM_CENTRAL ? 0.01 : 0.02;
        sfem_model *model = beam_of(&s);
        sfem_body_def def;
        sfem_body *body;
        const sfem_mesh *mesh = sfem_model_mesh(model);
        const double middle[3] = {2, 0.5, 0.5};
        double bary[4], f[3], x[3];
        sfem_int tet, handle;
        sfem_error err;
        int i, c;
        s.alpha = 5;
        def = body_def_of(&s, 0);
        def.gravity[2] = -9.81;
        body = make_body(model, &def);
        assert_true(sfem_mesh_locate(mesh, NULL, middle, &tet, bary));
        assert_ok(sfem_body_grab_point(body, tet, bary, &handle, &err), err);
        for (i = 0; i < 1500; ++i) step(body, h);
        sfem_body_handle_force(body, handle, f);
        sfem_body_handle_position(body, handle, x);
        for (c = 0; c < 3; ++c) {
            assert_near(f[c], c == 2 ? 9.81 * 4000 : 0, 0, 1e-7 * 4e4);
            assert_near(x[c], middle[c], 0, 1e-10);
        }
        sfem_body_free(body);
        sfem_model_free(model);
    }
}

/* A node taken in full flight: with plain Lagrange multipliers and Newmark's 1/4, 1/2 its acceleration
 * alternates and grows, from 138 to 6.6e4 in 960 steps of the source's example. */
static void a_moving_node_that_is_taken_does_not_ring(void **state)
{
    const double point[4] = {0.4, 0.3, 0.2, 0.1};
    size_t k;
    int at_point;
    (void)state;
    for (k = 0; k < TEST_COUNT(schemes); ++k) {
        for (at_point = 0; at_point < 2; ++at_point) {
            const scheme *s = schemes + k;
            sfem_model *model = beam_of(s);
            sfem_body_def def = body_def_of(s, CLAMPED);
            sfem_body *body = make_body(model, &def);
            sfem_int handle;
            sfem_error err;
            test_random r = {53};
            double v[DOFS], target[3], x[3], early = 0, late = 0, before, after;
            int i, j, c;
            random_fill(&r, v, DOFS, -1, 1);
            assert_ok(sfem_body_set_state(body, NULL, v, &err), err);
            for (i = 0; i < 20; ++i) step(body, 0.01);
            before = sfem_body_energy(body).total;
            if (at_point)
                assert_ok(sfem_body_grab_point(body, 11, point, &handle, &err), err);
            else
                handle = grab(body, FIRST);
            sfem_body_handle_position(body, handle, target);
            for (i = 0; i < 960; ++i) {
                double most = 0;
                step(body, 0.01);
                for (j = 0; j < DOFS; ++j) most = fmax(most, fabs(sfem_body_acceleration(body)[j]));
                sfem_body_handle_position(body, handle, x);
                for (c = 0; c < 3; ++c) assert_near(x[c], target[c], 0, 1e-10);
                if (i < 20) early = fmax(early, most);
                if (i >= 900) late = fmax(late, most);
            }
            after = sfem_body_energy(body).total;
            if (!(late < 2 * early)) fail_msg("%s: acceleration %g, then %g", s->name, early, late);
            if (!(after < 1.2 * before)) fail_msg("%s: energy %g, then %g", s->name, before, after);
            sfem_body_free(body);
            sfem_model_free(model);
        }
    }
}

/* ---- points, redundant handles, refusals ---- */

static void points_are_held_where_they_are_told(void **state)
{
    const double bary[2][4] = {{0.1, 0.2, 0.3, 0.4}, {0, 0.5, 0.5, 0}};
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(schemes); ++k) {
        const scheme *s = schemes + k;
        sfem_model *model = beam_of(s);
        sfem_body_def def = body_def_of(s, CLAMPED);
        sfem_body *body;
        sfem_int handle[2];
        sfem_error err;
        double from[2][3], x[DOFS], d[3], at[3];
        int i, j, c, a;
        def.gravity[2] = -9.81;
        body = make_body(model, &def);
        for (i = 0; i < 20; ++i) step(body, 0.01);
        for (j = 0; j < 2; ++j) {
            assert_ok(sfem_body_grab_point(body, 8 + 7 * j, bary[j], &handle[j], &err), err);
            sfem_body_handle_position(body, handle[j], from[j]);
        }
        for (i = 1; i <= 100; ++i) {
            path(0.01 * i, d);
            for (j = 0; j < 2; ++j) {
                for (c = 0; c < 3; ++c) at[c] = from[j][c] + d[c];
                assert_ok(sfem_body_move_handle(body, handle[j], at, &err), err);
            }
            step(body, 0.01);
            sfem_body_positions(body, x);
            for (j = 0; j < 2; ++j) {
                const sfem_int *t = sfem_model_mesh(model)->tet + 4 * (8 + 7 * j);
                sfem_body_handle_position(body, handle[j], at);
                for (c = 0; c < 3; ++c) {
                    double mean = 0;
                    for (a = 0; a < 4; ++a) mean += bary[j][a] * x[3 * t[a] + c];
                    assert_near(mean, from[j][c] + d[c], 0, 1e-12);
                    assert_near(at[c], mean, 0, 1e-14);
                }
            }
        }
        sfem_body_free(body);
        sfem_model_free(model);
    }
}

/* A fifth point of one tet, and a node taken twice, hang on what is held already: they change nothing. */
static void redundant_handles_carry_nothing(void **state)
{
    static const double bary[5][4] = {{1, 0, 0, 0},
                                      {0.2, 0.6, 0.1, 0.1},
                                      {0.1, 0.1, 0.7, 0.1},
                                      {0.05, 0.15, 0.2, 0.6},
                                      {0.25, 0.25, 0.25, 0.25}};
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(schemes); ++k) {
        const scheme *s = schemes + k;
        sfem_model *model = beam_of(s);
        sfem_body_def def = body_def_of(s, CLAMPED);
        sfem_body *body[2];
        sfem_int handle[2][7];
        sfem_error err;
        test_random r = {61};
        double v[DOFS], size = 0;
        int i, j, b, c;
        random_fill(&r, v, DOFS, -0.3, 0.3);
        def.gravity[2] = -9.81;
        for (b = 0; b < 2; ++b) {
            body[b] = make_body(model, &def);
            assert_ok(sfem_body_set_state(body[b], NULL, v, &err), err);
            step(body[b], 0.01);
            for (j = 0; j < 4; ++j)
                assert_ok(sfem_body_grab_point(body[b], 16, bary[j], &handle[b][j], &err), err);
            handle[b][4] = grab(body[b], 4);
        }
        assert_ok(sfem_body_grab_point(body[1], 16, bary[4], &handle[1][5], &err), err);
        handle[1][6] = grab(body[1], 4);
        for (i = 0; i < 50; ++i) {
            for (b = 0; b < 2; ++b) step(body[b], 0.01);
            same_displacement(body[0], body[1], 1e-9, s->name);
            for (j = 0; j < 5; ++j) {
                double f[2][3];
                for (b = 0; b < 2; ++b) sfem_body_handle_force(body[b], handle[b][j], f[b]);
                for (c = 0; c < 3; ++c) {
                    size = fmax(size, fabs(f[0][c]));
                    if (!(fabs(f[0][c] - f[1][c]) <= 1e-8 * size))
                        fail_msg("%s: force %g of handle %d is %g with others", s->name, f[0][c], j,
                                 f[1][c]);
                }
            }
            for (j = 5; j < 7; ++j) {
                double f[3];
                sfem_body_handle_force(body[1], handle[1][j], f);
                for (c = 0; c < 3; ++c) assert_true(f[c] == 0);
            }
        }
        assert_true(size > 10);
        for (b = 0; b < 2; ++b) sfem_body_free(body[b]);
        sfem_model_free(model);
    }
}

static void what_cannot_be_held_is_refused(void **state)
{
    static const double bary[4] = {0.25, 0.25, 0.25, 0.25}, sum[4] = {0.5, 0.5, 0.5, 0.5};
    static const double nan_bary[4] = {NAN, 0, 0, 1}, nan_x[3] = {0, INFINITY, 0};
    sfem_model *model = beam_of(schemes);
    sfem_body_def def = body_def_of(schemes, CLAMPED);
    sfem_body *body;
    sfem_int handle = -7, taken, i;
    sfem_error err;
    double x[3];
    (void)state;
    def.max_handles = 3;
    body = make_body(model, &def);
    assert_status(sfem_body_grab_node(body, 2, &handle, &err), SFEM_BAD_ARGUMENT);
    assert_string_equal(err.text, "node 2 is pinned on all axes");
    assert_int_equal(err.node, 2);
    assert_status(sfem_body_grab_node(body, NODES, &handle, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "node 20");
    assert_status(sfem_body_grab_node(body, -1, &handle, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "node -1");
    assert_status(sfem_body_grab_point(body, 20, bary, &handle, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "tet 20");
    assert_status(sfem_body_grab_point(body, -1, bary, &handle, &err), SFEM_BAD_ARGUMENT);
    assert_status(sfem_body_grab_point(body, 3, sum, &handle, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "add up");
    assert_int_equal(err.tet, 3);
    assert_status(sfem_body_grab_point(body, 3, nan_bary, &handle, &err), SFEM_BAD_ARGUMENT);
    for (i = 0; i < 3; ++i) assert_int_equal(grab(body, 8 + i), i);
    assert_status(sfem_body_grab_node(body, 12, &handle, &err), SFEM_FULL);
    assert_names(err, "all 3 handles");
    assert_status(sfem_body_grab_point(body, 3, bary, &handle, NULL), SFEM_FULL);
    assert_int_equal(handle, -7);
    sfem_body_handle_position(body, 1, x);
    assert_status(sfem_body_move_handle(body, 1, nan_x, &err), SFEM_NOT_FINITE);
    assert_names(err, "handle 1");
    step(body, 0.01);
    for (i = 0; i < 3; ++i) assert_true(sfem_body_displacement(body)[3 * 9 + i] == 0);
    /* a number is used again once it was released, and only then */
    sfem_body_release_handle(body, 1);
    taken = grab(body, 12);
    assert_int_equal(taken, 1);
    sfem_body_handle_position(body, 1, x);
    assert_near(x[0], 3, 0, 1e-12);
    sfem_body_free(body);
    def.max_handles = 0;
    body = make_body(model, &def);
    assert_status(sfem_body_grab_node(body, 12, &handle, &err), SFEM_FULL);
    step(body, 0.01);
    sfem_body_free(body);
    sfem_model_free(model);
}

/* Of a node that slides along a plane, a handle holds what is free. */
static void a_handle_holds_the_free_axes_of_a_pinned_node(void **state)
{
    const unsigned char axes[5] = {7, 7, 7, 7, SFEM_AXIS_Z};
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(schemes); ++k) {
        sfem_model *model = beam_of(schemes + k);
        sfem_body_def def = body_def_of(schemes + k, CLAMPED + 1);
        sfem_body *body, *pinned;
        sfem_int handle;
        double f[3];
        int i;
        def.gravity[0] = 3;
        def.gravity[2] = -9.81;
        pinned = make_body(model, &def);
        def.pin_axes = axes;
        body = make_body(model, &def);
        handle = grab(body, FIRST);
        for (i = 0; i < 50; ++i) {
            step(body, 0.01);
            step(pinned, 0.01);
            same_displacement(body, pinned, 1e-9, schemes[k].name);
        }
        sfem_body_handle_force(body, handle, f);
        assert_true(f[2] == 0 && fabs(f[0]) > 1);
        sfem_body_free(body);
        sfem_body_free(pinned);
        sfem_model_free(model);
    }
}

/* ---- release ---- */

static void handles_that_pull_nothing_leave_no_trace(void **state)
{
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(schemes); ++k) {
        const scheme *s = schemes + k;
        sfem_model *model;
        sfem_body_def def = body_def_of(s, 0);
        sfem_body *body, *free_body;
        sfem_int handle[2];
        sfem_error err;
        double v[DOFS], f[3], x[3];
        int i, j, c;
        const double speed[3] = {0.3, -0.2, 0.5};
        if (s->alpha != 0) continue; /* mass damping would brake the flight */
        model = beam_of(s);
        body = make_body(model, &def);
        free_body = make_body(model, &def);
        for (i = 0; i < DOFS; ++i) v[i] = speed[i % 3];
        assert_ok(sfem_body_set_state(body, NULL, v, &err), err);
        assert_ok(sfem_body_set_state(free_body, NULL, v, &err), err);
        for (i = 0; i < 60; ++i) {
            if (i == 20)
                for (j = 0; j < 2; ++j) handle[j] = grab(body, clamp[CLAMPED + j]);
            for (j = 0; j < 2 && i >= 20 && i < 40; ++j) {
                sfem_body_handle_position(body, handle[j], x);
                for (c = 0; c < 3; ++c) x[c] += 0.01 * speed[c];
                assert_ok(sfem_body_move_handle(body, handle[j], x, &err), err);
            }
            if (i == 40)
                for (j = 0; j < 2; ++j) sfem_body_release_handle(body, handle[j]);
            step(body, 0.01);
            step(free_body, 0.01);
            same_displacement(body, free_body, 1e-11, s->name);
            for (j = 0; j < 2 && i >= 20 && i < 40; ++j) {
                sfem_body_handle_force(body, handle[j], f);
                for (c = 0; c < 3; ++c) assert_near(f[c], 0, 0, 1e-6);
            }
        }
        sfem_body_free(body);
        sfem_body_free(free_body);
        sfem_model_free(model);
    }
}

/* ... and to take and let go between two steps changes no bit. */
static void taking_and_releasing_between_steps_changes_nothing(void **state)
{
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(schemes); ++k) {
        sfem_model *model = beam_of(schemes + k);
        sfem_body_def def = body_def_of(schemes + k, CLAMPED);
        sfem_body *body[2];
        sfem_int handle;
        sfem_error err;
        int i, b;
        def.gravity[1] = 7;
        for (b = 0; b < 2; ++b) {
            body[b] = make_body(model, &def);
            for (i = 0; i < 40; ++i) {
                if (b && i % 10 == 5) {
                    handle = grab(body[b], FIRST);
                    if (i > 20) assert_ok(sfem_body_prepare(body[b], 0.01, &err), err);
                    sfem_body_release_handle(body[b], handle);
                }
                step(body[b], 0.01);
            }
        }
        assert_true(hash_reals(sfem_body_displacement(body[0]), DOFS) ==
                    hash_reals(sfem_body_displacement(body[1]), DOFS));
        for (b = 0; b < 2; ++b) sfem_body_free(body[b]);
        sfem_model_free(model);
    }
}

/* A step under way is given up by what changes its equation, and the body is where it was. */
static void a_predicted_step_can_be_given_up(void **state)
{
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(schemes); ++k) {
        sfem_model *model = beam_of(schemes + k);
        sfem_body_def def = body_def_of(schemes + k, CLAMPED);
        sfem_body *body[2];
        sfem_int handle;
        sfem_error err;
        int i, b;
        def.gravity[1] = 7;
        for (b = 0; b < 2; ++b) {
            body[b] = make_body(model, &def);
            for (i = 0; i < 30; ++i) {
                if (i == 10) handle = grab(body[b], FIRST);
                if (b && i > 0) assert_ok(sfem_body_predict(body[b], 0.01, &err), err);
                if (b && i == 5) assert_ok(sfem_body_solve(body[b], &err), err);
                if (b && i == 7) assert_ok(sfem_body_prepare(body[b], 0.005, &err), err);
                if (i == 20) sfem_body_release_handle(body[b], handle);
                if (i == 25)
                    assert_ok(sfem_body_set_pins(body[b], CLAMPED + 1, clamp, NULL, &err), err);
                step(body[b], 0.01);
            }
        }
        same_displacement(body[0], body[1], 1e-15, schemes[k].name);
        for (b = 0; b < 2; ++b) sfem_body_free(body[b]);
        sfem_model_free(model);
    }
}

/* ---- saving, allocation ---- */

static void pull(sfem_body *body, sfem_int handle, int i)
{
    double d[3], x[3];
    sfem_error err;
    path(0.01 * i, d);
    x[0] = 4 + d[0];
    x[1] = d[1];
    x[2] = 1 + d[2];
    assert_ok(sfem_body_move_handle(body, handle, x, &err), err);
    step(body, i % 7 ? 0.01 : 0.004);
}

static void a_saved_state_with_handles_goes_on_bit_for_bit(void **state)
{
    static const double bary[4] = {0.1, 0.2, 0.3, 0.4};
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(schemes); ++k) {
        sfem_model *model = beam_of(schemes + k);
        sfem_body_def def = body_def_of(schemes + k, CLAMPED);
        sfem_body *body[2];
        sfem_int handle, point;
        sfem_error err;
        uint64_t hash = 0;
        double force[3], f[3];
        void *memory;
        size_t bytes;
        int i, b;
        def.gravity[2] = -9.81;
        for (b = 0; b < 2; ++b) body[b] = make_body(model, &def);
        assert_int_equal(grab(body[0], 9), 0);
        handle = grab(body[0], FIRST);
        assert_ok(sfem_body_grab_point(body[0], 11, bary, &point, &err), err);
        sfem_body_release_handle(body[0], 0);
        for (i = 1; i < 25; ++i) pull(body[0], handle, i);
        bytes = sfem_body_state_size(body[0]);
        assert_int_equal(bytes, sfem_body_state_size(body[1]));
        memory = malloc(bytes);
        assert_non_null(memory);
        sfem_body_save_state(body[0], memory);
        grab(body[1], 10); /* goes with the load */
        grab(body[1], 11);
        step(body[1], 0.01); /* with columns of its own, which must not serve the loaded handles */
        for (b = 0; b < 3; ++b) { /* the same body, another, and the first one set back */
            sfem_body *on = body[b % 2];
            if (b) assert_ok(sfem_body_load_state(on, memory, bytes, &err), err);
            for (i = 25; i < 60; ++i) pull(on, handle, i);
            sfem_body_handle_force(on, point, f);
            if (b == 0) hash = hash_reals(sfem_body_displacement(on), DOFS);
            if (b == 0) memcpy(force, f, sizeof f);
            assert_true(hash == hash_reals(sfem_body_displacement(on), DOFS));
            assert_memory_equal(force, f, sizeof f);
        }
        ((unsigned char *)memory)[bytes / 2] ^= 4;
        hash = hash_reals(sfem_body_displacement(body[0]), DOFS);
        assert_status(sfem_body_load_state(body[0], memory, bytes, &err), SFEM_FORMAT);
        assert_names(err, "damaged");
        assert_true(hash == hash_reals(sfem_body_displacement(body[0]), DOFS));
        ((unsigned char *)memory)[bytes / 2] ^= 4;
        sfem_body_free(body[1]);
        def.max_handles = 15;
        body[1] = make_body(model, &def);
        assert_status(sfem_body_load_state(body[1], memory, bytes, &err), SFEM_MISMATCH);
        free(memory);
        for (b = 0; b < 2; ++b) sfem_body_free(body[b]);
        sfem_model_free(model);
    }
}

/* A checksum is no signature: whatever stands in a block, what is taken from it is safe to step. */
static void a_forged_state_is_refused_or_harmless(void **state)
{
    const sfem_int cells[3] = {1, 1, 1}, pin = 0;
    const sfem_real size[3] = {1, 1, 1};
    const uint64_t wrong[3] = {0x7fffffff7fffffffu, 0x4000000000000040u, 0xffffffffffffffffu};
    sfem_model_def md = linear_model_def();
    sfem_body_def def = exact_body_def();
    sfem_mesh mesh;
    sfem_model *model;
    sfem_body *body;
    sfem_error err;
    sfem_int handle, refused = 0, i;
    size_t bytes, at;
    char *block, *forged;
    int k;
    (void)state;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_6_TETS, NULL, &mesh, &err), err);
    md.mesh = &mesh;
    md.material.law = SFEM_NEOHOOKEAN;
    assert_ok(sfem_model_create(&md, &model, &err), err);
    def.pins = &pin;
    def.pin_count = 1;
    def.max_handles = 1;
    assert_ok(sfem_body_create(model, &def, &body, &err), err);
    assert_ok(sfem_body_grab_node(body, 7, &handle, &err), err);
    assert_ok(sfem_body_step(body, 0.01, &err), err);
    bytes = sfem_body_state_size(body);
    block = (char *)malloc(2 * bytes);
    forged = block + bytes;
    sfem_body_save_state(body, block);
    for (at = 16; at + 8 <= bytes; at += 8) /* after the version; the checksum stands at 32 */
        for (k = 0; k < 3; ++k) {
            uint64_t sum = 0;
            sfem_status status;
            memcpy(forged, block, bytes);
            memcpy(forged + at, wrong + k, 8);
            memcpy(forged + 32, &sum, 8);
            sum = hash_bytes(forged, bytes);
            memcpy(forged + 32, &sum, 8);
            status = sfem_body_load_state(body, forged, bytes, &err);
            refused += status != SFEM_OK;
            (void)sfem_body_step(body, 0.01, &err);
            for (i = 0; i < 3 * mesh.nodes; ++i)
                assert_true(isfinite(sfem_body_displacement(body)[i]));
            assert_ok(sfem_body_load_state(body, block, bytes, &err), err);
        }
    assert_true(refused > 9 * mesh.nodes); /* u, w and a at least */
    free(block);
    sfem_body_free(body);
    sfem_model_free(model);
    sfem_mesh_free(&mesh);
}

static void without_allocation_only_a_new_step_size_asks_to_be_prepared(void **state)
{
    test_memory memory = {0};
    sfem_model *model = make_beam(SFEM_MASS_LUMPED, test_allocator(&memory));
    sfem_body_def def = body_def_of(schemes, CLAMPED);
    sfem_body *body;
    sfem_int handle;
    sfem_error err;
    size_t calls;
    int i;
    (void)state;
    def.may_allocate = 0;
    def.allocator = test_allocator(&memory);
    def.gravity[2] = -9.81;
    body = make_body(model, &def);
    assert_status(sfem_body_step(body, 0.01, &err), SFEM_NOT_PREPARED);
    assert_names(err, "0.01");
    assert_status(sfem_body_predict(body, 0.01, NULL), SFEM_NOT_PREPARED);
    assert_near(sfem_body_time(body), 0, 0, 0);
    assert_ok(sfem_body_prepare(body, 0.01, &err), err);
    calls = memory.calls;
    step(body, 0.01);
    assert_status(sfem_body_step(body, 0.02, &err), SFEM_NOT_PREPARED);
    handle = grab(body, FIRST); /* its columns are solved for, into memory that is there */
    for (i = 0; i < 5; ++i) step(body, 0.01);
    assert_status(sfem_body_step(body, 0.02, &err), SFEM_NOT_PREPARED);
    grab(body, SECOND);
    for (i = 0; i < 5; ++i) step(body, 0.01);
    sfem_body_release_handle(body, handle);
    for (i = 0; i < 5; ++i) step(body, 0.01);
    assert_int_equal(memory.calls, calls); /* handles' memory was laid in by the first prepare */
    sfem_body_free(body);
    sfem_model_free(model);
    assert_no_leak(memory);
}

static sfem_status attempt_all(sfem_allocator allocator, void *user, sfem_error *err)
{
    static const double bary[4] = {0.1, 0.2, 0.3, 0.4};
    const scheme *s = (const scheme *)user;
    const sfem_allocator malloc_and_free = {NULL, NULL, NULL};
    sfem_model *model = make_beam(s->mass, malloc_and_free);
    sfem_body_def def = body_def_of(s, CLAMPED);
    sfem_body *body = NULL;
    sfem_int handle = -1;
    uint64_t before = 0;
    sfem_status status;
    def.allocator = allocator;
    def.gravity[2] = -9.81;
    status = sfem_body_create(model, &def, &body, err);
    if (status != SFEM_OK) assert_null(body);
    if (status == SFEM_OK) status = sfem_body_step(body, 0.01, err);
    if (status == SFEM_OK) status = sfem_body_grab_node(body, FIRST, &handle, err);
    if (status == SFEM_OK) status = sfem_body_grab_point(body, 11, bary, &handle, err);
    if (status == SFEM_OK) status = sfem_body_prepare(body, 0.01, err);
    if (status == SFEM_OK) status = sfem_body_step(body, 0.01, err);
    if (status == SFEM_OK) status = sfem_body_step(body, 0.005, err);
    if (status == SFEM_OK) {
        before = hash_reals(sfem_body_displacement(body), DOFS);
        status = sfem_body_set_pins(body, CLAMPED + 1, clamp, NULL, err);
        if (status != SFEM_OK) { /* as it was: it goes on */
            sfem_error again;
            assert_true(before == hash_reals(sfem_body_displacement(body), DOFS));
            assert_int_equal(sfem_body_get_info(body).free_nodes, NODES - CLAMPED);
            assert_ok(sfem_body_step(body, 0.005, &again), again);
        }
    }
    if (status == SFEM_OK) status = sfem_body_step(body, 0.005, err);
    if (status == SFEM_OK) {
        before = hash_reals(sfem_body_displacement(body), DOFS);
        status = sfem_body_solve_static(body, err);
        if (status != SFEM_OK)
            assert_true(before == hash_reals(sfem_body_displacement(body), DOFS));
    }
    sfem_body_free(body);
    sfem_model_free(model);
    return status;
}

static void every_allocation_of_a_body_may_fail(void **state)
{
    (void)state;
    assert_true(fail_every_allocation(attempt_all, (void *)(uintptr_t)&schemes[0]) > 15);
    fail_every_allocation(attempt_all, (void *)(uintptr_t)&schemes[5]);
    fail_every_allocation(attempt_all, (void *)(uintptr_t)&schemes[11]);
    fail_every_allocation(attempt_all, (void *)(uintptr_t)&schemes[12]);
}

/* factors belong to the model: its allocator fails here, on a body that exists */
static sfem_status attempt_factor(sfem_allocator allocator, void *user, sfem_error *err)
{
    test_memory *memory = (test_memory *)allocator.user;
    const size_t fail_at = memory->fail_at;
    const scheme *s = (const scheme *)user;
    sfem_model *model;
    sfem_body_def def = body_def_of(s, CLAMPED);
    sfem_body *body;
    sfem_status status;
    memory->fail_at = 0;
    model = make_beam(s->mass, allocator);
    body = make_body(model, &def);
    memory->calls = 0; /* from here on they count */
    memory->fail_at = fail_at;
    status = sfem_body_step(body, 0.01, err);
    if (status != SFEM_OK) assert_near(sfem_body_time(body), 0, 0, 0);
    if (status == SFEM_OK) status = sfem_body_step(body, 0.005, err); /* one like the first */
    if (status == SFEM_OK) status = sfem_body_solve_static(body, err);
    memory->fail_at = 0;
    if (status != SFEM_OK) {
        sfem_error again;
        assert_ok(sfem_body_step(body, 0.01, &again), again); /* once there is memory */
    }
    sfem_body_free(body);
    sfem_model_free(model);
    return status;
}

static void every_allocation_of_a_factor_may_fail(void **state)
{
    (void)state;
    assert_true(fail_every_allocation(attempt_factor, (void *)(uintptr_t)&schemes[2]) > 15);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(resting_handles_equal_eliminated_pins),
        cmocka_unit_test(handles_set_moved_and_released_equal_moved_pins),
        cmocka_unit_test(moving_handles_of_damped_newmark_converge_to_moving_pins),
        cmocka_unit_test(handles_follow_changes_of_the_step),
        cmocka_unit_test(velocity_of_what_is_pulled_survives_a_change_of_step),
        cmocka_unit_test(pins_set_at_run_time_take_over_from_handles),
        cmocka_unit_test(pins_set_at_run_time_equal_pins_from_the_start),
        cmocka_unit_test(only_pinned_nodes_can_be_moved),
        cmocka_unit_test(handles_carry_the_weight),
        cmocka_unit_test(a_handle_carries_a_body_that_comes_to_rest),
        cmocka_unit_test(a_moving_node_that_is_taken_does_not_ring),
        cmocka_unit_test(points_are_held_where_they_are_told),
        cmocka_unit_test(redundant_handles_carry_nothing),
        cmocka_unit_test(what_cannot_be_held_is_refused),
        cmocka_unit_test(a_handle_holds_the_free_axes_of_a_pinned_node),
        cmocka_unit_test(handles_that_pull_nothing_leave_no_trace),
        cmocka_unit_test(taking_and_releasing_between_steps_changes_nothing),
        cmocka_unit_test(a_predicted_step_can_be_given_up),
        cmocka_unit_test(a_saved_state_with_handles_goes_on_bit_for_bit),
        cmocka_unit_test(a_forged_state_is_refused_or_harmless),
        cmocka_unit_test(without_allocation_only_a_new_step_size_asks_to_be_prepared),
        cmocka_unit_test(every_allocation_of_a_body_may_fail),
        cmocka_unit_test(every_allocation_of_a_factor_may_fail),
    };
    return run_all_tests(tests);
}
