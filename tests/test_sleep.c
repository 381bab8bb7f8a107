/* Bodies that fall asleep, sleep and wake. */
#include "support.h"
#include "linear.h"

/* --------------------------------------------------------------------------------------------
 * scenes
 * -------------------------------------------------------------------------------------------- */

#define TOLERANCE 0.01 /* m/s, unless stated */

typedef struct scene {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_int pins[64], pin_count; /* the face at x = 0 */
    sfem_int tip;                 /* a node far from it */
} scene;

static scene bar(sfem_law law, double young)
{
    const sfem_int cells[3] = {4, 1, 1};
    const sfem_real size[3] = {0.4, 0.1, 0.1};
    sfem_model_def def = linear_model_def();
    sfem_error err;
    scene s;
    sfem_int i;
    memset(&s, 0, sizeof s);
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &s.mesh, &err), err);
    for (i = 0; i < s.mesh.nodes; ++i) {
        if (s.mesh.x[3 * i] < 1e-9) s.pins[s.pin_count++] = i;
        if (s.mesh.x[3 * i] > 0.4 - 1e-9) s.tip = i;
    }
    def.mesh = &s.mesh;
    def.material.young = young;
    def.material.poisson = 0.3;
    def.material.law = law;
    assert_ok(sfem_model_create(&def, &s.model, &err), err);
    return s;
}

static void drop(scene *s)
{
    sfem_model_free(s->model);
    sfem_mesh_free(&s->mesh);
}

/* hangs from its pins, damped so that it rests after some seconds */
static sfem_body_def hanging(const scene *s)
{
    sfem_body_def d = exact_body_def();
    d.pins = s->pins;
    d.pin_count = s->pin_count;
    d.gravity[1] = -9.8;
    d.mass_damping = 4;
    d.sleep_tolerance = TOLERANCE;
    return d;
}

static sfem_body *make(const scene *s, sfem_body_def def)
{
    sfem_body *body;
    sfem_error err;
    assert_ok(sfem_body_create(s->model, &def, &body, &err), err);
    return body;
}

static void step(sfem_body *body, double h)
{
    sfem_error err;
    assert_ok(sfem_body_step(body, h, &err), err);
}

static double largest_speed(const scene *s, const sfem_body *body)
{
    sfem_real *v = (sfem_real *)malloc(3 * (size_t)s->mesh.nodes * sizeof *v), most = 0;
    sfem_int i;
    sfem_body_velocities(body, v);
    for (i = 0; i < s->mesh.nodes; ++i)
        most = fmax(most, sqrt(v[3 * i] * v[3 * i] + v[3 * i + 1] * v[3 * i + 1] +
                               v[3 * i + 2] * v[3 * i + 2]));
    free(v);
    return most;
}

/* steps until it sleeps; at most 60 s */
static int run_to_sleep(sfem_body *body, double h)
{
    int k = 0;
    for (; !sfem_body_is_asleep(body); ++k) {
        if (k * h > 60) fail_msg("awake after 60 s");
        step(body, h);
    }
    return k;
}

static uint64_t hash_displacement(const scene *s, const sfem_body *body)
{
    return hash_reals(sfem_body_displacement(body), 3 * (size_t)s->mesh.nodes);
}

/* --------------------------------------------------------------------------------------------
 * falling asleep
 * -------------------------------------------------------------------------------------------- */

