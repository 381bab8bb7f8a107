/* Bodies that are crushed and struck: what is told of their energy, velocities and impulses is what they have. */
#include "support.h"

#include "bodies.h"

typedef struct scene {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_body *body;
    sfem_contact *contact;
    double mass;
} scene;

static scene block_of(sfem_int cells, double side, double young, double damping, const sfem_body_def *def)
{
    const sfem_int n[3] = {cells, cells, cells};
    const sfem_real size[3] = {side, side, side};
    sfem_model_def md = sfem_default_model_def();
    sfem_error err;
    sfem_int i;
    scene s;
    memset(&s, 0, sizeof s);
    assert_ok(sfem_mesh_block(n, size, SFEM_CELL_5_TETS, NULL, &s.mesh, &err), err);
    md.mesh = &s.mesh;
    md.material.young = young;
    md.material.stiffness_damping = damping;
    assert_ok(sfem_model_create(&md, &s.model, &err), err);
    for (i = 0; i < s.mesh.nodes; ++i) s.mass += sfem_model_node_mass(s.model)[i];
    assert_ok(sfem_body_create(s.model, def, &s.body, &err), err);
    assert_ok(sfem_contact_create(NULL, &s.contact, &err), err);
    assert_ok(sfem_contact_add_body(s.contact, s.body, NULL, ~0u, NULL, &err), err);
    return s;
}

static void drop(scene *s)
{
    sfem_contact_free(s->contact);
    sfem_body_free(s->body);
    sfem_model_free(s->model);
    sfem_mesh_free(&s->mesh);
}

static sfem_int add_obstacle(scene *s, const sfem_obstacle_def *def)
{
    sfem_error err;
    sfem_int id;
    assert_ok(sfem_contact_add_obstacle(s->contact, def, &id, &err), err);
    return id;
}

/* The momentum of the velocities told. */
static double kinetic_and_momentum(const scene *s, double p[3])
{
    const sfem_real *mass = sfem_model_node_mass(s->model);
    sfem_real *v = (sfem_real *)malloc(3 * (size_t)s->mesh.nodes * sizeof *v);
    double kinetic = 0;
    sfem_int i;
    sfem_body_velocities(s->body, v);
    memset(p, 0, 3 * sizeof *p);
    for (i = 0; i < 3 * s->mesh.nodes; ++i) {
        p[i % 3] += mass[i / 3] * v[i];
        kinetic += mass[i / 3] * v[i] * v[i] / 2;
    }
    free(v);
    return kinetic;
}

/* The kinetic energy of the way of a step of h from `before`. */
static double kinetic_of_way(const scene *s, const sfem_real *before, double h)
{
    const sfem_real *mass = sfem_model_node_mass(s->model), *u = sfem_body_displacement(s->body);
    double kinetic = 0;
    sfem_int i;
    for (i = 0; i < 3 * s->mesh.nodes; ++i) kinetic += mass[i / 3] * (u[i] - before[i]) * (u[i] - before[i]) / (2 * h * h);
    return kinetic;
}

/* A ball of 2 cm is driven through a cube of 30 cm, which lies on a floor or hangs in pins, and the floor. In no step is the
 * energy told above the work done, that of the half step under way included; nor the kinetic energy above what the ways
 * of the last two steps allow, v = w' + h a/2 with h a at most 2 (w' - w). */
