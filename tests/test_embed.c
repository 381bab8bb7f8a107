/* Render surfaces that follow coarse bodies: places and normals by other routes, hostile input, and broken bodies. */
#include "support.h"
#include "linear.h"

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
    sfem_embed_free(e);
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
    sfem_embed_free(e);
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
    sfem_embed_free(e);
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
    sfem_embed_free(e);
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
    assert_true(turned < 5e-7); /* floats */
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
    sfem_embed_free(e);
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
    sfem_embed_free(e);
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
        sfem_embed_free(e);
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
    broken = ball(1e150, 1); /* at 2e150: the squares of distances from there are not finite */
    for (k = 0; k < 3 * broken.nodes; ++k) broken.x[k] += 2e150;
    assert_status(sfem_embed_create(&broken, &d, &e, &err), SFEM_BAD_ARGUMENT);
    assert_int_equal(err.node, 0);
    assert_names(err, "node 0 of the mesh is at 2e+150 m: beyond 1e100");
    sfem_mesh_free(&broken);
    broken = m;
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
    sfem_embed_free(e);
    sfem_embed_free(NULL);
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
    sfem_embed_free(e);
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
    sfem_embed_free(e);
    drop(&s);
    sfem_mesh_free(&m);
    return status;
}

static void failing_allocations_leak_nothing(void **state)
{
    (void)state;
    assert_true(fail_every_allocation(attempt_create, NULL) > 15);
}

/* ---- broken bodies ---- */

typedef struct broken {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_body *body;
    sfem_embed *embed;
    sfem_embed_pieces pieces;
} broken;

/* The part of space that a node is in: three planes through the middle, by how many are asked for. */
static int part_of(const double *x, int planes)
{
    int part = 0, k;
    for (k = 0; k < planes; ++k) part |= (x[k] + 0.1 * x[(k + 1) % 3] > 0.05) << k;
    return part;
}

/* Breaks all edges between parts of a mesh, which the scene takes, and cuts a surface with it. */
static broken break_body(sfem_mesh mesh, const sfem_embed_def *d, int planes, sfem_real speed)
{
    sfem_model_def model = linear_model_def();
    sfem_body_def body = sfem_default_body_def();
    sfem_damage_def damage = sfem_default_damage_def();
    broken s;
    sfem_error err;
    sfem_int i, round;
    int j, k;
    double *v = (double *)calloc(3 * (size_t)mesh.nodes, sizeof *v);
    memset(&s, 0, sizeof s);
    s.mesh = mesh;
    model.mesh = &s.mesh;
    model.material.young = 1e4;
    model.material.density = 1000;
    damage.line_only = 1;
    body.damage = &damage;
    body.gravity[0] = body.gravity[1] = body.gravity[2] = 0;
    assert_ok(sfem_model_create(&model, &s.model, &err), err);
    assert_ok(sfem_body_create(s.model, &body, &s.body, &err), err);
    for (i = 0; i < s.mesh.nodes; ++i)
        for (k = 0; k < planes; ++k) v[3 * i + k] = part_of(s.mesh.x + 3 * i, planes) >> k & 1 ? speed : -speed;
    for (i = 0; i < s.mesh.tets; ++i)
        for (j = 0; j < 4; ++j)
            for (k = 0; k < j; ++k) {
                const sfem_int a = s.mesh.tet[4 * i + j], b = s.mesh.tet[4 * i + k];
                if (part_of(s.mesh.x + 3 * a, planes) != part_of(s.mesh.x + 3 * b, planes))
                    assert_ok(sfem_body_break_edge(s.body, a, b, &err), err);
            }
    for (round = 0; round < 17; ++round) assert_ok(sfem_body_step(s.body, 1e-3, &err), err);
    assert_ok(sfem_body_set_state(s.body, sfem_body_displacement(s.body), v, &err), err);
    for (round = 0; round < 5; ++round) assert_ok(sfem_body_step(s.body, 1e-3, &err), err);
    free(v);
    assert_ok(sfem_embed_create(&s.mesh, d, &s.embed, &err), err);
    assert_ok(sfem_embed_break(s.embed, s.body, NULL, &s.pieces, &err), err);
    return s;
}

static void drop_broken(broken *s)
{
    sfem_embed_pieces_free(&s->pieces);
    sfem_embed_free(s->embed);
    sfem_body_free(s->body);
    sfem_model_free(s->model);
    sfem_mesh_free(&s->mesh);
}

static int compare_edges(const void *a, const void *b)
{
    const sfem_int *p = (const sfem_int *)a, *q = (const sfem_int *)b;
    if (p[0] != q[0]) return p[0] < q[0] ? -1 : 1;
    return p[1] < q[1] ? -1 : p[1] > q[1];
}

