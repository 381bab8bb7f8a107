/* The energies of bodies that break: bent, pulled, struck, cut in flight, torn slowly; what goes in is what comes out. */
#include "support.h"
#include "strip.h"

typedef struct scene {
    const char *name;
    sfem_mesh mesh;
    sfem_model_def material;
    sfem_damage_def damage;
    sfem_body_def def;
    sfem_model *model;
    sfem_body *body;
    sfem_int *pin, pins;
    unsigned char *axes;
} scene;

static void must(sfem_status status, const sfem_error *err)
{
    if (status != SFEM_OK) fail_msg("%s", err->text);
}

static void open_scene(scene *s, const char *name, const sfem_int cells[3], const double size[3], double jitter)
{
    body_random random;
    sfem_error err;
    sfem_int i;
    int c;
    memset(s, 0, sizeof *s);
    random.state = 4;
    s->name = name;
    must(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &s->mesh, &err), &err);
    for (i = 0; i < 3 * s->mesh.nodes; ++i) {
        const double by = body_uniform(&random, -jitter, jitter);
        c = (int)(i % 3);
        if (s->mesh.x[i] > 1e-9 && s->mesh.x[i] < size[c] - 1e-9) s->mesh.x[i] += by;
    }
    s->material = sfem_default_model_def();
    s->material.material.law = SFEM_COROTATIONAL;
    s->damage = sfem_default_damage_def();
    s->def = sfem_default_body_def();
    s->pin = (sfem_int *)body_new((size_t)s->mesh.nodes, sizeof *s->pin);
    s->axes = (unsigned char *)body_new((size_t)s->mesh.nodes, 1);
}

static void hold(scene *s, int axis, double from, double to, double z, unsigned char axes)
{
    sfem_int i;
    for (i = 0; i < s->mesh.nodes; ++i) {
        const double *x = s->mesh.x + 3 * i;
        if (x[axis] < from || x[axis] > to || (z >= 0 && fabs(x[2] - z) > 1e-9)) continue;
        s->axes[s->pins] = axes;
        s->pin[s->pins++] = i;
    }
}

static void make(scene *s)
{
    sfem_error err;
    s->material.mesh = &s->mesh;
    must(sfem_model_create(&s->material, &s->model, &err), &err);
    s->def.damage = &s->damage;
    s->def.pins = s->pin;
    s->def.pin_axes = s->axes;
    s->def.pin_count = s->pins;
    s->def.max_handles = 64;
    must(sfem_body_create(s->model, &s->def, &s->body, &err), &err);
}

static void cut(scene *s, double x, double from, double to)
{
    const double start[9] = {x - 0.001, -1, from, x + 0.001, -1, from, x, 1, from};
    double end[9];
    sfem_error err;
    int i;
    memcpy(end, start, sizeof end);
    for (i = 2; i < 9; i += 3) end[i] = to;
    must(sfem_body_cut(s->body, start, end, NULL, &err), &err);
}

/* Moves the pins whose place along `axis` is at least `from`, by `way` along `along`. */
static void pull(scene *s, int axis, double from, int along, double way)
{
    sfem_error err;
    sfem_int i;
    for (i = 0; i < s->pins; ++i) {
        double to[3];
        memcpy(to, s->mesh.x + 3 * s->pin[i], sizeof to);
        if (to[axis] < from) continue;
        to[along] += way;
        must(sfem_body_move_pin(s->body, s->pin[i], to, &err), &err);
    }
}

static void advance(scene *s, double h)
{
    sfem_error err;
    must(sfem_body_step(s->body, h, &err), &err);
}

/* Closes it. At least `broken` edges broke, the error is at most `most` of the scale, and what it is made of adds up. */
static void assert_balance(scene *s, int broken, double most)
{
    const sfem_fracture f = sfem_body_fracture(s->body);
    const double error = f.kinetic_elastic - f.start - f.work + f.damped + f.released;
    print_message("%s: %d edges broken, %d pieces, %d steps rejected; of %.4g J error %.4f, rejected %.4f, dissipated %.4f, "
                  "released %.4f\n", s->name, (int)f.broken, (int)f.pieces, (int)sfem_body_get_info(s->body).rejected,
                  f.scale, f.error / f.scale, f.rejected / f.scale, f.dissipated / f.scale, f.released / f.scale);
    assert_near(f.error, error, 0, 1e-12 * f.scale);
    assert_true(f.broken >= broken);
    assert_true(fabs(f.error) <= most * f.scale);
    sfem_body_free(s->body);
    sfem_model_free(s->model);
    sfem_mesh_free(&s->mesh);
    free(s->pin);
    free(s->axes);
}

