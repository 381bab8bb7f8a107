/* Render surfaces that follow coarse bodies: places and normals by other routes, hostile input, and broken bodies. */
#include "support.h"

static sfem_mesh ball(sfem_real radius, sfem_int rings)
{
    sfem_mesh m;
    sfem_error err;
    assert_ok(sfem_mesh_ball(radius, rings, NULL, &m, &err), err);
    return m;
}

/* A geodesic sphere: the surface of a ball, with points of its own. */
static sfem_surface sphere(sfem_real radius, sfem_int rings)
{
    sfem_mesh m = ball(radius, rings);
    sfem_surface s;
    sfem_error err;
    sfem_int *number = (sfem_int *)calloc((size_t)m.nodes, sizeof *number), i;
    assert_ok(sfem_mesh_surface(&m, NULL, &s, &err), err);
    s.x = (sfem_real *)malloc(3 * (size_t)m.nodes * sizeof *s.x);
    for (i = 0; i < 3 * s.triangles; ++i) {
        if (!number[s.tri[i]]) {
            memcpy(s.x + 3 * (size_t)s.nodes, m.x + 3 * (size_t)s.tri[i], 3 * sizeof *s.x);
            number[s.tri[i]] = ++s.nodes;
        }
        s.tri[i] = number[s.tri[i]] - 1;
    }
    free(number);
    sfem_mesh_free(&m);
    return s;
}

static void drop(sfem_surface *s)
{
    free(s->x);
    s->x = NULL;
    sfem_surface_free(s);
}

static sfem_embed_def def_of(const sfem_surface *s)
{
    sfem_embed_def d = sfem_default_embed_def();
    d.points = s->nodes;
    d.x = s->x;
    d.triangles = s->triangles;
    d.tri = s->tri;
    return d;
}

static sfem_embed *embed(const sfem_mesh *m, const sfem_surface *s)
{
    const sfem_embed_def d = def_of(s);
    sfem_embed *e = NULL;
    sfem_error err;
    assert_ok(sfem_embed_create(m, &d, &e, &err), err);
    return e;
}

static void random_points(test_random *r, sfem_int count, double size, double *x)
{
    sfem_int i;
    for (i = 0; i < 3 * count; ++i) x[i] = random_uniform(r, -size, size);
}

/* ---- every point is taken ---- */

static void all_points_of_a_sphere_around_a_ball_are_taken(void **state)
{
    enum { POINTS = 2000 };
    static double x[3 * POINTS];
    sfem_mesh m = ball(1, 4);
    sfem_embed_def d = sfem_default_embed_def();
    sfem_embed *e;
    sfem_embed_info info;
    test_random r = {7};
    sfem_error err;
    sfem_int i, k, t, tet, outside = 0;
    double farthest = 0;
    (void)state;
    for (i = 0; i < POINTS; ++i) {
        double size = 0;
        for (k = 0; k < 3; ++k) x[3 * i + k] = random_normal(&r), size += x[3 * i + k] * x[3 * i + k];
        for (k = 0; k < 3; ++k) x[3 * i + k] *= 1.001 / sqrt(size);
    }
    d.points = POINTS;
    d.x = x;
    assert_ok(sfem_embed_create(&m, &d, &e, &err), err);
    info = sfem_embed_get_info(e);
    for (i = 0; i < POINTS; ++i) {
        double b[4], distance, sum = 0, at[3] = {0, 0, 0};
        sfem_embed_point(e, i, &tet, b, &distance);
        assert_in_range(tet, 0, m.tets - 1);
        for (k = 0; k < 4; ++k) {
            sum += b[k];
            for (t = 0; t < 3; ++t) at[t] += b[k] * m.x[3 * m.tet[4 * tet + k] + t];
        }
        assert_near(sum, 1, 0, 1e-14);
        assert_all_near(at, x + 3 * i, 3, 1e-13, 0);
        outside += distance > 0;
        farthest = fmax(farthest, distance);
        assert_int_equal(sfem_mesh_locate(&m, NULL, x + 3 * i, NULL, NULL), distance <= 0);
    }
    assert_int_equal(info.outside, POINTS); /* the ball's faces are chords */
    assert_int_equal(info.outside, outside);
    assert_near(info.distance, farthest, 0, 0);
    assert_true(info.distance > 0.001 && info.distance < 0.05);
    sfem_embed_point(e, info.farthest, NULL, NULL, &farthest);
    assert_near(info.distance, farthest, 0, 0);
    sfem_embed_destroy(e);
    sfem_mesh_free(&m);
}

