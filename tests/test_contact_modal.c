/* Modal bodies against obstacles. */
#include "support.h"

#include "bodies.h"
#include "contact_meshes.h"

#define GRAVITY 9.81

/* --------------------------------------------------------------------------------------------
 * scenes: a free or pinned modal body, and obstacles
 * -------------------------------------------------------------------------------------------- */

typedef struct scene {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_modes modes;
    sfem_reduced *reduced;
    sfem_modal *body;
    sfem_contact *contact;
    sfem_int floor;
    double mass;
} scene;

typedef struct options {
    double young, friction, restitution, stiffness_damping;
    sfem_int modes; /* that are not rigid; < 0: all */
    sfem_int pins;  /* the first nodes */
    sfem_modal_def def;
    sfem_allocator allocator; /* of the contact */
    sfem_int max_contacts;
} options;

static options usual(double young)
{
    options o;
    memset(&o, 0, sizeof o);
    o.young = young;
    o.friction = 0.5;
    o.stiffness_damping = 1e-3;
    o.modes = 20;
    o.def = sfem_default_modal_def();
    o.def.gravity[2] = -GRAVITY;
    o.max_contacts = 4096;
    return o;
}

static double bottom(const sfem_mesh *mesh)
{
    double z = 1e300;
    sfem_int i;
    for (i = 0; i < mesh->nodes; ++i) z = fmin(z, mesh->x[3 * i + 2]);
    return z;
}

static void make_model(scene *s, const options *o)
{
    sfem_model_def model_def = sfem_default_model_def();
    sfem_modes_def modes_def = sfem_default_modes_def();
    sfem_reduced_def def = sfem_default_reduced_def();
    sfem_int pins[64], i;
    sfem_error err;
    model_def.mesh = &s->mesh;
    model_def.material.young = o->young;
    model_def.material.poisson = 0.3;
    model_def.material.density = 1000;
    model_def.material.law = SFEM_LINEAR;
    assert_ok(sfem_model_create(&model_def, &s->model, &err), err);
    for (i = 0; i < o->pins; ++i) pins[i] = i;
    modes_def.pins = pins;
    modes_def.pin_count = o->pins;
    modes_def.modes = o->modes < 0 ? 3 * (s->mesh.nodes - o->pins) : o->modes + (o->pins ? 0 : 6);
    modes_def.dense = o->modes < 0;
    def.stiffness_damping = o->stiffness_damping;
    assert_ok(sfem_modes_create(s->model, &modes_def, &s->modes, &err), err);
    assert_ok(sfem_reduced_create(s->model, &s->modes, &def, &s->reduced, &err), err);
    s->mass = sfem_reduced_get_info(s->reduced).mass;
}

/* The mesh is the scene's from here on. No obstacle yet. */
static scene scene_of(sfem_mesh mesh, const options *o)
{
    sfem_contact_def contact_def = sfem_default_contact_def();
    sfem_contact_surface surface = sfem_default_contact_surface();
    sfem_error err;
    scene s;
    memset(&s, 0, sizeof s);
    s.mesh = mesh;
    s.floor = -1;
    make_model(&s, o);
    assert_ok(sfem_modal_create(s.reduced, &o->def, &s.body, &err), err);
    contact_def.allocator = o->allocator;
    contact_def.max_contacts = o->max_contacts;
    surface.friction = o->friction;
    surface.restitution = o->restitution;
    assert_ok(sfem_contact_create(&contact_def, &s.contact, &err), err);
    assert_ok(sfem_contact_add_modal(s.contact, s.body, &surface, 0, NULL, NULL, &err), err);
    return s;
}

static sfem_int add_floor(scene *s, double friction)
{
    sfem_obstacle_def def = sfem_default_obstacle_def();
    sfem_error err;
    def.contact.friction = friction;
    assert_ok(sfem_contact_add_obstacle(s->contact, &def, &s->floor, &err), err);
    return s->floor;
}

static scene on_floor(sfem_mesh mesh, const options *o)
{
    scene s = scene_of(mesh, o);
    add_floor(&s, o->friction);
    return s;
}

static void drop(scene *s)
{
    sfem_contact_free(s->contact);
    sfem_modal_free(s->body);
    sfem_reduced_free(s->reduced);
    sfem_modes_free(&s->modes);
    sfem_model_free(s->model);
    sfem_mesh_free(&s->mesh);
}

static void step(scene *s, double h)
{
    sfem_error err;
    assert_ok(sfem_contact_step(s->contact, h, &err), err);
}

static void throw_body(scene *s, double vx, double vz, double wy)
{
    sfem_rigid rigid = sfem_modal_rigid(s->body);
    sfem_error err;
    rigid.v[0] = vx;
    rigid.v[2] = vz;
    rigid.w[1] = wy;
    assert_ok(sfem_modal_set_rigid(s->body, &rigid, &err), err);
}

/* With gravity's, of a free body. Fitted oscillators have a little more kinetic energy than this. */
static double energy(const scene *s)
{
    const sfem_modal_info info = sfem_modal_get_info(s->body);
    return info.kinetic + info.elastic + s->mass * GRAVITY * sfem_modal_rigid(s->body).x[2];
}

/* --------------------------------------------------------------------------------------------
 * falling, resting, sliding
 * -------------------------------------------------------------------------------------------- */

