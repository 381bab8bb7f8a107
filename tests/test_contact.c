/* Bodies against obstacles, with friction. */
#include "support.h"

#include "bodies.h"
#include "contact_meshes.h"

#define GRAVITY 9.81

/* --------------------------------------------------------------------------------------------
 * scenes: one body or many copies of it, and obstacles
 * -------------------------------------------------------------------------------------------- */

enum { MOST = 128 };

typedef struct scene {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_body *body[MOST];
    int bodies;
    sfem_contact *contact;
    sfem_int floor;
    double mass; /* of one body */
} scene;

static void rotate(sfem_mesh *mesh, double angle) /* about y */
{
    const double c = cos(angle), s = sin(angle);
    sfem_int i;
    for (i = 0; i < mesh->nodes; ++i) {
        sfem_real *x = mesh->x + 3 * i;
        const double a = x[0], b = x[2];
        x[0] = c * a + s * b;
        x[2] = -s * a + c * b;
    }
}

static sfem_body_def falling(void)
{
    sfem_body_def d = sfem_default_body_def();
    d.gravity[2] = -GRAVITY;
    return d;
}

/* A scene that owns the mesh; its bodies come later. */
static scene scene_with(sfem_mesh mesh, sfem_law law, double young, double poisson, const sfem_contact_def *contact)
{
    sfem_model_def def = sfem_default_model_def();
    sfem_error err;
    scene s;
    sfem_int i;
    memset(&s, 0, sizeof s);
    s.mesh = mesh;
    s.floor = -1;
    def.mesh = &s.mesh;
    def.material.young = young;
    def.material.poisson = poisson;
    def.material.density = 1000;
    def.material.law = law;
    assert_ok(sfem_model_create(&def, &s.model, &err), err);
    for (i = 0; i < mesh.nodes; ++i) s.mass += sfem_model_node_mass(s.model)[i];
    assert_ok(sfem_contact_create(contact, &s.contact, &err), err);
    return s;
}

static scene scene_of(sfem_mesh mesh, sfem_law law, double young, double poisson)
{
    return scene_with(mesh, law, young, poisson, NULL);
}

static int add_body(scene *s, const sfem_body_def *def, double friction)
{
    sfem_contact_surface surface = sfem_default_contact_surface();
    sfem_error err;
    sfem_int id;
    surface.friction = friction;
    assert_ok(sfem_body_create(s->model, def, &s->body[s->bodies], &err), err);
    assert_ok(sfem_contact_add_body(s->contact, s->body[s->bodies], &surface, ~0u, &id, &err), err);
    assert_int_equal(id, s->bodies);
    return s->bodies++;
}

static sfem_int add_plane(scene *s, double nx, double nz, double offset, double friction, double restitution)
{
    const sfem_real normal[3] = {nx, 0, nz}, point[3] = {offset * nx, 0, offset * nz};
    sfem_obstacle_def def = sfem_obstacle_plane(normal, point);
    sfem_error err;
    sfem_int id;
    def.contact.friction = friction;
    def.contact.restitution = restitution;
    assert_ok(sfem_contact_add_obstacle(s->contact, &def, &id, &err), err);
    return id;
}

static scene on_floor(sfem_mesh mesh, double young, const sfem_body_def *def)
{
    scene s = scene_of(mesh, SFEM_COROTATIONAL, young, 0.3);
    add_body(&s, def, 0.5);
    s.floor = add_plane(&s, 0, 1, 0, 0.5, 0);
    return s;
}

static void drop(scene *s)
{
    int i;
    sfem_contact_free(s->contact);
    for (i = 0; i < s->bodies; ++i) sfem_body_free(s->body[i]);
    sfem_model_free(s->model);
    sfem_mesh_free(&s->mesh);
}

static void step(scene *s, double h)
{
    sfem_error err;
    assert_ok(sfem_contact_step(s->contact, h, &err), err);
}

static void throw_body(scene *s, int k, double vx, double vy, double vz)
{
    sfem_real *v = (sfem_real *)calloc(3 * (size_t)s->mesh.nodes, sizeof *v);
    sfem_error err;
    sfem_int i;
    for (i = 0; i < s->mesh.nodes; ++i) {
        v[3 * i] = vx;
        v[3 * i + 1] = vy;
        v[3 * i + 2] = vz;
    }
    assert_ok(sfem_body_set_state(s->body[k], NULL, v, &err), err);
    free(v);
}

static void place_body(scene *s, int k, double dx, double dy, double dz)
{
    sfem_real *u = (sfem_real *)calloc(3 * (size_t)s->mesh.nodes, sizeof *u);
    sfem_error err;
    sfem_int i;
    for (i = 0; i < s->mesh.nodes; ++i) {
        u[3 * i] = dx;
        u[3 * i + 1] = dy;
        u[3 * i + 2] = dz;
    }
    assert_ok(sfem_body_set_state(s->body[k], u, NULL, &err), err);
    free(u);
}

/* The centre of mass. */
static void centre(const scene *s, int k, double x[3])
{
    const sfem_real *u = sfem_body_displacement(s->body[k]), *mass = sfem_model_node_mass(s->model);
    sfem_int i;
    int c;
    for (c = 0; c < 3; ++c) {
        x[c] = 0;
        for (i = 0; i < s->mesh.nodes; ++i) x[c] += mass[i] / s->mass * (s->mesh.x[3 * i + c] + u[3 * i + c]);
    }
}

static double lowest(const scene *s, int k)
{
    const sfem_real *u = sfem_body_displacement(s->body[k]);
    double z = 1e300;
    sfem_int i;
    for (i = 0; i < s->mesh.nodes; ++i) z = fmin(z, s->mesh.x[3 * i + 2] + u[3 * i + 2]);
    return z;
}

static double largest_difference(const sfem_real *a, const sfem_real *b, sfem_int nodes)
{
    double most = 0;
    sfem_int i;
    for (i = 0; i < 3 * nodes; ++i) most = fmax(most, fabs(a[i] - b[i]));
    return most;
}

static sfem_real *copy_displacement(const scene *s, int k)
{
    const size_t bytes = 3 * (size_t)s->mesh.nodes * sizeof(sfem_real);
    sfem_real *u = (sfem_real *)malloc(bytes);
    memcpy(u, sfem_body_displacement(s->body[k]), bytes);
    return u;
}

/* What the integrator conserves of a body under gravity, the motion of its centre included: in the middle of the step
 * that took the centre from x0 to x1. */
static double middle_energy(const scene *s, int k, const double x0[3], const double x1[3], double h)
{
    double v2 = 0;
    int c;
    for (c = 0; c < 3; ++c) v2 += (x1[c] - x0[c]) * (x1[c] - x0[c]) / (h * h);
    return sfem_body_energy(s->body[k]).conserved + s->mass * (v2 / 2 + GRAVITY * (x0[2] + x1[2]) / 2);
}

/* --------------------------------------------------------------------------------------------
 * friction
 * -------------------------------------------------------------------------------------------- */

/* A block on a plane that is inclined by `degrees` about y. */
static scene inclined(double degrees, double friction, double young)
{
    const double angle = degrees * TEST_PI / 180;
    sfem_body_def def = falling();
    sfem_mesh mesh = block(5, 0.5);
    scene s;
    rotate(&mesh, angle);
    def.stiffness_damping = 0.01;
    s = scene_of(mesh, SFEM_COROTATIONAL, young, 0.3);
    add_body(&s, &def, friction);
    add_plane(&s, sin(angle), cos(angle), 0, friction, 0);
    return s;
}

/* mu = 0.5 holds up to 26.57 degrees. All nodes, over the second half of 5 s: the first one is that of settling. */
static void a_block_below_the_friction_angle_does_not_creep(void **unused)
{
    static const double degrees[] = {20, 26};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(degrees); ++i) {
        scene s = inclined(degrees[i], 0.5, 1e6);
        sfem_real *before = NULL;
        int k;
        for (k = 0; k < 300; ++k) {
            if (k == 150) before = copy_displacement(&s, 0);
            step(&s, 1.0 / 60);
        }
        assert_true(largest_difference(before, sfem_body_displacement(s.body[0]), s.mesh.nodes) < 1e-5);
        assert_int_equal(sfem_body_get_info(s.body[0]).rejected, 0);
        free(before);
        drop(&s);
    }
}

/* The relative error of the acceleration down the plane from 0.75 s to 1.5 s. */
static double acceleration_error(double degrees, double friction)
{
    const double angle = degrees * TEST_PI / 180, h = 1.0 / 60, along[3] = {cos(angle), 0, -sin(angle)};
    const double exact = GRAVITY * (sin(angle) - friction * cos(angle));
    scene s = inclined(degrees, friction, 1e6);
    double x[4][3], v[2] = {0, 0};
    int k, c;
    for (k = 0; k < 90; ++k) {
        if (k == 45) centre(&s, 0, x[0]);
        if (k == 46) centre(&s, 0, x[1]);
        if (k == 89) centre(&s, 0, x[2]);
        step(&s, h);
    }
    centre(&s, 0, x[3]);
    for (c = 0; c < 3; ++c) {
        v[0] += along[c] * (x[1][c] - x[0][c]) / h;
        v[1] += along[c] * (x[3][c] - x[2][c]) / h;
    }
    drop(&s);
    return fabs((v[1] - v[0]) / (44 * h) / exact - 1);
}

static void a_block_above_the_friction_angle_accelerates_as_coulomb_has_it(void **unused)
{
    (void)unused;
    assert_true(acceleration_error(27.2, 0.5) < 1e-6);
    assert_true(acceleration_error(30, 0.5) < 1e-6);
    assert_true(acceleration_error(30, 0) < 1e-12);
}

/* A block of 1e8 Pa at 5 m/s stops after v^2/(2 mu g), on a moving belt that is what it moves relative to that. */
static void a_block_slides_to_rest_relative_to_a_belt(void **unused)
{
    static const double belts[] = {0, 2};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(belts); ++i) {
        const sfem_real velocity[3] = {belts[i], 0, 0}, origin[3] = {0, 0, 0};
        sfem_body_def def = falling();
        double x0[3], x1[3], way;
        sfem_error err;
        scene s;
        int k;
        def.stiffness_damping = 0.002;
        s = on_floor(block(3, 0.5), 1e8, &def);
        assert_ok(sfem_contact_move_obstacle(s.contact, s.floor, origin, NULL, velocity, NULL, &err), err);
        throw_body(&s, 0, 5, 0, 0);
        centre(&s, 0, x0);
        for (k = 0; k < 120; ++k) step(&s, 1.0 / 60);
        centre(&s, 0, x1);
        way = (5 - belts[i]) * (5 - belts[i]) / (2 * 0.5 * GRAVITY);
        assert_near(x1[0] - x0[0] - belts[i] * 2, way, 0.02, 0);
        step(&s, 1.0 / 60);
        centre(&s, 0, x0);
        assert_near((x0[0] - x1[0]) * 60, belts[i], 1e-3, 1e-3);
        drop(&s);
    }
}

/* --------------------------------------------------------------------------------------------
 * impact and energy
 * -------------------------------------------------------------------------------------------- */

/* A cube falls 1 m with 1 m/s sideways. In no step does its energy rise above what it was at the start; it never sinks in
 * by more than 2 mm, and rests at the end. */
static void a_dropped_cube_makes_no_energy_and_does_not_sink(void **unused)
{
    const double h = 1.0 / 60;
    double young;
    (void)unused;
    for (young = 1e5; young < 2e8; young *= 10) {
        sfem_body_def def = falling();
        sfem_mesh mesh = block(5, 0.5);
        double start = 0, told, x0[3], x1[3];
        scene s;
        int k;
        shift(&mesh, 0, 0, 1);
        s = on_floor(mesh, young, &def);
        throw_body(&s, 0, 1, 0, 0);
        told = sfem_body_energy(s.body[0]).total;
        for (k = 0; k < 120; ++k) {
            double energy;
            centre(&s, 0, x0);
            step(&s, h);
            centre(&s, 0, x1);
            energy = middle_energy(&s, 0, x0, x1, h);
            if (k == 0) start = energy;
            assert_true(energy <= start * (1 + 1e-9));
            assert_true(sfem_body_energy(s.body[0]).total <= told + 1e-9 * start);
            assert_true(lowest(&s, 0) > -2e-3);
        }
        assert_true(sfem_body_get_info(s.body[0]).rejected <= 3);
        assert_true(sfem_contact_get_info(s.contact).work < 0);
        drop(&s);
    }
}

typedef struct bounce {
    double kept;        /* energy after the bounce over that before */
    double restitution; /* the same of speeds of the centre */
} bounce;

/* A ball of 0.25 m falls 1 m. Energy is that of the step in which the last contact ended. */
static bounce bounce_at(double hertz)
{
    const double h = 1 / hertz;
    sfem_body_def def = falling();
    sfem_mesh mesh = ball(0.25, 4);
    double in = 0, out = 0, x0[3], x1[3], energy = 0;
    int k, touched = 0, left = 0;
    bounce b;
    scene s;
    shift(&mesh, 0, 0, 1.25);
    s = on_floor(mesh, 1e6, &def);
    b.kept = 0;
    for (k = 0; k < (int)(0.75 * hertz); ++k) {
        sfem_int contacts;
        centre(&s, 0, x0);
        step(&s, h);
        centre(&s, 0, x1);
        contacts = sfem_contact_get_info(s.contact).contacts;
        touched |= contacts > 0;
        energy = middle_energy(&s, 0, x0, x1, h) - s.mass * GRAVITY * 0.25;
        if (!touched) in = (x0[2] - x1[2]) / h;
        out = fmax(out, (x1[2] - x0[2]) / h);
        if (touched && !contacts && !left) {
            left = 1;
            b.kept = energy / (s.mass * GRAVITY);
        }
    }
    b.restitution = out / in;
    drop(&s);
    return b;
}