/* The distance of a point from a triangle by minimising over its area: slow, and no formula of the library's. */
static double distance_of(const double *p, const double *a, const double *b, const double *c)
{
    double low[2] = {0, 0}, best = 1e300, s, t, step = 0.1, at[2] = {0, 0};
    int i, j, k, round;
    for (round = 0; round < 12; ++round, step /= 4) {
        const double s0 = round ? at[0] - 5 * step : 0, t0 = round ? at[1] - 5 * step : 0;
        for (i = 0; i <= 10; ++i)
            for (j = 0; j <= 10; ++j) {
                double d = 0;
                s = fmin(1, fmax(0, s0 + i * step));
                t = fmin(1 - s, fmax(0, t0 + j * step));
                for (k = 0; k < 3; ++k) {
                    const double v = p[k] - a[k] - s * (b[k] - a[k]) - t * (c[k] - a[k]);
                    d += v * v;
                }
                if (d < best) best = d, low[0] = s, low[1] = t;
            }
        at[0] = low[0], at[1] = low[1];
    }
    return sqrt(best);
}

static void tets_are_those_of_locate_and_outside_the_nearest(void **state)
{
    enum { POINTS = 300 };
    double x[3 * POINTS];
    sfem_mesh m = ball(1, 2);
    sfem_surface s;
    sfem_embed_def d = sfem_default_embed_def();
    sfem_embed *e;
    test_random r = {3};
    sfem_error err;
    sfem_int i, k, tet, other;
    (void)state;
    random_points(&r, POINTS, 2, x);
    memcpy(x, m.x, sizeof(double) * 3 * 20);   /* on nodes */
    for (i = 20; i < 40; ++i)                  /* on edges */
        for (k = 0; k < 3; ++k) x[3 * i + k] = (m.x[3 * m.tet[4 * i] + k] + m.x[3 * m.tet[4 * i + 1] + k]) / 2;
    d.points = POINTS;
    d.x = x;
    assert_ok(sfem_mesh_surface(&m, NULL, &s, &err), err);
    assert_ok(sfem_embed_create(&m, &d, &e, &err), err);
    for (i = 0; i < POINTS; ++i) {
        double b[4], c[4], distance, least = 1e300, own = 1e300;
        sfem_embed_point(e, i, &tet, b, &distance);
        if (sfem_mesh_locate(&m, NULL, x + 3 * i, &other, c)) {
            assert_int_equal(tet, other);
            assert_memory_equal(b, c, sizeof b);
            continue;
        }
        for (k = 0; k < s.triangles; ++k) {
            const double now = distance_of(x + 3 * i, m.x + 3 * s.tri[3 * k], m.x + 3 * s.tri[3 * k + 1],
                                           m.x + 3 * s.tri[3 * k + 2]);
            if (now < least) least = now;
            if (s.tet[k] == tet && now < own) own = now;
        }
        assert_near(distance, least, 0, 1e-6);
        assert_near(own, least, 0, 1e-6);
    }
    sfem_embed_destroy(e);
    sfem_surface_free(&s);
    sfem_mesh_free(&m);
}

static void one_tet_takes_every_point(void **state)
{
    sfem_real x[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1}, p[9] = {0.1, 0.1, 0.1, -1, -1, -1, 50, 0, 0}, b[4], out[9];
    const sfem_real u[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1}; /* twice the size */
    sfem_int tet[4] = {0, 1, 2, 3};
    sfem_mesh m;
    sfem_embed_def d = sfem_default_embed_def();
    sfem_embed *e;
    sfem_error err;
    sfem_real distance;
    (void)state;
    assert_ok(sfem_mesh_copy(4, x, 1, tet, NULL, &m, &err), err);
    d.points = 3;
    d.x = p;
    assert_ok(sfem_embed_create(&m, &d, &e, &err), err);
    sfem_embed_point(e, 1, NULL, b, &distance);
    assert_near(distance, sqrt(3.0), 1e-15, 0);
    assert_near(b[0], 4, 1e-15, 0);
    sfem_embed_point(e, 2, NULL, b, &distance);
    assert_near(distance, 49, 1e-15, 0);
    sfem_embed_positions(e, u, out, NULL);
    assert_near(out[6], 100, 1e-15, 0);
    assert_near(out[3], -2, 1e-15, 0);
    sfem_embed_destroy(e);
    sfem_mesh_free(&m);
}

/* ---- places and normals ---- */