/* Edges that are not used equally in both directions, and those in other than two triangles: by sorting. */
static void count_edges(const sfem_embed_pieces *p, sfem_int *open, sfem_int *many)
{
    sfem_int (*edge)[3] = (sfem_int(*)[3])malloc((3 * (size_t)p->triangles + 1) * sizeof *edge), n = 0, i, j, sum;
    int k;
    *open = *many = 0;
    for (i = 0; i < p->triangles; ++i)
        for (k = 0; k < 3; ++k) {
            const sfem_int a = p->weld[p->tri[3 * i + k]], b = p->weld[p->tri[3 * i + (k + 1) % 3]];
            if (a == b) continue;
            edge[n][0] = a < b ? a : b;
            edge[n][1] = a < b ? b : a;
            edge[n++][2] = a < b ? 1 : -1;
        }
    qsort(edge, (size_t)n, sizeof *edge, compare_edges);
    for (i = 0; i < n; i = j) {
        for (j = i, sum = 0; j < n && !compare_edges(edge[i], edge[j]); ++j) sum += edge[j][2];
        *open += sum != 0;
        *many += j - i != 2;
    }
    free(edge);
}

/* What holds of every cut: corners in one piece, weights, open edges as told, shares, places at rest. */
static void check_pieces(const broken *s, const sfem_embed_def *d)
{
    const sfem_embed_pieces *p = &s->pieces;
    const sfem_int *piece_of = sfem_body_piece_of(s->body);
    sfem_int i, k, open, many, *piece = (sfem_int *)malloc((size_t)(p->vertices + 1) * sizeof *piece);
    double *rest = (double *)calloc(3 * (size_t)p->vertices + 1, sizeof *rest), size = 0;
    int c;
    assert_true(p->triangles >= 0 && p->inner <= p->triangles);
    for (i = 0; i < 3 * s->mesh.nodes; ++i) size = fmax(size, fabs(s->mesh.x[i]));
    for (i = 0; i < 3 * d->points; ++i) size = fmax(size, fabs(d->x[i]));
    for (i = 0; i < p->vertices; ++i) {
        double sum = 0, share = 0, at[3] = {0, 0, 0};
        piece[i] = piece_of[p->support[4 * i]];
        for (c = 0; c < 3; ++c) rest[3 * i + c] = p->arm[3 * i + c];
        for (k = 0; k < 4 && p->support[4 * i + k] >= 0; ++k) {
            const sfem_int node = p->support[4 * i + k];
            assert_int_equal(piece_of[node], piece[i]); /* nothing goes with two pieces */
            sum += p->weight[4 * i + k];
            for (c = 0; c < 3; ++c) rest[3 * i + c] += p->weight[4 * i + k] * s->mesh.x[3 * node + c];
        }
        assert_near(sum, 1, 0, 1e-12);
        for (k = 0; k < 3 && p->point[3 * i + k] >= 0; ++k) {
            share += p->share[3 * i + k];
            assert_true(p->share[3 * i + k] >= 0);
            for (c = 0; c < 3; ++c) at[c] += p->share[3 * i + k] * d->x[3 * p->point[3 * i + k] + c];
        }
        if (k) {
            assert_near(share, 1, 0, 1e-12);
            assert_all_near(at, rest + 3 * i, 3, 0, 1e-11 * size);
        }
        assert_true(p->weld[i] <= i && p->weld[p->weld[i]] == p->weld[i]);
        assert_int_equal(piece[p->weld[i]], piece[i]);
        assert_all_near(rest + 3 * p->weld[i], rest + 3 * i, 3, 0, 1e-11 * size);
    }
    for (i = 0; i < p->triangles; ++i) {
        for (c = 0; c < 3; ++c) {
            assert_in_range(p->tri[3 * i + c], 0, p->vertices - 1);
            assert_int_equal(piece[p->tri[3 * i + c]], piece_of[p->node[i]]);
        }
        if (i < p->triangles - p->inner) assert_in_range(p->source[i], 0, d->triangles - 1);
        else assert_int_equal(p->source[i], -1);
    }
    count_edges(p, &open, &many);
    assert_int_equal(open, p->open_edges);
    free(rest);
    free(piece);
}

/* Volume of each piece at rest, from its own closed surface, by the divergence theorem; areas of the render surface and
 * of the inner faces. */
static void measure(const broken *s, double *volume, double area[2])
{
    const sfem_embed_pieces *p = &s->pieces;
    const sfem_int *piece_of = sfem_body_piece_of(s->body);
    sfem_int i;
    int c, k, j;
    area[0] = area[1] = 0;
    for (i = 0; i < p->triangles; ++i) {
        double x[3][3], n[3], u[3], v[3];
        for (k = 0; k < 3; ++k)
            for (c = 0; c < 3; ++c) {
                const sfem_int w = p->tri[3 * i + k];
                x[k][c] = p->arm[3 * w + c];
                for (j = 0; j < 4 && p->support[4 * w + j] >= 0; ++j)
                    x[k][c] += p->weight[4 * w + j] * s->mesh.x[3 * p->support[4 * w + j] + c];
            }
        for (c = 0; c < 3; ++c) u[c] = x[1][c] - x[0][c], v[c] = x[2][c] - x[0][c];
        for (c = 0; c < 3; ++c) n[c] = u[(c + 1) % 3] * v[(c + 2) % 3] - u[(c + 2) % 3] * v[(c + 1) % 3];
        for (c = 0; c < 3; ++c) volume[piece_of[p->node[i]]] += n[c] * x[0][c] / 6;
        area[p->source[i] < 0] += sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) / 2;
    }
}

