/* The generator of unstructured bodies: what it makes is valid, and is what it says. */
#include "support.h"
#include "bodies.h"

static sfem_mesh scattered(sfem_int tets, double q_min, uint64_t seed)
{
    sfem_error err;
    sfem_mesh m;
    assert_ok(body_scattered(tets, q_min, seed, &m, &err), err);
    return m;
}

/* Each point is outside of each circumscribed sphere, whose centre is found here by Cramer's rule. */
static void tets_are_delaunays(void **state)
{
    body_points p = body_scatter(0.15, 400, 7);
    double volume = 0;
    int *tet, n = body_connect(&p, &tet), t, i, k;
    (void)state;
    assert_true(p.n > 150 && n > 4 * p.n);
    for (t = 0; t < n; ++t) {
        double a[3][3], b[3], c[3], det, r2 = 0;
        for (i = 0; i < 3; ++i)
            for (b[i] = k = 0; k < 3; ++k) {
                a[i][k] = (double)(p.grid[tet[4 * t + i + 1]][k] - p.grid[tet[4 * t]][k]);
                b[i] += a[i][k] * a[i][k] / 2;
            }
        det = a[0][0] * (a[1][1] * a[2][2] - a[1][2] * a[2][1]) +
              a[0][1] * (a[1][2] * a[2][0] - a[1][0] * a[2][2]) +
              a[0][2] * (a[1][0] * a[2][1] - a[1][1] * a[2][0]);
        assert_true(det > 0);
        volume += det / 6 * BODY_STEP * BODY_STEP * BODY_STEP;
        for (k = 0; k < 3; ++k) {
            const int l = (k + 1) % 3, m = (k + 2) % 3;
            c[k] = (b[0] * (a[1][l] * a[2][m] - a[1][m] * a[2][l]) +
                    b[1] * (a[2][l] * a[0][m] - a[2][m] * a[0][l]) +
                    b[2] * (a[0][l] * a[1][m] - a[0][m] * a[1][l])) /
                   det;
            r2 += c[k] * c[k];
        }
        for (i = 0; i < p.n; ++i) {
            double d2 = 0;
            for (k = 0; k < 3; ++k) {
                const double d = (double)(p.grid[i][k] - p.grid[tet[4 * t]][k]) - c[k];
                d2 += d * d;
            }
            assert_true(d2 > r2 * (1 - 1e-9));
        }
    }
    assert_in_range(volume * 1000, 650, 1000); /* of the convex hull, far from that of the body */
    free(tet);
    body_points_free(&p);
}

/* Each edge of the surface is used once in each direction. */
static void assert_closed(const sfem_mesh *m)
{
    sfem_surface s;
    sfem_error err;
    int i, k, a, b;
    assert_ok(sfem_mesh_surface(m, NULL, &s, &err), err);
    for (i = 0; i < 3 * s.triangles; ++i) {
        int same = 0, opposite = 0;
        a = s.tri[i], b = s.tri[i % 3 == 2 ? i - 2 : i + 1];
        for (k = 0; k < 3 * s.triangles; ++k) {
            const int c = s.tri[k], d = s.tri[k % 3 == 2 ? k - 2 : k + 1];
            same += a == c && b == d;
            opposite += a == d && b == c;
        }
        assert_int_equal(same, 1);
        assert_int_equal(opposite, 1);
    }
    sfem_surface_free(&s);
}

static void bodies_are_valid_and_closed(void **state)
{
    static const sfem_int tets[] = {600, 1500, 3000};
    static const double q_min[] = {0.1, 0.01};
    size_t i, k;
    uint64_t seed;
    (void)state;
    for (i = 0; i < TEST_COUNT(tets); ++i)
        for (k = 0; k < TEST_COUNT(q_min); ++k)
            for (seed = 1; seed <= 3; ++seed) {
                sfem_mesh m = scattered(tets[i], q_min[k], seed);
                sfem_mesh_report r;
                sfem_error err;
                assert_ok(sfem_mesh_check(&m, &r, &err), err);
                assert_int_equal(r.unused + r.coincident + r.overlapping, 0);
                assert_int_equal(r.components, 1);
                assert_int_equal(r.euler, 2); /* as of a ball: no hole went through it */
                assert_near(m.tets, tets[i], i ? 0.1 : 0.3, 0);
                if (tets[i] < 2000) assert_closed(&m);
                sfem_mesh_free(&m);
            }
}

static void bodies_have_the_quality_asked_for(void **state)
{
    uint64_t seed;
    (void)state;
    for (seed = 1; seed <= 4; ++seed) {
        sfem_mesh good = scattered(3000, 0.1, seed), poor = scattered(3000, 0.01, seed);
        sfem_mesh_report r;
        sfem_error err;
        assert_true(body_below(&good, 0.1) <= 0.01);
        assert_ok(sfem_mesh_check(&good, &r, &err), err);
        assert_true(r.mean_quality > 0.6 && r.min_quality > 0.05);
        assert_near(body_quality(good.x, good.tet + 4 * r.worst_tet), r.min_quality, 1e-12, 0);
        assert_ok(sfem_mesh_check(&poor, &r, &err), err);
        assert_true(r.min_quality >= 0.0099 && r.min_quality < 0.02);
        assert_true(body_below(&poor, 0.1) > 0.02);
        sfem_mesh_free(&good);
        sfem_mesh_free(&poor);
    }
}

/* The chords of a surface of 1000 nodes lose a few percent; all limbs are there. */
static void bodies_fill_their_shape(void **state)
{
    static const double limb[5][3] = {{0.43, 0.70, -0.1},
                                      {0.30, -0.65, 0.23},
                                      {-1.0, 0.3, -0.1},
                                      {-1.1, -0.24, 0.05},
                                      {-0.7, 0, 0.46}};
    const double wanted = body_volume();
    sfem_mesh m = scattered(5000, 0.1, 3);
    sfem_mesh_report r;
    sfem_error err;
    sfem_int i;
    int k;
    (void)state;
    assert_ok(sfem_mesh_check(&m, &r, &err), err);
    assert_true(r.volume > 0.93 * wanted && r.volume < wanted);
    for (k = 0; k < 5; ++k) assert_true(sfem_mesh_locate(&m, NULL, limb[k], NULL, NULL));
    for (i = 0; i < m.nodes; ++i) assert_true(body_distance(m.x + 3 * i) < 1e-3);
    sfem_mesh_free(&m);
}

static void the_same_seed_gives_the_same_bits(void **state)
{
    sfem_mesh a = scattered(2000, 0.1, 11), b = scattered(2000, 0.1, 11),
              c = scattered(2000, 0.1, 12);
    (void)state;
    assert_int_equal(a.nodes, b.nodes);
    assert_int_equal(a.tets, b.tets);
    assert_memory_equal(a.x, b.x, 3 * (size_t)a.nodes * sizeof *a.x);
    assert_memory_equal(a.tet, b.tet, 4 * (size_t)a.tets * sizeof *a.tet);
    assert_true(a.nodes != c.nodes || a.tets != c.tets);
    sfem_mesh_free(&a);
    sfem_mesh_free(&b);
    sfem_mesh_free(&c);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(tets_are_delaunays),
        cmocka_unit_test(bodies_are_valid_and_closed),
        cmocka_unit_test(bodies_have_the_quality_asked_for),
        cmocka_unit_test(bodies_fill_their_shape),
        cmocka_unit_test(the_same_seed_gives_the_same_bits),
    };
    return run_all_tests(tests);
}