/* A linear bar on two supports; with one solve a step 8 % of its energy was in the inertia of the old factor. */
static void a_bent_bar_keeps_its_energy_where_it_is_corrected(void **state)
{
    static const sfem_int cells[3] = {17, 2, 5};
    static const double size[3] = {1, 0.12, 0.25}, h = 0.003;
    scene s;
    int k;
    (void)state;
    open_scene(&s, "bent", cells, size, 0.006);
    s.material.material.law = SFEM_LINEAR;
    s.material.material.young = 2e6;
    s.material.material.mass_damping = 4;
    s.damage.toughness = 20;
    s.damage.corrected = 1;
    s.def.dissipation = 0;
    hold(&s, 0, 0.09, 0.15, 0, SFEM_AXIS_ALL);
    hold(&s, 0, 0.85, 0.91, 0, SFEM_AXIS_Y | SFEM_AXIS_Z);
    hold(&s, 0, 0.45, 0.55, 0.25, SFEM_AXIS_Z);
    make(&s);
    cut(&s, 0.5, -0.1, 0.075);
    for (k = 0; k < 330; ++k) {
        const double t = h * (k + 1);
        sfem_error err;
        sfem_int i;
        for (i = 0; i < s.pins; ++i) {
            double to[3];
            memcpy(to, s.mesh.x + 3 * s.pin[i], sizeof to);
            if (to[2] < 0.2) continue;
            to[2] -= 0.012 * (t > 0.4 ? t - 0.2 : t * t / 0.8) + (t > 0.8 ? 0.3 * (t - 0.8) * (t - 0.8) : 0);
            must(sfem_body_move_pin(s.body, s.pin[i], to, &err), &err);
        }
        advance(&s, h);
    }
    assert_balance(&s, 30, 0.005);
}

/* Softening, large strains, the pieces snap back. */
static void a_bar_that_is_pulled_apart(void **state)
{
    static const sfem_int cells[3] = {14, 3, 3};
    static const double size[3] = {1, 0.2, 0.2}, h = 0.004;
    scene s;
    sfem_int i;
    int k, c;
    (void)state;
    open_scene(&s, "pulled", cells, size, 0);
    for (i = 0; i < s.mesh.nodes; ++i)
        for (c = 1; c < 3; ++c) { /* narrower in the middle */
            double *x = s.mesh.x + 3 * i;
            x[c] = 0.1 + (1 - 0.35 * exp(-pow(fabs(x[0] - 0.5) / 0.22, 4))) * (x[c] - 0.1);
        }
    s.material.material.young = 1e6;
    s.material.material.mass_damping = 1;
    s.material.material.stiffness_damping = 0.004;
    s.damage.toughness = 50;
    s.damage.criterion = SFEM_BREAK_DUCTILE;
    s.damage.soften[0] = 0.05;
    s.damage.soften[1] = 0.45;
    hold(&s, 0, -1, 1e-9, -1, SFEM_AXIS_ALL);
    hold(&s, 0, 1 - 1e-9, 2, -1, SFEM_AXIS_ALL);
    make(&s);
    for (k = 0; k < 230; ++k) {
        pull(&s, 0, 0.5, 0, 0.35 * h * (k + 1));
        advance(&s, h);
    }
    assert_balance(&s, 20, 0.02);
}

static void a_plate_that_is_struck(void **state)
{
    static const sfem_int cells[3] = {10, 10, 1};
    static const double size[3] = {1, 1, 0.05}, h = 0.0005;
    sfem_int handle[64], handles = 0, i;
    sfem_error err;
    scene s;
    int k;
    (void)state;
    open_scene(&s, "struck", cells, size, 0.012);
    s.material.material.young = 5e6;
    s.material.material.mass_damping = 0.1;
    s.damage.toughness = 15;
    s.damage.weibull = 8;
    s.def.dissipation = 0;
    s.def.gravity[2] = -9.81;
    for (i = 0; i < s.mesh.nodes; ++i) {
        const double *x = s.mesh.x + 3 * i;
        if (fmax(fabs(x[0] - 0.5), fabs(x[1] - 0.5)) < 0.5 - 1e-9) continue;
        s.axes[s.pins] = SFEM_AXIS_ALL;
        s.pin[s.pins++] = i;
    }
    make(&s);
    for (i = 0; i < s.mesh.nodes && handles < 64; ++i) {
        const double *x = s.mesh.x + 3 * i;
        if (x[2] > 0.049 && hypot(x[0] - 0.45, x[1] - 0.55) < 0.1)
            must(sfem_body_grab_node(s.body, i, &handle[handles++], &err), &err);
    }
    for (k = 0; k < 160; ++k) {
        if (k == 60)
            for (i = 0; i < handles; ++i) sfem_body_release_handle(s.body, handle[i]);
        for (i = 0; k < 60 && i < handles; ++i) {
            double x[3];
            sfem_body_handle_position(s.body, handle[i], x);
            x[2] -= 4 * h;
            must(sfem_body_move_handle(s.body, handle[i], x, &err), &err);
        }
        advance(&s, h);
    }
    assert_balance(&s, 200, 0.02);
}