static double area_of(const sfem_surface *s)
{
    double sum = 0;
    sfem_int i;
    int c;
    for (i = 0; i < s->triangles; ++i) {
        const double *a = s->x + 3 * s->tri[3 * i], *b = s->x + 3 * s->tri[3 * i + 1], *d = s->x + 3 * s->tri[3 * i + 2];
        double n[3], u[3], v[3];
        for (c = 0; c < 3; ++c) u[c] = b[c] - a[c], v[c] = d[c] - a[c];
        for (c = 0; c < 3; ++c) n[c] = u[(c + 1) % 3] * v[(c + 2) % 3] - u[(c + 2) % 3] * v[(c + 1) % 3];
        sum += sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) / 2;
    }
    return sum;
}

/* A sphere inside a block: each place of the ball belongs to the node with the largest coordinate, so that volumes are
 * also found by points that are thrown. */
static void a_sphere_in_a_broken_block_is_cut_into_closed_pieces(void **state)
{
    const sfem_int cells[3] = {5, 5, 5};
    const sfem_real size[3] = {2, 2, 2};
    sfem_int planes;
    (void)state;
    for (planes = 1; planes <= 3; ++planes) {
        sfem_surface surface = sphere(0.8, 10);
        sfem_embed_def d = def_of(&surface);
        sfem_error err;
        sfem_mesh m;
        broken s;
        double volume[8] = {0}, thrown[8] = {0}, area[2], whole = 0, all = 0;
        sfem_int i, open, many, tet;
        test_random r = {11};
        int c;
        assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &m, &err), err);
        for (i = 0; i < 3 * m.nodes; ++i) m.x[i] -= 1;
        s = break_body(m, &d, planes, 1);
        assert_int_equal(sfem_body_fracture(s.body).pieces, 1 << planes);
        check_pieces(&s, &d);
        count_edges(&s.pieces, &open, &many);
        assert_int_equal(open, 0);
        assert_int_equal(many, 0);
        measure(&s, volume, area);
        assert_near(area[0], area_of(&surface), 1e-9, 0); /* nothing of it is lost or doubled */
        for (i = 0; i < surface.triangles; ++i) {
            const double *a = surface.x + 3 * surface.tri[3 * i], *b = surface.x + 3 * surface.tri[3 * i + 1];
            const double *e = surface.x + 3 * surface.tri[3 * i + 2];
            for (c = 0; c < 3; ++c)
                whole += a[c] * (b[(c + 1) % 3] * e[(c + 2) % 3] - b[(c + 2) % 3] * e[(c + 1) % 3]) / 6;
        }
        for (i = 0; i < 1 << planes; ++i) all += volume[i];
        assert_near(all, whole, 1e-9, 0);
        for (i = 0; i < 40000; ++i) {
            double x[3], b[4];
            int most = 0;
            for (c = 0; c < 3; ++c) x[c] = random_uniform(&r, -0.8, 0.8);
            if (x[0] * x[0] + x[1] * x[1] + x[2] * x[2] > 0.64) continue;
            if (!sfem_mesh_locate(&s.mesh, NULL, x, &tet, b)) continue;
            for (c = 1; c < 4; ++c)
                if (b[c] > b[most]) most = c;
            thrown[sfem_body_piece_of(s.body)[s.mesh.tet[4 * tet + most]]] += 1.6 * 1.6 * 1.6 / 40000;
        }
        for (i = 0; i < 1 << planes; ++i) assert_near(volume[i], thrown[i], 0, 0.03); /* 4 sigma is .03 */
        assert_true(area[1] > 2 * planes * 1.5);
        drop_broken(&s);
        drop(&surface);
    }
}