/* u = A X + t - X at the nodes */
static void affine(const sfem_mesh *m, const double a[9], const double t[3], double *u)
{
    sfem_int i, c, k;
    for (i = 0; i < m->nodes; ++i)
        for (c = 0; c < 3; ++c) {
            u[3 * i + c] = t[c] - m->x[3 * i + c];
            for (k = 0; k < 3; ++k) u[3 * i + c] += a[3 * c + k] * m->x[3 * i + k];
        }
}

static void affine_motions_are_exact_to_rounding(void **state)
{
    static const double shear[9] = {1.5, 0.3, -0.2, 0.1, 0.7, 0.4, -0.6, 0.2, 1.1}, shift[3] = {3, -5, 7};
    sfem_mesh m = ball(1, 3);
    sfem_surface s = sphere(1.3, 8); /* half of the points are outside */
    sfem_embed *e = embed(&m, &s);
    double *u = (double *)malloc(3 * (size_t)m.nodes * sizeof *u);
    double *x = (double *)malloc(6 * (size_t)s.nodes * sizeof *x), *n = x + 3 * s.nodes, worst = 0, turned = 0;
    float *f = (float *)malloc(8 * (size_t)s.nodes * sizeof *f);
    double cof[9];
    sfem_int i, c, k;
    (void)state;
    for (i = 0; i < s.nodes; i += 2)
        for (c = 0; c < 3; ++c) s.x[3 * i + c] *= 0.5;
    sfem_embed_destroy(e);
    e = embed(&m, &s);
    memset(u, 0, 3 * (size_t)m.nodes * sizeof *u);
    sfem_embed_positions(e, u, x, n);
    assert_memory_equal(x, s.x, 3 * (size_t)s.nodes * sizeof *x); /* at rest to the bit */
    affine(&m, shear, shift, u);
    for (c = 0; c < 9; ++c) {
        const int i1 = (c / 3 + 1) % 3, i2 = (c / 3 + 2) % 3, j1 = (c + 1) % 3, j2 = (c + 2) % 3;
        cof[c] = shear[3 * i1 + j1] * shear[3 * i2 + j2] - shear[3 * i1 + j2] * shear[3 * i2 + j1];
    }
    for (i = 0; i < s.nodes; ++i) {
        double rest[3], wanted[3] = {0, 0, 0}, now[3], size = 0;
        for (c = 0; c < 3; ++c) rest[c] = n[3 * i + c];
        for (c = 0; c < 3; ++c)
            for (k = 0; k < 3; ++k) wanted[c] += cof[3 * c + k] * rest[k];
        for (c = 0; c < 3; ++c) size += wanted[c] * wanted[c];
        sfem_embed_positions(e, u, i ? NULL : x, n); /* either may be missing */
        for (c = 0; c < 3; ++c) {
            now[c] = shift[c];
            for (k = 0; k < 3; ++k) now[c] += shear[3 * c + k] * s.x[3 * i + k];
            worst = fmax(worst, fabs(now[c] - x[3 * i + c]));
            turned = fmax(turned, fabs(wanted[c] / sqrt(size) - n[3 * i + c]));
        }
        memset(u, 0, 3 * (size_t)m.nodes * sizeof *u);
        sfem_embed_positions(e, u, NULL, n);
        affine(&m, shear, shift, u);
    }
    assert_true(worst < 1e-13);
    assert_true(turned < 1e-13);
    sfem_embed_positions(e, u, x, n);
    sfem_embed_to_floats(e, u, f, f + 3, 8 * sizeof *f);
    for (i = 0; i < s.nodes; ++i)
        for (c = 0; c < 3; ++c) {
            assert_true(f[8 * i + c] == (float)x[3 * i + c]);
            assert_true(f[8 * i + 3 + c] == (float)n[3 * i + c]);
        }
    free(f);
    free(x);
    free(u);
    sfem_embed_destroy(e);
    drop(&s);
    sfem_mesh_free(&m);
}