static void a_ball_that_is_cut_as_it_spins(void **state)
{
    const double h = 0.004;
    sfem_error err;
    scene s;
    double *v;
    sfem_int i;
    int k;
    (void)state;
    memset(&s, 0, sizeof s);
    s.name = "cut";
    must(sfem_mesh_ball(0.5, 4, NULL, &s.mesh, &err), &err);
    s.material = sfem_default_model_def();
    s.material.material.law = SFEM_COROTATIONAL;
    s.material.material.young = 2e5;
    s.material.material.mass_damping = 0.1;
    s.damage = sfem_default_damage_def();
    s.damage.toughness = 50;
    s.def = sfem_default_body_def();
    make(&s);
    v = (double *)body_new(3 * (size_t)s.mesh.nodes, sizeof *v);
    for (i = 0; i < s.mesh.nodes; ++i) {
        v[3 * i] = 2 * s.mesh.x[3 * i + 2];
        v[3 * i + 2] = -2 * s.mesh.x[3 * i];
    }
    must(sfem_body_set_state(s.body, NULL, v, &err), &err);
    free(v);
    for (k = 0; k < 200; ++k) {
        const double to = 0.6 - 4 * h * (k + 1);
        if (to > -0.7) cut(&s, 0.03, to + 8 * h, to);
        advance(&s, h);
    }
    assert_balance(&s, 100, 0.005);
}

/* A strip with a crack, of scattered points' Delaunay tets or of cells. */
static void tear(int kind)
{
    const double way = 0.05, h = 1 / 240.0;
    double from[9] = {0.901, -9, 0, 0.901, 9, 0, -9, 0, 0}, to[9];
    sfem_error err;
    scene s;
    int k;
    memset(&s, 0, sizeof s);
    s.name = strip_name[kind];
    must(strip_mesh(kind, 4, 1, 3, &s.mesh, &err), &err);
    s.material = sfem_default_model_def();
    s.material.material.law = SFEM_COROTATIONAL;
    s.material.material.young = 1e5;
    s.material.material.mass_damping = 1;
    s.damage = sfem_default_damage_def();
    s.damage.toughness = 400;
    s.def = sfem_default_body_def();
    s.def.dissipation = 0;
    s.pin = (sfem_int *)body_new((size_t)s.mesh.nodes, sizeof *s.pin);
    s.axes = (unsigned char *)body_new((size_t)s.mesh.nodes, 1);
    hold(&s, 2, -1, 1e-9, -1, SFEM_AXIS_ALL);
    hold(&s, 2, 1 - 1e-9, 2, -1, SFEM_AXIS_ALL);
    make(&s);
    memcpy(to, from, sizeof to);
    for (k = 2; k < 9; k += 3) {
        from[k] = kind == STRIP_DELAUNAY ? 0.5 : 0.625;
        to[k] = from[k] + 1e-6;
    }
    to[6] += 0.01;
    must(sfem_body_cut(s.body, from, to, NULL, &err), &err);
    for (k = 0; k < 1.5 / h; ++k) {
        pull(&s, 2, 0.5, 2, way * 2 * h * (k + 1));
        advance(&s, h);
    }
    assert_balance(&s, 10, 0.005);
}

static void strips_of_cells_and_of_scattered_nodes(void **state)
{
    (void)state;
    tear(STRIP_DELAUNAY);
    tear(STRIP_5_TETS);
}

/* At steps that resolve none of what a break sets free it rings, and was taken for growth: a third of the energy of
 * this bar was lost in rejected steps. What is lost now is, for the most part, what def.dissipation takes
 * of it: that is known exactly only where nothing rotates. */
static void slow_tearing_loses_nothing_in_rejected_steps(void **state)
{
    static const sfem_int cells[3] = {16, 4, 4};
    static const double size[3] = {1, 0.25, 0.25}, h = 1 / 60.0;
    sfem_fracture f;
    scene s;
    int k;
    (void)state;
    open_scene(&s, "torn slowly", cells, size, 0.006);
    s.material.material.young = 1e5;
    s.material.material.poisson = 0.35;
    s.material.material.mass_damping = 1;
    s.damage.toughness = 600;
    hold(&s, 0, -1, 1e-9, -1, SFEM_AXIS_ALL);
    hold(&s, 0, 1 - 1e-9, 2, -1, SFEM_AXIS_ALL);
    make(&s);
    cut(&s, 0.502, -0.1, 0.08);
    for (k = 0; k < 130; ++k) {
        pull(&s, 0, 0.5, 0, 0.15 * h * (k + 1));
        advance(&s, h);
    }
    f = sfem_body_fracture(s.body);
    assert_true(fabs(f.rejected) <= 0.02 * f.scale);
    assert_true(f.dissipated > -0.7 * f.error && f.error < 0);
    assert_balance(&s, 50, 0.5);
}