static void a_ball_keeps_its_energy_where_steps_resolve_the_bounce(void **unused)
{
    const bounce slow = bounce_at(60), fast = bounce_at(240), faster = bounce_at(480);
    (void)unused;
    assert_true(slow.restitution >= 0.6 && slow.restitution <= 1);
    assert_true(fast.kept >= 0.87 && fast.kept <= 1 + 1e-9);
    assert_true(faster.kept >= 0.95 && faster.kept <= 1 + 1e-9);
}

/* A force of one step changes the momentum by F h beside contacts without friction, also in steps that are rejected. */
static void forces_of_one_step_act_beside_contacts(void **unused)
{
    static const double speeds[] = {0, 12};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(speeds); ++i) {
        const double h = 1.0 / 60, way = 0.3;
        sfem_body_def def = sfem_default_body_def();
        sfem_mesh mesh = ball(0.1, 2);
        double x0[3], x1[3], momentum = 0;
        sfem_error err;
        sfem_int j;
        scene s;
        int k;
        if (speeds[i] == 0) def.gravity[2] = -GRAVITY;
        shift(&mesh, 0, 0, speeds[i] == 0 ? 0.1 : 0.3);
        s = scene_of(mesh, SFEM_COROTATIONAL, 1e6, 0.3);
        add_body(&s, &def, 0);
        s.floor = add_plane(&s, 0, 1, 0, 0, 0);
        if (speeds[i] > 0) throw_body(&s, 0, 0, 0, -speeds[i]);
        for (k = 0; k < 6; ++k) {
            const sfem_real f[3] = {way, 0, 0};
            for (j = 0; j < s.mesh.nodes; ++j) assert_ok(sfem_body_add_step_force(s.body[0], j, f, &err), err);
            momentum += way * s.mesh.nodes * h;
            centre(&s, 0, x0);
            step(&s, h);
            centre(&s, 0, x1);
            assert_near(s.mass * (x1[0] - x0[0]) / h, momentum, 1e-9, 0);
        }
        assert_true(sfem_contact_get_info(s.contact).work != 0);
        assert_true((sfem_body_get_info(s.body[0]).rejected > 0) == (speeds[i] > 0));
        drop(&s);
    }
}

/* Of bodies too stiff for the step to see them store energy. */
static void restitution_is_what_was_asked_for(void **unused)
{
    static const double asked[] = {0, 0.5, 0.8};
    size_t i;
    int shape;
    (void)unused;
    for (shape = 0; shape < 2; ++shape)
        for (i = 0; i < TEST_COUNT(asked); ++i) {
            const double h = 1.0 / 60;
            sfem_body_def def = falling();
            sfem_mesh mesh = shape ? ball(0.25, 3) : block(3, 0.5);
            double in = 0, out = 0, x0[3], x1[3];
            int k, touched = 0;
            scene s;
            shift(&mesh, 0, 0, shape ? 1.25 : 1);
            s = scene_of(mesh, SFEM_COROTATIONAL, 1e8, 0.3);
            add_body(&s, &def, 0.5);
            add_plane(&s, 0, 1, 0, 0.5, asked[i]);
            for (k = 0; k < 45; ++k) {
                centre(&s, 0, x0);
                step(&s, h);
                centre(&s, 0, x1);
                touched |= sfem_contact_get_info(s.contact).contacts > 0;
                if (!touched) in = (x0[2] - x1[2]) / h;
                out = fmax(out, (x1[2] - x0[2]) / h);
            }
            assert_near(out / in, asked[i], 0, 0.1);
            drop(&s);
        }
}

/* A ball at 30 m/s goes half a metre in a step: no plate is too thin. At 50 m/s, above the speed of its waves (32 m/s at
 * 1e6 Pa), all stays finite. */
static void fast_balls_do_not_pass_thin_plates(void **unused)
{
    static const double speeds[] = {10, 30, 30, 50, 50, 50}, half[] = {0.005, 0.005, 0.001, 0.005, 0.001, 0.001},
                        young[] = {1e6, 1e6, 1e6, 1e6, 1e5, 1e8};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(speeds); ++i) {
        sfem_body_def def = sfem_default_body_def();
        sfem_obstacle_def plate = sfem_default_obstacle_def();
        sfem_mesh mesh = ball(0.1, speeds[i] > 30 ? 2 : 3);
        sfem_error err;
        double x[3];
        scene s;
        int k;
        shift(&mesh, 0, 0, 0.25);
        s = scene_of(mesh, SFEM_COROTATIONAL, young[i], 0.3);
        add_body(&s, &def, 0.5);
        plate.kind = SFEM_OBSTACLE_BOX;
        plate.size[0] = plate.size[1] = 2;
        plate.size[2] = half[i];
        assert_ok(sfem_contact_add_obstacle(s.contact, &plate, NULL, &err), err);
        throw_body(&s, 0, 0, 0, -speeds[i]);
        for (k = 0; k < (speeds[i] > 30 ? 3 : 30); ++k) step(&s, 1.0 / 60);
        centre(&s, 0, x);
        assert_true(isfinite(x[0]) && isfinite(x[1]) && isfinite(x[2]));
        if (speeds[i] <= 30) assert_true(x[2] > 0.05);
        assert_true(sfem_body_energy(s.body[0]).total <= s.mass * speeds[i] * speeds[i] / 2 * (1 + 1e-9));
        drop(&s);
    }
}

/* Balls of 12 tets on their surface, thrown against a sphere so fast that they are flat after a step: whatever has to be
 * put in the place of that, no energy comes of it. */
static void flattened_balls_make_no_energy(void **unused)
{
    static const double young[] = {1e5, 1e6}, speed[] = {30, 50};
    test_random random = {11};
    int k, i;
    (void)unused;
    for (k = 0; k < (TEST_SANITIZED ? 12 : 40); ++k) {
        const double angle = random_uniform(&random, 0, 2 * TEST_PI), z = random_uniform(&random, -1, 1);
        const double d[3] = {sqrt(1 - z * z) * cos(angle), sqrt(1 - z * z) * sin(angle), z};
        sfem_body_def def = sfem_default_body_def();
        sfem_obstacle_def sphere = sfem_default_obstacle_def();
        sfem_mesh mesh = ball(0.02, 1);
        sfem_error err;
        scene s;
        shift(&mesh, 0.25 * d[0], 0.25 * d[1], 0.25 * d[2]);
        s = scene_of(mesh, SFEM_COROTATIONAL, young[k % 2], 0.3);
        add_body(&s, &def, 0.5);
        sphere.kind = SFEM_OBSTACLE_SPHERE;
        sphere.size[0] = 0.2;
        assert_ok(sfem_contact_add_obstacle(s.contact, &sphere, NULL, &err), err);
        throw_body(&s, 0, -speed[k / 2 % 2] * d[0], -speed[k / 2 % 2] * d[1], -speed[k / 2 % 2] * d[2]);
        for (i = 0; i < 6; ++i) {
            step(&s, 1.0 / 60);
            assert_true(sfem_body_energy(s.body[0]).total <=
                        s.mass * speed[k / 2 % 2] * speed[k / 2 % 2] / 2 * (1 + 1e-9) + sfem_contact_get_info(s.contact).moved);
        }
        drop(&s);
    }
}

/* --------------------------------------------------------------------------------------------
 * rest
 * -------------------------------------------------------------------------------------------- */

static void soft_and_stiff_bodies_rest_and_fall_asleep(void **unused)
{
    static const double young[] = {1e5, 1e8};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(young); ++i) {
        sfem_body_def def = falling();
        sfem_real *before = NULL;
        sfem_real force[3], torque[3];
        scene s;
        int k;
        def.stiffness_damping = 0.01;
        s = on_floor(block(5, 0.5), young[i], &def);
        for (k = 0; k < 60; ++k) step(&s, 1.0 / 60);
        before = copy_displacement(&s, 0);
        for (k = 0; k < 300; ++k) step(&s, 1.0 / 60);
        assert_true(largest_difference(before, sfem_body_displacement(s.body[0]), s.mesh.nodes) < 1e-3);
        assert_int_equal(sfem_body_get_info(s.body[0]).rejected, 0);
        sfem_contact_obstacle_force(s.contact, s.floor, force, torque);
        assert_near(force[2], -s.mass * GRAVITY, 1e-4, 0);
        free(before);
        drop(&s);

        def.sleep_tolerance = 0.02;
        s = on_floor(block(5, 0.5), young[i], &def);
        for (k = 0; k < 180 && !sfem_body_is_asleep(s.body[0]); ++k) step(&s, 1.0 / 60);
        assert_true(sfem_body_is_asleep(s.body[0]));
        for (k = 0; k < 10; ++k) step(&s, 1.0 / 60);
        assert_true(sfem_body_is_asleep(s.body[0]));
        sfem_contact_obstacle_force(s.contact, s.floor, force, torque); /* what it lies on feels it still */
        assert_near(force[2], -s.mass * GRAVITY, 1e-2, 0);
        assert_int_equal(sfem_contact_get_info(s.contact).systems, 0);
        drop(&s);
    }
}

/* Sleepers wake by what is taken from under them, what moves or what comes, and by nothing else. */
static void sleeping_bodies_wake_by_obstacles_that_stir(void **unused)
{
    sfem_body_def def = falling();
    const sfem_real far[3] = {5, 0, 0}, near[3] = {0.62, 0.25, 0.25}, left[3] = {-1, 0, 0}, up[3] = {0, 0, 0.1};
    const sfem_real origin[3] = {0, 0, 0};
    sfem_obstacle_def sphere = sfem_default_obstacle_def();
    sfem_error err;
    sfem_int id;
    scene s;
    int k, asleep[4];
    (void)unused;
    def.stiffness_damping = 0.01;
    def.sleep_tolerance = 0.02;
    s = on_floor(block(4, 0.5), 1e6, &def);
    sphere.kind = SFEM_OBSTACLE_SPHERE;
    sphere.size[0] = 0.1;
    memcpy(sphere.position, far, sizeof far);
    for (k = 0; k < 4; ++k) {
        int i;
        for (i = 0; i < 240 && !sfem_body_is_asleep(s.body[0]); ++i) step(&s, 1.0 / 60);
        assert_true(sfem_body_is_asleep(s.body[0]));
        if (k == 0) assert_ok(sfem_contact_add_obstacle(s.contact, &sphere, &id, &err), err); /* far away */
        if (k == 1) assert_ok(sfem_contact_move_obstacle(s.contact, id, near, NULL, left, NULL, &err), err);
        if (k == 2) assert_ok(sfem_contact_move_obstacle(s.contact, s.floor, origin, NULL, up, NULL, &err), err);
        if (k == 3) sfem_contact_remove_obstacle(s.contact, s.floor);
        for (i = 0; i < 3; ++i) step(&s, 1.0 / 60);
        asleep[k] = sfem_body_is_asleep(s.body[0]);
        if (k == 1) assert_ok(sfem_contact_move_obstacle(s.contact, id, far, NULL, NULL, NULL, &err), err);
        if (k == 2) assert_ok(sfem_contact_move_obstacle(s.contact, s.floor, origin, NULL, NULL, NULL, &err), err);
    }
    assert_true(asleep[0] && !asleep[1] && !asleep[2] && !asleep[3]);
    drop(&s);
}

/* A hundred bodies of one model on one floor: none is rejected, all sleep in the end, and columns are made once. */
static void a_hundred_bodies_rest_on_one_floor(void **unused)
{
    sfem_body_def def = falling();
    sfem_mesh mesh = block(2, 0.3);
    scene s;
    int i, k, asleep = 0;
    (void)unused;
    shift(&mesh, 0, 0, 0.02);
    def.stiffness_damping = 0.005;
    def.sleep_tolerance = 0.02;
    s = scene_of(mesh, SFEM_COROTATIONAL, 3e5, 0.3);
    for (i = 0; i < 100; ++i) {
        add_body(&s, &def, 0.5);
        place_body(&s, i, i % 10, i / 10, 0.001 * i);
    }
    s.floor = add_plane(&s, 0, 1, 0, 0.5, 0);
    for (k = 0; k < 180; ++k) step(&s, 1.0 / 60);
    for (i = 0; i < 100; ++i) {
        asleep += sfem_body_is_asleep(s.body[i]);
        assert_int_equal(sfem_body_get_info(s.body[i]).rejected, 0);
        assert_true(lowest(&s, i) > -1e-3);
    }
    assert_int_equal(asleep, 100);
    assert_true(sfem_contact_get_info(s.contact).columns_made <= 26); /* once for each node of a surface, not of 100 */
    drop(&s);
}