/* Blocks and balls, soft and stiff, without damping: no energy beyond what pushing out gives, no sinking, and they rest. */
static void a_dropped_body_makes_no_energy_and_comes_to_rest(void **unused)
{
    static const double young[] = {1e5, 1e6, 1e8, 1e5, 1e8};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(young); ++i) {
        options o = usual(young[i]);
        sfem_mesh mesh = i < 3 ? block(3, 0.3) : ball(0.2, 4);
        double start, deepest = 0, before[3] = {0, 0, 0};
        scene s;
        int k;
        o.stiffness_damping = 0;
        shift(&mesh, 0, 0, 0.3 - bottom(&mesh));
        s = on_floor(mesh, &o);
        throw_body(&s, 0.5, 0, i < 3 ? 0.5 : 0);
        start = energy(&s);
        for (k = 0; k < 240; ++k) {
            const sfem_rigid now = sfem_modal_rigid(s.body);
            if (k == 180) memcpy(before, now.x, sizeof before);
            step(&s, 1.0 / 60);
            assert_true(energy(&s) <= start * (1 + 1e-9) + sfem_contact_get_info(s.contact).moved);
            deepest = fmax(deepest, sfem_contact_get_info(s.contact).penetration);
        }
        assert_true(deepest < 1e-4);
        if (i < 3) { /* balls roll */
            const sfem_rigid now = sfem_modal_rigid(s.body);
            for (k = 0; k < 3; ++k) assert_near(now.x[k], before[k], 0, 2e-3);
            assert_true(sfem_modal_get_info(s.body).kinetic < 0.02 * s.mass);
        }
        drop(&s);
    }
}

/* A block on a floor under gravity at an angle, from where it is at rest. */
static scene inclined(double degrees, double friction, double young)
{
    const double angle = degrees * TEST_PI / 180;
    options o = usual(young);
    o.friction = friction;
    o.def.gravity[0] = GRAVITY * sin(angle);
    o.def.gravity[2] = -GRAVITY * cos(angle);
    return on_floor(block(3, 0.3), &o);
}

static void a_block_below_the_friction_angle_does_not_creep(void **unused)
{
    static const double degrees[] = {20, 26, 20, 26}, young[] = {1e6, 1e6, 1e8, 1e8};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(degrees); ++i) {
        scene s = inclined(degrees[i], 0.5, young[i]);
        double x[2][3];
        int k, c;
        for (k = 0; k < 60; ++k) step(&s, 1.0 / 60); /* it is pressed together first */
        memcpy(x[0], sfem_modal_rigid(s.body).x, sizeof x[0]);
        for (k = 0; k < 150; ++k) step(&s, 1.0 / 60);
        memcpy(x[1], sfem_modal_rigid(s.body).x, sizeof x[1]);
        for (c = 0; c < 3; ++c) assert_near(x[0][c], x[1][c], 0, 1e-5);
        drop(&s);
    }
}

/* What a block gains of speed along an incline in a second, and into it, once it hardly rings any more. */
static void slide(double degrees, double friction, double young, double gain[2])
{
    scene s = inclined(degrees, friction, young);
    sfem_rigid from, to;
    int k;
    for (k = 0; k < 120; ++k) step(&s, 1.0 / 60);
    from = sfem_modal_rigid(s.body);
    for (k = 0; k < 60; ++k) step(&s, 1.0 / 60);
    to = sfem_modal_rigid(s.body);
    gain[0] = to.v[0] - from.v[0];
    gain[1] = to.v[2] - from.v[2];
    drop(&s);
}

static void a_block_above_the_friction_angle_accelerates_as_coulomb_has_it(void **unused)
{
    static const double degrees[] = {27.2, 30, 30, 30}, young[] = {1e6, 1e6, 1e8, 1e6}, friction[] = {0.5, 0.5, 0.5, 0};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(degrees); ++i) {
        const double angle = degrees[i] * TEST_PI / 180;
        double gain[2];
        slide(degrees[i], friction[i], young[i], gain);
        assert_near(gain[0] + friction[i] * gain[1], GRAVITY * (sin(angle) - friction[i] * cos(angle)),
                    friction[i] > 0 ? 1e-6 : 1e-12, 0);
    }
}

/* Momenta change by gravity's and the impulses that are reported, about the origin, whatever happens. */
static void impulses_are_what_momenta_change_by(void **unused)
{
    options o = usual(3e5);
    sfem_mesh mesh = ball(0.2, 4);
    scene s;
    int k, c, touched = 0;
    (void)unused;
    shift(&mesh, 0.3, 0, 0.25);
    s = on_floor(mesh, &o);
    throw_body(&s, 2, -1, 10);
    for (k = 0; k < 60; ++k) {
        const double h = k % 2 ? 1.0 / 60 : 1.0 / 90;
        double p[2][3], l[2][3], x[2][3];
        const sfem_contact_point *point;
        sfem_int points, i;
        memcpy(x[0], sfem_modal_rigid(s.body).x, sizeof x[0]);
        sfem_modal_momentum(s.body, p[0], l[0]);
        step(&s, h);
        memcpy(x[1], sfem_modal_rigid(s.body).x, sizeof x[1]);
        sfem_modal_momentum(s.body, p[1], l[1]);
        point = sfem_contact_points(s.contact, &points);
        p[0][2] -= s.mass * GRAVITY * h;
        for (i = 0; i < points; ++i, ++touched)
            for (c = 0; c < 3; ++c) p[0][c] += point[i].impulse[c];
        for (c = 0; c < 3; ++c) assert_near(p[0][c], p[1][c], 0, 1e-9 * s.mass);
        for (i = 0; i < points; ++i) /* a floor gives no torque about z, but for friction */
            assert_true(point[i].impulse[2] >= 0 && hypot(point[i].impulse[0], point[i].impulse[1]) <=
                                                        0.5 * point[i].impulse[2] * (1 + 1e-9) + 1e-12);
    }
    assert_true(touched > 10);
    drop(&s);
}