static void sleeps_and_stays(scene *s, sfem_body_def def, double h)
{
    sfem_body *body = make(s, def), *still = make(s, def);
    const size_t n = 3 * (size_t)s->mesh.nodes;
    sfem_energy before, after;
    sfem_error err;
    const double allowed = 0.5 * 4 * TOLERANCE * TOLERANCE; /* the kinetic energy, of 4 kg */
    double time, far = 0;
    uint64_t hash;
    int k;
    size_t i;
    run_to_sleep(body, h);
    assert_true(largest_speed(s, body) == 0);
    assert_ok(sfem_body_solve_static(still, &err), err);
    for (i = 0; i < n; ++i)
        far = fmax(far, fabs(sfem_body_displacement(body)[i] - sfem_body_displacement(still)[i]));
    assert_true(far < TOLERANCE /
                          4); /* a speed below the tolerance at 4/s and faster, the slowest mode */
    hash = hash_displacement(s, body);
    before = sfem_body_energy(body);
    time = sfem_body_time(body);
    assert_true(before.kinetic == 0);
    assert_near(before.conserved, before.total, 1e-12, 0);
    for (k = 0; k < 1000; ++k) step(body, h);
    assert_true(sfem_body_is_asleep(body));
    assert_true(hash_displacement(s, body) == hash);
    assert_near(sfem_body_time(body), time + 1000 * h, 1e-9, 0);
    after = sfem_body_energy(body);
    assert_true(after.total == before.total);
    /* woken without reason it goes on where it was: slow, and with no more energy */
    sfem_body_wake(body);
    assert_false(sfem_body_is_asleep(body));
    for (k = 0; k < 400 && !sfem_body_is_asleep(body); ++k) {
        step(body, h);
        assert_true(largest_speed(s, body) <= TOLERANCE);
        after = sfem_body_energy(body);
        assert_true(after.total <=
                    before.total + 2e-3 * allowed); /* what the reading of v makes of it */
    }
    sfem_body_free(body);
    sfem_body_free(still);
}

static void a_damped_body_falls_asleep_where_it_rests_under_every_integrator_and_law(void **state)
{
    const sfem_law laws[] = {SFEM_LINEAR, SFEM_COROTATIONAL, SFEM_NEOHOOKEAN};
    size_t l;
    int integrator;
    (void)state;
    for (l = 0; l < TEST_COUNT(laws); ++l) {
        scene s = bar(laws[l], 1e5);
        for (integrator = SFEM_PQR; integrator <= SFEM_BATHE; ++integrator) {
            sfem_body_def def = hanging(&s);
            def.integrator = (sfem_integrator)integrator;
            def.accuracy = 1e-9; /* corrections are left out below what is to be seen of the energy */
            sleeps_and_stays(&s, def, integrator == SFEM_CENTRAL ? 1.0 / 1000 : 1.0 / 60);
        }
        drop(&s);
    }
}

static void it_does_not_before_it_was_calm_for_the_time_asked_for(void **state)
{
    scene s = bar(SFEM_COROTATIONAL, 1e5);
    sfem_body_def def = hanging(&s);
    double calm = 0;
    sfem_body *body, *plain;
    (void)state;
    def.sleep_time = 1.25;
    body = make(&s, def);
    def.sleep_tolerance = 0;
    plain = make(&s, def);
    while (!sfem_body_is_asleep(body)) { /* awake it moves as it would without sleep, bit by bit */
        assert_true(hash_displacement(&s, body) == hash_displacement(&s, plain));
        calm = largest_speed(&s, body) <= 0.98 * TOLERANCE ? calm + 1.0 / 64
                                                           : 0; /* v, not w: about the same */
        step(body, 1.0 / 64);
        step(plain, 1.0 / 64);
        assert_true(sfem_body_time(body) < 60);
    }
    assert_true(hash_displacement(&s, body) == hash_displacement(&s, plain));
    assert_true(calm > 1.2);
    assert_false(sfem_body_is_asleep(plain));
    assert_true(largest_speed(&s, plain) > 0);
    sfem_body_free(body);
    sfem_body_free(plain);
    drop(&s);
}

/* A swing near its first mode: the shape under gravity, let go without it. Speeds at the turning points stay
 * below the tolerance for longer than sleep_time. */
