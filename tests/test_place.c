/* Bodies that are placed: the rest shape rotated and moved; and normals for rendering. */
#include "support.h"
#include "blocks.h"
#include "linear.h"

enum { MAX_NODES = 256 };

typedef struct bar {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_int pins[64], pin_count;
} bar;

/* A bar along x, jittered, its mesh moved by r and t (NULL: not). */
static bar make_bar(sfem_law law, const double *r, const double *t)
{
    static const sfem_int cells[3] = {6, 2, 2};
    static const sfem_real size[3] = {0.6, 0.2, 0.2};
    sfem_model_def def = sfem_default_model_def();
    uint64_t random = 11;
    sfem_error err;
    sfem_int i;
    int c;
    bar b;
    memset(&b, 0, sizeof b);
    assert_ok(block_mesh(cells, size, 0.01, &random, &b.mesh, &err), err);
    assert_true(b.mesh.nodes <= MAX_NODES);
    b.pin_count = block_clamp(cells, b.pins);
    for (i = 0; r && i < b.mesh.nodes; ++i) {
        double x[3];
        memcpy(x, b.mesh.x + 3 * i, sizeof x);
        for (c = 0; c < 3; ++c) b.mesh.x[3 * i + c] = r[3 * c] * x[0] + r[3 * c + 1] * x[1] + r[3 * c + 2] * x[2] + t[c];
    }
    def.mesh = &b.mesh;
    def.material.young = 1e5;
    def.material.law = law;
    assert_ok(sfem_model_create(&def, &b.model, &err), err);
    return b;
}

static void drop_bar(bar *b)
{
    sfem_model_free(b->model);
    sfem_mesh_free(&b->mesh);
}

/* R = Rz(a) Ry(b) Rx(c) */
static void rotation(double a, double b, double c, double r[9])
{
    const double ca = cos(a), sa = sin(a), cb = cos(b), sb = sin(b), cc = cos(c), sc = sin(c);
    const double m[9] = {ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc,
                         sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc,
                         -sb,     cb * sc,                cb * cc};
    memcpy(r, m, sizeof m);
}

static const double by[3] = {3, -7, 0.5};

static void a_placed_body_is_the_rest_shape_at_rest(void **state)
{
    static const sfem_integrator integrator[] = {SFEM_PQR, SFEM_KR_ALPHA, SFEM_CENTRAL, SFEM_NEWMARK, SFEM_BACKWARD_EULER};
    static const sfem_law law[] = {SFEM_COROTATIONAL, SFEM_NEOHOOKEAN};
    double r[9], x[3 * MAX_NODES], v[3 * MAX_NODES], later[3 * MAX_NODES], zero[3 * MAX_NODES];
    size_t k;
    int i, c, l;
    (void)state;
    memset(zero, 0, sizeof zero);
    rotation(2.1, -0.8, 3, r);
    for (l = 0; l < 2; ++l)
        for (k = 0; k < TEST_COUNT(integrator); ++k) {
            bar b = make_bar(law[l], NULL, NULL);
            sfem_body_def def = sfem_default_body_def();
            sfem_body *body = NULL;
            sfem_error err;
            def.integrator = integrator[k];
            def.gravity[2] = -9.81;
            assert_ok(sfem_body_create(b.model, &def, &body, &err), err);
            for (i = 0; i < 5; ++i) assert_ok(sfem_body_step(body, 1e-4, &err), err); /* it is somewhere, and moves */
            assert_ok(sfem_body_place(body, r, by, &err), err);
            sfem_body_positions(body, x);
            sfem_body_velocities(body, v);
            assert_all_near(v, zero, 3 * b.mesh.nodes, 0, 0);
            for (i = 0; i < b.mesh.nodes; ++i)
                for (c = 0; c < 3; ++c) {
                    const double *X = b.mesh.x + 3 * i;
                    assert_near(x[3 * i + c], r[3 * c] * X[0] + r[3 * c + 1] * X[1] + r[3 * c + 2] * X[2] + by[c], 0, 1e-14);
                }
            assert_near(sfem_body_energy(body).elastic, 0, 0, 1e-12); /* rounding: E V eps is 5e-13 J */
            assert_near(sfem_body_energy(body).kinetic, 0, 0, 0);
            assert_near(sfem_body_time(body), 5e-4, 1e-12, 0);
            assert_ok(sfem_body_set_gravity(body, zero, &err), err);
            for (i = 0; i < 10; ++i) assert_ok(sfem_body_step(body, 1e-4, &err), err);
            sfem_body_positions(body, later);
            assert_all_near(later, x, 3 * b.mesh.nodes, 0, 1e-12);
            sfem_body_free(body);
            drop_bar(&b);
        }
}