/* A hundred balls in a box, with speeds of their own (they do not see each other). */
static void a_hundred_balls_in_a_box(void **unused)
{
    sfem_body_def def = falling();
    test_random random = {7};
    int64_t rejected = 0, steps = 0;
    double deepest = 0;
    sfem_error err;
    scene s;
    int i, k;
    (void)unused;
    def.stiffness_damping = 0.005;
    s = scene_of(ball(0.2, 2), SFEM_COROTATIONAL, 3e5, 0.3);
    for (i = 0; i < 100; ++i) {
        const double x = random_uniform(&random, -0.9, 0.9), y = random_uniform(&random, -0.9, 0.9),
                     z = random_uniform(&random, 0.25, 1.5);
        add_body(&s, &def, 0.5);
        place_body(&s, i, x, y, z);
    }
    s.floor = add_plane(&s, 0, 1, 0, 0.5, 0);
    add_plane(&s, 1, 0, -1.2, 0.5, 0);
    add_plane(&s, -1, 0, -1.2, 0.5, 0);
    for (i = -1; i <= 1; i += 2) {
        const sfem_real normal[3] = {0, i, 0}, point[3] = {0, -1.2 * i, 0};
        const sfem_obstacle_def wall = sfem_obstacle_plane(normal, point);
        assert_ok(sfem_contact_add_obstacle(s.contact, &wall, NULL, &err), err);
    }
    for (i = 0; i < 100; ++i) { /* thrown from where they are */
        const size_t n = 3 * (size_t)s.mesh.nodes;
        sfem_real *u = copy_displacement(&s, i), *v = (sfem_real *)malloc(n * sizeof *v);
        const double vx = random_uniform(&random, -3, 3), vy = random_uniform(&random, -3, 3);
        for (k = 0; k < s.mesh.nodes; ++k) v[3 * k] = vx, v[3 * k + 1] = vy, v[3 * k + 2] = 0;
        assert_ok(sfem_body_set_state(s.body[i], u, v, &err), err);
        free(u);
        free(v);
    }
    for (k = 0; k < (TEST_SANITIZED ? 30 : 90); ++k) {
        step(&s, 1.0 / 60);
        deepest = fmax(deepest, sfem_contact_get_info(s.contact).penetration);
        for (i = 0; i < 100; ++i) deepest = fmax(deepest, -lowest(&s, i));
    }
    for (i = 0; i < 100; ++i) {
        rejected += sfem_body_get_info(s.body[i]).rejected;
        steps += sfem_body_get_info(s.body[i]).steps;
    }
    assert_true((double)rejected < 0.01 * (double)steps);
    assert_true(deepest < 5e-3);
    drop(&s);
}

/* --------------------------------------------------------------------------------------------
 * against theory
 * -------------------------------------------------------------------------------------------- */

/* Steps with heavy damping until nothing moves: a static solution with contact. */
static void settle(scene *s, double h, int steps)
{
    int k;
    for (k = 0; k < steps; ++k) step(s, h);
}

/* Patch test: a block on a floor without friction under a uniform pressure p on its top is strained uniformly,
 * u = (nu p/E x, nu p/E y, -p/E z), and the floor exerts p times the area of each node. */
static void a_uniform_pressure_passes_through_the_contact(void **unused)
{
    const sfem_int cells[3] = {3, 2, 3};
    const sfem_real size[3] = {0.6, 0.4, 0.5};
    const double pressure = 100, young = 1e5, poisson = 0.3;
    sfem_body_def def = sfem_default_body_def();
    sfem_contact_def exact = sfem_default_contact_def();
    const sfem_contact_point *point;
    sfem_surface surface;
    sfem_mesh mesh;
    sfem_real *force, *floor;
    sfem_int i, points;
    sfem_error err;
    scene s;
    int k, c;
    (void)unused;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_6_TETS, NULL, &mesh, &err), err);
    for (i = 0; i < mesh.nodes; ++i) { /* inner nodes anywhere, those of faces in their faces */
        sfem_real *x = mesh.x + 3 * i;
        const double wiggle = 0.03 * sin(7 * i);
        for (c = 0; c < 3; ++c)
            if (x[c] > 1e-9 && x[c] < size[c] - 1e-9) x[c] += wiggle * (c == 1 ? -1 : 1);
    }
    exact.tolerance = 1e-9;
    s = scene_with(mesh, SFEM_LINEAR, young, poisson, &exact);
    def.stiffness_damping = 0.02;
    def.mass_damping = 5;
    add_body(&s, &def, 0);
    s.floor = add_plane(&s, 0, 1, 0, 0, 0);
    force = (sfem_real *)calloc(6 * (size_t)mesh.nodes, sizeof *force);
    floor = force + 3 * mesh.nodes;
    assert_ok(sfem_mesh_surface(&s.mesh, NULL, &surface, &err), err);
    for (i = 0; i < surface.triangles; ++i) {
        const sfem_int *t = surface.tri + 3 * i;
        const sfem_real *a = mesh.x + 3 * t[0], *b = mesh.x + 3 * t[1], *d = mesh.x + 3 * t[2];
        const double area = ((b[0] - a[0]) * (d[1] - a[1]) - (b[1] - a[1]) * (d[0] - a[0])) / 2; /* seen from above */
        const int top = a[2] + b[2] + d[2] > 3 * size[2] - 1e-9, bottom = a[2] + b[2] + d[2] < 1e-9;
        for (c = 0; c < 3; ++c) {
            if (top) force[3 * t[c] + 2] -= pressure * area / 3;
            if (bottom) floor[3 * t[c] + 2] -= pressure * area / 3; /* area < 0 */
        }
    }
    assert_ok(sfem_body_set_lasting_force(s.body[0], force, &err), err);
    settle(&s, 0.02, 300);
    point = sfem_contact_points(s.contact, &points);
    assert_int_equal(points, 4 * 3);
    for (k = 0; k < points; ++k) assert_near(point[k].force[2], floor[3 * point[k].node[0] + 2], 1e-6, 1e-6);
    for (i = 0; i < mesh.nodes; ++i) {
        const sfem_real *u = sfem_body_displacement(s.body[0]) + 3 * i, *x = mesh.x + 3 * i;
        const sfem_real *u0 = sfem_body_displacement(s.body[0]);
        const double strain = poisson * pressure / young, tolerance = 1e-6 * pressure / young;
        assert_near(u[2], -pressure / young * x[2], 0, tolerance);
        assert_near(u[0] - u0[0], strain * (x[0] - mesh.x[0]), 0, tolerance); /* it may drift: there is no friction */
        assert_near(u[1] - u0[1], strain * (x[1] - mesh.x[1]), 0, tolerance);
    }
    sfem_surface_free(&surface);
    free(force);
    drop(&s);
}

/* Elastic bar against a wall [Doyen, Ern, Piperno 2011], nu = 0, one-dimensional: a wave of stress rho c v runs to the
 * free end and back. It stays for 2 L/c, at the force rho c v A, and leaves as fast as it came. */
static void an_elastic_bar_stays_at_a_wall_for_as_long_as_its_wave_takes(void **unused)
{
    const sfem_int cells[3] = {1, 1, 40};
    const sfem_real size[3] = {0.05, 0.05, 1};
    const double speed = 1, young = 1e6, c = sqrt(young / 1000), stay = 2 / c, h = stay / 160, area = 0.0025;
    sfem_body_def def = sfem_default_body_def();
    sfem_mesh mesh;
    sfem_error err;
    double first = 0, last = 0, impulse = 0, x0[3], x1[3], middle = 0;
    int k, in_middle = 0;
    scene s;
    (void)unused;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
    shift(&mesh, 0, 0, 0.05 * h);
    s = scene_of(mesh, SFEM_COROTATIONAL, young, 0);
    add_body(&s, &def, 0);
    s.floor = add_plane(&s, 0, 1, 0, 0, 0);
    throw_body(&s, 0, 0, 0, -speed);
    for (k = 1; k <= 400; ++k) {
        sfem_real force[3], torque[3];
        step(&s, h);
        sfem_contact_obstacle_force(s.contact, s.floor, force, torque);
        impulse -= h * force[2];
        if (force[2] == 0) continue;
        if (first == 0) first = k * h;
        last = k * h;
        if (last - first < 0.2 * stay || last - first > 0.8 * stay) continue;
        middle -= force[2];
        ++in_middle;
    }
    centre(&s, 0, x0);
    step(&s, h);
    centre(&s, 0, x1);
    assert_near(last - first, stay, 0.05, 0);
    assert_near(middle / in_middle, 1000 * c * speed * area, 0.02, 0);
    assert_near((x1[2] - x0[2]) / h, speed, 0.05, 0);
    assert_near(impulse, s.mass * (speed + (x1[2] - x0[2]) / h), 1e-2, 0);
    drop(&s);
}

/* x to a Moebius map of the unit ball, which shrinks lengths at (0, 0, -1) by (1-a)/(1+a): angles and the sphere stay. */
static void refine_below(sfem_mesh *mesh, double a)
{
    sfem_int i;
    int c;
    for (i = 0; i < mesh->nodes; ++i) {
        sfem_real *x = mesh->x + 3 * i;
        const double y[3] = {x[0], x[1], x[2]}, y2 = y[0] * y[0] + y[1] * y[1] + y[2] * y[2], dot = -a * y[2];
        const double p = 1 + 2 * dot + y2, q = 1 - a * a, r = 1 + 2 * dot + a * a * y2;
        for (c = 0; c < 3; ++c) x[c] = (q * y[c] - (c == 2 ? p * a : 0)) / r;
    }
}

/* Hertz: F = 4/3 E/(1-nu^2) sqrt(R) d^(3/2), d the way of the upper half. That is held fast, which stiffens by
 * about F (1+nu)(3-2nu)/(2 pi E R) of d [Boussinesq's displacement at the depth R]: for d = R/2000 F grows by 2.4 %. */
static void a_ball_on_a_plane_bears_the_force_of_hertz(void **unused)
{
    static const double depth[] = {0.0005, 0.001};
    const double young = 1e6, poisson = 0.3;
    sfem_body_def def = sfem_default_body_def();
    sfem_int *pins;
    sfem_int i;
    sfem_error err;
    sfem_mesh mesh = ball(1, 9);
    double found[2];
    scene s;
    int k;
    (void)unused;
    refine_below(&mesh, 0.9);
    shift(&mesh, 0, 0, 1);
    pins = (sfem_int *)malloc((size_t)mesh.nodes * sizeof *pins);
    for (i = 0; i < mesh.nodes; ++i)
        if (mesh.x[3 * i + 2] > 1) pins[def.pin_count++] = i;
    def.pins = pins;
    def.stiffness_damping = 0.5;
    s = scene_of(mesh, SFEM_COROTATIONAL, young, poisson);
    add_body(&s, &def, 0);
    s.floor = add_plane(&s, 0, 1, 0, 0, 0);
    for (k = TEST_SANITIZED ? 1 : 0; k < 2; ++k) {
        const sfem_real up[3] = {0, 0, depth[k]};
        sfem_real force[3], torque[3];
        const double hertz = 4.0 / 3 * young / (1 - poisson * poisson) * pow(depth[k], 1.5);
        assert_ok(sfem_contact_move_obstacle(s.contact, s.floor, up, NULL, NULL, NULL, &err), err);
        settle(&s, 0.05, 50); /* 100 more change it by 1e-6 */
        sfem_contact_obstacle_force(s.contact, s.floor, force, torque);
        found[k] = -force[2] / hertz;
    }
    for (k = TEST_SANITIZED ? 1 : 0; k < 2; ++k) assert_near(found[k], 1, 0, 0.05);
    free(pins);
    drop(&s);
}

/* --------------------------------------------------------------------------------------------
 * obstacles
 * -------------------------------------------------------------------------------------------- */

static double wavy(void *user, const sfem_real x[3], sfem_real gradient[3]) /* a hilly ground */
{
    const double f = 0.08 * sin(9 * x[0]) * cos(9 * x[1]), fx = 0.72 * cos(9 * x[0]) * cos(9 * x[1]);
    const double fy = -0.72 * sin(9 * x[0]) * sin(9 * x[1]), length = sqrt(1 + fx * fx + fy * fy);
    (void)user;
    gradient[0] = -fx / length;
    gradient[1] = -fy / length;
    gradient[2] = 1 / length;
    return (x[2] - f) / length;
}

/* Of 0.2 m radius, with places of its own. */
static sfem_surface surface_of_a_ball(void)
{
    sfem_mesh mesh = ball(0.2, 6);
    sfem_surface s;
    sfem_error err;
    sfem_int i;
    assert_ok(sfem_mesh_surface(&mesh, NULL, &s, &err), err);
    s.nodes = mesh.nodes; /* the inner ones are of no use */
    s.x = (sfem_real *)malloc(3 * (size_t)mesh.nodes * sizeof *s.x);
    for (i = 0; i < 3 * mesh.nodes; ++i) s.x[i] = mesh.x[i];
    sfem_mesh_free(&mesh);
    return s;
}

static void free_surface(sfem_surface *s)
{
    free(s->x);
    s->x = NULL;
    sfem_surface_free(s);
}

static sfem_obstacle_def shape_of(sfem_obstacle_kind kind, const sfem_surface *surface)
{
    static sfem_real heights[41 * 41];
    sfem_obstacle_def d = sfem_default_obstacle_def();
    int i;
    d.kind = kind;
    d.size[0] = d.size[1] = d.size[2] = 0.2;
    d.distance = wavy;
    if (kind == SFEM_OBSTACLE_HEIGHTS) { /* the same hills, sampled */
        for (i = 0; i < 41 * 41; ++i)
            heights[i] = 0.08 * sin(9 * (i / 41 * 0.04 - 0.8)) * cos(9 * (i % 41 * 0.04 - 0.8));
        d.heights = heights;
        d.cells[0] = d.cells[1] = 41;
        d.size[0] = d.size[1] = 0.04;
        d.position[0] = d.position[1] = -0.8;
    }
    if (kind == SFEM_OBSTACLE_SURFACE) d.surface = surface;
    if (kind == SFEM_OBSTACLE_CAPSULE) d.size[0] = 0.1; /* lies along x */
    if (kind == SFEM_OBSTACLE_CAPSULE || kind == SFEM_OBSTACLE_CYLINDER) {
        d.rotation[0] = d.rotation[8] = 0;
        d.rotation[2] = 1;
        d.rotation[6] = -1;
    }
    return d;
}

/* A soft slab falls on each kind and rests on it or on the floor: forces on obstacles add up to its weight, and no node
 * is left inside. */