static void a_swing_does_not_fall_asleep_at_its_turning_points(void **state)
{
    const sfem_law laws[] = {SFEM_LINEAR, SFEM_COROTATIONAL};
    const double ratio[] = {1.2, 1.5, 4}; /* fastest speed over tolerance */
    size_t l, r;
    (void)state;
    for (l = 0; l < TEST_COUNT(laws); ++l) {
        scene s = bar(laws[l], 2e4);
        const size_t n = 3 * (size_t)s.mesh.nodes;
        sfem_body_def def = hanging(&s);
        sfem_real *u = (sfem_real *)malloc(n * sizeof *u);
        const double h = 1.0 / 240;
        double fastest = 0, last = 0, crossing[3] = {0, 0, 0}, period;
        int k, crossings = 0;
        sfem_body *body;
        sfem_error err;
        def.sleep_tolerance = def.mass_damping = 0;
        def.gravity[1] = -0.2;
        body = make(&s, def);
        assert_ok(sfem_body_solve_static(body, &err), err);
        memcpy(u, sfem_body_displacement(body), n * sizeof *u);
        def.gravity[1] = 0;
        sfem_body_free(body);
        body = make(&s, def);
        assert_ok(sfem_body_set_state(body, u, NULL, &err), err);
        for (k = 0; k < 2400 && crossings < 3; ++k) {
            const double y = sfem_body_displacement(body)[3 * s.tip + 1];
            if (last * y < 0) crossing[crossings++] = sfem_body_time(body);
            last = y;
            fastest = fmax(fastest, largest_speed(&s, body));
            step(body, h);
        }
        assert_int_equal(crossings, 3);
        period = crossing[2] - crossing[0];
        sfem_body_free(body);
        for (r = 0; r < TEST_COUNT(ratio); ++r) {
            int calm = 0, most = 0;
            def.sleep_tolerance = fastest / ratio[r];
            def.sleep_time =
                asin(1 / ratio[r]) / TEST_PI * period * 0.8; /* of the time below the tolerance */
            body = make(&s, def);
            assert_ok(sfem_body_set_state(body, u, NULL, &err), err);
            for (k = 0; k < 2400; ++k) {
                step(body, h);
                assert_false(sfem_body_is_asleep(body));
                calm = largest_speed(&s, body) < def.sleep_tolerance ? calm + 1 : 0;
                if (calm > most) most = calm;
            }
            assert_true(most * h >
                        def.sleep_time); /* it is the change of velocity that keeps it awake */
            sfem_body_free(body);
        }
        free(u);
        drop(&s);
    }
}

static void a_falling_body_does_not_sleep_at_the_top_of_its_flight(void **state)
{
    scene s = bar(SFEM_COROTATIONAL, 1e6);
    const size_t n = 3 * (size_t)s.mesh.nodes;
    sfem_body_def def = hanging(&s);
    sfem_real *v = (sfem_real *)calloc(n, sizeof *v);
    sfem_body *body;
    sfem_error err;
    size_t i;
    int k;
    (void)state;
    def.pin_count = 0;
    def.mass_damping = 0;
    def.gravity[1] = -1;
    def.sleep_tolerance = 0.5; /* below it for 1 s */
    for (i = 1; i < n; i += 3) v[i] = 2;
    body = make(&s, def);
    assert_ok(sfem_body_set_state(body, NULL, v, &err), err);
    for (k = 0; k < 240; ++k) {
        step(body, 1.0 / 60);
        assert_false(sfem_body_is_asleep(body));
    }
    sfem_body_free(body);
    free(v);
    drop(&s);
}

static void a_slow_ring_of_high_frequency_does_not_keep_a_body_awake(void **state)
{
    scene s = bar(SFEM_LINEAR, 1e6); /* Omega up to 30 */
    const size_t n = 3 * (size_t)s.mesh.nodes;
    sfem_body_def def = hanging(&s);
    sfem_real *v = (sfem_real *)calloc(n, sizeof *v);
    test_random random = {5};
    sfem_body *body;
    sfem_error err;
    (void)state;
    def.mass_damping = def.gravity[1] = 0; /* it never stops */
    random_fill(&random, v, n, -TOLERANCE / 40, TOLERANCE / 40);
    body = make(&s, def);
    assert_ok(sfem_body_set_state(body, NULL, v, &err), err);
    assert_true(run_to_sleep(body, 1.0 / 240) <= 242);
    sfem_body_free(body);
    free(v);
    drop(&s);
}

static void the_step_at_which_it_sleeps_is_the_same_for_any_number_of_threads(void **state)
{
    scene s = bar(SFEM_COROTATIONAL, 1e5);
    uint64_t hash[3];
    int steps[3], k;
    (void)state;
    for (k = 0; k < 3; ++k) {
        sfem_body_def def = hanging(&s);
        sfem_body *body;
        def.exec = thread_exec(1 + k);
        body = make(&s, def);
        steps[k] = run_to_sleep(body, 1.0 / 60);
        hash[k] = hash_displacement(&s, body);
        sfem_body_free(body);
    }
    assert_int_equal(steps[0], steps[1]);
    assert_int_equal(steps[0], steps[2]);
    assert_true(hash[0] == hash[1] && hash[0] == hash[2]);
    drop(&s);
}