static void a_crushed_body_tells_no_more_energy_than_it_has(void **unused)
{
    static const struct {
        double young, speed;
        int pins;
    } runs[] = {{1e6, 2, 0}, {1e5, 1, 0}, {1e6, 2, 1}};
    const double h = 1.0 / 60, gravity = 9.81;
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(runs); ++i) {
        const sfem_real velocity[3] = {0, 0, -runs[i].speed};
        static const sfem_int pins[] = {0, 3, 12, 15}; /* the corners at the bottom */
        sfem_obstacle_def floor = sfem_default_obstacle_def(), ball = sfem_default_obstacle_def();
        sfem_body_def def = sfem_default_body_def();
        double last_way = 0, last = 0, moved = 0, under_way = 0, p[3];
        sfem_real *before;
        sfem_error err;
        sfem_int id;
        scene s;
        int k;
        def.gravity[2] = -gravity;
        s = block_of(3, 0.3, runs[i].young, 5e-3, &def);
        before = (sfem_real *)malloc(3 * (size_t)s.mesh.nodes * sizeof *before);
        if (runs[i].pins) assert_ok(sfem_body_set_pins(s.body, TEST_COUNT(pins), pins, NULL, &err), err);
        (void)add_obstacle(&s, &floor);
        ball.kind = SFEM_OBSTACLE_SPHERE;
        ball.size[0] = 0.02;
        ball.position[0] = ball.position[1] = 0.15;
        ball.position[2] = 0.33;
        id = add_obstacle(&s, &ball);
        assert_ok(sfem_contact_move_obstacle(s.contact, id, ball.position, NULL, velocity, NULL, &err), err);
        for (k = 0; k < 40; ++k) {
            const sfem_energy start = sfem_body_energy(s.body);
            sfem_contact_info info;
            double way, told;
            memcpy(before, sfem_body_displacement(s.body), 3 * (size_t)s.mesh.nodes * sizeof *before);
            if (k == 0) assert_near(start.total, 0, 0, 1e-12);
            assert_ok(sfem_contact_step(s.contact, h, &err), err);
            info = sfem_contact_get_info(s.contact);
            way = kinetic_of_way(&s, before, h);
            told = kinetic_and_momentum(&s, p);
            /* a step that stays where it is has what was under way in the last one */
            assert_true(sfem_body_energy(s.body).total <= info.moved + 2 * fmax(under_way, info.moved - moved) + 1e-9);
            assert_true(told <= 9 * fmax(fmax(way, last_way), last) + 1e-9);
            last_way = way;
            last = told;
            under_way = fmax(0, info.moved - moved);
            moved = info.moved;
        }
        assert_true(moved > 0 && moved <= 2 * sfem_contact_get_info(s.contact).work); /* not of impulses that move nothing */
        free(before);
        drop(&s);
    }
}

/* A paddle that rotates by 0.5 to 5 rad a step strikes a block. In each step that is rejected the momentum is the sum of all
 * impulses and of gravity. */
static void the_impulses_of_rejected_steps_are_what_moved_the_body(void **unused)
{
    static const double omega[] = {30, 300};
    const double h = 1.0 / 60, gravity = 9.81;
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(omega); ++i) {
        static const sfem_real upright[9] = {0, -1, 0, 1, 0, 0, 0, 0, 1};
        const sfem_real spin[3] = {0, i ? omega[i] : 0, i ? 0 : -omega[i]};
        sfem_obstacle_def floor = sfem_default_obstacle_def(), paddle = sfem_default_obstacle_def();
        sfem_body_def def = sfem_default_body_def();
        double sum[3] = {0, 0, 0}, most = 0, p[3];
        int64_t rejected = 0;
        sfem_error err;
        sfem_int id;
        scene s;
        int k, c;
        def.gravity[2] = -gravity;
        s = block_of(3, 0.2, 1e6, 1e-3, &def);
        { /* beside the axis, 1 cm above the floor */
            static const sfem_real there[3] = {0.2, -0.1, 0.01};
            assert_ok(sfem_body_place(s.body, NULL, there, &err), err);
        }
        (void)add_obstacle(&s, &floor);
        paddle.kind = SFEM_OBSTACLE_BOX;
        paddle.size[0] = 0.5;
        paddle.size[1] = 0.05;
        paddle.size[2] = 0.2;
        paddle.position[2] = 0.21;
        memcpy(paddle.rotation, upright, sizeof upright);
        id = add_obstacle(&s, &paddle);
        assert_ok(sfem_contact_move_obstacle(s.contact, id, paddle.position, NULL, NULL, spin, &err), err);
        for (k = 0; k < 40; ++k) {
            const sfem_contact_point *point;
            sfem_int count, j;
            assert_ok(sfem_contact_step(s.contact, h, &err), err);
            point = sfem_contact_points(s.contact, &count);
            for (j = 0; j < count; ++j)
                for (c = 0; c < 3; ++c) sum[c] += point[j].impulse[c];
            (void)kinetic_and_momentum(&s, p);
            for (c = 0; c < 3; ++c) most = fmax(most, fabs(p[c]));
            if (sfem_body_get_info(s.body).rejected == rejected) continue;
            rejected = sfem_body_get_info(s.body).rejected;
            for (c = 0; c < 3; ++c)
                assert_near(p[c], sum[c] - (c == 2) * s.mass * gravity * (k + 1) * h, 0, 1e-9 * most);
        }
        assert_true(rejected > 0);
        drop(&s);
    }
}