/* A neo-Hookean block of 1 mm is jerked as it breaks. Its energy has no lower bound in damaged tets: where more was allowed
 * while they ring it grew without end. */
static void a_jerked_neohookean_body_stays_in_its_place(void **state)
{
    static const sfem_int cells[3] = {8, 4, 2};
    static const double size[3] = {1e-3, 0.5e-3, 0.25e-3}, h = 9e-5;
    const sfem_int node = 9 * 5 * 3 - 1;
    sfem_error err;
    sfem_int handle;
    scene s;
    int k;
    sfem_int i;
    (void)state;
    open_scene(&s, "jerked", cells, size, 0);
    s.material.material.law = SFEM_NEOHOOKEAN;
    s.material.material.young = 1e4;
    s.damage.toughness = 0.0144;
    s.def.gravity[2] = -1200;
    hold(&s, 0, -1, 1e-9, -1, SFEM_AXIS_ALL);
    make(&s);
    for (k = 0; k < 27; ++k) advance(&s, h);
    must(sfem_body_grab_node(s.body, node, &handle, &err), &err);
    for (k = 0; k < 73; ++k) {
        const sfem_real to[3] = {s.mesh.x[3 * node] + 1e-3 * k, s.mesh.x[3 * node + 1], s.mesh.x[3 * node + 2]};
        must(sfem_body_move_handle(s.body, handle, to, &err), &err);
        advance(&s, h);
        for (i = 0; i < 3 * s.mesh.nodes; ++i) assert_true(fabs(sfem_body_displacement(s.body)[i]) < 0.2);
    }
    assert_true(sfem_body_fracture(s.body).kinetic_elastic >= 0);
    assert_balance(&s, 50, 1);
}

/* Two materials, one with stiffness damping: K is taken from what breaks, D of its own is not. */
static void materials_of_their_own_damping_break_and_stay_finite(void **state)
{
    static const sfem_int cells[3] = {8, 2, 2};
    static const sfem_real size[3] = {1, 0.25, 0.25};
    static const sfem_real from[9] = {0.8, -1, -1, 0.8, 2, -1, 0.8, 0, -0.5}, to[9] = {0.8, -1, -1, 0.8, 2, -1, 0.8, 0, 2};
    int damped, k;
    (void)state;
    for (damped = 0; damped < 2; ++damped) {
        sfem_material material[2] = {sfem_default_material(), sfem_default_material()};
        sfem_damage_def damage = sfem_default_damage_def();
        sfem_body_def def = sfem_default_body_def();
        sfem_model_def model_def = sfem_default_model_def();
        sfem_int pin[9], pins = 0, *of, i;
        sfem_mesh mesh;
        sfem_model *model;
        sfem_body *body;
        sfem_error err;
        must(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), &err);
        of = (sfem_int *)malloc((size_t)mesh.tets * sizeof *of);
        for (i = 0; i < mesh.tets; ++i) of[i] = mesh.x[3 * mesh.tet[4 * i]] > 0.5;
        for (i = 0; i < mesh.nodes; ++i)
            if (mesh.x[3 * i] < 1e-9) pin[pins++] = i;
        material[0].law = material[1].law = SFEM_LINEAR;
        material[damped].stiffness_damping = 0.01;
        model_def.mesh = &mesh;
        model_def.materials = material;
        model_def.material_count = 2;
        model_def.tet_material = of;
        must(sfem_model_create(&model_def, &model, &err), &err);
        damage.toughness = 20;
        def.damage = &damage;
        def.pins = pin;
        def.pin_count = pins;
        def.gravity[2] = -20;
        must(sfem_body_create(model, &def, &body, &err), &err);
        for (k = 0; k < 60; ++k) {
            if (k == 10) must(sfem_body_cut(body, from, to, NULL, &err), &err);
            must(sfem_body_step(body, 1 / 60.0, &err), &err);
            assert_true(fabs(sfem_body_fracture(body).error) < 0.02 * sfem_body_fracture(body).scale);
        }
        sfem_body_free(body);
        sfem_model_free(model);
        sfem_mesh_free(&mesh);
        free(of);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_jerked_neohookean_body_stays_in_its_place),
        cmocka_unit_test(materials_of_their_own_damping_break_and_stay_finite),
        cmocka_unit_test(a_bent_bar_keeps_its_energy_where_it_is_corrected),
        cmocka_unit_test(a_bar_that_is_pulled_apart),
        cmocka_unit_test(a_plate_that_is_struck),
        cmocka_unit_test(a_ball_that_is_cut_as_it_spins),
        cmocka_unit_test(strips_of_cells_and_of_scattered_nodes),
        cmocka_unit_test(slow_tearing_loses_nothing_in_rejected_steps),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