static void a_slab_rests_on_obstacles_of_every_kind(void **unused)
{
    static const sfem_obstacle_kind kinds[] = {SFEM_OBSTACLE_SPHERE, SFEM_OBSTACLE_CAPSULE, SFEM_OBSTACLE_BOX,
                                               SFEM_OBSTACLE_CYLINDER, SFEM_OBSTACLE_DISTANCE,
                                               SFEM_OBSTACLE_HEIGHTS, SFEM_OBSTACLE_SURFACE};
    const sfem_int cells[3] = {8, 8, 3};
    const sfem_real size[3] = {0.8, 0.8, 0.3};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(kinds); i += TEST_SANITIZED ? 3 : 1) {
        sfem_body_def def = falling();
        sfem_surface surface = surface_of_a_ball();
        sfem_obstacle_def shape = shape_of(kinds[i], &surface);
        sfem_mesh mesh;
        sfem_error err;
        sfem_int id;
        double deepest = 0, sum = 0;
        sfem_real force[3], torque[3];
        scene s;
        int k;
        assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
        shift(&mesh, -0.38, -0.41, 0.35);
        def.stiffness_damping = 0.02;
        def.mass_damping = 2;
        s = on_floor(mesh, 2e5, &def);
        if (kinds[i] == SFEM_OBSTACLE_DISTANCE || kinds[i] == SFEM_OBSTACLE_HEIGHTS) shape.position[2] = 0.1;
        assert_ok(sfem_contact_add_obstacle(s.contact, &shape, &id, &err), err);
        for (k = 0; k < 120; ++k) {
            step(&s, 1.0 / 60);
            deepest = fmax(deepest, sfem_contact_get_info(s.contact).penetration);
        }
        assert_true(deepest < 5e-3);
        assert_true(sfem_contact_get_info(s.contact).penetration < 1e-4);
        sfem_contact_obstacle_force(s.contact, id, force, torque);
        assert_true(force[2] < -0.1 * s.mass * GRAVITY);
        sum = force[2];
        sfem_contact_obstacle_force(s.contact, s.floor, force, torque);
        sum += force[2];
        assert_near(sum, -s.mass * GRAVITY, 0.05, 0);
        free_surface(&surface);
        drop(&s);
    }
}

/* Needles, corners and edges smaller than the triangles of a body do not slip in between its nodes: how deep they are
 * below its top, less what that itself gives way. */
static void small_obstacles_do_not_slip_between_nodes(void **unused)
{
    int kind, fast;
    (void)unused;
    for (kind = 0; kind < 3; ++kind)
        for (fast = 0; fast < 2; ++fast) {
            sfem_body_def def = sfem_default_body_def();
            sfem_obstacle_def tool = sfem_default_obstacle_def();
            sfem_mesh mesh = block(2, 0.4); /* triangles of 0.2 m */
            const sfem_contact_point *point;
            const sfem_real down[3] = {0, 0, fast ? -20 : -0.5};
            sfem_int pins[9], i, points;
            sfem_real force[3], torque[3];
            sfem_error err;
            sfem_int id;
            double deepest = 0;
            scene s;
            int k;
            for (i = 0; i < mesh.nodes; ++i)
                if (mesh.x[3 * i + 2] < 1e-9) pins[def.pin_count++] = i;
            def.pins = pins;
            def.stiffness_damping = 0.01;
            s = scene_of(mesh, SFEM_COROTATIONAL, 1e5, 0.3);
            add_body(&s, &def, 0.5);
            tool.kind = kind == 0 ? SFEM_OBSTACLE_SPHERE : kind == 1 ? SFEM_OBSTACLE_CAPSULE : SFEM_OBSTACLE_BOX;
            tool.size[0] = kind == 2 ? 0.03 : 0.01;
            tool.size[1] = kind == 2 ? 0.03 : 0.2; /* a needle that points down */
            tool.size[2] = 0.03;
            if (kind == 2) { /* a cube on its corner: x, y and z axes at equal angles to the vertical */
                const double r[9] = {1 / sqrt(2.), -1 / sqrt(2.), 0,           1 / sqrt(6.), 1 / sqrt(6.), -2 / sqrt(6.),
                                     1 / sqrt(3.), 1 / sqrt(3.),  1 / sqrt(3.)};
                memcpy(tool.rotation, r, sizeof r);
            }
            tool.position[0] = 0.13;
            tool.position[1] = 0.07;
            tool.position[2] = 0.4 + (kind == 2 ? 0.03 * sqrt(3.) : kind == 1 ? 0.21 : 0.01) + (fast ? 0.15 : 0.002);
            assert_ok(sfem_contact_add_obstacle(s.contact, &tool, &id, &err), err);
            assert_ok(sfem_contact_move_obstacle(s.contact, id, tool.position, NULL, down, NULL, &err), err);
            for (k = 0; k < (fast ? 1 : 10); ++k) {
                step(&s, 1.0 / 120);
                deepest = fmax(deepest, sfem_contact_get_info(s.contact).penetration);
            }
            point = sfem_contact_points(s.contact, &points);
            assert_true(points > 0);
            assert_true(point[0].normal[2] < -0.3);
            sfem_contact_obstacle_force(s.contact, id, force, torque);
            assert_true(force[2] > 0);
            assert_true(deepest < 2e-3);
            drop(&s);
        }
}

/* A tool that presses into the side of a block and slides up past its edge lets go: the plane of its side does not go on
 * below it. */
static void a_tool_that_slides_off_lets_go(void **unused)
{
    const sfem_real up[3] = {0, 0, 0.5};
    sfem_body_def def = falling();
    sfem_obstacle_def tool = sfem_default_obstacle_def();
    sfem_real force[3], torque[3], pressed = 0;
    sfem_error err;
    sfem_int id;
    scene s;
    int k;
    (void)unused;
    def.stiffness_damping = 0.01;
    s = on_floor(block(4, 0.2), 1e5, &def);
    tool.kind = SFEM_OBSTACLE_BOX;
    tool.size[0] = 0.02;
    tool.size[1] = tool.size[2] = 0.05;
    tool.position[0] = 0.21; /* 1 cm deep: pushed out, then held there by the friction of the floor */
    tool.position[1] = 0.1;
    tool.position[2] = 0.11;
    tool.contact.friction = 0.2;
    assert_ok(sfem_contact_add_obstacle(s.contact, &tool, &id, &err), err);
    for (k = 0; k < 60; ++k) {
        if (k == 15) assert_ok(sfem_contact_move_obstacle(s.contact, id, tool.position, NULL, up, NULL, &err), err);
        step(&s, 1.0 / 60);
        sfem_contact_obstacle_force(s.contact, id, force, torque);
        if (k == 15) pressed = force[0];
    }
    assert_true(pressed > 1); /* its lower end has risen from 0.06 to 0.435 m */
    assert_true(force[0] == 0 && force[1] == 0 && force[2] == 0);
    drop(&s);
}

/* Against the surface of a ball of many triangles, and of an open one, distances and normals are those of the sphere. */
static void surfaces_are_as_far_as_spheres(void **unused)
{
    sfem_body_def def = sfem_default_body_def();
    sfem_surface surface = surface_of_a_ball();
    sfem_obstacle_def o = sfem_default_obstacle_def();
    test_random random = {5};
    sfem_error err;
    const int directions = TEST_SANITIZED ? 4 : 9;
    int open, k, at_it = 0;
    (void)unused;
    o.kind = SFEM_OBSTACLE_SURFACE;
    for (open = 0; open < 2; ++open) {
        const sfem_int all = surface.triangles;
        if (open) surface.triangles -= surface.triangles / 4;
        o.surface = &surface;
        o.size[0] = open ? 0.05 : 0;
        for (k = 0; k < directions; ++k) { /* a ball that comes from any side stops at its face */
            const double angle = random_uniform(&random, 0, 2 * TEST_PI), z = random_uniform(&random, -1, 1);
            const double d[3] = {sqrt(1 - z * z) * cos(angle), sqrt(1 - z * z) * sin(angle), z};
            sfem_contact_point point;
            sfem_int points, id;
            scene s = scene_of(ball(0.02, 2), SFEM_COROTATIONAL, 1e8, 0.3); /* all but rigid */
            add_body(&s, &def, 0.5);
            assert_ok(sfem_contact_add_obstacle(s.contact, &o, &id, &err), err);
            place_body(&s, 0, 0.25 * d[0], 0.25 * d[1], 0.25 * d[2]);
            {
                const size_t n = 3 * (size_t)s.mesh.nodes;
                sfem_real *u = copy_displacement(&s, 0), *v = (sfem_real *)malloc(n * sizeof *v);
                size_t i;
                for (i = 0; i < n; ++i) v[i] = -5 * d[i % 3];
                assert_ok(sfem_body_set_state(s.body[0], u, v, &err), err);
                free(u);
                free(v);
            }
            step(&s, 1.0 / 60);
            sfem_contact_points(s.contact, &points);
            if (open && !points) { /* it came through the hole */
                drop(&s);
                continue;
            }
            assert_true(points > 0);
            point = *sfem_contact_points(s.contact, &points);
            if (!open) { /* the nearest node is at the sphere, but for chords of 3 % */
                const sfem_real *u = sfem_body_displacement(s.body[0]);
                double nearest = 1;
                sfem_int i;
                for (i = 0; i < s.mesh.nodes; ++i) {
                    const double x[3] = {s.mesh.x[3 * i] + u[3 * i], s.mesh.x[3 * i + 1] + u[3 * i + 1],
                                         s.mesh.x[3 * i + 2] + u[3 * i + 2]};
                    nearest = fmin(nearest, sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]));
                }
                assert_true(nearest > 0.194);
                at_it += nearest < 0.206; /* the others: steps that were rejected and ended before it */
                assert_true(point.normal[0] * d[0] + point.normal[1] * d[1] + point.normal[2] * d[2] > 0.9);
            }
            drop(&s);
        }
        surface.triangles = all;
        if (!open) assert_true(4 * at_it >= 3 * directions);
    }
    o.size[0] = 0; /* open, and no thickness */
    surface.triangles -= 3;
    {
        scene s = scene_of(block(1, 1), SFEM_COROTATIONAL, 1e6, 0.3);
        assert_status(sfem_contact_add_obstacle(s.contact, &o, NULL, &err), SFEM_BAD_MESH);
        assert_names(err, "open");
        surface.x[4] = NAN;
        assert_status(sfem_contact_add_obstacle(s.contact, &o, NULL, &err), SFEM_NOT_FINITE);
        surface.x[4] = 0;
        surface.tri[7] = 100000;
        assert_status(sfem_contact_add_obstacle(s.contact, &o, NULL, &err), SFEM_BAD_MESH);
        drop(&s);
    }
    free_surface(&surface);
}

/* Two plates that close on a ball, hold it without gravity and turn about its centre take it with them; their forces
 * are opposite, and their work is what the ball has gained and lost. */
static void moving_plates_carry_a_ball_and_their_work_is_counted(void **unused)
{
    sfem_body_def def = sfem_default_body_def();
    const double h = 1.0 / 120;
    sfem_obstacle_def plate = sfem_default_obstacle_def();
    sfem_real force[2][3], torque[3];
    double x0[3], x1[3];
    sfem_error err;
    sfem_int id[2];
    scene s;
    int i, k;
    (void)unused;
    def.stiffness_damping = 0.01;
    s = scene_of(ball(0.1, 4), SFEM_COROTATIONAL, 1e5, 0.3);
    add_body(&s, &def, 1);
    plate.kind = SFEM_OBSTACLE_BOX;
    plate.size[0] = 0.02;
    plate.size[1] = plate.size[2] = 0.1;
    plate.contact.friction = 1;
    for (i = 0; i < 2; ++i) {
        plate.position[0] = i ? -0.13 : 0.13;
        assert_ok(sfem_contact_add_obstacle(s.contact, &plate, &id[i], &err), err);
    }
    for (k = 0; k < 240; ++k) { /* 1.5 cm each in half a second; a pause; up by half a metre */
        for (i = 0; i < 2; ++i) {
            sfem_real p[3], r[9], v[3] = {0, 0, 0};
            sfem_contact_obstacle_pose(s.contact, id[i], p, r);
            if (k < 60) v[0] = i ? 0.05 : -0.05;
            if (k >= 120) v[2] = 0.5;
            assert_ok(sfem_contact_move_obstacle(s.contact, id[i], p, NULL, v, NULL, &err), err);
        }
        centre(&s, 0, x0);
        step(&s, h);
    }
    centre(&s, 0, x1);
    assert_near(x1[2], 0.5, 0, 0.01);
    assert_near((x1[2] - x0[2]) / h, 0.5, 0, 0.01);
    for (i = 0; i < 2; ++i) sfem_contact_obstacle_force(s.contact, id[i], force[i], torque);
    assert_true(force[0][0] > 1);
    assert_near(force[0][0], -force[1][0], 1e-2, 0);
    { /* work of the plates = kinetic + elastic energy + what friction and damping took, which is not negative */
        const sfem_contact_info info = sfem_contact_get_info(s.contact);
        const sfem_energy e = sfem_body_energy(s.body[0]);
        assert_true(info.moved > 0);
        assert_true(e.total <= info.moved * (1 + 1e-6));
        assert_true(info.work <= info.moved * (1 + 1e-9));
    }
    drop(&s);
}