/* The hardest case for signs: every point of the render surface on a plane of the mesh, and of the cracks. */
static void the_surface_of_the_mesh_itself_is_cut_and_closed(void **state)
{
    const sfem_int cells[3] = {4, 3, 3};
    const sfem_real size[3] = {2, 1.5, 1.5};
    int kind, planes;
    (void)state;
    for (kind = 0; kind < 3; ++kind)
        for (planes = 1; planes <= 3; planes += 2) {
            sfem_embed_def d = sfem_default_embed_def();
            sfem_surface surface;
            sfem_error err;
            sfem_mesh m, copy;
            broken s;
            double volume[64] = {0}, area[2], all = 0, *x;
            sfem_int i, open, many;
            if (kind < 2)
                assert_ok(sfem_mesh_block(cells, size, kind ? SFEM_CELL_6_TETS : SFEM_CELL_5_TETS, NULL, &m, &err), err);
            else
                m = ball(1, 3);
            for (i = 0; kind < 2 && i < 3 * m.nodes; ++i) m.x[i] -= size[i % 3] / 2;
            assert_ok(sfem_mesh_copy(m.nodes, m.x, m.tets, m.tet, NULL, &copy, &err), err);
            assert_ok(sfem_mesh_surface(&m, NULL, &surface, &err), err);
            d.points = copy.nodes;
            d.x = copy.x;
            d.triangles = surface.triangles;
            d.tri = surface.tri;
            s = break_body(m, &d, planes, 1);
            check_pieces(&s, &d);
            count_edges(&s.pieces, &open, &many);
            assert_int_equal(open, 0);
            surface.x = copy.x;
            measure(&s, volume, area);
            for (i = 0; i < 64; ++i) all += volume[i];
            assert_near(all, kind < 2 ? 4.5 : 4.0 / 3 * TEST_PI, 0, kind < 2 ? 1e-4 : 0.25);
            assert_near(area[0], area_of(&surface), 1e-9, 0);
            x = (double *)malloc(3 * (size_t)s.pieces.vertices * sizeof *x);
            sfem_embed_pieces_positions(s.embed, &s.pieces, s.body, x, NULL);
            for (i = 0; i < s.pieces.vertices; ++i) {
                const sfem_int point = s.pieces.point[3 * i];
                const double *u = sfem_body_displacement(s.body) + 3 * point;
                double at[3];
                int c;
                if (s.pieces.share[3 * i] < 1) continue; /* nodes are where the body's are */
                for (c = 0; c < 3; ++c) at[c] = copy.x[3 * point + c] + u[c];
                assert_all_near(x + 3 * i, at, 3, 1e-12, 0);
            }
            free(x);
            surface.x = NULL;
            drop_broken(&s);
            sfem_surface_free(&surface);
            sfem_mesh_free(&copy);
        }
}

static void points_outside_are_cut_with_their_nearest_places(void **state)
{
    double radius;
    (void)state;
    for (radius = 1; radius < 1.5; radius += 0.2) {
        sfem_surface surface = sphere(radius, 13);
        sfem_embed_def d = def_of(&surface);
        broken s = break_body(ball(1, 4), &d, 3, 1);
        double volume[64] = {0}, area[2];
        sfem_int open, many;
        assert_in_range(sfem_body_fracture(s.body).pieces, 8, 64);
        assert_true(sfem_embed_get_info(s.embed).outside > surface.nodes / 2);
        check_pieces(&s, &d);
        count_edges(&s.pieces, &open, &many);
        assert_int_equal(open, 0);
        measure(&s, volume, area);
        assert_near(area[0], area_of(&surface), 1e-9, 0);
        drop_broken(&s);
        drop(&surface);
    }
}

/* Breaks each edge of a ball with a probability, so that there are pieces of single nodes and cracks that end. */
static void random_breaks_make_closed_pieces(void **state)
{
    int run;
    (void)state;
    for (run = 0; run < 3; ++run) {
        sfem_surface surface = sphere(0.9, 7);
        sfem_embed_def d = def_of(&surface);
        sfem_embed_pieces again;
        broken s = break_body(ball(1, 3), &d, 0, 0);
        test_random r = {20 + (uint64_t)run};
        double *volume, area[2], *x, sum = 0, whole = 0, none = 0;
        sfem_int i, open, many;
        sfem_error err;
        int j, k;
        assert_int_equal(s.pieces.triangles, surface.triangles); /* not broken yet */
        assert_int_equal(s.pieces.inner, 0);
        measure(&s, &whole, area);
        assert_int_equal(s.pieces.open_edges, 0);
        for (i = 0; i < s.mesh.tets; ++i)
            for (j = 0; j < 4; ++j)
                for (k = 0; k < j; ++k)
                    if (random_uniform(&r, 0, 1) < 0.4 + 0.1 * run)
                        assert_ok(sfem_body_break_edge(s.body, s.mesh.tet[4 * i + j], s.mesh.tet[4 * i + k], &err), err);
        for (i = 0; i < 17; ++i) assert_ok(sfem_body_step(s.body, 1e-3, &err), err);
        assert_true(sfem_body_fracture(s.body).pieces > 5);
        sfem_embed_pieces_free(&s.pieces);
        assert_ok(sfem_embed_break(s.embed, s.body, NULL, &s.pieces, &err), err);
        check_pieces(&s, &d);
        count_edges(&s.pieces, &open, &many);
        assert_int_equal(open, 0);
        volume = (double *)calloc((size_t)sfem_body_fracture(s.body).pieces, sizeof *volume);
        measure(&s, volume, area);
        assert_near(area[0], area_of(&surface), 1e-9, 0);
        for (i = 0; i < sfem_body_fracture(s.body).pieces; ++i) {
            sum += volume[i];
            none = fmin(none, volume[i]);
        }
        assert_near(sum, whole, 1e-9, 0);
        assert_true(none > -1e-6); /* no piece is inside out */
        x = (double *)malloc(3 * (size_t)s.pieces.vertices * sizeof *x);
        sfem_embed_pieces_positions(s.embed, &s.pieces, s.body, x, NULL);
        for (i = 0; i < 3 * s.pieces.vertices; ++i) assert_true(fabs(x[i]) < 2);
        assert_ok(sfem_embed_break(s.embed, s.body, NULL, &again, &err), err); /* the same again */
        assert_int_equal(again.vertices, s.pieces.vertices);
        assert_int_equal(again.triangles, s.pieces.triangles);
        assert_memory_equal(again.tri, s.pieces.tri, 3 * (size_t)again.triangles * sizeof *again.tri);
        assert_memory_equal(again.arm, s.pieces.arm, 3 * (size_t)again.vertices * sizeof *again.arm);
        sfem_embed_pieces_free(&again);
        free(x);
        free(volume);
        drop_broken(&s);
        drop(&surface);
    }
}