/* --------------------------------------------------------------------------------------------
 * waking
 * -------------------------------------------------------------------------------------------- */

enum {
    WAKE,
    FORCE,
    NODE_FORCE,
    GRAVITY,
    PIN,
    HANDLE,
    GRAB,
    RELEASE,
    SET_STATE,
    SET_PINS,
    STATIC,
    PREDICT,
    CAUSES
};

/* with `same` the cause that changes nothing, where there is such a one */
static void provoke(scene *s, sfem_body *body, int cause, int same, sfem_int handle)
{
    const sfem_real g[3] = {0, same ? -9.8 : -9.7, 0}, push[3] = {0, 0, same ? 0 : 0.1};
    sfem_real *all = (sfem_real *)calloc(3 * (size_t)s->mesh.nodes, sizeof *all), x[3];
    const sfem_int node = s->pins[0];
    sfem_error err;
    sfem_int other;
    int c;
    switch (cause) {
    case WAKE:
        sfem_body_wake(body);
        break;
    case FORCE:
        all[3 * s->tip] = same ? 0.5 : 0.6;
        assert_ok(sfem_body_set_lasting_force(body, all, &err), err);
        break;
    case NODE_FORCE:
        assert_ok(sfem_body_add_lasting_force(body, s->tip, push, &err), err);
        break;
    case GRAVITY:
        assert_ok(sfem_body_set_gravity(body, g, &err), err);
        break;
    case PIN:
        for (c = 0; c < 3; ++c)
            x[c] = s->mesh.x[3 * node + c] + sfem_body_displacement(body)[3 * node + c];
        x[1] += same ? 0 : 1e-3;
        assert_ok(sfem_body_move_pin(body, node, x, &err), err);
        break;
    case HANDLE:
        for (c = 0; c < 3; ++c) x[c] = s->mesh.x[3 * s->tip + c];
        x[1] += same ? 0 : 1e-3;
        assert_ok(sfem_body_move_handle(body, handle, x, &err), err);
        break;
    case GRAB:
        assert_ok(sfem_body_grab_node(body, s->tip - 1, &other, &err), err);
        break;
    case RELEASE:
        sfem_body_release_handle(body, handle);
        break;
    case SET_STATE:
        assert_ok(sfem_body_set_state(body, NULL, NULL, &err), err);
        break;
    case SET_PINS:
        assert_ok(sfem_body_set_pins(body, s->pin_count, s->pins, NULL, &err), err);
        break;
    case STATIC:
        assert_ok(sfem_body_solve_static(body, &err), err);
        break;
    case PREDICT:
        assert_ok(sfem_body_predict(body, 1.0 / 60, &err), err);
        break;
    default:
        break;
    }
    free(all);
}

static sfem_int hold_and_load(scene *s, sfem_body *body)
{
    sfem_real *all = (sfem_real *)calloc(3 * (size_t)s->mesh.nodes, sizeof *all);
    sfem_int handle;
    sfem_error err;
    all[3 * s->tip] = 0.5;
    assert_ok(sfem_body_set_lasting_force(body, all, &err), err);
    assert_ok(sfem_body_grab_node(body, s->tip, &handle, &err), err);
    free(all);
    return handle;
}

static void each_cause_wakes_it_and_what_changes_nothing_does_not(void **state)
{
    const sfem_integrator integrators[] = {SFEM_PQR, SFEM_NEWMARK, SFEM_BATHE};
    const sfem_law laws[] = {SFEM_LINEAR, SFEM_COROTATIONAL};
    size_t l, i;
    int cause;
    (void)state;
    for (l = 0; l < TEST_COUNT(laws); ++l) {
        scene s = bar(laws[l], 1e5);
        for (i = 0; i < TEST_COUNT(integrators); ++i) {
            sfem_body_def def = hanging(&s);
            def.integrator = integrators[i];
            for (cause = 0; cause < CAUSES; ++cause) {
                sfem_body *body = make(&s, def);
                const sfem_int handle = hold_and_load(&s, body);
                uint64_t hash;
                run_to_sleep(body, 1.0 / 60);
                hash = hash_displacement(&s, body);
                if (cause >= FORCE && cause <= HANDLE) {
                    provoke(&s, body, cause, 1, handle);
                    step(body, 1.0 / 60);
                    assert_true(sfem_body_is_asleep(body));
                    assert_true(hash_displacement(&s, body) == hash);
                }
                provoke(&s, body, cause, 0, handle);
                step(body, 1.0 / 60);
                if (sfem_body_is_asleep(body)) fail_msg("cause %d does not wake it", cause);
                step(body, 1.0 / 60);
                assert_true(hash_displacement(&s, body) != hash); /* it moves again */
                if (cause != SET_STATE && cause != RELEASE) run_to_sleep(body, 1.0 / 60);
                sfem_body_free(body);
            }
        }
        drop(&s);
    }
}