/* A bar bent to a circle: normals against those of the bent ellipsoid, whose formula is known. */
static void normals_of_a_bent_bar_are_those_of_the_bent_surface(void **state)
{
    static const double axes[3] = {0.95, 0.25, 0.25}, k = 1.2;
    const sfem_int cells[3] = {20, 6, 6};
    const sfem_real size[3] = {2, 0.6, 0.6};
    sfem_mesh m;
    sfem_surface s = sphere(1, 20);
    sfem_embed_def d;
    sfem_embed *e;
    sfem_error err;
    double *u, *n = (double *)malloc(6 * (size_t)s.nodes * sizeof *n), *given = n + 3 * s.nodes, mean = 0, worst = 0;
    sfem_int i, c;
    (void)state;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &m, &err), err);
    u = (double *)malloc(3 * (size_t)m.nodes * sizeof *u);
    for (i = 0; i < m.nodes; ++i) {
        double *x = m.x + 3 * i, t, r;
        for (c = 0; c < 3; ++c) x[c] -= size[c] / 2;
        t = k * x[0], r = 1 / k - x[2];
        u[3 * i] = r * sin(t) - x[0], u[3 * i + 1] = 0, u[3 * i + 2] = 1 / k - r * cos(t) - x[2];
    }
    for (i = 0; i < 3 * s.nodes; ++i) given[i] = 7 * s.x[i] / axes[i % 3], s.x[i] *= axes[i % 3];
    d = def_of(&s);
    d.normal = given;
    assert_ok(sfem_embed_create(&m, &d, &e, &err), err);
    assert_int_equal(sfem_embed_get_info(e).outside, 0);
    sfem_embed_positions(e, u, NULL, n);
    for (i = 0; i < s.nodes; ++i) {
        const double *x = s.x + 3 * i, *g = given + 3 * i, t = k * x[0], stretch = 1 - k * x[2];
        /* F turns by t about y and stretches x by 1 - k z: cof F = R diag(1, stretch, stretch) */
        const double a = g[0], b = g[1] * stretch, z = g[2] * stretch, length = sqrt(a * a + b * b + z * z);
        const double w[3] = {(a * cos(t) - z * sin(t)) / length, b / length, (a * sin(t) + z * cos(t)) / length};
        double dot = 0, angle;
        for (c = 0; c < 3; ++c) dot += w[c] * n[3 * i + c];
        angle = 180 / TEST_PI * acos(fmin(1, dot));
        mean += angle / s.nodes;
        worst = fmax(worst, angle);
    }
    assert_true(mean < 0.1); /* measured .07 and 1.4; of each tet's own F 1.3 and 5, of the triangles .9 and 4 */
    assert_true(worst < 1.5);
    free(n);
    free(u);
    sfem_embed_destroy(e);
    drop(&s);
    sfem_mesh_free(&m);
}

static void threads_give_the_same_bits_and_apply_allocates_nothing(void **state)
{
    sfem_mesh m = ball(1, 8);
    sfem_surface s = sphere(1.01, 24);
    double *u = (double *)malloc(3 * (size_t)m.nodes * sizeof *u);
    double *x = (double *)malloc(12 * (size_t)s.nodes * sizeof *x);
    test_random r = {5};
    sfem_int threads, i;
    (void)state;
    for (i = 0; i < 3 * m.nodes; ++i) u[i] = random_uniform(&r, -0.05, 0.05);
    for (threads = 1; threads <= 8; ++threads) {
        test_memory memory = {0};
        sfem_embed_def d = def_of(&s);
        sfem_embed *e;
        sfem_error err;
        double *to = x + (threads > 1 ? 6 * s.nodes : 0);
        size_t calls;
        d.allocator = test_allocator(&memory);
        d.exec = thread_exec(threads);
        assert_ok(sfem_embed_create(&m, &d, &e, &err), err);
        calls = memory.calls;
        sfem_embed_positions(e, u, to, to + 3 * s.nodes);
        assert_int_equal(memory.calls, calls);
        assert_true(memory.bytes >= sfem_embed_get_info(e).bytes);
        assert_true((double)memory.bytes < 1.05 * (double)sfem_embed_get_info(e).bytes + 4096);
        assert_memory_equal(x, to, 6 * (size_t)s.nodes * sizeof *x);
        sfem_embed_destroy(e);
        assert_no_leak(memory);
    }
    free(x);
    free(u);
    drop(&s);
    sfem_mesh_free(&m);
}

/* ---- hostile input ---- */

