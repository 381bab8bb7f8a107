/* What a renderer reads of modal bodies: velocities and normals of views. */
#include "support.h"
#include "linear.h"

typedef struct scene {
    sfem_model *model;
    sfem_modes modes;
    sfem_reduced *reduced;
    sfem_int nodes;
} scene;

static scene make_scene(int held)
{
    static const sfem_int cells[3] = {8, 2, 2};
    static const sfem_real size[3] = {4, 1, 0.8};
    sfem_model_def model_def = linear_model_def();
    sfem_modes_def modes_def = sfem_default_modes_def();
    sfem_reduced_def def = sfem_default_reduced_def();
    sfem_int pins[16], i;
    sfem_mesh mesh;
    sfem_error err;
    scene s;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_6_TETS, NULL, &mesh, &err), err);
    model_def.mesh = &mesh;
    assert_ok(sfem_model_create(&model_def, &s.model, &err), err);
    for (i = 0; i < 9; ++i) pins[i] = i;
    modes_def.pins = pins;
    modes_def.pin_count = held ? 9 : 0;
    modes_def.modes = 12;
    def.free = !held;
    assert_ok(sfem_modes_create(s.model, &modes_def, &s.modes, &err), err);
    assert_ok(sfem_reduced_create(s.model, &s.modes, &def, &s.reduced, &err), err);
    s.nodes = mesh.nodes;
    sfem_mesh_free(&mesh);
    return s;
}

static void free_scene(scene *s)
{
    sfem_reduced_free(s->reduced);
    sfem_modes_free(&s->modes);
    sfem_model_free(s->model);
}

/* A body that is far bent and moves, the frame of a free one, too. */
static sfem_modal *make_modal(const scene *s, sfem_warp warp, int held, const sfem_exec *exec)
{
    const sfem_reduced_info info = sfem_reduced_get_info(s->reduced);
    sfem_modal_def def = sfem_default_modal_def();
    test_random random = {5};
    double q[16], v[16];
    sfem_modal *b = NULL;
    sfem_error err;
    int k;
    def.warp = warp;
    if (exec) def.exec = *exec;
    assert_ok(sfem_modal_create(s->reduced, &def, &b, &err), err);
    for (k = 0; k < info.modes; ++k) {
        q[k] = random_uniform(&random, -1, 1) * sqrt(info.mass) / (1 + k);
        v[k] = random_uniform(&random, -3, 3) * sqrt(info.mass) / (1 + k);
    }
    assert_ok(sfem_modal_set_coordinates(b, q, v, NULL, &err), err);
    if (!held) {
        sfem_rigid rigid = sfem_modal_rigid(b);
        for (k = 0; k < 3; ++k) {
            rigid.x[k] = random_uniform(&random, -5, 5);
            rigid.v[k] = random_uniform(&random, -5, 5);
            rigid.w[k] = random_uniform(&random, -2, 2);
        }
        assert_ok(sfem_modal_set_rigid(b, &rigid, &err), err);
    }
    return b;
}

/* r exp [t w]x, w in the world: Rodrigues' formula on the left */
static void turn(const double r[9], const double w[3], double t, double out[9])
{
    const double a = t * sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
    const double s = a > 0 ? sin(a) / a * t : t, c = a > 0 ? (1 - cos(a)) / (a * a) * t * t : 0;
    int i, j;
    for (j = 0; j < 3; ++j) {
        const double x[3] = {r[j], r[3 + j], r[6 + j]};
        double y[3], z[3];
        for (i = 0; i < 3; ++i) y[i] = w[(i + 1) % 3] * x[(i + 2) % 3] - w[(i + 2) % 3] * x[(i + 1) % 3];
        for (i = 0; i < 3; ++i) z[i] = w[(i + 1) % 3] * y[(i + 2) % 3] - w[(i + 2) % 3] * y[(i + 1) % 3];
        for (i = 0; i < 3; ++i) out[3 * i + j] = x[i] + s * y[i] + c * z[i];
    }
}

/* Positions dt later, if q' and the frame's velocities went on as they are. */
static void positions_at(sfem_modal *b, const sfem_reduced_view *view, double dt, int held, int modes, double *x)
{
    const sfem_rigid rigid = sfem_modal_rigid(b);
    double q[16], now[16];
    sfem_rigid moved = rigid;
    sfem_error err;
    int k;
    memcpy(now, sfem_modal_coordinates(b), (size_t)modes * sizeof *now);
    for (k = 0; k < modes; ++k) q[k] = now[k] + dt * sfem_modal_coordinate_velocities(b)[k];
    for (k = 0; k < 3; ++k) moved.x[k] += dt * rigid.v[k];
    turn(rigid.r, rigid.w, dt, moved.r);
    assert_ok(sfem_modal_set_coordinates(b, q, NULL, NULL, &err), err);
    if (!held) assert_ok(sfem_modal_set_rigid(b, &moved, &err), err);
    sfem_modal_positions(b, view, x);
    assert_ok(sfem_modal_set_coordinates(b, now, NULL, NULL, &err), err);
    if (!held) assert_ok(sfem_modal_set_rigid(b, &rigid, &err), err);
}