/* The independent route: a body whose mesh was moved before its model was made. */
static void a_placed_body_moves_as_one_whose_mesh_was_moved(void **state)
{
    static const sfem_integrator integrator[] = {SFEM_PQR, SFEM_BACKWARD_EULER, SFEM_NEWMARK};
    double r[9], x[2][3 * MAX_NODES];
    unsigned char axes[64];
    size_t k;
    int i, way, partly;
    (void)state;
    rotation(1.2, 0.4, -2, r);
    for (partly = 0; partly < 2; ++partly)
        for (k = 0; k < TEST_COUNT(integrator); ++k) {
            for (way = 0; way < 2; ++way) {
                bar b = make_bar(SFEM_COROTATIONAL, way ? r : NULL, by);
                sfem_body_def def = sfem_default_body_def();
                sfem_body *body = NULL;
                sfem_error err;
                for (i = 0; i < 64; ++i) axes[i] = partly && i % 3 == 0 ? SFEM_AXIS_Z : SFEM_AXIS_ALL;
                def.integrator = integrator[k];
                def.accuracy = 1e-20;
                def.newton.tolerance = 1e-12;
                def.pins = b.pins;
                def.pin_count = b.pin_count;
                def.pin_axes = axes;
                def.gravity[1] = -9.81;
                assert_ok(sfem_body_create(b.model, &def, &body, &err), err);
                if (!way) assert_ok(sfem_body_place(body, r, by, &err), err);
                for (i = 0; i < 20; ++i) assert_ok(sfem_body_step(body, 1.0 / 60, &err), err);
                sfem_body_positions(body, x[way]);
                assert_true(fabs(sfem_body_displacement(body)[3 * (b.mesh.nodes - 1) + 1]) > 0.01);
                sfem_body_free(body);
                drop_bar(&b);
            }
            assert_all_near(x[0], x[1], 3 * 63, 0, 1e-7);
        }
}