static void filters_say_who_touches_whom(void **unused)
{
    sfem_body_def def = falling();
    sfem_contact_surface surface = sfem_default_contact_surface();
    sfem_obstacle_def table;
    const sfem_real up[3] = {0, 0, 1}, at[3] = {0, 0, -0.5};
    sfem_mesh mesh = block(2, 0.2);
    sfem_error err;
    scene s;
    sfem_int i;
    int k;
    (void)unused;
    mesh.region = (sfem_int *)calloc((size_t)mesh.tets, sizeof *mesh.region);
    for (i = 0; i < mesh.tets; ++i) mesh.region[i] = mesh.x[3 * mesh.tet[4 * i] + 2] < 0.05 ? 3 : 1;
    s = scene_of(mesh, SFEM_COROTATIONAL, 1e6, 0.3);
    surface.groups = 2;
    for (k = 0; k < 3; ++k) {
        assert_ok(sfem_body_create(s.model, &def, &s.body[k], &err), err);
        surface.collides = k == 0 ? 1 : 4;
        assert_ok(sfem_contact_add_body(s.contact, s.body[k], &surface, k == 2 ? 1u << 7 : ~0u, NULL, &err), err);
        ++s.bodies;
    }
    s.floor = add_plane(&s, 0, 1, 0, 0.5, 0); /* group 1 */
    table = sfem_obstacle_plane(up, at);
    table.contact.groups = 4;
    assert_ok(sfem_contact_add_obstacle(s.contact, &table, NULL, &err), err);
    for (k = 0; k < 60; ++k) step(&s, 1.0 / 60);
    sfem_contact_remove_body(s.contact, 0); /* of which the others notice nothing; its number is free */
    step(&s, 1.0 / 60);
    assert_near(lowest(&s, 0), 0, 0, 1e-3);    /* the floor */
    assert_near(lowest(&s, 1), -0.5, 0, 1e-3); /* the table, through the floor */
    assert_true(lowest(&s, 2) < -2);           /* no region of it takes part */
    free(s.mesh.region);
    s.mesh.region = NULL;
    drop(&s);
}

/* Bodies of one model of which other regions take part: each has columns of its own nodes. */
static void bodies_of_one_model_may_touch_by_other_regions(void **unused)
{
    static const uint32_t regions[3] = {1u << 3, 1u << 1, ~0u};
    const sfem_real half_turn[9] = {1, 0, 0, 0, -1, 0, 0, 0, -1}, to[3] = {0, 0, 0.22};
    sfem_body_def def = falling();
    sfem_mesh mesh = block(2, 0.2);
    sfem_error err;
    scene s;
    sfem_int i;
    int k;
    (void)unused;
    mesh.region = (sfem_int *)calloc((size_t)mesh.tets, sizeof *mesh.region);
    for (i = 0; i < mesh.tets; ++i) {
        double z = 0;
        for (k = 0; k < 4; ++k) z += mesh.x[3 * mesh.tet[4 * i + k] + 2] / 4;
        mesh.region[i] = z > 0.1 ? 3 : 1;
    }
    shift(&mesh, 0, 0, 0.01);
    s = scene_of(mesh, SFEM_COROTATIONAL, 1e6, 0.3);
    for (k = 0; k < 3; ++k) {
        assert_ok(sfem_body_create(s.model, &def, &s.body[k], &err), err);
        assert_ok(sfem_contact_add_body(s.contact, s.body[k], NULL, regions[k], NULL, &err), err);
        ++s.bodies;
    }
    assert_ok(sfem_body_place(s.body[0], half_turn, to, &err), err); /* on its upper half */
    s.floor = add_plane(&s, 0, 1, 0, 0.5, 0);
    for (k = 0; k < 30; ++k) step(&s, 1.0 / 60);
    for (k = 0; k < 3; ++k) assert_near(lowest(&s, k), 0, 0, 1e-3);
    assert_near(sfem_contact_points(s.contact, &i)[0].force[2], sfem_contact_points(s.contact, &i)[i - 1].force[2], 0.9, 1);
    assert_int_equal(i, 27);
    free(s.mesh.region);
    s.mesh.region = NULL;
    drop(&s);
}

static double far_ball(void *user, const sfem_real x[3], sfem_real gradient[3])
{
    const double length = sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
    int c;
    ++*(int *)user;
    for (c = 0; c < 3; ++c) gradient[c] = x[c] / length;
    return length - 1;
}

/* What is far costs a look each, not one for each node; contacts end where a body is put elsewhere. */
static void what_is_far_is_not_touched(void **unused)
{
    static const sfem_real heights[4] = {0, 0.1, 0.1, 0};
    const sfem_real one[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, up[3] = {1, 0, 5};
    sfem_body_def def = falling();
    sfem_obstacle_def o = sfem_default_obstacle_def();
    sfem_error err;
    int calls = 0, k;
    scene s = on_floor(block(3, 0.2), 1e5, &def);
    (void)unused;
    o.kind = SFEM_OBSTACLE_DISTANCE;
    o.distance = far_ball;
    o.user = &calls;
    o.position[0] = 4;
    assert_ok(sfem_contact_add_obstacle(s.contact, &o, NULL, &err), err);
    o = sfem_default_obstacle_def();
    o.kind = SFEM_OBSTACLE_HEIGHTS; /* below the block in its second place, and beside it in its first */
    o.heights = heights;
    o.cells[0] = o.cells[1] = 2;
    o.size[0] = o.size[1] = 0.5;
    o.position[0] = 0.85;
    o.position[1] = -0.15;
    o.position[2] = 4.85;
    assert_ok(sfem_contact_add_obstacle(s.contact, &o, NULL, &err), err);
    for (k = 0; k < 20; ++k) step(&s, 1.0 / 60);
    assert_true(calls > 0 && calls < 20 * 20); /* 56 nodes are on the surface */
    assert_int_equal(sfem_contact_get_info(s.contact).contacts, 16);
    assert_ok(sfem_body_place(s.body[0], one, up, &err), err);
    step(&s, 1.0 / 60);
    assert_int_equal(sfem_contact_get_info(s.contact).contacts, 0);
    for (k = 0; k < 30; ++k) step(&s, 1.0 / 60);
    assert_true(sfem_contact_get_info(s.contact).contacts > 0 && lowest(&s, 0) > 4.8);
    drop(&s);
}

/* Penetration is compliance times force: of a block on four nodes of a spring each. */
static void compliance_gives_way_in_proportion(void **unused)
{
    sfem_body_def def = falling();
    sfem_contact_surface soft = sfem_default_contact_surface();
    const sfem_contact_point *point;
    sfem_error err;
    sfem_int points;
    scene s;
    int k;
    (void)unused;
    def.stiffness_damping = 0.01;
    def.mass_damping = 5;
    s = scene_of(block(1, 0.2), SFEM_COROTATIONAL, 1e7, 0.3);
    soft.compliance = 1e-4;
    assert_ok(sfem_body_create(s.model, &def, &s.body[0], &err), err);
    assert_ok(sfem_contact_add_body(s.contact, s.body[0], &soft, ~0u, NULL, &err), err);
    s.bodies = 1;
    s.floor = add_plane(&s, 0, 1, 0, 0.5, 0);
    for (k = 0; k < 240; ++k) step(&s, 1.0 / 60);
    point = sfem_contact_points(s.contact, &points);
    assert_int_equal(points, 4);
    for (k = 0; k < points; ++k) assert_near(point[k].gap, -1e-4 * point[k].force[2], 0.02, 1e-7);
    drop(&s);
}

/* A body made inside of an obstacle, or on which one is put, leaves it no faster than it is pushed. */
static void overlaps_are_pushed_out_slowly(void **unused)
{
    sfem_body_def def = falling();
    sfem_mesh mesh = block(3, 0.3);
    double fastest = 0, x0[3], x1[3];
    scene s;
    int k, pushed = 0;
    (void)unused;
    shift(&mesh, 0, 0, -0.1);
    def.stiffness_damping = 0.01;
    s = on_floor(mesh, 1e6, &def);
    for (k = 0; k < 120; ++k) {
        centre(&s, 0, x0);
        step(&s, 1.0 / 60);
        centre(&s, 0, x1);
        fastest = fmax(fastest, (x1[2] - x0[2]) * 60);
        pushed += sfem_contact_get_info(s.contact).pushed > 0;
    }
    assert_true(pushed > 0);
    assert_true(lowest(&s, 0) > -1e-3);
    assert_true(fastest < 1); /* push_speed is 0.5: elastic recovery adds to it */
    drop(&s);
}

/* Pins, handles, damage, linear laws. */
static void held_and_linear_bodies_touch_too(void **unused)
{
    static const sfem_law laws[] = {SFEM_LINEAR, SFEM_COROTATIONAL, SFEM_NEOHOOKEAN, SFEM_STVK};
    const sfem_int cells[3] = {8, 2, 2};
    const sfem_real size[3] = {0.8, 0.2, 0.2};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(laws); ++i) {
        sfem_body_def def = falling();
        sfem_int pins[9], tip = 0, handle, j;
        sfem_real at[3];
        sfem_error err;
        sfem_mesh mesh;
        scene s;
        int k;
        assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
        for (j = 0; j < mesh.nodes; ++j) {
            if (mesh.x[3 * j] < 1e-9) pins[def.pin_count++] = j;
            if (mesh.x[3 * j] > 0.8 - 1e-9 && mesh.x[3 * j + 2] > 0.2 - 1e-9) tip = j;
        }
        def.pins = pins;
        def.stiffness_damping = 0.01;
        s = scene_of(mesh, laws[i], 2e5, 0.3);
        add_body(&s, &def, 0.5);
        s.floor = add_plane(&s, 0, 1, -0.05, 0.5, 0); /* the cantilever comes down on it */
        for (k = 0; k < 120; ++k) step(&s, 1.0 / 60);
        assert_true(lowest(&s, 0) > -0.0501 && lowest(&s, 0) < -0.0499);
        assert_true(sfem_contact_get_info(s.contact).contacts > 0);
        assert_ok(sfem_body_grab_node(s.body[0], tip, &handle, &err), err); /* lifted off, and pressed down again */
        sfem_body_handle_position(s.body[0], handle, at);
        for (k = 0; k < 120; ++k) {
            at[2] += k < 60 ? 0.002 : -0.0025;
            assert_ok(sfem_body_move_handle(s.body[0], handle, at, &err), err);
            step(&s, 1.0 / 60);
            if (k == 59) assert_int_equal(sfem_contact_get_info(s.contact).contacts, 0);
            assert_true(lowest(&s, 0) > -0.052);
        }
        assert_true(sfem_contact_get_info(s.contact).contacts > 0);
        drop(&s);
    }
}

/* A ball moves into the side of a pinned block next to the pinned edge: no lever of a nearly held point throws it about. */
static void a_tool_at_a_pinned_edge_throws_nothing_about(void **unused)
{
    static const double away[] = {0.01, 1e-3, 1e-6};
    const sfem_int cells[3] = {2, 2, 2}, pins[] = {0, 1, 2, 3, 4, 5, 6, 7, 8}; /* x = 0 */
    const sfem_real size[3] = {0.2, 0.2, 0.2}, velocity[3] = {0, 0.5, 0};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(away); ++i) {
        sfem_obstacle_def ball = sfem_default_obstacle_def();
        sfem_body_def def = sfem_default_body_def();
        sfem_error err;
        sfem_mesh mesh;
        sfem_int id, j;
        scene s;
        int k;
        assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
        def.pins = pins;
        def.pin_count = TEST_COUNT(pins);
        s = scene_of(mesh, SFEM_COROTATIONAL, 1e5, 0.3);
        add_body(&s, &def, 0.5);
        ball.kind = SFEM_OBSTACLE_SPHERE;
        ball.size[0] = 0.005;
        ball.position[0] = away[i];
        ball.position[1] = -0.01;
        ball.position[2] = 0.05;
        assert_ok(sfem_contact_add_obstacle(s.contact, &ball, &id, &err), err);
        assert_ok(sfem_contact_move_obstacle(s.contact, id, ball.position, NULL, velocity, NULL, &err), err);
        for (k = 0; k < 8; ++k) {
            step(&s, 1.0 / 60);
            for (j = 0; j < 3 * s.mesh.nodes; ++j) assert_true(fabs(sfem_body_displacement(s.body[0])[j]) < 0.5);
        }
        drop(&s);
    }
}

/* Tets that do not lock: a nearly incompressible cube lands, makes no energy, does not sink, and rests with its weight. */
static void smooth_tets_touch_too(void **unused)
{
    const double h = 1.0 / 60;
    sfem_model_def model_def = sfem_default_model_def();
    sfem_body_def def = falling();
    sfem_real force[3], torque[3];
    double start = 0, x0[3], x1[3];
    sfem_mesh mesh = block(4, 0.3);
    sfem_error err;
    scene s;
    int k;
    (void)unused;
    shift(&mesh, 0, 0, 0.3);
    s = scene_of(mesh, SFEM_COROTATIONAL, 1e5, 0.49);
    sfem_model_free(s.model);
    model_def.mesh = &s.mesh;
    model_def.material.young = 1e5;
    model_def.material.poisson = 0.49;
    model_def.material.tet = SFEM_TET_SMOOTH;
    assert_ok(sfem_model_create(&model_def, &s.model, &err), err);
    def.stiffness_damping = 0.01;
    def.mass_damping = 1;
    add_body(&s, &def, 0.5);
    s.floor = add_plane(&s, 0, 1, 0, 0.5, 0);
    for (k = 0; k < 180; ++k) {
        double energy;
        centre(&s, 0, x0);
        step(&s, h);
        centre(&s, 0, x1);
        energy = middle_energy(&s, 0, x0, x1, h);
        if (k == 0) start = energy;
        assert_true(energy <= start * (1 + 1e-9));
        assert_true(lowest(&s, 0) > -2e-3);
    }
    sfem_contact_obstacle_force(s.contact, s.floor, force, torque);
    assert_near(force[2], -s.mass * GRAVITY, 1e-2, 0);
    drop(&s);
}