/* By the heights from where a stiff ball falls and to where it bounces. */
static void restitution_is_what_was_asked_for(void **unused)
{
    static const double wanted[] = {0, 0.5};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(wanted); ++i) {
        options o = usual(1e9);
        sfem_mesh mesh = ball(0.2, 4);
        double height = 0;
        scene s;
        int k, touched = 0;
        o.restitution = wanted[i];
        shift(&mesh, 0, 0, 0.3 - bottom(&mesh));
        s = on_floor(mesh, &o);
        for (k = 0; k < 80; ++k) {
            const int before = touched;
            step(&s, 1.0 / 240);
            touched |= sfem_contact_get_info(s.contact).contacts > 0;
            if (before && sfem_modal_rigid(s.body).v[2] > 0) height = fmax(height, sfem_modal_rigid(s.body).x[2] - 0.2);
        }
        print_message("e %g: %g\n", wanted[i], sqrt(height / 0.3));
        assert_near(sqrt(height / 0.3), wanted[i], 0, 0.1);
        drop(&s);
    }
}

/* The finer the step, the more of its energy a ball keeps that nothing damps. */
static void a_ball_keeps_its_energy_where_steps_resolve_the_bounce(void **unused)
{
    static const double hertz[] = {240, 480, 960}, kept[] = {0.6, 0.8, 0.85};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(hertz); ++i) {
        options o = usual(1e6);
        sfem_mesh mesh = ball(0.2, 4);
        double start, middle, end, low;
        scene s;
        int k;
        o.stiffness_damping = 0;
        o.modes = 30;
        shift(&mesh, 0, 0, 0.5 - bottom(&mesh));
        s = on_floor(mesh, &o);
        low = s.mass * GRAVITY * 0.2;
        start = energy(&s) - low;
        for (k = 0; k < 0.45 * hertz[i]; ++k) step(&s, 1 / hertz[i]);
        middle = sfem_modal_rigid(s.body).v[2];
        end = energy(&s) - low;
        print_message("%g Hz: %g of its energy\n", hertz[i], end / start);
        assert_true(middle > 0 && end <= start * (1 + 1e-9) && end >= kept[i] * start);
        drop(&s);
    }
}

/* --------------------------------------------------------------------------------------------
 * obstacles that move, thin ones, small ones
 * -------------------------------------------------------------------------------------------- */

static void fast_balls_do_not_pass_thin_plates(void **unused)
{
    static const double speeds[] = {10, 30, 30, 50, 50, 50}, half[] = {0.005, 0.005, 0.001, 0.005, 0.001, 0.001},
                        young[] = {1e6, 1e6, 1e6, 1e6, 1e5, 1e8};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(speeds); ++i) {
        options o = usual(young[i]);
        sfem_obstacle_def plate = sfem_default_obstacle_def();
        sfem_mesh mesh = ball(0.1, 3);
        sfem_error err;
        double x[3];
        scene s;
        int k;
        o.stiffness_damping = 0;
        o.def.gravity[2] = 0;
        shift(&mesh, 0, 0, 0.25);
        s = scene_of(mesh, &o);
        plate.kind = SFEM_OBSTACLE_BOX;
        plate.size[0] = plate.size[1] = 2;
        plate.size[2] = half[i];
        assert_ok(sfem_contact_add_obstacle(s.contact, &plate, NULL, &err), err);
        throw_body(&s, 0, -speeds[i], 0);
        for (k = 0; k < 30; ++k) {
            step(&s, 1.0 / 60);
            assert_true(sfem_modal_get_info(s.body).kinetic + sfem_modal_get_info(s.body).elastic <=
                        s.mass * speeds[i] * speeds[i] / 2 * (1 + 1e-9) + sfem_contact_get_info(s.contact).moved);
        }
        memcpy(x, sfem_modal_rigid(s.body).x, sizeof x);
        assert_true(isfinite(x[0]) && isfinite(x[1]) && isfinite(x[2]));
        if (speeds[i] <= 30) assert_true(x[2] > 0.05);
        drop(&s);
    }
}