static void what_a_body_cannot_bear_is_refused(void **state)
{
    bar linear = make_bar(SFEM_LINEAR, NULL, NULL), other = make_bar(SFEM_COROTATIONAL, NULL, NULL);
    sfem_body_def def = sfem_default_body_def();
    double r[9], bad[9], before[3 * MAX_NODES], x[3 * MAX_NODES];
    const double far[3] = {1, NAN, 0};
    sfem_body *body = NULL;
    sfem_error err;
    int i;
    (void)state;
    rotation(0.1, 0, 0, r);
    assert_ok(sfem_body_create(linear.model, &def, &body, &err), err);
    assert_ok(sfem_body_place(body, NULL, by, &err), err);
    sfem_body_positions(body, before);
    assert_near(before[0], linear.mesh.x[0] + by[0], 1e-15, 0);
    assert_status(sfem_body_place(body, r, by, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "tet 0 has the linear law, which does not know rotations");
    sfem_body_positions(body, x);
    assert_memory_equal(x, before, sizeof(double) * 3 * (size_t)linear.mesh.nodes);
    sfem_body_free(body);
    assert_ok(sfem_body_create(other.model, &def, &body, &err), err);
    assert_ok(sfem_body_place(body, r, by, &err), err);
    sfem_body_positions(body, before);
    for (i = 0; i < 9; ++i) bad[i] = -r[i];
    assert_status(sfem_body_place(body, bad, NULL, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "not a proper rotation");
    for (i = 0; i < 9; ++i) bad[i] = (1 + 1e-5) * r[i];
    assert_status(sfem_body_place(body, bad, NULL, &err), SFEM_BAD_ARGUMENT);
    memset(bad, 0, sizeof bad);
    assert_status(sfem_body_place(body, bad, NULL, &err), SFEM_BAD_ARGUMENT);
    bad[4] = INFINITY;
    assert_status(sfem_body_place(body, bad, NULL, &err), SFEM_NOT_FINITE);
    assert_status(sfem_body_place(body, NULL, far, &err), SFEM_NOT_FINITE);
    sfem_body_positions(body, x);
    assert_memory_equal(x, before, sizeof(double) * 3 * (size_t)other.mesh.nodes);
    for (i = 0; i < 9; ++i) bad[i] = (1 + 1e-7) * r[i]; /* taken, and made exact */
    assert_ok(sfem_body_place(body, bad, by, &err), err);
    sfem_body_positions(body, x);
    assert_all_near(x, before, 3 * other.mesh.nodes, 0, 1e-14);
    sfem_body_free(body);
    def.frame = SFEM_FRAME_REST;
    assert_ok(sfem_body_create(other.model, &def, &body, &err), err);
    assert_status(sfem_body_place(body, r, NULL, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "SFEM_FRAME_REST");
    sfem_body_free(body);
    drop_bar(&linear);
    drop_bar(&other);
}

/* A handle keeps its target, and pulls the body back to it; a sleeping body wakes. */
static void handles_keep_their_targets_and_sleepers_wake(void **state)
{
    bar b = make_bar(SFEM_COROTATIONAL, NULL, NULL);
    sfem_body_def def = exact_body_def();
    const double up[3] = {0, 0, 0.3};
    sfem_body *body = NULL;
    sfem_int handle;
    sfem_error err;
    double x[3];
    int i;
    (void)state;
    def.mass_damping = 5;
    def.sleep_tolerance = 0.02;
    assert_ok(sfem_body_create(b.model, &def, &body, &err), err);
    assert_ok(sfem_body_grab_node(body, 0, &handle, &err), err);
    for (i = 0; i < 120; ++i) assert_ok(sfem_body_step(body, 1.0 / 60, &err), err);
    assert_true(sfem_body_is_asleep(body));
    assert_ok(sfem_body_place(body, NULL, up, &err), err);
    assert_false(sfem_body_is_asleep(body));
    sfem_body_handle_position(body, handle, x);
    assert_near(x[2], b.mesh.x[2] + 0.3, 1e-12, 0);
    assert_ok(sfem_body_step(body, 1.0 / 60, &err), err);
    sfem_body_handle_position(body, handle, x);
    assert_near(x[2], b.mesh.x[2], 1e-9, 1e-12);
    sfem_body_free(body);
    drop_bar(&b);
}

/* By hand, in double: the area vectors of a node's triangles. */
static void expected_normals(const sfem_surface *s, const double *x, sfem_int nodes, double *n)
{
    sfem_int i;
    int k, c;
    memset(n, 0, 3 * (size_t)nodes * sizeof *n);
    for (i = 0; i < s->triangles; ++i) {
        const double *p = x + 3 * s->tri[3 * i], *q = x + 3 * s->tri[3 * i + 1], *r = x + 3 * s->tri[3 * i + 2];
        for (c = 0; c < 3; ++c) {
            const int d = (c + 1) % 3, e = (c + 2) % 3;
            for (k = 0; k < 3; ++k)
                n[3 * s->tri[3 * i + k] + c] += (q[d] - p[d]) * (r[e] - p[e]) - (q[e] - p[e]) * (r[d] - p[d]);
        }
    }
    for (i = 0; i < nodes; ++i) {
        const double size = sqrt(n[3 * i] * n[3 * i] + n[3 * i + 1] * n[3 * i + 1] + n[3 * i + 2] * n[3 * i + 2]);
        for (c = 0; size > 0 && c < 3; ++c) n[3 * i + c] /= size;
    }
}

static void normals_are_those_of_the_present_surface(void **state)
{
    bar b = make_bar(SFEM_COROTATIONAL, NULL, NULL);
    sfem_body_def def = sfem_default_body_def();
    double x[3 * MAX_NODES], n[3 * MAX_NODES], change = 0;
    float got[MAX_NODES][7], rest[MAX_NODES][3];
    sfem_surface surface;
    sfem_body *body = NULL;
    sfem_error err;
    int i, c, inside = 0;
    (void)state;
    def.gravity[2] = -9.81;
    def.pins = b.pins;
    def.pin_count = b.pin_count;
    assert_ok(sfem_mesh_surface(&b.mesh, NULL, &surface, &err), err);
    assert_ok(sfem_body_create(b.model, &def, &body, &err), err);
    sfem_body_normals(body, &surface, rest[0], sizeof rest[0]);
    for (i = 0; i < 10; ++i) assert_ok(sfem_body_step(body, 1.0 / 60, &err), err);
    for (i = 0; i < b.mesh.nodes; ++i)
        for (c = 0; c < 7; ++c) got[i][c] = 77;
    sfem_body_normals(body, &surface, &got[0][2], sizeof got[0]);
    sfem_body_positions(body, x);
    expected_normals(&surface, x, b.mesh.nodes, n);
    for (i = 0; i < b.mesh.nodes; ++i) {
        inside += n[3 * i] == 0 && n[3 * i + 1] == 0 && n[3 * i + 2] == 0;
        for (c = 0; c < 7; ++c) {
            if (c < 2 || c > 4) assert_true(got[i][c] == 77);
            else assert_near(got[i][c], n[3 * i + c - 2], 0, 1e-6);
        }
        for (c = 0; c < 3; ++c) change = fmax(change, fabs((double)got[i][c + 2] - (double)rest[i][c]));
    }
    assert_int_equal(inside, 5); /* the nodes inside the bar */
    assert_true(change > 0.05);
    sfem_surface_normals(&surface, x, b.mesh.nodes, rest[0], sizeof rest[0]);
    for (i = 0; i < b.mesh.nodes; ++i)
        for (c = 0; c < 3; ++c) assert_true(rest[i][c] == got[i][c + 2]);
    sfem_body_free(body);
    sfem_surface_free(&surface);
    drop_bar(&b);
}

/* On a geodesic sphere normals are radial; of a surface of its own x; of tiny ones and of folded ones. */
static void normals_of_spheres_are_radial_and_outward(void **state)
{
    static float n[2000][3];
    sfem_mesh mesh;
    sfem_surface s;
    sfem_error err;
    sfem_int i, tri[6] = {0, 1, 2, 0, 2, 1};
    double flat[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0}, tiny = 1e-12;
    int c, k;
    (void)state;
    assert_ok(sfem_mesh_ball(1, 5, NULL, &mesh, &err), err);
    assert_ok(sfem_mesh_surface(&mesh, NULL, &s, &err), err);
    assert_true(mesh.nodes < 2000);
    for (k = 0; k < 2; ++k) {
        int outside = 0;
        sfem_surface_normals(&s, mesh.x, mesh.nodes, n[0], sizeof n[0]);
        for (i = 0; i < mesh.nodes; ++i) {
            const double *x = mesh.x + 3 * i, r = sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]) / (k ? tiny : 1);
            double dot = 0, size = 0;
            for (c = 0; c < 3; ++c) dot += x[c] / (k ? tiny : 1) * (double)n[i][c], size += (double)n[i][c] * (double)n[i][c];
            outside += r > 0.999;
            assert_near(size, r > 0.999, 1e-6, 0);
            if (r > 0.999) assert_true(dot > 0.999);
        }
        assert_int_equal(outside, 252);
        for (i = 0; i < 3 * mesh.nodes; ++i) mesh.x[i] *= tiny;
    }
    sfem_surface_free(&s);
    sfem_mesh_free(&mesh);
    memset(&s, 0, sizeof s);
    s.triangles = 1;
    s.tri = tri;
    s.x = flat;
    s.nodes = 3;
    sfem_surface_normals(&s, NULL, 3, n[0], sizeof n[0]);
    for (i = 0; i < 3; ++i) assert_true(n[i][0] == 0 && n[i][1] == 0 && n[i][2] == 1);
    s.triangles = 2; /* and back: no area */
    sfem_surface_normals(&s, NULL, 3, n[0], sizeof n[0]);
    for (i = 0; i < 3; ++i) assert_true(n[i][0] == 0 && n[i][1] == 0 && n[i][2] == 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_placed_body_is_the_rest_shape_at_rest),
        cmocka_unit_test(a_placed_body_moves_as_one_whose_mesh_was_moved),
        cmocka_unit_test(what_a_body_cannot_bear_is_refused),
        cmocka_unit_test(handles_keep_their_targets_and_sleepers_wake),
        cmocka_unit_test(normals_are_those_of_the_present_surface),
        cmocka_unit_test(normals_of_spheres_are_radial_and_outward),
    };
    return run_all_tests(tests);
}