/* --------------------------------------------------------------------------------------------
 * unstructured meshes
 * -------------------------------------------------------------------------------------------- */

/* A body with limbs and slivers is dropped, thrown at 50 m/s, and rests. */
static void a_body_with_slivers_is_dropped_and_thrown(void **unused)
{
    static const double young[] = {1e5, 3e6, 1e5, 1e8}, speed[] = {0, 0, 50, 50};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(young); ++i) {
        sfem_body_def def = falling();
        const int steps = speed[i] > 0 ? 20 : 75;
        double start = 0, x0[3], x1[3], deepest = 0, bottom = 0;
        sfem_mesh mesh;
        sfem_error err;
        sfem_int j;
        scene s;
        int k;
        assert_ok(body_scattered(800, 0.01, 3, &mesh, &err), err);
        for (j = 0; j < mesh.nodes; ++j) bottom = fmin(bottom, mesh.x[3 * j + 2]);
        shift(&mesh, 0, 0, 0.3 - bottom);
        def.stiffness_damping = 0.002;
        s = on_floor(mesh, young[i], &def);
        throw_body(&s, 0, speed[i] / 2, 0, -speed[i]);
        for (k = 0; k < steps; ++k) {
            double energy;
            centre(&s, 0, x0);
            step(&s, 1.0 / 60);
            centre(&s, 0, x1);
            energy = middle_energy(&s, 0, x0, x1, 1.0 / 60);
            if (k == 0) start = energy;
            assert_true(energy <= start * (1 + 1e-9)); /* NaN fails, too */
            deepest = fmax(deepest, sfem_contact_get_info(s.contact).penetration);
        }
        assert_true(deepest < (speed[i] == 0 ? 2e-3 : 0.1));
        drop(&s);
    }
}

/* A body that falls more than its own length in a step, and turns over in it, makes no energy, comes down and stays. */
static void tiny_bodies_make_no_energy(void **unused)
{
    static const double size[] = {0.01, 0.001};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(size); ++i) {
        sfem_body_def def = falling();
        double start, bottom = 1e300;
        sfem_mesh mesh;
        sfem_error err;
        sfem_int j;
        scene s;
        int k;
        assert_ok(body_scattered(150, 0.01, 3, &mesh, &err), err);
        for (j = 0; j < 3 * mesh.nodes; ++j) mesh.x[j] *= size[i] * (j % 3 == 0 ? 1 : 0.4);
        rotate(&mesh, -0.3);
        for (j = 0; j < mesh.nodes; ++j) bottom = fmin(bottom, mesh.x[3 * j + 2]);
        shift(&mesh, 0, 0, 0.3 * size[i] - bottom);
        s = on_floor(mesh, 1e6, &def);
        start = sfem_body_energy(s.body[0]).total;
        for (k = 0; k < 12; ++k) {
            step(&s, 1.0 / 60);
            assert_true(sfem_body_energy(s.body[0]).total - start <=
                        sfem_contact_get_info(s.contact).moved + 1e-9 * s.mass * GRAVITY * size[i]);
        }
        assert_near(lowest(&s, 0), 0, 0, 0.02 * size[i]);
        drop(&s);
    }
}

/* Columns are bounded by their budget, made early by theirs, and the same whenever they are made: three runs with the
 * same bits. */
static void columns_keep_their_budgets_and_change_nothing(void **unused)
{
    uint64_t hash[3];
    int run;
    (void)unused;
    for (run = 0; run < 3; ++run) {
        sfem_contact_def few = sfem_default_contact_def();
        sfem_body_def def = falling();
        sfem_mesh mesh = block(4, 0.3);
        sfem_int most = 0, before = 0;
        scene s;
        int k;
        if (run > 0) few.column_flops = 0;
        if (run == 2) few.cache_bytes = 5 * 12 * 375; /* five of columns of all unknowns, more of others */
        shift(&mesh, 0, 0, 0.2);
        s = scene_with(mesh, SFEM_COROTATIONAL, 1e6, 0.3, &few);
        add_body(&s, &def, 0.5);
        add_plane(&s, 0, 1, 0, 0.5, 0);
        for (k = 0; k < 40; ++k) {
            step(&s, 1.0 / 60);
            if (sfem_contact_get_info(s.contact).contacts == 0 && most == 0)
                before = sfem_contact_get_info(s.contact).columns;
            else if (sfem_contact_get_info(s.contact).columns > most) most = sfem_contact_get_info(s.contact).columns;
        }
        hash[run] = hash_reals(sfem_body_displacement(s.body[0]), 3 * (size_t)s.mesh.nodes);
        assert_true(sfem_contact_get_info(s.contact).contacts > 0);
        if (run == 0) assert_true(before >= 25); /* all of the face that lands */
        else assert_int_equal(before, 0);
        if (run == 2) assert_true(most >= 5 && most < 25);
        else assert_true(most >= 25);
        drop(&s);
    }
    assert_true(hash[0] == hash[1] && hash[1] == hash[2]);
}

/* Columns take one sweep, and that only up the elimination tree: eight nodes in a step by a budget of 20 multiply-adds for a
 * number in L, where three solves for each, by 8 right sides, take 96. And less memory than 36 bytes for each pair of
 * nodes. */
static void columns_take_a_part_of_one_sweep(void **unused)
{
    sfem_contact_def def = sfem_default_contact_def();
    sfem_body_def falls = falling();
    sfem_mesh mesh = block(8, 0.5);
    sfem_contact_info info;
    size_t before;
    scene s;
    int k;
    (void)unused;
    shift(&mesh, 0, 0, 0.2);
    s = scene_with(mesh, SFEM_COROTATIONAL, 1e6, 0.3, &def);
    add_body(&s, &falls, 0.5);
    step(&s, 1.0 / 60); /* prepares */
    def.column_flops = 20.0 / sizeof(double) * (double)sfem_body_get_info(s.body[0]).factor_bytes;
    drop(&s);
    mesh = block(8, 0.5);
    shift(&mesh, 0, 0, 0.2);
    s = scene_with(mesh, SFEM_COROTATIONAL, 1e6, 0.3, &def);
    add_body(&s, &falls, 0.5);
    add_plane(&s, 0, 1, 0, 0.5, 0);
    before = sfem_contact_get_info(s.contact).bytes;
    for (k = 0, info = sfem_contact_get_info(s.contact); k < 20 && info.columns == 0; ++k) {
        step(&s, 1.0 / 60);
        info = sfem_contact_get_info(s.contact);
    }
    assert_int_equal(info.columns, 8);
    assert_int_equal(info.contacts, 0);
    step(&s, 1.0 / 60);
    assert_int_equal(sfem_contact_get_info(s.contact).columns, 16);
    assert_true(sfem_contact_get_info(s.contact).bytes > info.bytes && info.bytes > before);
    assert_true(sfem_contact_get_info(s.contact).bytes - info.bytes < 8 * (size_t)36 * 386); /* nodes of the surface */
    drop(&s);
}

/* --------------------------------------------------------------------------------------------
 * saved states
 * -------------------------------------------------------------------------------------------- */

/* A ball between a floor and a plate that comes down on it and slides. */
static scene pressed(sfem_int *plate)
{
    const sfem_real velocity[3] = {0.2, 0, -0.1};
    sfem_body_def def = falling();
    sfem_obstacle_def box = sfem_default_obstacle_def();
    sfem_mesh mesh = ball(0.1, 3);
    sfem_error err;
    scene s;
    shift(&mesh, 0, 0, 0.11);
    def.stiffness_damping = 0.005;
    s = on_floor(mesh, 2e5, &def);
    box.kind = SFEM_OBSTACLE_BOX;
    box.size[0] = box.size[1] = 0.2;
    box.size[2] = 0.01;
    box.position[2] = 0.24;
    assert_ok(sfem_contact_add_obstacle(s.contact, &box, plate, &err), err);
    assert_ok(sfem_contact_move_obstacle(s.contact, *plate, box.position, NULL, velocity, NULL, &err), err);
    return s;
}

/* Of displacements and what the contacts report. */
static uint64_t hash_of(const scene *s)
{
    uint64_t hash = hash_reals(sfem_body_displacement(s->body[0]), 3 * (size_t)s->mesh.nodes);
    const sfem_contact_info info = sfem_contact_get_info(s->contact);
    const sfem_contact_point *point;
    sfem_int points, i;
    point = sfem_contact_points(s->contact, &points);
    for (i = 0; i < points; ++i) hash = 31 * hash + hash_reals(point[i].force, 3) + 7 * hash_reals(point[i].position, 3);
    return 31 * (31 * hash + hash_reals(&info.work, 1)) + hash_reals(&info.moved, 1);
}

/* Bodies and contacts go on from a saved state with the same bits, in the scene that saved it and in another one. */
static void saved_states_go_on_with_the_same_bits(void **unused)
{
    size_t size[2], at;
    char *memory[2];
    uint64_t hash, loaded;
    sfem_error err;
    sfem_int plate;
    scene s = pressed(&plate), other = pressed(&plate);
    int k;
    (void)unused;
    for (k = 0; k < 40; ++k) step(&s, 1.0 / 60);
    assert_true(sfem_contact_get_info(s.contact).contacts > 2);
    size[0] = sfem_body_state_size(s.body[0]);
    size[1] = sfem_contact_state_size(s.contact);
    memory[0] = (char *)malloc(size[0]);
    memory[1] = (char *)malloc(size[1]);
    sfem_body_save_state(s.body[0], memory[0]);
    sfem_contact_save_state(s.contact, memory[1]);
    hash = hash_of(&s);
    assert_ok(sfem_contact_load_state(s.contact, memory[1], size[1], &err), err);
    assert_true(hash_of(&s) == hash);
    for (k = 0; k < 20; ++k) step(&s, 1.0 / 60);
    hash = hash_of(&s);
    for (k = 0; k < 2; ++k) {
        scene *to = k ? &other : &s;
        int i;
        assert_ok(sfem_body_load_state(to->body[0], memory[0], size[0], &err), err);
        assert_ok(sfem_contact_load_state(to->contact, memory[1], size[1], &err), err);
        for (i = 0; i < 20; ++i) step(to, 1.0 / 60);
        loaded = hash_of(to);
        assert_true(loaded == hash);
    }
    /* what is damaged, cut short or of another scene is refused, and changes nothing */
    for (at = 0; at < size[1]; at += 13) {
        memory[1][at] = (char)(memory[1][at] ^ 4);
        assert_status(sfem_contact_load_state(s.contact, memory[1], size[1], &err), SFEM_FORMAT);
        memory[1][at] = (char)(memory[1][at] ^ 4);
    }
    assert_status(sfem_contact_load_state(s.contact, memory[1], size[1] - 8, &err), SFEM_FORMAT);
    sfem_contact_remove_obstacle(other.contact, plate);
    assert_status(sfem_contact_load_state(other.contact, memory[1], size[1], &err), SFEM_MISMATCH);
    assert_true(hash_of(&s) == hash);
    free(memory[0]);
    free(memory[1]);
    drop(&s);
    drop(&other);
}

/* --------------------------------------------------------------------------------------------
 * contact of the caller's own: Gauss-Seidel of the test, against a floor at z = 0
 * -------------------------------------------------------------------------------------------- */

enum { OWN = 64 };

typedef struct own {
    sfem_body *body;
    const sfem_mesh *mesh;
    sfem_int nodes, node[OWN];
    double friction, h, *g; /* [nodes][nodes][9]: C of the rest pose */
    double l[OWN][3];       /* N s */
} own;

static own own_contact(const scene *s, double friction, double h)
{
    own o;
    sfem_real *column = (sfem_real *)malloc(9 * (size_t)s->mesh.nodes * sizeof *column);
    sfem_error err;
    sfem_int i, j;
    memset(&o, 0, sizeof o);
    o.body = s->body[0];
    o.mesh = &s->mesh;
    o.friction = friction;
    o.h = h;
    assert_ok(sfem_body_prepare(o.body, h, &err), err);
    for (i = 0; i < s->mesh.nodes; ++i)
        if (s->mesh.x[3 * i + 2] < lowest(s, 0) + 1e-9) o.node[o.nodes++] = i;
    assert_true(o.nodes > 0 && o.nodes <= OWN);
    o.g = (double *)malloc(9 * (size_t)(o.nodes * o.nodes) * sizeof *o.g);
    for (j = 0; j < o.nodes; ++j) {
        assert_ok(sfem_body_compliance(o.body, o.node[j], column, &err), err);
        for (i = 0; i < o.nodes; ++i) memcpy(o.g + 9 * (i * o.nodes + j), column + 9 * o.node[i], 9 * sizeof *o.g);
    }
    free(column);
    return o;
}

/* W = Q_i C Q_j^T. */
static void own_block(const own *o, int i, int j, double w[9])
{
    sfem_real qi[9], qj[9];
    const double *c = o->g + 9 * (i * o->nodes + j);
    int a, b, k, m;
    sfem_body_frame(o->body, o->node[i], qi);
    sfem_body_frame(o->body, o->node[j], qj);
    for (a = 0; a < 3; ++a)
        for (b = 0; b < 3; ++b)
            for (w[3 * a + b] = 0, k = 0; k < 3; ++k)
                for (m = 0; m < 3; ++m) w[3 * a + b] += qi[3 * a + k] * c[3 * k + m] * qj[3 * b + m];
}