/* A plate comes down on a ball on a floor, slides, and turns: what it does is counted, and more the ball does not have. */
static void moving_plates_give_no_more_than_their_work(void **unused)
{
    options o = usual(2e5);
    const sfem_real velocity[3] = {0.3, 0, -0.15}, angular[3] = {0, 0.2, 1};
    sfem_obstacle_def plate = sfem_default_obstacle_def();
    sfem_mesh mesh = ball(0.1, 3);
    double start, lowest = 0;
    sfem_error err;
    sfem_int id;
    scene s;
    int k;
    (void)unused;
    o.stiffness_damping = 0;
    shift(&mesh, 0, 0, 0.101);
    s = on_floor(mesh, &o);
    plate.kind = SFEM_OBSTACLE_BOX;
    plate.size[0] = plate.size[1] = 0.5;
    plate.size[2] = 0.01;
    plate.position[2] = 0.24;
    assert_ok(sfem_contact_add_obstacle(s.contact, &plate, &id, &err), err);
    assert_ok(sfem_contact_move_obstacle(s.contact, id, plate.position, NULL, velocity, angular, &err), err);
    start = energy(&s);
    for (k = 0; k < 40; ++k) {
        sfem_real force[3], torque[3];
        step(&s, 1.0 / 60);
        assert_true(energy(&s) <= start * (1 + 1e-9) + sfem_contact_get_info(s.contact).moved);
        sfem_contact_obstacle_force(s.contact, id, force, torque);
        lowest = fmax(lowest, force[2]);
    }
    assert_true(lowest > s.mass * GRAVITY && sfem_contact_get_info(s.contact).moved > 0);
    drop(&s);
}

/* A pin smaller than the body's triangles does not slip between its nodes. */
static void small_obstacles_do_not_slip_between_nodes(void **unused)
{
    options o = usual(1e6);
    sfem_obstacle_def pin = sfem_default_obstacle_def();
    sfem_mesh mesh = block(2, 0.3);
    sfem_error err;
    scene s;
    int k, touched = 0;
    (void)unused;
    shift(&mesh, -0.1, -0.08, 0.2);
    o.friction = 1;
    s = scene_of(mesh, &o);
    pin.kind = SFEM_OBSTACLE_SPHERE;
    pin.size[0] = 0.02;
    assert_ok(sfem_contact_add_obstacle(s.contact, &pin, NULL, &err), err);
    for (k = 0; k < 18; ++k) {
        step(&s, 1.0 / 60);
        touched |= sfem_contact_get_info(s.contact).contacts > 0;
        assert_true(sfem_contact_get_info(s.contact).penetration < 2e-3);
    }
    assert_true(touched && sfem_contact_get_info(s.contact).work < 0);
    assert_true(sfem_modal_rigid(s.body).x[2] > 0); /* it would be at -0.09 */
    drop(&s);
}

static void overlaps_are_pushed_out_slowly(void **unused)
{
    options o = usual(1e6);
    sfem_mesh mesh = block(2, 0.2);
    scene s;
    double fastest = 0;
    int k;
    (void)unused;
    shift(&mesh, 0, 0, -0.05);
    s = on_floor(mesh, &o);
    for (k = 0; k < 120; ++k) {
        step(&s, 1.0 / 60);
        fastest = fmax(fastest, fabs(sfem_modal_rigid(s.body).v[2]));
    }
    assert_true(sfem_contact_get_info(s.contact).penetration < 1e-4);
    assert_true(fastest < 0.2); /* a shift, no velocity */
    assert_near(sfem_contact_get_info(s.contact).moved, s.mass * GRAVITY * 0.05, 0.1, 0);
    drop(&s);
}

/* --------------------------------------------------------------------------------------------
 * the same body by nodes
 * -------------------------------------------------------------------------------------------- */

/* A clamped bar of all its modes, pressed by a sphere a little: places and force are those of the linear body of nodes in
 * contact, which steps by another method and solves its cones with another matrix. */
static void all_modes_are_the_linear_body(void **unused)
{
    const sfem_int cells[3] = {6, 2, 2};
    const sfem_real size[3] = {0.6, 0.2, 0.2}, at[3] = {0.55, 0.11, 0.399}, down[3] = {0, 0, -0.01};
    options o = usual(1e6);
    sfem_obstacle_def tool = sfem_default_obstacle_def();
    sfem_body_def def = sfem_default_body_def();
    sfem_contact *contact;
    sfem_body *body;
    sfem_real force[2][3], torque[3];
    sfem_int id[2], pins[9] = {0, 1, 2, 3, 4, 5, 6, 7, 8}, i;
    double largest = 0, difference = 0;
    sfem_mesh mesh;
    sfem_error err;
    scene s;
    int k, c;
    (void)unused;
    o.modes = -1;
    o.pins = 9;
    o.stiffness_damping = 0.02;
    o.def.warp = SFEM_WARP_NONE;
    o.def.gravity[2] = 0;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
    s = scene_of(mesh, &o);
    def.stiffness_damping = 0.02;
    def.pins = pins;
    def.pin_count = 9;
    assert_ok(sfem_body_create(s.model, &def, &body, &err), err);
    assert_ok(sfem_contact_create(NULL, &contact, &err), err);
    assert_ok(sfem_contact_add_body(contact, body, NULL, ~0u, NULL, &err), err);
    tool.kind = SFEM_OBSTACLE_SPHERE;
    tool.size[0] = 0.2;
    tool.contact.friction = 0;
    memcpy(tool.position, at, sizeof tool.position);
    assert_ok(sfem_contact_add_obstacle(s.contact, &tool, id, &err), err);
    assert_ok(sfem_contact_add_obstacle(contact, &tool, id + 1, &err), err);
    for (k = 0; k < 240; ++k) {
        const double z = at[2] + down[2] * fmin(k / 60.0, 1);
        const sfem_real place[3] = {at[0], at[1], z};
        assert_ok(sfem_contact_move_obstacle(s.contact, id[0], place, NULL, k < 60 ? down : NULL, NULL, &err), err);
        assert_ok(sfem_contact_move_obstacle(contact, id[1], place, NULL, k < 60 ? down : NULL, NULL, &err), err);
        step(&s, 1.0 / 60);
        assert_ok(sfem_contact_step(contact, 1.0 / 60, &err), err);
    }
    sfem_contact_obstacle_force(s.contact, id[0], force[0], torque);
    sfem_contact_obstacle_force(contact, id[1], force[1], torque);
    assert_true(force[1][2] > 1);
    for (c = 0; c < 3; ++c) assert_near(force[0][c], force[1][c], 0, 1e-3 * force[1][2]);
    for (i = 0; i < s.mesh.nodes; ++i) {
        sfem_real x[3];
        sfem_modal_node(s.body, i, x, NULL, NULL);
        for (c = 0; c < 3; ++c) {
            const double u = sfem_body_displacement(body)[3 * i + c];
            largest = fmax(largest, fabs(u));
            difference = fmax(difference, fabs(x[c] - s.mesh.x[3 * i + c] - u));
        }
    }
    assert_true(largest > 5e-3 && difference < 1e-3 * largest);
    sfem_contact_free(contact);
    sfem_body_free(body);
    drop(&s);
}

