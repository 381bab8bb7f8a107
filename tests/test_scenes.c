/* The scenes of examples/scenes: they run, do what they are for, and refuse bad numbers. The functions that the page
 * has in place of libm's. */
#include "support.h"
#define PM_NAMES_ONLY
#include "../examples/web/portable_math.h"
#include "../examples/scenes/all.h"

static sc_world *opened(const char *name, const char *slider, double value)
{
    const sc_scene *scene = sc_find(name);
    double values[SC_SLIDERS];
    sfem_error err;
    sc_world *w;
    int k;
    assert_non_null(scene);
    for (k = 0; k < SC_SLIDERS; ++k) values[k] = scene->slider[k].value;
    k = sc_slider_of(scene, "tets");
    if (k >= 0) values[k] = scene->slider[k].low; /* small, so that it is fast */
    if (slider) {
        k = sc_slider_of(scene, slider);
        assert_true(k >= 0);
        values[k] = value;
    }
    w = sc_open(scene, values, &err);
    if (!w) fail_msg("%s: %s", name, err.text);
    return w;
}

static void every_scene_survives_and_repeats(void **state)
{
    const int steps = TEST_SANITIZED ? 10 : 60;
    sfem_error err;
    int k, i, c, repeat;
    (void)state;
    for (k = 0; k < SC_SCENES; ++k) {
        uint64_t hash[2];
        for (repeat = 0; repeat < 2; ++repeat) {
            sc_world *w = opened(sc_scenes[k]->name, NULL, 0);
            for (i = 0; i < steps; ++i) {
                assert_ok(sc_step(w, &err), err);
                if (i > 2 && sc_energy_made(w) > 0.01) /* twist starts with a jerk: little energy yet */
                    fail_msg("%s made %g of its energy by step %d", w->scene->name, sc_energy_made(w), i);
            }
            assert_true(w->steps == steps && w->items > 0);
            for (c = 0; c < 3; ++c) assert_true(w->box[0][c] < w->box[1][c]);
            for (i = 0; i < w->items; ++i) {
                sc_positions(w, i, w->x);
                for (c = 0; c < 3 * w->mesh.nodes; ++c) assert_true(fabs(w->x[c]) < 20);
            }
            hash[repeat] = sc_hash(w);
            sc_close(w);
        }
        assert_true(hash[0] == hash[1]);
    }
}

static double lowest(sc_world *w)
{
    double low = 1e9;
    sfem_int i;
    sc_positions(w, 0, w->x);
    for (i = 0; i < w->mesh.nodes; ++i) low = fmin(low, w->x[3 * i + 2]);
    return low;
}