/* What would do nothing, or be done twice, is refused by name. */
static void a_body_has_one_contact_and_a_plane_a_normal(void **unused)
{
    static const sfem_real none[3] = {0, 0, 0};
    const sfem_body_def def = sfem_default_body_def();
    scene s = block_of(1, 1, 1e6, 0, &def);
    sfem_obstacle_def plane = sfem_obstacle_plane(none, none);
    sfem_contact *other;
    sfem_error err;
    sfem_int id;
    (void)unused;
    assert_status(sfem_contact_add_obstacle(s.contact, &plane, &id, &err), SFEM_NOT_FINITE);
    assert_names(err, "normal");
    assert_ok(sfem_contact_create(NULL, &other, &err), err);
    assert_status(sfem_contact_add_body(other, s.body, NULL, ~0u, &id, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "sfem_contact_remove_body");
    sfem_contact_remove_body(s.contact, 0);
    assert_ok(sfem_contact_add_body(other, s.body, NULL, ~0u, &id, &err), err);
    sfem_contact_free(other);
    assert_ok(sfem_contact_add_body(s.contact, s.body, NULL, ~0u, &id, &err), err);
    drop(&s);
}

/* A block of irregular tets, slivers among them, on an incline of 20 and 26 degrees, mu = 0.5: nodes of its inside are moved
 * at random as far as volumes stay positive. The second half of 5 s: no creep beyond 1e-5 m, no step rejected. */
static void irregular_blocks_do_not_creep(void **unused)
{
    static const double degrees[] = {20, 26};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(degrees); ++i) {
        static const sfem_int cells[3] = {4, 4, 4};
        static const sfem_real size[3] = {0.5, 0.5, 0.5}, none[3] = {0, 0, 0};
        const double angle = degrees[i] * TEST_PI / 180;
        const sfem_real normal[3] = {sin(angle), 0, cos(angle)};
        sfem_model_def md = sfem_default_model_def();
        sfem_body_def def = sfem_default_body_def();
        sfem_obstacle_def plane = sfem_obstacle_plane(normal, none);
        test_random random = {5};
        double worst = 0, flattest = 1;
        sfem_real *before = NULL;
        sfem_error err;
        sfem_int j;
        scene s;
        int k, c;
        memset(&s, 0, sizeof s);
        assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &s.mesh, &err), err);
        for (j = 0; j < s.mesh.nodes; ++j) {
            sfem_real *x = s.mesh.x + 3 * j;
            int inside = 1;
            for (c = 0; c < 3; ++c) inside &= x[c] > 1e-9 && x[c] < 0.5 - 1e-9;
            for (c = 0; inside && c < 3; ++c) x[c] += random_uniform(&random, -0.3, 0.3) * 0.125;
        }
        for (j = 0; j < s.mesh.tets; ++j) { /* volume over that of a regular tet of the longest edge */
            const sfem_int *tet = s.mesh.tet + 4 * j;
            double e[3][3], longest = 0, volume;
            int a, b;
            for (a = 0; a < 4; ++a)
                for (b = 0; b < a; ++b) {
                    double square = 0;
                    for (c = 0; c < 3; ++c) {
                        const double d = s.mesh.x[3 * tet[a] + c] - s.mesh.x[3 * tet[b] + c];
                        square += d * d;
                        if (b == 0) e[a - 1][c] = d;
                    }
                    longest = fmax(longest, sqrt(square));
                }
            volume = (e[0][0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1]) - e[0][1] * (e[1][0] * e[2][2] - e[1][2] * e[2][0]) +
                      e[0][2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0])) / 6;
            assert_true(volume > 0);
            flattest = fmin(flattest, volume * 6 * sqrt(2.0) / (longest * longest * longest));
        }
        assert_true(flattest < 0.1);
        for (j = 0; j < s.mesh.nodes; ++j) {
            sfem_real *x = s.mesh.x + 3 * j;
            const double a = x[0], b = x[2];
            x[0] = cos(angle) * a + sin(angle) * b;
            x[2] = -sin(angle) * a + cos(angle) * b;
        }
        md.mesh = &s.mesh;
        md.material.young = 1e6;
        md.material.stiffness_damping = 0.01;
        def.gravity[2] = -9.81;
        assert_ok(sfem_model_create(&md, &s.model, &err), err);
        assert_ok(sfem_body_create(s.model, &def, &s.body, &err), err);
        assert_ok(sfem_contact_create(NULL, &s.contact, &err), err);
        assert_ok(sfem_contact_add_body(s.contact, s.body, NULL, ~0u, NULL, &err), err);
        (void)add_obstacle(&s, &plane);
        before = (sfem_real *)malloc(3 * (size_t)s.mesh.nodes * sizeof *before);
        for (k = 0; k < 300; ++k) {
            if (k == 150) memcpy(before, sfem_body_displacement(s.body), 3 * (size_t)s.mesh.nodes * sizeof *before);
            assert_ok(sfem_contact_step(s.contact, 1.0 / 60, &err), err);
        }
        for (j = 0; j < 3 * s.mesh.nodes; ++j) worst = fmax(worst, fabs(sfem_body_displacement(s.body)[j] - before[j]));
        assert_true(worst < 1e-5);
        assert_int_equal(sfem_body_get_info(s.body).rejected, 0);
        free(before);
        drop(&s);
    }
}