/* --------------------------------------------------------------------------------------------
 * other meshes, other ways to be held
 * -------------------------------------------------------------------------------------------- */

static void fall(sfem_mesh mesh, double young, double speed)
{
    options o = usual(young);
    const double h = 1.0 / 60;
    double start, deepest = 0;
    scene s;
    int k;
    shift(&mesh, 0, 0, 0.2 - bottom(&mesh));
    s = on_floor(mesh, &o);
    throw_body(&s, speed / 2, -speed, 3);
    start = energy(&s);
    for (k = 0; k < (speed > 0 ? 30 : 120); ++k) {
        step(&s, h);
        assert_true(energy(&s) <= start * (1 + 1e-9) + sfem_contact_get_info(s.contact).moved);
        deepest = fmax(deepest, sfem_contact_get_info(s.contact).penetration);
    }
    assert_true(speed > 0 ? deepest < 0.1 : deepest < 2e-3);
    drop(&s);
}

static void a_body_with_slivers_is_dropped_and_thrown(void **unused)
{
    static const double young[] = {1e5, 1e8, 1e5, 1e8}, speed[] = {0, 0, 50, 50};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(young); ++i) {
        sfem_mesh mesh;
        sfem_error err;
        assert_ok(body_scattered(800, 0.01, 3, &mesh, &err), err);
        fall(mesh, young[i], speed[i]);
    }
}

static sfem_real wavy(const sfem_real x[3], void *user)
{
    (void)user;
    return sqrt(x[0] * x[0] + 2 * x[1] * x[1] + 3 * x[2] * x[2]) - 0.5 - 0.05 * sin(9 * x[0]) * cos(7 * x[1]);
}

static void a_mesh_of_the_mesher_is_dropped(void **unused)
{
    const sfem_real box[2][3] = {{-0.6, -0.6, -0.6}, {0.6, 0.6, 0.6}};
    sfem_mesher_def def = sfem_default_mesher_def();
    sfem_mesh mesh;
    sfem_error err;
    (void)unused;
    def.tets = 3000;
    assert_ok(sfem_mesh_from_sdf(&def, wavy, NULL, (const sfem_real(*)[3])box, &mesh, NULL, &err), err);
    fall(mesh, 3e5, 0);
}

/* Meshes of others, made as large as a metre. */
static void meshes_of_files_are_dropped(void **unused)
{
    static const char *const name[] = {"pbd_armadillo_4k.node", "igl_octopus_low.mesh"};
    size_t k;
    (void)unused;
    for (k = 0; k < TEST_COUNT(name) && !TEST_SANITIZED; ++k) {
        const char *path = mesh_path(name[k]);
        double size = 0;
        sfem_mesh mesh;
        sfem_error err;
        sfem_int i;
        if (!path) continue;
        assert_ok(sfem_mesh_read(path, NULL, &mesh, &err), err);
        sfem_mesh_orient(&mesh);
        for (i = 3; i < 3 * mesh.nodes; ++i) size = fmax(size, fabs(mesh.x[i] - mesh.x[i % 3]));
        for (i = 0; i < 3 * mesh.nodes; ++i) mesh.x[i] /= size;
        fall(mesh, 1e6, 0);
    }
}