static void scenes_do_what_they_are_for(void **state)
{
    sc_world *w;
    sfem_error err;
    double low, high;
    sfem_int i;
    (void)state;
    if (TEST_SANITIZED) return; /* the same code, longer */

    w = opened("cut", "blade", 0.1);
    assert_ok(sc_run(w, 30, &err), err);
    assert_true(sc_measure_all(w).large == 2);
    sc_close(w);

    w = opened("tear", "toughness", 300);
    for (i = 0; i < 200 && !w->phase; ++i) assert_ok(sc_step(w, &err), err);
    assert_true(w->phase == 1 && sc_measure_all(w).pieces >= 2);
    sc_close(w);

    w = opened("shatter", NULL, 0);
    assert_ok(sc_run(w, 60, &err), err);
    assert_true(sc_measure_all(w).pieces > 2);
    assert_true(w->handles == 0);
    sc_close(w);

    w = opened("twist", "turns", 0.5); /* the far end is the other way up, and comes back when it is let go */
    assert_ok(sc_run(w, 62, &err), err);
    sc_positions(w, 0, w->x);
    for (i = 0; i < w->group_count; ++i)
        assert_near(w->x[3 * w->group[i] + 2] - 0.1, 0.1 - w->mesh.x[3 * w->group[i] + 2], 0, 1e-6);
    assert_true(w->phase == 0);
    assert_ok(sc_run(w, 60, &err), err);
    assert_true(w->phase == 1 && sc_measure_all(w).kinetic > 0);
    sc_close(w);

    w = opened("jelly", "shake", 30); /* the plate goes both ways by as much as it should */
    for (low = high = 0, i = 0; i < 60; ++i) {
        assert_ok(sc_step(w, &err), err);
        sc_positions(w, 1, w->x);
        low = fmin(low, w->x[3 * w->pin[0]] - w->mesh.x[3 * w->pin[0]] - w->item[1].at[0]);
        high = fmax(high, w->x[3 * w->pin[0]] - w->mesh.x[3 * w->pin[0]] - w->item[1].at[0]);
    }
    assert_near(low, -0.03, 0, 0.002);
    assert_near(high, 0.03, 0, 0.002);
    sc_close(w);

    w = opened("drop", NULL, 0); /* it falls, and lies on the floor */
    assert_ok(sc_run(w, 150, &err), err);
    assert_near(lowest(w), 0, 0, 0.005);
    assert_true(sc_measure_all(w).contacts > 0);
    sc_close(w);

    w = opened("gripper", NULL, 0); /* the fruit goes up with the fingers, and falls down when they become slippery */
    assert_ok(sc_run(w, 280, &err), err);
    assert_true(w->phase == 1 && sc_grip_felt(w) > sc_weight(w));
    assert_near(lowest(w), SC_RISE, 0, 0.01);
    high = w->time;
    assert_ok(sc_set(&w, sc_slider_of(w->scene, "friction"), 0.05, &err), err);
    assert_true(w->time == high && w->obstacles == 3);
    assert_ok(sc_run(w, 60, &err), err);
    assert_near(lowest(w), 0, 0, 0.005);
    sc_close(w);

    w = opened("modes", "amplitude", 0.1); /* each in its own mode: nothing else moves, and the energy stays */
    {
        const sc_measure before = sc_measure_all(w);
        sc_measure after;
        assert_ok(sc_run(w, 100, &err), err);
        after = sc_measure_all(w);
        assert_near(before.kinetic + before.elastic, after.kinetic + after.elastic, 1e-6, 0);
        for (i = 0; i < w->items; ++i) assert_near(sfem_modal_coordinates(w->item[i].modal)[(i + 1) % SC_ZOO], 0, 0, 1e-9);
    }
    sc_close(w);
}

/* The longest intact edge over its length at rest. */
static double longest_edge(sc_world *w)
{
    double longest = 0;
    sfem_int t;
    int i, j;
    sc_positions(w, 0, w->x);
    for (t = 0; t < w->mesh.tets; ++t)
        for (i = 0; i < 3; ++i)
            for (j = i + 1; j < 4; ++j) {
                const sfem_int *v = w->mesh.tet + 4 * (size_t)t;
                double length[2];
                int k;
                if (!(sfem_body_edge_left(w->item[0].body, v[i], v[j]) > 0)) continue;
                for (k = 0; k < 2; ++k) {
                    const double *x = k ? w->mesh.x : w->x, *a = x + 3 * (size_t)v[i], *b = x + 3 * (size_t)v[j];
                    length[k] = hypot(hypot(a[0] - b[0], a[1] - b[1]), a[2] - b[2]);
                }
                longest = fmax(longest, length[0] / length[1]);
            }
    return longest;
}

/* Where a blade leaves fibres that carry nothing, they break too, though nothing else may break by itself. */
static void a_blade_leaves_nothing_hanging(void **state)
{
    int k;
    (void)state;
    for (k = 0; k < (TEST_SANITIZED ? 1 : 8); ++k) {
        const double x = 0.4 + 0.05 * k, lean = 0.1 * k - 0.35;
        const double from[6] = {x - lean, -1, 1, x - lean, 2, 1}, to[6] = {x + lean, -1, -1, x + lean, 2, -1};
        sc_world *w = opened("cut", NULL, 0);
        sfem_error err;
        int marked;
        assert_ok(sc_cut(w, from, to, &marked, &err), err);
        assert_true(marked > 0);
        assert_ok(sc_run(w, 50, &err), err);
        assert_true(sc_measure_all(w).large >= 2);
        assert_true(longest_edge(w) < 2.5);
        sc_close(w);
    }
}