/* Obstacles of points that are not finite are refused, and the world goes on. */
static void obstacles_of_no_finite_points_are_refused(void **unused)
{
    const sfem_body_def def = sfem_default_body_def();
    sfem_real heights[4] = {0, 0, NAN, 0};
    sfem_obstacle_def o = sfem_default_obstacle_def();
    scene s = block_of(1, 1, 1e6, 0, &def);
    sfem_surface surface;
    sfem_real *x;
    sfem_error err;
    (void)unused;
    o.kind = SFEM_OBSTACLE_HEIGHTS;
    o.size[0] = o.size[1] = 1;
    o.cells[0] = o.cells[1] = 2;
    o.heights = heights;
    assert_status(sfem_contact_add_obstacle(s.contact, &o, NULL, &err), SFEM_NOT_FINITE);
    assert_ok(sfem_mesh_surface(&s.mesh, NULL, &surface, &err), err);
    x = (sfem_real *)malloc(3 * (size_t)s.mesh.nodes * sizeof *x);
    memcpy(x, s.mesh.x, 3 * (size_t)s.mesh.nodes * sizeof *x);
    x[4] = NAN;
    o = sfem_default_obstacle_def();
    o.kind = SFEM_OBSTACLE_SURFACE;
    surface.x = x;
    surface.nodes = s.mesh.nodes;
    o.surface = &surface;
    assert_status(sfem_contact_add_obstacle(s.contact, &o, NULL, &err), SFEM_NOT_FINITE);
    assert_ok(sfem_contact_step(s.contact, 1.0 / 60, &err), err);
    assert_int_equal(sfem_contact_get_info(s.contact).contacts, 0);
    free(x);
    surface.x = NULL;
    surface.nodes = 0;
    sfem_surface_free(&surface);
    drop(&s);
}

int main(void)
{
    static const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_crushed_body_tells_no_more_energy_than_it_has),
        cmocka_unit_test(the_impulses_of_rejected_steps_are_what_moved_the_body),
        cmocka_unit_test(irregular_blocks_do_not_creep),
        cmocka_unit_test(obstacles_of_no_finite_points_are_refused),
        cmocka_unit_test(a_body_has_one_contact_and_a_plane_a_normal),
    };
    return run_all_tests(tests);
}