/* A clamped bar swings down on a box under its end, with few modes or more, warped far, and stays on it. */
static void a_clamped_bar_stops_on_a_box(void **unused)
{
    static const sfem_int modes[] = {1, 3, 20};
    const sfem_int cells[3] = {10, 2, 2};
    const sfem_real size[3] = {1, 0.1, 0.1};
    size_t i;
    (void)unused;
    for (i = 0; i < TEST_COUNT(modes); ++i) {
        options o = usual(3e5);
        sfem_obstacle_def box = sfem_default_obstacle_def();
        sfem_real force[3], torque[3];
        double deepest = 0;
        sfem_mesh mesh;
        sfem_error err;
        scene s;
        int k;
        o.pins = 9;
        o.modes = modes[i];
        o.stiffness_damping = 0.01;
        assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_6_TETS, NULL, &mesh, &err), err);
        s = scene_of(mesh, &o);
        box.kind = SFEM_OBSTACLE_BOX;
        box.size[0] = box.size[1] = box.size[2] = 0.15;
        box.position[0] = 0.9;
        box.position[2] = -0.25;
        assert_ok(sfem_contact_add_obstacle(s.contact, &box, &s.floor, &err), err);
        for (k = 0; k < 180; ++k) {
            step(&s, 1.0 / 60);
            deepest = fmax(deepest, sfem_contact_get_info(s.contact).penetration);
        }
        sfem_contact_obstacle_force(s.contact, s.floor, force, torque);
        assert_true(force[2] < 0 && -force[2] < 10 * 9.81); /* it bears a part of 10 kg */
        assert_true(deepest < 2e-3);
        assert_true(sfem_modal_get_info(s.body).kinetic < 1e-3);
        drop(&s);
    }
}

/* Exact oscillators and Newmark's as they are; with handles, too. */
static void all_integrators_touch(void **unused)
{
    static const sfem_modal_integrator integrator[] = {SFEM_MODAL_NEWMARK, SFEM_MODAL_EXACT, SFEM_MODAL_FITTED};
    size_t i;
    (void)unused;
    for (i = 0; i < 2 * TEST_COUNT(integrator); ++i) {
        options o = usual(3e5);
        sfem_mesh mesh = block(3, 0.3);
        double start, deepest = 0;
        sfem_error err;
        sfem_int handle = -1;
        scene s;
        int k;
        o.def.integrator = integrator[i % 3];
        o.stiffness_damping = 2e-3;
        shift(&mesh, 0, 0, 0.1);
        s = on_floor(mesh, &o);
        if (i >= 3) assert_ok(sfem_modal_grab_node(s.body, s.mesh.nodes - 1, &handle, &err), err);
        start = energy(&s);
        for (k = 0; k < 120; ++k) {
            step(&s, 1.0 / 60);
            if (i < 3) assert_true(energy(&s) <= start * (1 + 1e-9) + sfem_contact_get_info(s.contact).moved);
            deepest = fmax(deepest, sfem_contact_get_info(s.contact).penetration);
        }
        assert_true(deepest < 1e-3 && sfem_contact_get_info(s.contact).contacts > 0);
        assert_true(sfem_modal_get_info(s.body).kinetic < 0.05);
        drop(&s);
    }
}

static void filters_say_who_touches_whom(void **unused)
{
    options o = usual(1e6);
    sfem_mesh mesh = block(2, 0.2);
    sfem_obstacle_def def = sfem_default_obstacle_def();
    sfem_int top[9], count = 0, i;
    sfem_error err;
    scene s;
    int k;
    (void)unused;
    shift(&mesh, 0, 0, 0.01);
    s = scene_of(mesh, &o);
    def.contact.groups = 2;
    def.contact.collides = 4; /* the body is of group 1 */
    assert_ok(sfem_contact_add_obstacle(s.contact, &def, &s.floor, &err), err);
    for (k = 0; k < 30; ++k) step(&s, 1.0 / 60);
    assert_true(sfem_modal_rigid(s.body).x[2] < -0.5);
    /* only the nodes on its top: the floor comes up to there */
    sfem_contact_remove_obstacle(s.contact, s.floor);
    sfem_contact_remove_body(s.contact, 0);
    for (i = 0; i < s.mesh.nodes; ++i)
        if (s.mesh.x[3 * i + 2] > 0.2) top[count++] = i;
    assert_int_equal(count, 9);
    assert_ok(sfem_contact_add_modal(s.contact, s.body, NULL, count, top, NULL, &err), err);
    def = sfem_default_obstacle_def();
    def.position[2] = -3;
    assert_ok(sfem_contact_add_obstacle(s.contact, &def, &s.floor, &err), err);
    for (k = 0; k < 240; ++k) step(&s, 1.0 / 60);
    assert_near(sfem_modal_rigid(s.body).x[2], -3.1, 0, 0.02);
    drop(&s);
}

/* --------------------------------------------------------------------------------------------
 * states, threads, faults
 * -------------------------------------------------------------------------------------------- */

static uint64_t hash_of(const scene *s)
{
    const size_t m = (size_t)sfem_modal_get_info(s->body).modes;
    const sfem_contact_info info = sfem_contact_get_info(s->contact);
    const sfem_rigid rigid = sfem_modal_rigid(s->body);
    uint64_t hash = hash_reals(sfem_modal_coordinates(s->body), m);
    hash = 31 * hash + hash_reals(sfem_modal_coordinate_velocities(s->body), m);
    hash = 31 * hash + hash_reals(rigid.x, 18);
    return 31 * (31 * hash + hash_reals(&info.work, 1)) + hash_reals(&info.moved, 1);
}

static scene rolling(const options *o)
{
    sfem_mesh mesh = ball(0.2, 3);
    scene s;
    shift(&mesh, 0, 0, 0.21);
    s = on_floor(mesh, o);
    throw_body(&s, 1, 0, 0);
    return s;
}