/* Each piece turned and moved as a whole: vertices and normals follow, over the borders of tets of one piece, too. */
static void pieces_that_move_as_wholes_stay_as_they_are(void **state)
{
    static const double turn[2][9] = {{0, -1, 0, 1, 0, 0, 0, 0, 1}, {0.8, 0, 0.6, 0, 1, 0, -0.6, 0, 0.8}};
    sfem_surface surface = sphere(0.9, 9);
    sfem_embed_def d = def_of(&surface);
    broken s = break_body(ball(1, 4), &d, 1, 0);
    const sfem_int *piece_of = sfem_body_piece_of(s.body);
    const sfem_embed_pieces *p = &s.pieces;
    double *u = (double *)malloc(3 * (size_t)s.mesh.nodes * sizeof *u), worst = 0, turned = 0, flat = 0;
    double *x = (double *)malloc(6 * (size_t)p->vertices * sizeof *x), *n = x + 3 * p->vertices;
    float *f = (float *)malloc(8 * (size_t)p->vertices * sizeof *f);
    sfem_error err;
    sfem_int i, k;
    int c, r;
    (void)state;
    for (i = 0; i < s.mesh.nodes; ++i)
        for (c = 0; c < 3; ++c) {
            const double *by = turn[piece_of[i] % 2];
            u[3 * i + c] = 5 * (piece_of[i] % 2) - s.mesh.x[3 * i + c];
            for (r = 0; r < 3; ++r) u[3 * i + c] += by[3 * c + r] * s.mesh.x[3 * i + r];
        }
    assert_ok(sfem_body_set_state(s.body, u, NULL, &err), err);
    sfem_embed_pieces_positions(s.embed, p, s.body, x, n);
    sfem_embed_pieces_to_floats(s.embed, p, s.body, f, f + 4, 8 * sizeof *f);
    for (i = 0; i < p->vertices; ++i) {
        const int piece = piece_of[p->support[4 * i]] % 2, outer = p->normal[3 * i] != 0 || p->normal[3 * i + 1] != 0;
        double rest[3], size = 0;
        for (c = 0; c < 3; ++c) {
            rest[c] = p->arm[3 * i + c];
            for (k = 0; k < 4 && p->support[4 * i + k] >= 0; ++k)
                rest[c] += p->weight[4 * i + k] * s.mesh.x[3 * p->support[4 * i + k] + c];
            size += n[3 * i + c] * n[3 * i + c];
        }
        assert_near(size, 1, 0, 1e-6);
        for (c = 0; c < 3; ++c) {
            double at = 5 * piece, normal = 0, length = 0;
            for (r = 0; r < 3; ++r) {
                at += turn[piece][3 * c + r] * rest[r];
                normal += turn[piece][3 * c + r] * (double)p->normal[3 * i + r];
                length += (double)p->normal[3 * i + r] * (double)p->normal[3 * i + r];
            }
            worst = fmax(worst, fabs(at - x[3 * i + c]));
            if (outer) turned = fmax(turned, fabs(normal / sqrt(length) - n[3 * i + c]));
            assert_near(f[8 * i + c], x[3 * i + c], 0, 1e-6);
            if (outer) flat = fmax(flat, fabs(f[8 * i + 4 + c] - n[3 * i + c])); /* inner ones: of places in floats */
        }
    }
    assert_true(worst < 2e-5);  /* the rotations of >>fragments, whose unit part is some 1e-5 */
    assert_true(turned < 1e-4);
    assert_true(flat < 1e-6);
    free(f);
    free(x);
    free(u);
    drop_broken(&s);
    drop(&surface);
}

static void one_broken_tet_cuts_a_sphere_in_four(void **state)
{
    sfem_real x[12] = {1, 1, 1, 1, -1, -1, -1, 1, -1, -1, -1, 1};
    sfem_int tet[4] = {0, 1, 2, 3}, open, many, i;
    sfem_surface surface = sphere(0.4, 6);
    sfem_embed_def d = def_of(&surface);
    sfem_mesh m;
    sfem_error err;
    double volume[4] = {0}, area[2];
    broken s;
    int j, k;
    (void)state;
    assert_ok(sfem_mesh_copy(4, x, 1, tet, NULL, &m, &err), err);
    s = break_body(m, &d, 0, 0);
    for (j = 0; j < 4; ++j)
        for (k = 0; k < j; ++k) assert_ok(sfem_body_break_edge(s.body, j, k, &err), err);
    for (i = 0; i < 17; ++i) assert_ok(sfem_body_step(s.body, 1e-3, &err), err);
    assert_int_equal(sfem_body_fracture(s.body).pieces, 4);
    sfem_embed_pieces_free(&s.pieces);
    assert_ok(sfem_embed_break(s.embed, s.body, NULL, &s.pieces, &err), err);
    check_pieces(&s, &d);
    count_edges(&s.pieces, &open, &many);
    assert_int_equal(open, 0);
    measure(&s, volume, area);
    for (i = 1; i < 4; ++i) assert_near(volume[i], volume[0], 0.02, 0); /* the geodesic sphere is not the tet's */
    assert_true(volume[0] > 0.06 && volume[0] < 4.0 / 3 * TEST_PI * 0.064 / 4);
    drop_broken(&s);
    drop(&surface);
}