/* One round: cones at the present w', changes applied. Returns the largest one. */
static double own_round(own *o)
{
    const sfem_real *u = sfem_body_displacement(o->body);
    static double w[OWN * OWN][9];
    double v[OWN][3], old[OWN][3], most = 0;
    sfem_error err;
    int i, j, a, b, sweep;
    memcpy(old, o->l, sizeof old);
    for (i = 0; i < o->nodes; ++i) {
        sfem_body_free_velocity(o->body, o->node[i], v[i]);
        for (j = 0; j < o->nodes; ++j) own_block(o, i, j, w[i * o->nodes + j]);
    }
    for (sweep = 0; sweep < 300; ++sweep)
        for (i = 0; i < o->nodes; ++i) {
            const double *d = w[i * o->nodes + i], z = o->mesh->x[3 * o->node[i] + 2] + u[3 * o->node[i] + 2];
            double l[3], size;
            if (!(d[8] > 0)) continue; /* pinned */
            l[2] = fmax(0, o->l[i][2] - (v[i][2] + z / o->h) / d[8]);
            for (a = 0; a < 2; ++a) l[a] = o->l[i][a] - (v[i][a] + d[3 * a + 2] * (l[2] - o->l[i][2])) / (d[0] + d[4]);
            size = sqrt(l[0] * l[0] + l[1] * l[1]);
            for (a = 0; a < 2; ++a)
                if (size > o->friction * l[2]) l[a] *= o->friction * l[2] / size;
            for (j = 0; j < o->nodes; ++j)
                for (a = 0; a < 3; ++a)
                    for (b = 0; b < 3; ++b) v[j][a] += w[j * o->nodes + i][3 * a + b] * (l[b] - o->l[i][b]);
            memcpy(o->l[i], l, sizeof l);
        }
    for (i = 0; i < o->nodes; ++i) {
        const sfem_real change[3] = {o->l[i][0] - old[i][0], o->l[i][1] - old[i][1], o->l[i][2] - old[i][2]};
        assert_ok(sfem_body_add_impulse(o->body, o->node[i], change, &err), err);
        for (a = 0; a < 3; ++a) most = fmax(most, fabs(change[a]));
    }
    assert_ok(sfem_body_apply_impulses(o->body, &err), err);
    return most;
}

static void own_step(own *o, double tolerance)
{
    sfem_error err;
    int k;
    assert_ok(sfem_body_predict(o->body, o->h, &err), err);
    assert_ok(sfem_body_solve(o->body, &err), err);
    memset(o->l, 0, sizeof o->l);
    for (k = 0; k < 12 && own_round(o) > tolerance; ++k) {}
    assert_ok(sfem_body_finish(o->body, &err), err);
}

/* A held beam of the linear law, for which C is exact, and a free cube that falls, slides and stops: the caller's cones
 * lead to where the built-in ones do. */
static void own_contact_equals_the_one_that_is_built_in(void **unused)
{
    const double h = 1.0 / 60;
    int rotates;
    (void)unused;
    for (rotates = 0; rotates < 2; ++rotates) {
        const sfem_int cells[3] = {6, 2, 2};
        const sfem_real size[3] = {0.6, 0.2, 0.2};
        sfem_contact_def exact = sfem_default_contact_def();
        sfem_body_def def = falling();
        sfem_int pins[9], i;
        double travelled = 0;
        sfem_error err;
        sfem_mesh mesh;
        scene s, t;
        own o;
        int k;
        exact.tolerance = 1e-10;
        exact.sweeps = 300;
        def.stiffness_damping = 0.005;
        for (k = 0; k < 2; ++k) {
            if (rotates) mesh = block(3, 0.3);
            else assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
            shift(&mesh, 0, 0, 0.02);
            for (i = 0, def.pin_count = 0; !rotates && i < mesh.nodes; ++i)
                if (mesh.x[3 * i] < 1e-9) pins[def.pin_count++] = i;
            def.pins = pins;
            *(k ? &t : &s) = scene_with(mesh, rotates ? SFEM_COROTATIONAL : SFEM_LINEAR, rotates ? 1e6 : 1e5, 0.3, &exact);
            add_body(k ? &t : &s, &def, 0.5);
            if (rotates) throw_body(k ? &t : &s, 0, 1, 0, 0);
        }
        add_plane(&s, 0, 1, 0, 0.5, 0);
        o = own_contact(&t, 0.5, h);
        for (k = 0; k < 40; ++k) {
            const sfem_contact_point *point;
            sfem_int points;
            double built = 0, mine = 0;
            step(&s, h);
            own_step(&o, 1e-9);
            point = sfem_contact_points(s.contact, &points);
            for (i = 0; i < points; ++i) built += point[i].impulse[2];
            for (i = 0; i < o.nodes; ++i) mine += o.l[i][2];
            assert_near(mine, built, rotates ? 1e-3 : 1e-6, rotates ? 1e-3 : 1e-6);
        }
        for (i = 0; i < s.mesh.nodes; ++i)
            travelled = fmax(travelled, fabs(sfem_body_displacement(t.body[0])[3 * i + (rotates ? 0 : 2)]));
        assert_true(travelled > 0.01);
        assert_true(largest_difference(sfem_body_displacement(s.body[0]), sfem_body_displacement(t.body[0]), s.mesh.nodes) <
                    (rotates ? 2e-4 : 1e-9) * travelled);
        free(o.g);
        drop(&s);
        drop(&t);
    }
}

/* Impulses of the caller are in the energy budget, and stay in steps that are rejected (those of one solve are): a cube
 * thrown at the floor gains no energy, and its momentum changes by what it was given. */
static void own_impulses_are_in_the_budget_and_in_rejected_steps(void **unused)
{
    static const double accuracy[] = {1e-6, 1};
    const double h = 1.0 / 60, speed = 20;
    size_t j;
    (void)unused;
    for (j = 0; j < TEST_COUNT(accuracy); ++j) {
        sfem_body_def def = sfem_default_body_def();
        sfem_mesh mesh = block(3, 0.3);
        double momentum, x0[3], x1[3], start;
        scene s;
        own o;
        int i, k;
        def.accuracy = accuracy[j];
        shift(&mesh, 0, 0, 0.2);
        s = scene_of(mesh, SFEM_COROTATIONAL, 1e5, 0.3);
        add_body(&s, &def, 0.5);
        throw_body(&s, 0, 0, 0, -speed);
        o = own_contact(&s, 0, h);
        momentum = -s.mass * speed;
        start = s.mass * speed * speed / 2;
        for (k = 0; k < 10; ++k) {
            double v;
            centre(&s, 0, x0);
            own_step(&o, 1e-6);
            centre(&s, 0, x1);
            v = (x1[2] - x0[2]) / h;
            for (i = 0; i < o.nodes; ++i) momentum += o.l[i][2];
            assert_near(s.mass * v, momentum, 1e-9, 1e-9 * s.mass * speed);
            assert_true(sfem_body_energy(s.body[0]).conserved + s.mass * v * v / 2 <= start * (1 + 1e-9));
        }
        assert_true(momentum > 0);
        assert_true((sfem_body_get_info(s.body[0]).rejected > 0) == (accuracy[j] == 1));
        free(o.g);
        drop(&s);
    }
}