static void the_hand_takes_what_the_ray_meets(void **state)
{
    static const char *const name[3] = {"grab", "cut", "modes"};
    sfem_error err;
    int k, i;
    (void)state;
    for (k = 0; k < 3; ++k) {
        sc_world *w = opened(name[k], NULL, 0);
        const double back[3] = {0, 1, 0}, away[3] = {0, -1, 0}, eye[3] = {k == 1 ? 0.6 : 0, -5, k == 1 ? 0.12 : 0.4};
        double distance, at[3], to[3], force[3];
        assert_ok(sc_grab(w, eye, away, &distance, &err), err);
        assert_true(distance < 0 && !sc_hand(w, at, force));
        assert_ok(sc_grab(w, eye, back, &distance, &err), err);
        assert_true(distance > 4 && distance < 5.1 && sc_hand(w, at, force));
        memcpy(to, at, sizeof to);
        to[2] += 0.1;
        for (i = 0; i < 40; ++i) {
            assert_ok(sc_move_hand(w, to, &err), err);
            assert_ok(sc_step(w, &err), err);
        }
        assert_true(sc_hand(w, at, force));
        assert_near(at[2], to[2], 0, 0.06);
        to[0] = NAN;
        assert_status(sc_move_hand(w, to, &err), SFEM_NOT_FINITE);
        sc_release(w);
        assert_true(!sc_hand(w, at, force));
        assert_ok(sc_run(w, 5, &err), err);
        sc_close(w);
    }
}

/* A ball that is put before a jelly goes into it, feels it, and goes out of it again; no node is inside of it but by a little. */
static void a_ball_pokes(void **state)
{
    const double eye[3] = {0.27, -3, 0.1}, along[3] = {0, 1, 0}, beside[3] = {0, 0, 1};
    sc_world *w = opened("jelly", NULL, 0);
    double distance, x[3], force[3], to[3], radius, before;
    sfem_error err;
    sfem_int i;
    (void)state;
    assert_ok(sc_run(w, 20, &err), err);
    before = sc_measure_all(w).contacts;
    assert_ok(sc_poke(w, eye, along, &distance, &err), err);
    assert_true(w->poking && w->obstacles == 2 && distance > 2 && distance < 3);
    radius = w->obstacle[1].def.size[0];
    assert_ok(sc_run(w, 60, &err), err);
    assert_true(sc_hand(w, x, force));
    assert_near(x[1], eye[1] + distance, 0, 1e-3); /* there it is, */
    assert_true(force[1] > 0.1 && force[1] > 0.5 * hypot(hypot(force[0], force[1]), force[2])); /* pushes away from the eye, */
    assert_true(sc_measure_all(w).contacts > before);
    sc_positions(w, 1, w->x); /* and the jelly makes room */
    for (i = 0; i < w->mesh.nodes; ++i)
        assert_true(hypot(hypot(w->x[3 * i] - x[0], w->x[3 * i + 1] - x[1]), w->x[3 * i + 2] - x[2]) > 0.95 * radius);
    memcpy(to, x, sizeof to);
    to[1] -= 1;
    assert_ok(sc_move_hand(w, to, &err), err);
    assert_ok(sc_run(w, 60, &err), err);
    assert_true(sc_hand(w, x, force) && x[1] < to[1] + 0.3 && force[1] == 0);
    to[0] = NAN;
    assert_status(sc_move_hand(w, to, &err), SFEM_NOT_FINITE);
    sc_release(w);
    assert_true(!sc_hand(w, x, force) && w->obstacles == 1);
    assert_ok(sc_poke(w, eye, beside, &distance, &err), err); /* nothing is there: beside */
    assert_ok(sc_run(w, 2, &err), err);
    sc_close(w);
    w = opened("modes", NULL, 0);
    assert_status(sc_poke(w, eye, along, &distance, &err), SFEM_BAD_ARGUMENT);
    assert_true(!w->poking);
    sc_close(w);
}