static void saved_states_go_on_with_the_same_bits(void **unused)
{
    const options o = usual(1e5);
    scene s = rolling(&o), other = rolling(&o);
    size_t size[2], at;
    char *memory[2];
    uint64_t hash;
    sfem_error err;
    int k, i;
    (void)unused;
    for (k = 0; k < 30; ++k) step(&s, 1.0 / 60);
    assert_true(sfem_contact_get_info(s.contact).contacts > 0);
    size[0] = sfem_modal_state_size(s.body);
    size[1] = sfem_contact_state_size(s.contact);
    memory[0] = (char *)malloc(size[0]);
    memory[1] = (char *)malloc(size[1]);
    sfem_modal_save_state(s.body, memory[0]);
    sfem_contact_save_state(s.contact, memory[1]);
    for (k = 0; k < 30; ++k) step(&s, 1.0 / 60);
    hash = hash_of(&s);
    for (i = 0; i < 2; ++i) {
        scene *to = i ? &other : &s;
        assert_ok(sfem_modal_load_state(to->body, memory[0], size[0], &err), err);
        assert_ok(sfem_contact_load_state(to->contact, memory[1], size[1], &err), err);
        for (k = 0; k < 30; ++k) step(to, 1.0 / 60);
        assert_true(hash_of(to) == hash);
    }
    for (at = 0; at < size[1]; at += 13) {
        memory[1][at] = (char)(memory[1][at] ^ 4);
        assert_status(sfem_contact_load_state(s.contact, memory[1], size[1], &err), SFEM_FORMAT);
        memory[1][at] = (char)(memory[1][at] ^ 4);
    }
    free(memory[0]);
    free(memory[1]);
    drop(&s);
    drop(&other);
}

static void threads_make_the_same_bits(void **unused)
{
    uint64_t hash[2];
    int run, k;
    (void)unused;
    for (run = 0; run < 2; ++run) {
        options o = usual(1e5);
        scene s;
        if (run) o.def.exec = thread_exec(3);
        s = rolling(&o);
        for (k = 0; k < 40; ++k) step(&s, 1.0 / 60);
        hash[run] = hash_of(&s);
        drop(&s);
    }
    assert_true(hash[0] == hash[1]);
}