/* Triangles that share no points, as .stl has them: they are one surface where their corners are at one place. */
static void soups_are_cut_as_the_surface_that_they_are(void **state)
{
    sfem_surface surface = sphere(0.9, 5), soup;
    sfem_embed_def d;
    broken s;
    double volume[64] = {0}, area[2];
    sfem_int i, open, many;
    int c;
    (void)state;
    memset(&soup, 0, sizeof soup);
    soup.nodes = 3 * surface.triangles;
    soup.triangles = surface.triangles;
    soup.x = (sfem_real *)malloc(9 * (size_t)soup.triangles * sizeof *soup.x);
    soup.tri = (sfem_int *)malloc(3 * (size_t)soup.triangles * sizeof *soup.tri);
    for (i = 0; i < soup.nodes; ++i) {
        soup.tri[i] = i;
        for (c = 0; c < 3; ++c) soup.x[3 * i + c] = surface.x[3 * surface.tri[i] + c];
    }
    d = def_of(&soup);
    s = break_body(ball(1, 3), &d, 2, 1);
    check_pieces(&s, &d);
    count_edges(&s.pieces, &open, &many);
    assert_int_equal(open, 0);
    measure(&s, volume, area);
    assert_near(area[0], area_of(&surface), 1e-9, 0);
    drop_broken(&s);
    free(soup.tri);
    free(soup.x);
    drop(&surface);
}

/* Half a sphere, and two spheres through each other: nothing is closed for sure, but all else holds. */
static void open_and_crossing_surfaces_are_cut_too(void **state)
{
    int kind;
    (void)state;
    for (kind = 0; kind < 2; ++kind) {
        sfem_surface surface = sphere(0.7, 8), other = sphere(0.7, 8);
        sfem_embed_def d;
        broken s;
        double volume[64] = {0}, area[2];
        sfem_int i, open, many;
        if (kind == 0) surface.triangles /= 2;
        else {
            sfem_surface library = surface; /* its triangles go, those of both come */
            library.x = NULL;
            sfem_surface_free(&library);
            surface.tet = NULL;
            surface.x = (sfem_real *)realloc(surface.x, 6 * (size_t)surface.nodes * sizeof *surface.x);
            surface.tri = (sfem_int *)malloc(6 * (size_t)other.triangles * sizeof *surface.tri);
            for (i = 0; i < 3 * surface.nodes; ++i) surface.x[3 * surface.nodes + i] = other.x[i] + (i % 3 ? 0 : 0.25);
            for (i = 0; i < 6 * other.triangles; ++i)
                surface.tri[i] = other.tri[i % (3 * other.triangles)] + (i < 3 * other.triangles ? 0 : other.nodes);
            surface.nodes *= 2;
            surface.triangles *= 2;
        }
        d = def_of(&surface);
        s = break_body(ball(1, 4), &d, 3, 1);
        check_pieces(&s, &d);
        count_edges(&s.pieces, &open, &many);
        if (kind) assert_int_equal(open, 0);
        else assert_true(open > 0);
        measure(&s, volume, area);
        assert_near(area[0], area_of(&surface), 1e-9, 0);
        drop_broken(&s);
        if (kind) free(surface.tri), surface.tri = NULL;
        drop(&surface);
        drop(&other);
    }
}

/* Where no plane between pieces comes near it, and where there are points alone. */
static void a_surface_in_one_piece_stays_as_it_is(void **state)
{
    int alone, k;
    (void)state;
    for (alone = 0; alone < 2; ++alone) {
        sfem_surface surface = sphere(0.05, 1);
        sfem_embed_def d = def_of(&surface);
        broken s;
        double *x;
        for (k = 0; k < 3 * surface.nodes; ++k) surface.x[k] += k % 3 ? 0.1 : 0.8;
        if (alone) d.triangles = 0;
        s = break_body(ball(1, 2), &d, 1, 0);
        assert_int_equal(sfem_body_fracture(s.body).pieces, 2);
        assert_int_equal(s.pieces.triangles, d.triangles);
        assert_int_equal(s.pieces.inner, 0);
        assert_int_equal(s.pieces.open_edges, 0);
        assert_int_equal(s.pieces.vertices, alone ? 0 : surface.nodes);
        x = (double *)malloc((3 * (size_t)s.pieces.vertices + 1) * sizeof *x);
        sfem_embed_pieces_positions(s.embed, &s.pieces, s.body, x, NULL);
        for (k = 0; k < 3 * s.pieces.vertices; ++k)
            assert_near(x[k], surface.x[3 * s.pieces.point[k - k % 3] + k % 3], 0, 1e-9);
        free(x);
        drop_broken(&s);
        drop(&surface);
    }
}