/* Also where nothing is touched otherwise, and while sliders are moved. */
static void the_ball_is_in_every_scene(void **state)
{
    const double away[3] = {0, 1, 0};
    int k, c;
    (void)state;
    for (k = 0; k < SC_SCENES; ++k) {
        sc_world *w = opened(sc_scenes[k]->name, NULL, 0);
        double eye[3], distance, x[3], force[3];
        const int friction = sc_slider_of(w->scene, "friction"), obstacles = w->obstacles;
        sfem_error err;
        for (c = 0; c < 3; ++c) eye[c] = 0.5 * (w->box[0][c] + w->box[1][c]) - 3 * away[c];
        if (w->item[0].body) {
            assert_ok(sc_poke(w, eye, away, &distance, &err), err);
            assert_true(w->obstacles == obstacles + 1 && distance > 2 && distance < 4);
            assert_ok(sc_run(w, 5, &err), err);
            assert_true(sc_energy_made(w) < 0.01);
            if (friction >= 0) assert_ok(sc_set(&w, friction, 0.1, &err), err);
            assert_true(w->obstacles == obstacles + 1 && sc_hand(w, x, force) && isfinite(force[0] + force[1] + force[2]));
            if (friction >= 0) assert_near(w->obstacle[obstacles].def.contact.friction, 0.1, 0, 0);
            assert_ok(sc_run(w, 5, &err), err);
            sc_release(w);
            assert_true(w->obstacles == obstacles && !sc_hand(w, x, force));
            assert_ok(sc_poke(w, eye, away, &distance, &err), err);
            assert_ok(sc_set(&w, sc_slider_of(w->scene, "E"), 2 * w->value[sc_slider_of(w->scene, "E")], &err), err);
            assert_true(w->obstacles == obstacles && !w->poking); /* new bodies, and no ball */
            assert_ok(sc_run(w, 5, &err), err);
        }
        sc_close(w);
    }
}

static void bad_values_leave_the_scene_as_it_was(void **state)
{
    static const double bad[4] = {NAN, INFINITY, -1, 1e12};
    sc_world *w = opened("jelly", NULL, 0), *before = w;
    double values[SC_SLIDERS];
    sfem_error err;
    uint64_t hash;
    int k, i;
    (void)state;
    assert_ok(sc_run(w, 3, &err), err);
    hash = sc_hash(w);
    for (k = 0; k < SC_SLIDERS && w->scene->slider[k].name; ++k)
        for (i = 0; i < 4; ++i) {
            memset(&err, 0, sizeof err);
            assert_status(sc_set(&w, k, bad[i], &err), SFEM_BAD_ARGUMENT);
            assert_non_null(strstr(err.text, w->scene->slider[k].name));
            assert_true(w == before && sc_hash(w) == hash);
        }
    assert_status(sc_set(&w, SC_SLIDERS, 1, &err), SFEM_BAD_ARGUMENT);
    memcpy(values, w->value, sizeof values);
    values[0] = NAN;
    assert_null(sc_open(w->scene, values, &err));
    sc_close(w);
}

static void a_softer_body_goes_on_where_it_was(void **state)
{
    sc_world *w = opened("jelly", NULL, 0);
    sfem_error err;
    uint64_t hash;
    double time;
    int k;
    (void)state;
    assert_ok(sc_run(w, 20, &err), err);
    hash = sc_hash(w);
    time = w->time;
    assert_ok(sc_set(&w, sc_slider_of(w->scene, "E"), 4e3, &err), err);
    assert_true(sc_hash(w) == hash && w->time == time);
    assert_ok(sc_run(w, 5, &err), err);
    for (k = 0; k < w->items; ++k) assert_true(sfem_body_get_info(w->item[k].body).rejected == 0);
    assert_ok(sc_set(&w, sc_slider_of(w->scene, "jellies"), 2, &err), err);
    assert_true(w->items == 2 && w->steps == 0);
    sc_close(w);
}

static void files_become_a_metre_large(void **state)
{
    static const char obj[] = "v 0 0 0\nv 3 0 0\nv 0 2 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
    static const char mesh[] = "MeshVersionFormatted 1\nDimension 3\nVertices 4\n0 0 0 0\n4 0 0 0\n0 2 0 0\n0 0 1 0\n"
                               "Tetrahedra 1\n1 2 3 4 0\nEnd\n";
    const char *const text[2] = {obj, mesh}, *const name[2] = {"a.OBJ", "b.mesh"};
    const sc_scene *scene = sc_find("mesh");
    double values[SC_SLIDERS], size;
    sfem_error err;
    int k, i;
    (void)state;
    for (k = 0; k < 2; ++k) {
        sc_file file;
        sc_world *w;
        memset(&file, 0, sizeof file);
        file.name = name[k], file.bytes = text[k], file.size = strlen(text[k]);
        for (i = 0; i < SC_SLIDERS; ++i) values[i] = scene->slider[i].value;
        values[sc_slider_of(scene, "tets")] = 500;
        values[sc_slider_of(scene, "up")] = 2;
        w = sc_open_with(scene, values, &file, NULL, &err);
        if (!w) fail_msg("%s: %s", name[k], err.text);
        for (size = 0, i = 0; i < 3 * w->mesh.nodes; i += 3) size = fmax(size, fabs(w->mesh.x[i]));
        assert_near(size, 0.5, 0, k ? 1e-12 : 0.05); /* the fitted mesh cuts corners off */
        assert_int_equal(file.skin.triangles, k ? 0 : 4);
        assert_ok(sc_run(w, 5, &err), err);
        sc_close(w);
        sfem_surface_free(&file.skin);
        file.size = 20;
        assert_null(sc_open_with(scene, values, &file, NULL, &err));
        sfem_surface_free(&file.skin);
    }
}