static void wrong_input_is_named(void **state)
{
    sfem_mesh m = ball(1, 2), broken = m;
    sfem_real x[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0}, n[12] = {0}; /* the last point is the first again */
    sfem_int tri[6] = {0, 1, 2, 0, 1, 1}, k; /* the second triangle has no area */
    sfem_embed_def d = sfem_default_embed_def();
    sfem_embed *e = NULL;
    sfem_error err;
    double out[12], u[3 * 200] = {0}, b[2][4];
    (void)state;
    assert_status(sfem_embed_create(&m, &d, &e, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "no points");
    d.points = 4;
    d.x = x;
    d.triangles = 2;
    assert_status(sfem_embed_create(&m, &d, &e, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "2 triangles without an array");
    d.tri = tri;
    tri[4] = 4;
    assert_status(sfem_embed_create(&m, &d, &e, &err), SFEM_BAD_MESH);
    assert_names(err, "triangle 1 names point 4, not in 0 .. 3");
    tri[4] = -1;
    assert_status(sfem_embed_create(&m, &d, &e, &err), SFEM_BAD_MESH);
    tri[4] = 1;
    for (k = 0; k < 2; ++k) {
        x[7] = k ? NAN : -INFINITY;
        assert_status(sfem_embed_create(&m, &d, &e, &err), SFEM_NOT_FINITE);
        assert_int_equal(err.node, 2);
        assert_names(err, "point 2 is not finite");
    }
    x[7] = -1e200;
    assert_status(sfem_embed_create(&m, &d, &e, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "beyond 1e100");
    x[7] = 1;
    d.normal = n;
    n[4] = NAN;
    assert_status(sfem_embed_create(&m, &d, &e, &err), SFEM_NOT_FINITE);
    assert_names(err, "normal of point 1");
    d.normal = NULL;
    broken.tets = 0;
    assert_status(sfem_embed_create(&broken, &d, &e, &err), SFEM_BAD_MESH);
    assert_null(e);
    assert_ok(sfem_embed_create(&m, &d, &e, &err), err);
    sfem_embed_point(e, 0, NULL, b[0], NULL);
    sfem_embed_point(e, 3, NULL, b[1], NULL);
    assert_memory_equal(b[0], b[1], sizeof b[0]); /* points at one place go together, and share a normal */
    assert_in_range(m.nodes, 1, 200);
    sfem_embed_positions(e, u, NULL, out);
    assert_near(out[11], 1, 0, 0);
    assert_memory_equal(out, out + 9, 3 * sizeof *out);
    sfem_embed_destroy(e);
    sfem_embed_destroy(NULL);
    sfem_mesh_free(&m);
}

static void a_surface_much_larger_than_the_mesh_stays_finite(void **state)
{
    sfem_mesh m = ball(1, 2);
    sfem_surface s = sphere(1e6, 6);
    double *u = (double *)calloc(3 * (size_t)m.nodes, sizeof *u), *x = (double *)malloc(6 * (size_t)s.nodes * sizeof *x);
    static const double turn[9] = {0, -1, 0, 1, 0, 0, 0, 0, 1}, none[3] = {0, 0, 0};
    sfem_embed *e = embed(&m, &s);
    sfem_int i, c;
    (void)state;
    assert_int_equal(sfem_embed_get_info(e).outside, s.nodes);
    assert_near(sfem_embed_get_info(e).distance, 1e6, 1e-5, 0);
    affine(&m, turn, none, u);
    sfem_embed_positions(e, u, x, x + 3 * s.nodes);
    for (i = 0; i < s.nodes; ++i) {
        assert_near(x[3 * i], -s.x[3 * i + 1], 0, 1e-7);
        assert_near(x[3 * i + 1], s.x[3 * i], 0, 1e-7);
        for (c = 0; c < 3; ++c) assert_true(fabs(x[3 * (s.nodes + i) + c]) <= 1 + 1e-12);
    }
    free(u);
    free(x);
    sfem_embed_destroy(e);
    drop(&s);
    sfem_mesh_free(&m);
}

static sfem_status attempt_create(sfem_allocator allocator, void *user, sfem_error *err)
{
    sfem_mesh m = ball(1, 1);
    sfem_surface s = sphere(1.1, 2);
    sfem_embed_def d = def_of(&s);
    sfem_embed *e = NULL;
    sfem_status status;
    (void)user;
    d.allocator = allocator;
    status = sfem_embed_create(&m, &d, &e, err);
    if (status != SFEM_OK) assert_null(e);
    sfem_embed_destroy(e);
    drop(&s);
    sfem_mesh_free(&m);
    return status;
}

static void failing_allocations_leak_nothing(void **state)
{
    (void)state;
    assert_true(fail_every_allocation(attempt_create, NULL) > 15);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(all_points_of_a_sphere_around_a_ball_are_taken),
        cmocka_unit_test(tets_are_those_of_locate_and_outside_the_nearest),
        cmocka_unit_test(one_tet_takes_every_point),
        cmocka_unit_test(affine_motions_are_exact_to_rounding),
        cmocka_unit_test(normals_of_a_bent_bar_are_those_of_the_bent_surface),
        cmocka_unit_test(threads_give_the_same_bits_and_apply_allocates_nothing),
        cmocka_unit_test(wrong_input_is_named),
        cmocka_unit_test(a_surface_much_larger_than_the_mesh_stays_finite),
        cmocka_unit_test(failing_allocations_leak_nothing),
    };
    return run_all_tests(tests);
}