static void bad_input_is_refused_and_changes_nothing(void **unused)
{
    const options o = usual(1e5);
    scene s = rolling(&o);
    sfem_contact_surface surface = sfem_default_contact_surface();
    sfem_obstacle_def def = sfem_default_obstacle_def();
    sfem_rigid rigid = sfem_modal_rigid(s.body);
    const sfem_int wrong[2] = {0, 100000};
    const sfem_real nowhere[3] = {0, NAN, 0};
    sfem_modal *another;
    uint64_t hash;
    sfem_error err;
    int k;
    (void)unused;
    for (k = 0; k < 20; ++k) step(&s, 1.0 / 60);
    hash = hash_of(&s);
    assert_status(sfem_contact_add_modal(s.contact, s.body, NULL, 0, NULL, NULL, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "added before");
    assert_ok(sfem_modal_create(s.reduced, &o.def, &another, &err), err);
    assert_status(sfem_contact_add_modal(s.contact, another, NULL, 2, wrong, NULL, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "100000");
    assert_status(sfem_contact_add_modal(s.contact, another, NULL, 0, wrong, NULL, &err), SFEM_BAD_ARGUMENT);
    surface.friction = -1;
    assert_status(sfem_contact_add_modal(s.contact, another, &surface, 0, NULL, NULL, &err), SFEM_BAD_ARGUMENT);
    sfem_modal_free(another);
    rigid.x[2] = NAN;
    assert_status(sfem_modal_set_rigid(s.body, &rigid, &err), SFEM_NOT_FINITE);
    assert_status(sfem_contact_move_obstacle(s.contact, s.floor, nowhere, NULL, NULL, NULL, &err), SFEM_NOT_FINITE);
    def.position[0] = NAN;
    assert_status(sfem_contact_add_obstacle(s.contact, &def, NULL, &err), SFEM_NOT_FINITE);
    assert_status(sfem_contact_step(s.contact, NAN, &err), SFEM_BAD_ARGUMENT);
    assert_true(hash_of(&s) == hash);
    step(&s, 1.0 / 60);
    drop(&s);
}

/* More contacts than allowed, of the second body: the first one's step is taken back, too. */
static void a_step_that_fails_leaves_all_as_they_were(void **unused)
{
    options o = usual(1e5);
    sfem_mesh mesh = block(3, 0.3);
    sfem_modal *second;
    sfem_rigid rigid;
    uint64_t hash;
    sfem_error err;
    scene s;
    int k, failed = 0;
    (void)unused;
    o.max_contacts = 24;
    shift(&mesh, 0, 0, 0.005);
    s = on_floor(mesh, &o);
    assert_ok(sfem_modal_create(s.reduced, &o.def, &second, &err), err);
    rigid = sfem_modal_rigid(second);
    rigid.x[0] = 1;
    rigid.x[2] += 0.1;
    assert_ok(sfem_modal_set_rigid(second, &rigid, &err), err);
    assert_ok(sfem_contact_add_modal(s.contact, second, NULL, 0, NULL, NULL, &err), err);
    for (k = 0; k < 60 && !failed; ++k) {
        const double z = sfem_modal_rigid(second).x[2];
        hash = hash_of(&s);
        failed = sfem_contact_step(s.contact, 1.0 / 60, &err) != SFEM_OK;
        if (!failed) continue;
        assert_names(err, "max_contacts");
        assert_true(hash_of(&s) == hash);
        assert_true(sfem_modal_rigid(second).x[2] == z);
    }
    assert_true(failed);
    rigid.x[2] = 5;
    assert_ok(sfem_modal_set_rigid(second, &rigid, &err), err);
    step(&s, 1.0 / 60);
    sfem_contact_remove_body(s.contact, 1);
    sfem_modal_free(second);
    drop(&s);
}

static sfem_status live(sfem_allocator allocator, void *user, sfem_error *err)
{
    const scene *s = (const scene *)user;
    const sfem_modal_def modal_def = usual(1e5).def;
    const sfem_obstacle_def floor = sfem_default_obstacle_def();
    sfem_contact_def def = sfem_default_contact_def();
    sfem_contact *contact = NULL;
    sfem_modal *body = NULL;
    sfem_status status;
    int k;
    def.allocator = allocator;
    status = sfem_modal_create(s->reduced, &modal_def, &body, NULL);
    if (status == SFEM_OK) status = sfem_contact_create(&def, &contact, err);
    if (status == SFEM_OK) status = sfem_contact_add_modal(contact, body, NULL, 0, NULL, NULL, err);
    if (status == SFEM_OK) status = sfem_contact_add_obstacle(contact, &floor, NULL, err);
    for (k = 0; status == SFEM_OK && k < 15; ++k) status = sfem_contact_step(contact, 1.0 / 60, err);
    sfem_contact_free(contact);
    sfem_modal_free(body);
    return status;
}

static void every_allocation_may_fail(void **unused)
{
    const options o = usual(1e5);
    scene s = rolling(&o);
    (void)unused;
    fail_every_allocation(live, &s);
    drop(&s);
}

/* Nodes next to pins hardly move with the modes. A ball that met them moved all others by a kilometre. */
static void a_ball_next_to_pinned_nodes_throws_no_body(void **unused)
{
    static const double from_edge[] = {0.03, 0.01, 0.001, 1e-6};
    const sfem_real velocity[3] = {0, 0.5, 0};
    size_t i;
    int k, a;
    (void)unused;
    for (i = 0; i < TEST_COUNT(from_edge); ++i) {
        options o = usual(1e5);
        sfem_obstacle_def tool = sfem_default_obstacle_def();
        sfem_int id, node;
        sfem_error err;
        scene s;
        o.pins = 9;
        o.def.gravity[2] = 0;
        s = scene_of(block(2, 0.2), &o);
        tool.kind = SFEM_OBSTACLE_SPHERE;
        tool.size[0] = 0.005;
        tool.position[0] = from_edge[i];
        tool.position[1] = -0.01;
        tool.position[2] = 0.05;
        assert_ok(sfem_contact_add_obstacle(s.contact, &tool, &id, &err), err);
        assert_ok(sfem_contact_move_obstacle(s.contact, id, tool.position, NULL, velocity, NULL, &err), err);
        for (k = 0; k < 8; ++k) {
            step(&s, 1 / 60.0);
            for (node = 0; node < s.mesh.nodes; ++node) {
                sfem_real x[3];
                sfem_modal_node(s.body, node, x, NULL, NULL);
                for (a = 0; a < 3; ++a) assert_true(fabs(x[a] - s.mesh.x[3 * node + a]) < 0.25);
            }
        }
        drop(&s);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_ball_next_to_pinned_nodes_throws_no_body),
        cmocka_unit_test(a_dropped_body_makes_no_energy_and_comes_to_rest),
        cmocka_unit_test(a_block_below_the_friction_angle_does_not_creep),
        cmocka_unit_test(a_block_above_the_friction_angle_accelerates_as_coulomb_has_it),
        cmocka_unit_test(impulses_are_what_momenta_change_by),
        cmocka_unit_test(restitution_is_what_was_asked_for),
        cmocka_unit_test(a_ball_keeps_its_energy_where_steps_resolve_the_bounce),
        cmocka_unit_test(fast_balls_do_not_pass_thin_plates),
        cmocka_unit_test(moving_plates_give_no_more_than_their_work),
        cmocka_unit_test(small_obstacles_do_not_slip_between_nodes),
        cmocka_unit_test(overlaps_are_pushed_out_slowly),
        cmocka_unit_test(all_modes_are_the_linear_body),
        cmocka_unit_test(a_body_with_slivers_is_dropped_and_thrown),
        cmocka_unit_test(a_mesh_of_the_mesher_is_dropped),
        cmocka_unit_test(meshes_of_files_are_dropped),
        cmocka_unit_test(a_clamped_bar_stops_on_a_box),
        cmocka_unit_test(all_integrators_touch),
        cmocka_unit_test(filters_say_who_touches_whom),
        cmocka_unit_test(saved_states_go_on_with_the_same_bits),
        cmocka_unit_test(threads_make_the_same_bits),
        cmocka_unit_test(bad_input_is_refused_and_changes_nothing),
        cmocka_unit_test(a_step_that_fails_leaves_all_as_they_were),
        cmocka_unit_test(every_allocation_may_fail),
    };
    return run_all_tests(tests);
}