/* The same load set every step, in two parts at that, lets it sleep; one that changes by a bit does not. */
static void a_load_that_is_set_every_step_counts_when_it_changes(void **state)
{
    scene s = bar(SFEM_COROTATIONAL, 1e5);
    sfem_body *body = make(&s, hanging(&s));
    sfem_real f[3] = {0.25, 0.5, 0};
    sfem_error err;
    int k, asleep = 0;
    (void)state;
    for (k = 0; k < 1200; ++k) {
        assert_ok(sfem_body_set_lasting_force(body, NULL, &err), err);
        assert_ok(sfem_body_add_lasting_force(body, s.tip, f, &err), err);
        step(body, 1.0 / 60);
        asleep += sfem_body_is_asleep(body);
    }
    assert_true(asleep > 600);
    for (k = 0; k < 600; ++k) {
        f[0] = nextafter(f[0], 1);
        assert_ok(sfem_body_set_lasting_force(body, NULL, &err), err);
        assert_ok(sfem_body_add_lasting_force(body, s.tip, f, &err), err);
        step(body, 1.0 / 60);
        assert_false(sfem_body_is_asleep(body));
    }
    sfem_body_free(body);
    drop(&s);
}

/* A woken body moves as one that was set there at rest. */
static void a_push_after_sleep_acts_as_on_a_body_at_rest(void **state)
{
    const sfem_integrator integrators[] = {SFEM_PQR, SFEM_NEWMARK, SFEM_GENERALIZED_ALPHA};
    const sfem_law laws[] = {SFEM_LINEAR, SFEM_COROTATIONAL};
    const sfem_real push[3] = {0, 3, 1};
    size_t l, i;
    int k;
    (void)state;
    for (l = 0; l < TEST_COUNT(laws); ++l) {
        scene s = bar(laws[l], 1e5);
        const size_t n = 3 * (size_t)s.mesh.nodes;
        for (i = 0; i < TEST_COUNT(integrators); ++i) {
            sfem_body_def def = hanging(&s);
            sfem_body *body, *rest;
            sfem_error err;
            def.integrator = integrators[i];
            def.accuracy = 1e-20; /* corrections end by what has moved before: the energy in motion, the pairs */
            body = make(&s, def);
            rest = make(&s, def);
            run_to_sleep(body, 1.0 / 60);
            assert_ok(sfem_body_set_state(rest, sfem_body_displacement(body), NULL, &err), err);
            sfem_body_start(rest); /* its load at the start is the old one, too */
            assert_ok(sfem_body_add_lasting_force(body, s.tip, push, &err), err);
            assert_ok(sfem_body_add_lasting_force(rest, s.tip, push, &err), err);
            for (k = 0; k < 30; ++k) {
                step(body, 1.0 / 60);
                step(rest, 1.0 / 60);
            }
            /* frames are rounded differently after a fresh look at the same u */
            assert_all_near(sfem_body_displacement(body), sfem_body_displacement(rest), n, 1e-9, 0);
            sfem_body_free(body);
            sfem_body_free(rest);
        }
        drop(&s);
    }
}

/* --------------------------------------------------------------------------------------------
 * saved states, refusals
 * -------------------------------------------------------------------------------------------- */