static void velocities_are_the_differences_of_positions(void **state)
{
    static const sfem_warp warp[] = {SFEM_WARP_NONE, SFEM_WARP_ROTATION, SFEM_WARP_PATH};
    const double dt = 1e-5;
    int held, way, i;
    size_t k;
    (void)state;
    for (held = 0; held < 2; ++held) {
        scene s = make_scene(held);
        const int modes = sfem_reduced_get_info(s.reduced).modes;
        for (k = 0; k < TEST_COUNT(warp); ++k)
            for (way = 0; way < 2; ++way) {
                sfem_modal *b = make_modal(&s, warp[k], held, NULL);
                sfem_reduced_view *view;
                double v[3 * 128], before[3 * 128], after[3 * 128], most = 0;
                const sfem_int node[5] = {80, 3, 41, 3, 17};
                sfem_int count;
                sfem_error err;
                assert_true(s.nodes <= 128);
                if (way) assert_ok(sfem_reduced_view_create(s.reduced, 5, node, SFEM_DOUBLE, &view, &err), err);
                else assert_ok(sfem_reduced_view_create(s.reduced, 0, NULL, SFEM_DOUBLE, &view, &err), err);
                count = sfem_reduced_view_count(view);
                sfem_modal_velocities(b, view, v);
                positions_at(b, view, -dt, held, modes, before);
                positions_at(b, view, dt, held, modes, after);
                for (i = 0; i < 3 * count; ++i) {
                    after[i] = (after[i] - before[i]) / (2 * dt);
                    most = fmax(most, fabs(v[i]));
                }
                assert_true(most > 1);
                assert_all_near(v, after, 3 * count, 0, 2e-7 * most);
                sfem_reduced_view_free(view);
                sfem_modal_free(b);
            }
        free_scene(&s);
    }
}

/* A step's positions say the same, to the order of the step: no hand sets the state. */
static void velocities_are_those_of_a_running_body(void **state)
{
    int held, i;
    (void)state;
    for (held = 0; held < 2; ++held) {
        scene s = make_scene(held);
        sfem_modal *b = make_modal(&s, SFEM_WARP_PATH, held, NULL);
        double x[2][3 * 128], v[3 * 128], most = 0;
        const double h = 1e-5;
        sfem_reduced_view *view;
        sfem_error err;
        assert_ok(sfem_reduced_view_create(s.reduced, 0, NULL, SFEM_DOUBLE, &view, &err), err);
        for (i = 0; i < 10; ++i) assert_ok(sfem_modal_step(b, h, &err), err);
        sfem_modal_positions(b, view, x[0]);
        assert_ok(sfem_modal_step(b, h, &err), err);
        sfem_modal_velocities(b, view, v);
        assert_ok(sfem_modal_step(b, h, &err), err);
        sfem_modal_positions(b, view, x[1]);
        for (i = 0; i < 3 * s.nodes; ++i) {
            x[1][i] = (x[1][i] - x[0][i]) / (2 * h);
            most = fmax(most, fabs(v[i]));
        }
        assert_all_near(v, x[1], 3 * s.nodes, 0, 1e-5 * most);
        sfem_reduced_view_free(view);
        sfem_modal_free(b);
        free_scene(&s);
    }
}

static void any_number_of_threads_gives_the_same_velocities(void **state)
{
    scene s = make_scene(0);
    double v[2][3 * 128];
    int k;
    (void)state;
    for (k = 0; k < 2; ++k) {
        const sfem_exec exec = thread_exec(k ? 3 : 1);
        sfem_modal *b = make_modal(&s, SFEM_WARP_PATH, 0, &exec);
        sfem_reduced_view *view;
        sfem_error err;
        assert_ok(sfem_reduced_view_create(s.reduced, 0, NULL, SFEM_MIXED, &view, &err), err);
        sfem_modal_velocities(b, view, v[k]);
        sfem_reduced_view_free(view);
        sfem_modal_free(b);
    }
    assert_memory_equal(v[0], v[1], 3 * (size_t)s.nodes * sizeof(double));
    free_scene(&s);
}

static void normals_of_a_view_are_those_of_its_positions(void **state)
{
    scene s = make_scene(0);
    const sfem_reduced_info info = sfem_reduced_get_info(s.reduced);
    sfem_modal *b = make_modal(&s, SFEM_WARP_PATH, 0, NULL);
    float vertex[128][8], n[128][3];
    double x[3 * 128];
    sfem_int tri[3 * 512];
    sfem_surface surface;
    sfem_reduced_view *view;
    sfem_error err;
    int i, c;
    (void)state;
    assert_true(info.surface_triangles <= 512);
    memset(&surface, 0, sizeof surface);
    memcpy(tri, info.surface_tri, 3 * (size_t)info.surface_triangles * sizeof *tri);
    surface.triangles = info.surface_triangles;
    surface.tri = tri;
    assert_ok(sfem_reduced_view_surface(s.reduced, SFEM_DOUBLE, &view, &err), err);
    for (i = 0; i < 128; ++i)
        for (c = 0; c < 8; ++c) vertex[i][c] = 77;
    sfem_modal_to_floats(b, view, vertex[0], sizeof vertex[0]);
    sfem_modal_normals(b, view, vertex[0], &vertex[0][4], sizeof vertex[0]);
    sfem_modal_positions(b, view, x);
    sfem_surface_normals(&surface, x, info.surface_nodes, n[0], sizeof n[0]);
    for (i = 0; i < info.surface_nodes; ++i) {
        assert_near(hypot(hypot((double)n[i][0], (double)n[i][1]), (double)n[i][2]), 1, 1e-6, 0);
        for (c = 0; c < 3; ++c) assert_near(vertex[i][4 + c], n[i][c], 0, 2e-5);
        assert_true(vertex[i][3] == 77 && vertex[i][7] == 77);
    }
    for (; i < 128; ++i) assert_true(vertex[i][4] == 77);
    sfem_reduced_view_free(view);
    sfem_modal_free(b);
    free_scene(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(velocities_are_the_differences_of_positions),
        cmocka_unit_test(velocities_are_those_of_a_running_body),
        cmocka_unit_test(any_number_of_threads_gives_the_same_velocities),
        cmocka_unit_test(normals_of_a_view_are_those_of_its_positions),
    };
    return run_all_tests(tests);
}