static broken *shared; /* for attempt_break */

static sfem_status attempt_break(sfem_allocator allocator, void *user, sfem_error *err)
{
    sfem_embed_pieces p;
    sfem_status status;
    (void)user;
    memset(&p, 0, sizeof p);
    status = sfem_embed_break(shared->embed, shared->body, &allocator, &p, err);
    if (status != SFEM_OK) assert_int_equal(p.vertices, 0);
    sfem_embed_pieces_free(&p);
    return status;
}

static void failing_allocations_of_a_cut_leak_nothing_and_places_take_none(void **state)
{
    sfem_surface surface = sphere(0.8, 2);
    sfem_embed_def d = def_of(&surface);
    test_memory memory = {0};
    sfem_mesh m = ball(1, 1);
    broken s;
    sfem_embed_pieces p;
    sfem_embed *e;
    sfem_error err;
    size_t calls;
    double *x;
    (void)state;
    d.allocator = test_allocator(&memory);
    s = break_body(ball(1, 2), &d, 2, 1);
    calls = memory.calls;
    x = (double *)malloc(6 * (size_t)s.pieces.vertices * sizeof *x);
    sfem_embed_pieces_positions(s.embed, &s.pieces, s.body, x, x + 3 * s.pieces.vertices);
    assert_int_equal(memory.calls, calls);
    free(x);
    shared = &s;
    assert_true(fail_every_allocation(attempt_break, NULL) > 40);
    assert_ok(sfem_embed_create(&m, &d, &e, &err), err);
    assert_status(sfem_embed_break(e, s.body, NULL, &p, &err), SFEM_MISMATCH);
    assert_names(err, "not the one that the points are embedded in");
    sfem_embed_free(e);
    sfem_mesh_free(&m);
    drop_broken(&s);
    assert_no_leak(memory);
    drop(&surface);
}

/* Surfaces of the real world in cages of tets, which hold them, and in fitted meshes, which leave thin parts out. */
static void real_surfaces_are_taken_and_cut(void **state)
{
    static const char *const name[] = {"igl_cow.off", "igl_decimated-knight.off", "igl_fertility.off", "igl_screwdriver.off"};
    sfem_int f, mode, i;
    int c;
    (void)state;
    if (!getenv("SFEM_MESHES")) skip();
    for (f = 0; f < (TEST_SANITIZED ? 2 : 4); ++f)
        for (mode = 0; mode < 2; ++mode) {
            sfem_mesher_def mesher = sfem_default_mesher_def();
            char path[1100];
            double low[3] = {1e300, 1e300, 1e300}, high[3] = {-1e300, -1e300, -1e300}, size = 0, area[2];
            static double volume[1000];
            sfem_surface surface;
            sfem_embed_def d;
            sfem_embed_info info;
            sfem_mesh m;
            sfem_error err;
            broken s;
            snprintf(path, sizeof path, "%s/../surfaces/%s", getenv("SFEM_MESHES"), name[f]);
            if (access(path, R_OK) != 0) skip();
            assert_ok(sfem_surface_read(path, NULL, &surface, &err), err);
            for (i = 0; i < 3 * surface.nodes; ++i) {
                low[i % 3] = fmin(low[i % 3], surface.x[i]);
                high[i % 3] = fmax(high[i % 3], surface.x[i]);
            }
            for (c = 0; c < 3; ++c) size = fmax(size, high[c] - low[c]);
            for (i = 0; i < 3 * surface.nodes; ++i)
                surface.x[i] = (surface.x[i] - (low[i % 3] + high[i % 3]) / 2) / size * 2;
            mesher.tets = 1500;
            mesher.mode = mode ? SFEM_CAGE : SFEM_FITTED;
            assert_ok(sfem_mesh_from_surface(&mesher, &surface, &m, NULL, &err), err);
            d = def_of(&surface);
            s = break_body(m, &d, 3, 1);
            info = sfem_embed_get_info(s.embed);
            if (mode) assert_int_equal(info.outside, 0);
            check_pieces(&s, &d);
            assert_in_range(sfem_body_fracture(s.body).pieces, 4, 1000);
            measure(&s, volume, area);
            /* lost or doubled at most where a triangle comes from piece to piece past the mesh */
            assert_near(area[0], area_of(&surface), mode ? 1e-9 : 1e-3, 0);
            if (mode) assert_int_equal(s.pieces.open_edges, 0);
            else assert_true(s.pieces.open_edges < s.pieces.triangles / 50);
            drop_broken(&s);
            sfem_surface_free(&surface);
        }
}

/* ---- bodies ---- */