static void own_contact_is_refused_where_it_cannot_be(void **unused)
{
    sfem_body_def def = falling();
    scene s = scene_of(block(1, 0.1), SFEM_COROTATIONAL, 1e6, 0.3);
    sfem_real column[9 * 8];
    sfem_error err;
    (void)unused;
    add_body(&s, &def, 0.5);
    assert_status(sfem_body_compliance(s.body[0], 0, column, &err), SFEM_NOT_PREPARED);
    assert_names(err, "prepare");
    assert_status(sfem_body_apply_impulses(s.body[0], &err), SFEM_BAD_ARGUMENT);
    assert_ok(sfem_body_prepare(s.body[0], 0.01, &err), err);
    assert_status(sfem_body_compliance(s.body[0], 8, column, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "no node 8");
    drop(&s);
    s = scene_of(block(1, 0.1), SFEM_COROTATIONAL, 1e6, 0.3);
    def.integrator = SFEM_HHT;
    assert_ok(sfem_body_create(s.model, &def, &s.body[0], &err), err);
    s.bodies = 1;
    assert_status(sfem_body_compliance(s.body[0], 0, column, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "SFEM_PQR");
    drop(&s);
}

/* --------------------------------------------------------------------------------------------
 * bodies that break
 * -------------------------------------------------------------------------------------------- */

/* A bar that a blade has cut falls on the ridge of a box: its pieces come to rest on the floor, on both sides. */
static void pieces_touch_obstacles(void **unused)
{
    const sfem_int cells[3] = {8, 2, 2};
    const sfem_real size[3] = {0.8, 0.2, 0.2};
    const sfem_real from[9] = {0.44, -1, 1, 0.44, 2, 1, 0.44, 0.1, -3}, to[9] = {0.46, -1, 1, 0.46, 2, 1, 0.46, 0.1, -3};
    sfem_damage_def damage = sfem_default_damage_def();
    sfem_body_def def = falling();
    sfem_obstacle_def ridge = sfem_default_obstacle_def();
    double deepest = 0, x0[3], x1[3], start = 0, low[2] = {1e300, 1e300};
    const sfem_int *piece;
    sfem_mesh mesh;
    sfem_error err;
    sfem_int i, marked;
    scene s;
    int k;
    (void)unused;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
    shift(&mesh, 0, 0, 0.2);
    damage.toughness = 1e9; /* the blade alone breaks it */
    def.damage = &damage;
    def.stiffness_damping = 0.01;
    def.mass_damping = 1;
    s = on_floor(mesh, 3e5, &def);
    ridge.kind = SFEM_OBSTACLE_BOX;
    ridge.size[0] = 0.02;
    ridge.size[1] = 0.3;
    ridge.size[2] = 0.05;
    ridge.position[0] = 0.45;
    ridge.position[1] = 0.1;
    ridge.position[2] = 0.05;
    assert_ok(sfem_contact_add_obstacle(s.contact, &ridge, NULL, &err), err);
    assert_ok(sfem_body_cut(s.body[0], from, to, &marked, &err), err);
    assert_true(marked > 0);
    for (k = 0; k < 150; ++k) {
        double energy;
        centre(&s, 0, x0);
        step(&s, 1.0 / 60);
        centre(&s, 0, x1);
        energy = sfem_body_energy(s.body[0]).total;
        if (k == 0) start = energy;
        assert_true(energy <= start + 0.02 * s.mass * GRAVITY);
        deepest = fmax(deepest, sfem_contact_get_info(s.contact).penetration);
    }
    assert_int_equal(sfem_body_fracture(s.body[0]).pieces, 2);
    assert_true(deepest < 2e-3);
    piece = sfem_body_piece_of(s.body[0]);
    for (i = 0; i < s.mesh.nodes; ++i) {
        const double z = s.mesh.x[3 * i + 2] + sfem_body_displacement(s.body[0])[3 * i + 2];
        const int which = piece[i] != piece[0];
        low[which] = fmin(low[which], z);
    }
    for (k = 0; k < 2; ++k) assert_near(low[k], 0, 0, 2e-3);
    drop(&s);
}

/* --------------------------------------------------------------------------------------------
 * hostile input
 * -------------------------------------------------------------------------------------------- */

/* A bar breaks into single nodes, which fall into the corner of a floor and a box: what is left of faces, whose nodes are
 * of several pieces, holds them nowhere. */
static void debris_in_a_corner_makes_no_energy(void **unused)
{
    const sfem_int cells[3] = {6, 2, 2};
    const sfem_real size[3] = {0.6, 0.2, 0.2};
    sfem_damage_def damage = sfem_default_damage_def();
    sfem_body_def def = falling();
    sfem_obstacle_def box = sfem_default_obstacle_def();
    double start = 0;
    sfem_mesh mesh;
    sfem_error err;
    scene s;
    int k;
    (void)unused;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
    rotate(&mesh, -0.4);
    shift(&mesh, 0, 0, 0.3);
    damage.toughness = 10;
    def.damage = &damage;
    def.stiffness_damping = 1e-4;
    s = on_floor(mesh, 1e6, &def);
    box.kind = SFEM_OBSTACLE_BOX;
    box.size[0] = 0.02;
    box.size[1] = 1;
    box.size[2] = 0.1;
    box.position[0] = 0.1;
    box.position[2] = 0.05;
    assert_ok(sfem_contact_add_obstacle(s.contact, &box, NULL, &err), err);
    throw_body(&s, 0, 0, 0, -10);
    start = sfem_body_energy(s.body[0]).total;
    for (k = 0; k < 150; ++k) {
        step(&s, 1.0 / 240);
        assert_true(sfem_body_energy(s.body[0]).total <= start * (1 + 1e-9) + sfem_contact_get_info(s.contact).moved);
        assert_true(sfem_contact_get_info(s.contact).penetration < 2e-3);
    }
    assert_true(sfem_body_fracture(s.body[0]).pieces > 20);
    drop(&s);
}

static void bad_definitions_are_refused(void **unused)
{
    sfem_contact_def def = sfem_default_contact_def();
    sfem_obstacle_def o = sfem_default_obstacle_def();
    sfem_body_def other = sfem_default_body_def();
    sfem_contact_surface surface = sfem_default_contact_surface();
    const sfem_real at[3] = {0, 0, NAN}, zero[3] = {0, 0, 0};
    sfem_workspace *workspace;
    sfem_contact *contact = NULL;
    sfem_body *body;
    sfem_error err;
    sfem_int id;
    scene s;
    (void)unused;
    def.sweeps = 0;
    assert_status(sfem_contact_create(&def, &contact, &err), SFEM_BAD_ARGUMENT);
    def = sfem_default_contact_def();
    def.push_share = 2;
    assert_status(sfem_contact_create(&def, &contact, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "push_share");
    def = sfem_default_contact_def();
    def.tolerance = NAN;
    assert_status(sfem_contact_create(&def, &contact, &err), SFEM_BAD_ARGUMENT);

    s = scene_of(block(1, 1), SFEM_COROTATIONAL, 1e5, 0.3);
    {
        sfem_surface surface_in = surface_of_a_ball();
        sfem_int i;
        for (i = 0; i < surface_in.triangles; ++i) {
            const sfem_int corner = surface_in.tri[3 * i];
            surface_in.tri[3 * i] = surface_in.tri[3 * i + 1];
            surface_in.tri[3 * i + 1] = corner;
        }
        o = shape_of(SFEM_OBSTACLE_SURFACE, &surface_in);
        assert_status(sfem_contact_add_obstacle(s.contact, &o, &id, &err), SFEM_BAD_MESH);
        assert_names(err, "inside out");
        free_surface(&surface_in);
        o = sfem_default_obstacle_def();
    }
    o.contact.friction = -0.1;
    assert_status(sfem_contact_add_obstacle(s.contact, &o, &id, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "friction");
    o = sfem_default_obstacle_def();
    o.contact.restitution = 1.5;
    assert_status(sfem_contact_add_obstacle(s.contact, &o, &id, &err), SFEM_BAD_ARGUMENT);
    o = sfem_default_obstacle_def();
    o.position[1] = NAN;
    assert_status(sfem_contact_add_obstacle(s.contact, &o, &id, &err), SFEM_NOT_FINITE);
    o = sfem_default_obstacle_def();
    o.rotation[0] = 2;
    assert_status(sfem_contact_add_obstacle(s.contact, &o, &id, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "rotation");
    o = sfem_default_obstacle_def();
    o.kind = SFEM_OBSTACLE_SPHERE;
    assert_status(sfem_contact_add_obstacle(s.contact, &o, &id, &err), SFEM_BAD_ARGUMENT); /* size 0 */
    o.kind = (sfem_obstacle_kind)77;
    assert_status(sfem_contact_add_obstacle(s.contact, &o, &id, &err), SFEM_BAD_ARGUMENT);
    o.kind = SFEM_OBSTACLE_DISTANCE;
    assert_status(sfem_contact_add_obstacle(s.contact, &o, &id, &err), SFEM_BAD_ARGUMENT);

    s.floor = add_plane(&s, 0, 1, 0, 0.5, 0);
    assert_status(sfem_contact_move_obstacle(s.contact, s.floor, at, NULL, NULL, NULL, &err), SFEM_NOT_FINITE);
    assert_status(sfem_contact_move_obstacle(s.contact, s.floor, zero, NULL, at, NULL, &err), SFEM_NOT_FINITE);
    assert_status(sfem_contact_move_obstacle(s.contact, 9, zero, NULL, NULL, NULL, &err), SFEM_BAD_ARGUMENT);

    surface.friction = NAN;
    add_body(&s, &other, 0.5);
    assert_ok(sfem_body_create(s.model, &other, &body, &err), err);
    assert_status(sfem_contact_add_body(s.contact, body, &surface, ~0u, &id, &err), SFEM_BAD_ARGUMENT);
    assert_status(sfem_contact_add_body(s.contact, s.body[0], NULL, ~0u, &id, &err), SFEM_BAD_ARGUMENT); /* twice */
    sfem_body_free(body);
    other.integrator = SFEM_HHT;
    assert_ok(sfem_body_create(s.model, &other, &body, &err), err);
    assert_status(sfem_contact_add_body(s.contact, body, NULL, ~0u, &id, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "SFEM_PQR");
    sfem_body_free(body);
    other = sfem_default_body_def();
    assert_ok(sfem_workspace_create(NULL, &workspace, &err), err);
    other.workspace = workspace;
    assert_ok(sfem_body_create(s.model, &other, &body, &err), err);
    assert_status(sfem_contact_add_body(s.contact, body, NULL, ~0u, &id, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "workspace");
    sfem_body_free(body);
    sfem_workspace_free(workspace);
    assert_status(sfem_contact_step(s.contact, 0, &err), SFEM_BAD_ARGUMENT);
    assert_status(sfem_contact_step(s.contact, NAN, &err), SFEM_BAD_ARGUMENT);
    drop(&s);
}

/* More contacts than allowed: the whole scene is as it was, and goes on with the bits of one that never failed. */
static void a_step_that_fails_leaves_all_as_they_were(void **unused)
{
    const sfem_real sideways[3] = {1, 0, 0}, inside[3] = {0.05, 0, 0};
    sfem_contact_def few = sfem_default_contact_def();
    sfem_body_def def = falling();
    uint64_t hash[2];
    int run;
    (void)unused;
    few.max_contacts = 16;
    for (run = 0; run < 2; ++run) {
        sfem_obstacle_def wall = sfem_default_obstacle_def();
        sfem_mesh mesh = block(3, 0.3);
        sfem_error err;
        sfem_int id;
        scene s;
        int k;
        shift(&mesh, 0, 0, 0.01);
        s = scene_with(mesh, SFEM_COROTATIONAL, 1e6, 0.3, &few);
        add_body(&s, &def, 0.5);
        add_body(&s, &def, 0.5);
        place_body(&s, 1, 2, 0, 9);
        s.floor = add_plane(&s, 0, 1, 0, 0.5, 0);
        for (k = 0; k < 20; ++k) step(&s, 1.0 / 60);
        if (run) {
            wall = sfem_obstacle_plane(sideways, inside);
            assert_ok(sfem_contact_add_obstacle(s.contact, &wall, &id, &err), err);
            assert_status(sfem_contact_step(s.contact, 1.0 / 60, &err), SFEM_FULL);
            assert_names(err, "max_contacts");
            sfem_contact_remove_obstacle(s.contact, id);
        }
        for (k = 0; k < 20; ++k) step(&s, 1.0 / 60);
        hash[run] = hash_reals(sfem_body_displacement(s.body[0]), 3 * (size_t)s.mesh.nodes) ^
                    hash_reals(sfem_body_displacement(s.body[1]), 3 * (size_t)s.mesh.nodes);
        drop(&s);
    }
    assert_true(hash[0] == hash[1]);
}

/* An obstacle that leaps into a body pushes it out, no faster than it may; one that is nowhere finite is not touched. */
static double nowhere(void *user, const sfem_real x[3], sfem_real gradient[3])
{
    (void)user;
    (void)x;
    gradient[0] = gradient[1] = gradient[2] = NAN;
    return NAN;
}

static void leaping_and_broken_obstacles_do_no_harm(void **unused)
{
    sfem_body_def def = sfem_default_body_def();
    sfem_obstacle_def o = sfem_default_obstacle_def();
    const sfem_real far[3] = {10, 0, 0}, in[3] = {0.35, 0.15, 0.15};
    double x0[3], x1[3], fastest = 0;
    sfem_error err;
    sfem_int id;
    scene s;
    int k, c;
    (void)unused;
    s = scene_of(block(3, 0.3), SFEM_COROTATIONAL, 1e6, 0.3);
    add_body(&s, &def, 0.5);
    o.kind = SFEM_OBSTACLE_DISTANCE;
    o.distance = nowhere;
    assert_ok(sfem_contact_add_obstacle(s.contact, &o, NULL, &err), err);
    o.kind = SFEM_OBSTACLE_SPHERE;
    o.size[0] = 0.1;
    memcpy(o.position, far, sizeof far);
    assert_ok(sfem_contact_add_obstacle(s.contact, &o, &id, &err), err);
    for (k = 0; k < 60; ++k) {
        if (k == 5) assert_ok(sfem_contact_move_obstacle(s.contact, id, in, NULL, NULL, NULL, &err), err);
        centre(&s, 0, x0);
        step(&s, 1.0 / 60);
        centre(&s, 0, x1);
        for (c = 0; c < 3; ++c) fastest = fmax(fastest, fabs(x1[c] - x0[c]) * 60);
    }
    assert_true(fastest > 0.01 && fastest < 1); /* push_speed is 0.5: elastic recovery adds to it */
    assert_true(x1[0] < 0.15);
    drop(&s);
}

/* A whole life on an allocator that may fail: the first failure is returned, nothing leaks. */
static sfem_status live(sfem_allocator allocator, void *user, sfem_error *err)
{
    sfem_contact_def def = sfem_default_contact_def();
    sfem_body_def body = falling();
    const sfem_real up[3] = {0, 0, 1}, at[3] = {0, 0, 0};
    sfem_obstacle_def plane = sfem_obstacle_plane(up, at);
    sfem_contact *contact = NULL;
    sfem_body *b = NULL;
    sfem_status status;
    scene *s = (scene *)user;
    int k;
    def.allocator = allocator;
    status = sfem_body_create(s->model, &body, &b, err);
    if (status == SFEM_OK) status = sfem_contact_create(&def, &contact, err);
    if (status == SFEM_OK) status = sfem_contact_add_body(contact, b, NULL, ~0u, NULL, err);
    if (status == SFEM_OK) status = sfem_contact_add_obstacle(contact, &plane, NULL, err);
    for (k = 0; status == SFEM_OK && k < 3; ++k) status = sfem_contact_step(contact, 1.0 / 60, err);
    sfem_contact_free(contact);
    sfem_body_free(b);
    return status;
}

static void every_allocation_may_fail(void **unused)
{
    scene s = scene_of(block(2, 0.3), SFEM_COROTATIONAL, 1e6, 0.3);
    (void)unused;
    fail_every_allocation(live, &s);
    drop(&s);
}

/* Results do not depend on threads. */
static void threads_make_the_same_bits(void **unused)
{
    uint64_t hash[2];
    int run;
    (void)unused;
    for (run = 0; run < 2; ++run) {
        sfem_body_def def = falling();
        sfem_mesh mesh = block(8, 0.5);
        scene s;
        int k;
        shift(&mesh, 0, 0, 0.005);
        if (run) def.exec = thread_exec(3);
        s = on_floor(mesh, 1e6, &def);
        for (k = 0; k < 20; ++k) step(&s, 1.0 / 60);
        hash[run] = hash_reals(sfem_body_displacement(s.body[0]), 3 * (size_t)s.mesh.nodes);
        drop(&s);
    }
    assert_true(hash[0] == hash[1]);
}

/* --------------------------------------------------------------------------------------------
 * main
 * -------------------------------------------------------------------------------------------- */

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_block_below_the_friction_angle_does_not_creep),
        cmocka_unit_test(a_block_above_the_friction_angle_accelerates_as_coulomb_has_it),
        cmocka_unit_test(a_block_slides_to_rest_relative_to_a_belt),
        cmocka_unit_test(a_dropped_cube_makes_no_energy_and_does_not_sink),
        cmocka_unit_test(a_ball_keeps_its_energy_where_steps_resolve_the_bounce),
        cmocka_unit_test(forces_of_one_step_act_beside_contacts),
        cmocka_unit_test(restitution_is_what_was_asked_for),
        cmocka_unit_test(fast_balls_do_not_pass_thin_plates),
        cmocka_unit_test(flattened_balls_make_no_energy),
        cmocka_unit_test(soft_and_stiff_bodies_rest_and_fall_asleep),
        cmocka_unit_test(sleeping_bodies_wake_by_obstacles_that_stir),
        cmocka_unit_test(a_hundred_bodies_rest_on_one_floor),
        cmocka_unit_test(a_hundred_balls_in_a_box),
        cmocka_unit_test(a_uniform_pressure_passes_through_the_contact),
        cmocka_unit_test(an_elastic_bar_stays_at_a_wall_for_as_long_as_its_wave_takes),
        cmocka_unit_test(a_ball_on_a_plane_bears_the_force_of_hertz),
        cmocka_unit_test(a_slab_rests_on_obstacles_of_every_kind),
        cmocka_unit_test(small_obstacles_do_not_slip_between_nodes),
        cmocka_unit_test(a_tool_that_slides_off_lets_go),
        cmocka_unit_test(surfaces_are_as_far_as_spheres),
        cmocka_unit_test(moving_plates_carry_a_ball_and_their_work_is_counted),
        cmocka_unit_test(filters_say_who_touches_whom),
        cmocka_unit_test(bodies_of_one_model_may_touch_by_other_regions),
        cmocka_unit_test(what_is_far_is_not_touched),
        cmocka_unit_test(compliance_gives_way_in_proportion),
        cmocka_unit_test(overlaps_are_pushed_out_slowly),
        cmocka_unit_test(held_and_linear_bodies_touch_too),
        cmocka_unit_test(a_tool_at_a_pinned_edge_throws_nothing_about),
        cmocka_unit_test(smooth_tets_touch_too),
        cmocka_unit_test(a_body_with_slivers_is_dropped_and_thrown),
        cmocka_unit_test(tiny_bodies_make_no_energy),
        cmocka_unit_test(columns_keep_their_budgets_and_change_nothing),
        cmocka_unit_test(columns_take_a_part_of_one_sweep),
        cmocka_unit_test(saved_states_go_on_with_the_same_bits),
        cmocka_unit_test(own_contact_equals_the_one_that_is_built_in),
        cmocka_unit_test(own_impulses_are_in_the_budget_and_in_rejected_steps),
        cmocka_unit_test(own_contact_is_refused_where_it_cannot_be),
        cmocka_unit_test(pieces_touch_obstacles),
        cmocka_unit_test(debris_in_a_corner_makes_no_energy),
        cmocka_unit_test(bad_definitions_are_refused),
        cmocka_unit_test(a_step_that_fails_leaves_all_as_they_were),
        cmocka_unit_test(leaping_and_broken_obstacles_do_no_harm),
        cmocka_unit_test(every_allocation_may_fail),
        cmocka_unit_test(threads_make_the_same_bits),
    };
    return run_all_tests(tests);
}