static void sleep_is_part_of_the_saved_state(void **state)
{
    const sfem_law laws[] = {SFEM_LINEAR, SFEM_COROTATIONAL};
    size_t l;
    (void)state;
    for (l = 0; l < TEST_COUNT(laws); ++l) {
        scene s = bar(laws[l], 1e5);
        sfem_body *body = make(&s, hanging(&s)), *copy = make(&s, hanging(&s)), *never;
        sfem_body_def def = hanging(&s);
        const size_t bytes = sfem_body_state_size(body);
        void *calm = malloc(bytes), *asleep = malloc(bytes);
        const sfem_real push[3] = {0, 0, 1};
        sfem_error err;
        int k, steps = 0;
        run_to_sleep(body, 1.0 / 60);
        sfem_body_save_state(body, asleep);
        step(body, 1.0 / 60);
        assert_ok(sfem_body_load_state(copy, asleep, bytes, &err), err);
        assert_true(sfem_body_is_asleep(copy));
        step(copy, 1.0 / 60);
        assert_true(sfem_body_time(body) == sfem_body_time(copy));
        assert_ok(sfem_body_add_lasting_force(body, s.tip, push, &err), err);
        assert_ok(sfem_body_add_lasting_force(copy, s.tip, push, &err), err);
        do { /* both wake and go the same way; taken up again in the midst of the calm time, too */
            step(body, 1.0 / 60);
            step(copy, 1.0 / 60);
            assert_true(hash_displacement(&s, body) == hash_displacement(&s, copy));
            assert_int_equal(sfem_body_is_asleep(body), sfem_body_is_asleep(copy));
            sfem_body_save_state(body, calm);
            if (++steps % 7 == 0) assert_ok(sfem_body_load_state(copy, calm, bytes, &err), err);
            assert_true(steps < 3600);
        } while (!sfem_body_is_asleep(body));
        assert_ok(sfem_body_load_state(body, asleep, bytes, &err), err);
        for (k = 0; k < 10; ++k) step(body, 1.0 / 60);
        assert_true(sfem_body_is_asleep(body));
        def.sleep_tolerance = 0;
        never = make(&s, def);
        assert_status(sfem_body_load_state(never, asleep, bytes, &err), SFEM_MISMATCH);
        sfem_body_free(body);
        sfem_body_free(copy);
        sfem_body_free(never);
        free(calm);
        free(asleep);
        drop(&s);
    }
}

static void a_tolerance_or_time_that_makes_no_sense_is_refused(void **state)
{
    scene s = bar(SFEM_LINEAR, 1e5);
    sfem_body_def def = hanging(&s);
    sfem_body *body = NULL;
    sfem_error err;
    (void)state;
    assert_true(exact_body_def().sleep_tolerance == 0);
    def.sleep_tolerance = -1;
    assert_status(sfem_body_create(s.model, &def, &body, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "sleep (below -1 m/s");
    def = hanging(&s);
    def.sleep_time = -0.5;
    assert_status(sfem_body_create(s.model, &def, &body, &err), SFEM_BAD_ARGUMENT);
    def.sleep_time = NAN;
    assert_status(sfem_body_create(s.model, &def, &body, &err), SFEM_BAD_ARGUMENT);
    def = hanging(&s);
    body = make(&s, def);
    run_to_sleep(body, 1.0 / 60);
    assert_status(sfem_body_step(body, -1, &err), SFEM_BAD_ARGUMENT);
    assert_status(sfem_body_step(body, NAN, &err), SFEM_BAD_ARGUMENT);
    assert_true(sfem_body_is_asleep(body));
    sfem_body_free(body);
    drop(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_damped_body_falls_asleep_where_it_rests_under_every_integrator_and_law),
        cmocka_unit_test(it_does_not_before_it_was_calm_for_the_time_asked_for),
        cmocka_unit_test(a_swing_does_not_fall_asleep_at_its_turning_points),
        cmocka_unit_test(a_falling_body_does_not_sleep_at_the_top_of_its_flight),
        cmocka_unit_test(a_slow_ring_of_high_frequency_does_not_keep_a_body_awake),
        cmocka_unit_test(the_step_at_which_it_sleeps_is_the_same_for_any_number_of_threads),
        cmocka_unit_test(each_cause_wakes_it_and_what_changes_nothing_does_not),
        cmocka_unit_test(a_load_that_is_set_every_step_counts_when_it_changes),
        cmocka_unit_test(a_push_after_sleep_acts_as_on_a_body_at_rest),
        cmocka_unit_test(sleep_is_part_of_the_saved_state),
        cmocka_unit_test(a_tolerance_or_time_that_makes_no_sense_is_refused),
    };
    return run_all_tests(tests);
}