static void full_and_modal_bodies_take_points_along(void **state)
{
    const sfem_int cells[3] = {6, 2, 2};
    const sfem_real size[3] = {3, 1, 1}, spin[3] = {0.3, 1, 0.2};
    sfem_model_def model_def = linear_model_def();
    sfem_body_def body_def = sfem_default_body_def();
    sfem_modes_def modes_def = sfem_default_modes_def();
    sfem_reduced_def reduced_def = sfem_default_reduced_def();
    sfem_modal_def modal_def = sfem_default_modal_def();
    sfem_surface surface = sphere(0.6, 4);
    sfem_embed_def d = def_of(&surface);
    sfem_mesh mesh;
    sfem_model *model;
    sfem_body *body;
    sfem_modes modes;
    sfem_reduced *reduced;
    sfem_reduced_view *view;
    sfem_modal *modal;
    sfem_rigid rigid;
    sfem_embed *e;
    sfem_error err;
    double *x, *u, *out;
    sfem_int i, step, tet;
    int c, k, kind;
    (void)state;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
    for (i = 0; i < 3 * mesh.nodes; ++i) mesh.x[i] -= size[i % 3] / 2; /* the sphere sticks out */
    model_def.mesh = &mesh;
    model_def.material.young = 1e4;
    assert_ok(sfem_model_create(&model_def, &model, &err), err);
    assert_ok(sfem_body_create(model, &body_def, &body, &err), err);
    modes_def.modes = 8;
    modes_def.rigid = 1;
    assert_ok(sfem_modes_create(model, &modes_def, &modes, &err), err);
    assert_ok(sfem_reduced_create(model, &modes, &reduced_def, &reduced, &err), err);
    assert_ok(sfem_reduced_view_create(reduced, 0, NULL, SFEM_DOUBLE, &view, &err), err);
    assert_ok(sfem_modal_create(reduced, &modal_def, &modal, &err), err);
    rigid = sfem_modal_rigid(modal); /* free: its frame spins */
    memcpy(rigid.w, spin, sizeof rigid.w);
    assert_ok(sfem_modal_set_rigid(modal, &rigid, &err), err);
    assert_ok(sfem_modal_add_lasting_force(modal, 0, size, &err), err);
    assert_ok(sfem_body_add_lasting_force(body, 0, size, &err), err);
    assert_ok(sfem_embed_create(&mesh, &d, &e, &err), err);
    x = (double *)malloc(6 * (size_t)mesh.nodes * sizeof *x);
    u = x + 3 * mesh.nodes;
    out = (double *)malloc(6 * (size_t)surface.nodes * sizeof *out);
    for (step = 0; step < 20; ++step) {
        assert_ok(sfem_body_step(body, 0.02, &err), err);
        assert_ok(sfem_modal_step(modal, 0.02, &err), err);
    }
    for (kind = 0; kind < 2; ++kind) {
        if (kind) {
            sfem_modal_positions(modal, view, x);
            sfem_modal_displacements(modal, view, u);
        } else {
            sfem_body_positions(body, x);
            memcpy(u, sfem_body_displacement(body), 3 * (size_t)mesh.nodes * sizeof *u);
        }
        assert_true(fabs(u[0]) > 1e-3);
        sfem_embed_positions(e, u, out, out + 3 * surface.nodes);
        for (i = 0; i < surface.nodes; ++i) {
            double b[4], at[3] = {0, 0, 0};
            sfem_embed_point(e, i, &tet, b, NULL);
            for (k = 0; k < 4; ++k)
                for (c = 0; c < 3; ++c) at[c] += b[k] * x[3 * mesh.tet[4 * tet + k] + c];
            assert_all_near(at, out + 3 * i, 3, 1e-13, 1e-13);
        }
    }
    free(out);
    free(x);
    sfem_embed_free(e);
    sfem_modal_free(modal);
    sfem_reduced_view_free(view);
    sfem_reduced_free(reduced);
    sfem_modes_free(&modes);
    sfem_body_free(body);
    sfem_model_free(model);
    sfem_mesh_free(&mesh);
    drop(&surface);
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
        cmocka_unit_test(a_sphere_in_a_broken_block_is_cut_into_closed_pieces),
        cmocka_unit_test(the_surface_of_the_mesh_itself_is_cut_and_closed),
        cmocka_unit_test(points_outside_are_cut_with_their_nearest_places),
        cmocka_unit_test(random_breaks_make_closed_pieces),
        cmocka_unit_test(pieces_that_move_as_wholes_stay_as_they_are),
        cmocka_unit_test(one_broken_tet_cuts_a_sphere_in_four),
        cmocka_unit_test(a_surface_in_one_piece_stays_as_it_is),
        cmocka_unit_test(soups_are_cut_as_the_surface_that_they_are),
        cmocka_unit_test(open_and_crossing_surfaces_are_cut_too),
        cmocka_unit_test(failing_allocations_of_a_cut_leak_nothing_and_places_take_none),
        cmocka_unit_test(real_surfaces_are_taken_and_cut),
        cmocka_unit_test(full_and_modal_bodies_take_points_along),
    };
    return run_all_tests(tests);
}