/* Against libm, to a few units in the last place; what is exact is exact. */
static void portable_functions_are_those_of_libm(void **state)
{
    test_random random = {3};
    int k;
    (void)state;
    for (k = 0; k < 20000; ++k) {
        const double x = random_uniform(&random, -1, 1), y = random_uniform(&random, -1, 1), scale = exp(12 * y);
        const double eps = 2.3e-16;
        assert_near(pm_exp(100 * x), exp(100 * x), 4 * eps, 0);
        assert_near(pm_expm1(x), expm1(x), 8 * eps, 0);
        assert_near(pm_expm1(scale * 1e-5), expm1(scale * 1e-5), 8 * eps, 0);
        assert_near(pm_log(scale), log(scale), 4 * eps, eps);
        assert_near(pm_log1p(x), log1p(x), 4 * eps, 0);
        assert_near(pm_log10(scale), log10(scale), 6 * eps, eps);
        assert_near(pm_log2(scale), log2(scale), 6 * eps, eps);
        assert_near(pm_pow(scale, x), pow(scale, x), 20 * eps, 0);
        assert_near(pm_sin(20 * x), sin(20 * x), 4 * eps, 4 * eps);
        assert_near(pm_cos(20 * x), cos(20 * x), 4 * eps, 4 * eps);
        assert_near(pm_sin(1e5 * x), sin(1e5 * x), 4 * eps, 4 * eps);
        assert_near(pm_atan2(scale * x, y), atan2(scale * x, y), 6 * eps, 0);
        assert_near(pm_acos(x), acos(x), 8 * eps, 0);
        assert_near(pm_sinh(9 * x), sinh(9 * x), 10 * eps, 0);
        assert_near(pm_cosh(9 * x), cosh(9 * x), 10 * eps, 0);
        assert_near(pm_tanh(9 * x), tanh(9 * x), 10 * eps, 0);
        assert_near(pm_hypot(scale, x), hypot(scale, x), 4 * eps, 0);
    }
    assert_true(pm_exp(0) == 1 && pm_exp(1000) == HUGE_VAL && pm_exp(-1000) == 0 && isnan(pm_exp(NAN)));
    assert_true(pm_log(1) == 0 && pm_log(0) == -HUGE_VAL && isnan(pm_log(-1)) && pm_log(HUGE_VAL) == HUGE_VAL);
    assert_true(pm_pow(3, 4) == 81 && pm_pow(2, -3) == 0.125 && pm_pow(0, 0.5) == 0 && isnan(pm_pow(-1, 0.5)));
    assert_true(pm_sin(0) == 0 && pm_cos(0) == 1 && isnan(pm_sin(INFINITY)) && isnan(pm_cos(NAN)));
    assert_near(pm_atan2(0.0, -1), TEST_PI, 0, 0);
    assert_near(pm_atan2(-0.0, -1), -TEST_PI, 0, 0);
    assert_true(pm_atan2(0, 1) == 0 && pm_hypot(0, 0) == 0 && pm_tanh(50) == 1 && pm_tanh(-50) == -1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_scene_survives_and_repeats),
        cmocka_unit_test(scenes_do_what_they_are_for),
        cmocka_unit_test(a_blade_leaves_nothing_hanging),
        cmocka_unit_test(the_hand_takes_what_the_ray_meets),
        cmocka_unit_test(a_ball_pokes),
        cmocka_unit_test(the_ball_is_in_every_scene),
        cmocka_unit_test(bad_values_leave_the_scene_as_it_was),
        cmocka_unit_test(a_softer_body_goes_on_where_it_was),
        cmocka_unit_test(files_become_a_metre_large),
        cmocka_unit_test(portable_functions_are_those_of_libm),
    };
    return run_all_tests(tests);
}
