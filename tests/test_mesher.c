/* Tets from surfaces and functions: angles, closedness, volume and distance are measured here by other routes. */
#define SFEM_STATIC
#define SOFTFEM_IMPLEMENTATION
#define SFEM_MINIMAL
#define SFEM_ENABLE_MESHIO
#define SFEM_ENABLE_MESHER
#define SFEM_ENABLE_MODEL
#include "support.h"
#include "bodies.h"
#include "linear.h"

/* ---- surfaces of our own ---- */

static sfem_surface new_surface(sfem_int nodes, sfem_int triangles)
{
    sfem_surface s;
    memset(&s, 0, sizeof s);
    s.nodes = nodes;
    s.triangles = triangles;
    s.x = (sfem_real *)calloc(3 * (size_t)nodes, sizeof *s.x);
    s.tri = (sfem_int *)calloc(3 * (size_t)triangles, sizeof *s.tri);
    return s;
}

static void drop_surface(sfem_surface *s) /* not the library's: made by calloc */
{
    free(s->x);
    free(s->tri);
}

/* The axis of a tube, 0 <= u < 1: a circle of radius 1, or a trefoil knot. */
static void axis_at(int knot, double u, double x[3])
{
    const double a = 2 * TEST_PI * u;
    if (knot) {
        x[0] = 0.5 * (sin(a) + 2 * sin(2 * a));
        x[1] = 0.5 * (cos(a) - 2 * cos(2 * a));
        x[2] = -0.5 * sin(3 * a);
    } else
        x[0] = cos(a), x[1] = sin(a), x[2] = 0;
}

/* A closed tube of radius r in n x m quads; outward. */
static sfem_surface tube(int knot, int n, int m, double r)
{
    sfem_surface s = new_surface(n * m, 2 * n * m);
    int i, j, c;
    for (i = 0; i < n; ++i) {
        double a[3], b[3], t[3], e[3], f[3], up[3] = {0, 0, 1}, length;
        axis_at(knot, (double)i / n, a);
        axis_at(knot, (i + 1e-4) / n, b);
        for (c = 0; c < 3; ++c) t[c] = b[c] - a[c];
        length = sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2]);
        for (c = 0; c < 3; ++c) t[c] /= length;
        sfemi_cross(t, up, e);
        length = sqrt(sfemi_dot3(e, e));
        for (c = 0; c < 3; ++c) e[c] /= length;
        sfemi_cross(t, e, f);
        for (j = 0; j < m; ++j) {
            const double v = 2 * TEST_PI * j / m;
            sfem_int *q = s.tri + 6 * (i * m + j);
            for (c = 0; c < 3; ++c) s.x[3 * (i * m + j) + c] = a[c] + r * (cos(v) * e[c] + sin(v) * f[c]);
            q[0] = i * m + j, q[2] = (i + 1) % n * m + j, q[1] = (i + 1) % n * m + (j + 1) % m;
            q[3] = i * m + j, q[5] = q[1], q[4] = i * m + (j + 1) % m;
        }
    }
    return s;
}

/* Adds a box to a surface, outward. */
static void add_box(sfem_surface *s, const double low[3], const double high[3])
{
    static const sfem_int face[12][3] = {{0, 2, 1}, {1, 2, 3}, {4, 5, 6}, {5, 7, 6}, {0, 1, 4}, {1, 5, 4},
                                         {2, 6, 3}, {3, 6, 7}, {0, 4, 2}, {2, 4, 6}, {1, 3, 5}, {3, 7, 5}};
    int k, c;
    s->x = (sfem_real *)realloc(s->x, 3 * (size_t)(s->nodes + 8) * sizeof *s->x);
    s->tri = (sfem_int *)realloc(s->tri, 3 * (size_t)(s->triangles + 12) * sizeof *s->tri);
    for (k = 0; k < 8; ++k)
        for (c = 0; c < 3; ++c) s->x[3 * (s->nodes + k) + c] = k >> c & 1 ? high[c] : low[c];
    for (k = 0; k < 36; ++k) s->tri[3 * s->triangles + k] = s->nodes + face[k / 3][k % 3];
    s->nodes += 8;
    s->triangles += 12;
}

static sfem_surface boxes(int count, const double (*corner)[2][3])
{
    sfem_surface s;
    int k;
    memset(&s, 0, sizeof s);
    for (k = 0; k < count; ++k) add_box(&s, corner[k][0], corner[k][1]);
    return s;
}

/* ---- measures ---- */

static double enclosed(const sfem_surface *s, const sfem_real *x)
{
    double v = 0, n[3];
    sfem_int t;
    for (t = 0; t < s->triangles; ++t) {
        const sfem_real *a = x + 3 * s->tri[3 * t], *b = x + 3 * s->tri[3 * t + 1], *c = x + 3 * s->tri[3 * t + 2];
        n[0] = a[1] * b[2] - a[2] * b[1], n[1] = a[2] * b[0] - a[0] * b[2], n[2] = a[0] * b[1] - a[1] * b[0];
        v += (n[0] * c[0] + n[1] * c[1] + n[2] * c[2]) / 6;
    }
    return v;
}

/* Distance of a point from a triangle: the plane if the foot is inside, else the sides. */
static double from_triangle(const double p[3], const double *a, const double *b, const double *c)
{
    const double *v[3];
    double e[3][3], n[3], d[3], best = HUGE_VAL, area;
    int k, i, inside = 1;
    v[0] = a, v[1] = b, v[2] = c;
    for (k = 0; k < 3; ++k) sfemi_sub3(v[(k + 1) % 3], v[k], e[k]);
    sfemi_cross(e[0], e[1], n);
    area = sqrt(sfemi_dot3(n, n));
    for (k = 0; k < 3; ++k) {
        double w[3], t, foot[3];
        sfemi_sub3(p, v[k], d);
        sfemi_cross(e[k], d, w);
        if (sfemi_dot3(w, n) < 0) inside = 0;
        t = sfemi_dot3(d, e[k]) / sfemi_dot3(e[k], e[k]);
        t = t < 0 ? 0 : t > 1 ? 1 : t;
        for (i = 0; i < 3; ++i) foot[i] = d[i] - t * e[k][i];
        best = fmin(best, sqrt(sfemi_dot3(foot, foot)));
    }
    sfemi_sub3(p, a, d);
    if (inside && area > 0) best = fmin(best, fabs(sfemi_dot3(d, n)) / area);
    return best;
}

/* Triangles whose boxes are farther away than the nearest so far are passed over. */
static double from_surface(const double p[3], const sfem_surface *s, const sfem_real *x)
{
    double best = HUGE_VAL;
    sfem_int t;
    for (t = 0; t < s->triangles; ++t) {
        const sfem_real *a = x + 3 * s->tri[3 * t], *b = x + 3 * s->tri[3 * t + 1], *c = x + 3 * s->tri[3 * t + 2];
        double far2 = 0;
        int k;
        for (k = 0; k < 3; ++k) {
            const double low = (a[k] < b[k] ? a[k] < c[k] ? a[k] : c[k] : b[k] < c[k] ? b[k] : c[k]) - p[k];
            const double high = p[k] - (a[k] > b[k] ? a[k] > c[k] ? a[k] : c[k] : b[k] > c[k] ? b[k] : c[k]);
            const double d = low > 0 ? low : high > 0 ? high : 0;
            far2 += d * d;
        }
        if (far2 < best * best) best = fmin(best, from_triangle(p, a, b, c));
    }
    return best;
}

/* The largest distance of points on one surface, corners and a random one of each k-th triangle, from the other. */
static double one_way(const sfem_surface *s, const sfem_real *x, const sfem_surface *o, const sfem_real *y, int every)
{
    test_random random = {3};
    double worst = 0;
    sfem_int t;
    for (t = 0; t < s->triangles; t += every) {
        const double u = random_uniform(&random, 0, 1), v = random_uniform(&random, 0, 1 - u);
        double p[3];
        int c;
        for (c = 0; c < 3; ++c)
            p[c] = u * x[3 * s->tri[3 * t] + c] + v * x[3 * s->tri[3 * t + 1] + c] +
                   (1 - u - v) * x[3 * s->tri[3 * t + 2] + c];
        worst = fmax(worst, from_surface(p, o, y));
        worst = fmax(worst, from_surface(x + 3 * s->tri[3 * t], o, y));
    }
    return worst;
}

static double hausdorff(const sfem_surface *s, const sfem_mesh *m)
{
    sfem_surface own;
    sfem_error err;
    double d;
    assert_ok(sfem_mesh_surface(m, NULL, &own, &err), err);
    d = fmax(one_way(s, s->x, &own, m->x, s->triangles / 250 + 1), one_way(&own, m->x, s, s->x, own.triangles / 250 + 1));
    sfem_surface_free(&own);
    return d;
}

static int compare_pairs(const void *a, const void *b) { return memcmp(a, b, 2 * sizeof(sfem_int)); }

/* Right-handed tets that meet face to face, no unused node; every edge of the surface in just two triangles, once in
 * either direction; dihedral angles, from the planes' normals through each edge, within the bounds. */
static void assert_sound(const sfem_mesh *m, double least, double most)
{
    const double most_cosine = cos(least * TEST_PI / 180), least_cosine = cos(most * TEST_PI / 180);
    sfem_mesh_report r;
    sfem_surface s;
    sfem_error err;
    sfem_int t, n, (*edge)[2];
    int i, j, k;
    assert_ok(sfem_mesh_check(m, &r, &err), err);
    assert_int_equal(r.unused + r.overlapping + r.inverted, 0);
    assert_ok(sfem_mesh_surface(m, NULL, &s, &err), err);
    n = 3 * s.triangles;
    edge = (sfem_int(*)[2])malloc((size_t)n * sizeof *edge);
    for (t = 0; t < n; ++t) {
        const sfem_int a = s.tri[t], b = s.tri[t % 3 == 2 ? t - 2 : t + 1];
        edge[t][0] = a < b ? a : b;
        edge[t][1] = a < b ? b : a;
    }
    qsort(edge, (size_t)n, sizeof *edge, compare_pairs);
    for (t = 0; t < n; t += 2) {
        assert_int_equal(compare_pairs(edge[t], edge[t + 1]), 0);
        assert_true(t + 2 == n || compare_pairs(edge[t], edge[t + 2]) != 0);
    }
    free(edge);
    sfem_surface_free(&s);
    for (t = 0; t < m->tets; ++t)
        for (i = 0; i < 4; ++i)
            for (j = i + 1; j < 4; ++j) { /* edge i j; the other two nodes, seen along it */
                const sfem_real *a = m->x + 3 * m->tet[4 * t + i], *b = m->x + 3 * m->tet[4 * t + j];
                double e[3], d[3], out[2][3], cosine, length2;
                int found = 0, c;
                sfemi_sub3(b, a, e);
                length2 = sfemi_dot3(e, e);
                for (k = 0; k < 4; ++k) {
                    if (k == i || k == j) continue;
                    sfemi_sub3(m->x + 3 * m->tet[4 * t + k], a, d);
                    for (c = 0; c < 3; ++c) out[found][c] = d[c] - sfemi_dot3(d, e) / length2 * e[c];
                    ++found;
                }
                cosine = sfemi_dot3(out[0], out[1]) / sqrt(sfemi_dot3(out[0], out[0]) * sfemi_dot3(out[1], out[1]));
                if (!(cosine <= most_cosine && cosine >= least_cosine))
                    fail_msg("tet %d has an angle of %g degrees", (int)t, acos(cosine) * 180 / TEST_PI);
            }
}

static sfem_mesh mesh_of(const sfem_surface *s, sfem_mesher_mode mode, double size, sfem_int tets, sfem_mesher_info *info)
{
    sfem_mesher_def def = sfem_default_mesher_def();
    sfem_error err;
    sfem_mesh m;
    def.mode = mode;
    def.size = size;
    if (tets) def.tets = tets;
    assert_ok(sfem_mesh_from_surface(&def, s, &m, info, &err), err);
    if (mode == SFEM_FITTED)
        assert_sound(&m, 10.7, 164.8);
    else
        assert_sound(&m, 59.999, 90.001);
    return m;
}

static uint64_t hash_mesh(const sfem_mesh *m)
{
    return hash_reals(m->x, 3 * (size_t)m->nodes) ^ 3 * hash_bytes(m->tet, 4 * (size_t)m->tets * sizeof *m->tet) ^
           (m->region ? 5 * hash_bytes(m->region, (size_t)m->tets * sizeof *m->region) : 0);
}

static double share_volume(const sfem_mesh *m)
{
    double v = 0;
    sfem_int t;
    for (t = 0; t < m->tets; ++t) {
        const sfem_int *n = m->tet + 4 * t;
        assert_in_range(m->region[t], 0, SFEM_CAGE_LEVELS);
        v += sfemi_volume6(m->x + 3 * n[0], m->x + 3 * n[1], m->x + 3 * n[2], m->x + 3 * n[3]) / 6 * m->region[t] /
             SFEM_CAGE_LEVELS;
    }
    return v;
}

/* ---- the winding number ---- */

/* The area of a spherical triangle by l'Huilier's formula, which shares nothing with that of van Oosterom, Strackee. */
static double solid_angle(const double *a, const double *b, const double *c, const double p[3])
{
    const double *corner[3];
    double u[3][3], side[3], s, n[3], excess;
    int k, i;
    corner[0] = a, corner[1] = b, corner[2] = c;
    for (k = 0; k < 3; ++k) {
        sfemi_sub3(corner[k], p, u[k]);
        s = sqrt(sfemi_dot3(u[k], u[k]));
        for (i = 0; i < 3; ++i) u[k][i] /= s;
    }
    for (k = 0; k < 3; ++k) {
        sfemi_cross(u[(k + 1) % 3], u[(k + 2) % 3], n);
        side[k] = atan2(sqrt(sfemi_dot3(n, n)), sfemi_dot3(u[(k + 1) % 3], u[(k + 2) % 3]));
    }
    s = 0.5 * (side[0] + side[1] + side[2]);
    excess = tan(s / 2) * tan((s - side[0]) / 2) * tan((s - side[1]) / 2) * tan((s - side[2]) / 2);
    excess = 4 * atan(sqrt(excess > 0 ? excess : 0));
    sfemi_cross(u[1], u[2], n);
    return sfemi_dot3(u[0], n) > 0 ? excess : -excess;
}

static void the_tree_gives_the_winding_number_of_all_triangles(void **state)
{
    sfem_surface s = tube(0, 60, 30, 0.4);
    sfemi_solid solid;
    sfemi_repair repair;
    sfem_mesher_info info;
    sfem_error err;
    test_random random = {1};
    sfem_int t;
    int k;
    (void)state;
    s.triangles -= 400; /* a hole: winding numbers between 0 and 1 */
    memset(&solid, 0, sizeof solid), memset(&repair, 0, sizeof repair), memset(&info, 0, sizeof info);
    repair.s = &s, repair.info = &info, repair.err = &err;
    assert_ok(sfemi_repair_collect(&repair), err);
    assert_ok(sfemi_mesher_tree(&solid, &repair), err);
    for (k = 0; k < 400; ++k) {
        double p[3], w = 0;
        random_fill(&random, p, 3, -1.6, 1.6);
        p[2] *= 0.4;
        for (t = 0; t < s.triangles; ++t)
            w += solid_angle(s.x + 3 * s.tri[3 * t], s.x + 3 * s.tri[3 * t + 1], s.x + 3 * s.tri[3 * t + 2], p);
        assert_near(sfemi_bvh_winding(&solid.tree, p), w / (4 * TEST_PI), 0, 0.08);
    }
    sfemi_delete(&repair.a, repair.tri);
    sfemi_delete(&repair.a, solid.tree.corner);
    sfemi_delete(&repair.a, solid.tree.node);
    drop_surface(&s);
}

/* ---- fitted ---- */

static void a_fitted_mesh_is_near_the_surface_and_fills_its_volume(void **state)
{
    int k;
    (void)state;
    for (k = 0; k < 4; ++k) {
        sfem_surface s = tube(k % 2, 160, 40, 0.25);
        const double size = k < 2 ? 0.12 : 0.07;
        sfem_mesher_info info;
        sfem_mesh m = mesh_of(&s, SFEM_FITTED, size, 0, &info);
        sfem_mesh_report r;
        sfem_error err;
        assert_true(enclosed(&s, s.x) > 0);
        assert_ok(sfem_mesh_check(&m, &r, &err), err);
        assert_near(r.volume, enclosed(&s, s.x), k < 2 ? 0.07 : 0.03, 0); /* 4 and 7 cells across */
        assert_near(r.volume, info.volume, 1e-12, 0);
        assert_int_equal(r.components, 1);
        assert_int_equal(r.euler, 0);
        assert_true(hausdorff(&s, &m) < size);
        assert_int_equal(info.flipped + info.doubled + info.degenerate + info.open_edges + info.repaired, 0);
        sfem_mesh_free(&m);
        drop_surface(&s);
    }
}

static void a_box_keeps_its_volume_and_faces(void **state)
{
    static const double corner[1][2][3] = {{{0, 0, 0}, {1, 0.7, 0.5}}};
    sfem_surface s = boxes(1, corner);
    int k;
    (void)state;
    for (k = 0; k < 3; ++k) { /* with points of the lattice on the faces, too */
        const double size = k == 0 ? 0.1 : k == 1 ? 0.05 : 0.0413;
        sfem_mesher_info info;
        sfem_mesh m = mesh_of(&s, SFEM_FITTED, size, 0, &info);
        assert_near(info.volume, 0.35, 0.03, 0);
        assert_true(hausdorff(&s, &m) < size);
        sfem_mesh_free(&m);
    }
    drop_surface(&s);
}

/* Cuts are as bad as can be, at the limits of moving: no function has such ones. */
static void angles_stay_in_their_bounds_for_random_cuts(void **state)
{
    static const double limit[2] = {0.24999, 0.41189};
    sfem_allocator a = {NULL, NULL, NULL};
    int seed, c;
    (void)state;
    for (seed = 0; seed < 12; ++seed) {
        test_random random = {(uint64_t)seed};
        sfemi_solid solid;
        sfemi_lattice l;
        sfem_mesher_info info;
        sfem_error err;
        sfem_int p, i;
        memset(&solid, 0, sizeof solid), memset(&l, 0, sizeof l), memset(&info, 0, sizeof info);
        for (c = 0; c < 3; ++c) solid.box[1][c] = 12;
        l.solid = &solid, l.a = &a, l.err = &err, l.limit = 1e6;
        assert_ok(sfemi_lattice_lay(&l, 1, 0), err);
        for (p = 0; p < l.points; ++p) {
            sfem_int at[3];
            sfemi_lattice_indices(&l, p, at);
            l.sign[p] = (signed char)(random_uniform(&random, 0, 1) < 0.2 + 0.2 * (seed % 4) ? 1 : -1);
            for (c = 0; c < 3; ++c)
                if (at[c] < 1 || at[c] >= l.n[c] - 2) l.sign[p] = -1;
        }
        solid.tree.nodes = 0; /* no triangle: cuts are replaced by random ones */
        assert_ok(sfemi_lattice_cuts(&l), err);
        for (i = 0; i < l.cuts; ++i) {
            sfemi_cut *cut = l.cut + i;
            const double at = limit[(cut->a ^ cut->b) & 1] + (random_below(&random, 2) ? 1e-9 : -1e-9);
            sfem_real x[3], y[3];
            cut->t = random_below(&random, 2) ? random_uniform(&random, 0, 1) : random_below(&random, 2) ? at : 1 - at;
            sfemi_lattice_place(&l, cut->a, x);
            sfemi_lattice_place(&l, cut->b, y);
            sfemi_solid_between(x, y, cut->t, cut->x);
        }
        sfemi_lattice_warp(&l);
        assert_ok(sfemi_lattice_mesh(&l, &info), err);
        assert_sound(&l.mesh, 10.7, 164.8);
        assert_true(info.split > 0);
        sfemi_lattice_free(&l);
    }
}

static void the_number_of_tets_is_what_was_asked_for(void **state)
{
    static const double corner[2][2][3] = {{{0, 0, 0}, {1, 1, 0.1}}, {{0.45, 0.45, 0.05}, {0.55, 0.55, 1}}};
    static const sfem_int wanted[2] = {2000, 9000};
    int body, mode, k;
    (void)state;
    for (body = 0; body < 3; ++body) {
        sfem_surface s = body < 2 ? tube(body, 120, 24, 0.3) : boxes(2, corner);
        for (mode = 0; mode < 2; ++mode)
            for (k = 0; k < (mode && body < 2 ? 1 : 2); ++k) {
                sfem_mesher_info info;
                sfem_mesh m = mesh_of(&s, (sfem_mesher_mode)mode, 0, wanted[k], &info);
                assert_near(m.tets, wanted[k], 0.15, 0);
                sfem_mesh_free(&m);
            }
        drop_surface(&s);
    }
}

/* ---- soups ---- */

/* Of 5 percent of the triangles: 0 reverses, 1 takes away, 2 both by turns. */
static sfem_surface damaged(const sfem_surface *s, int how)
{
    sfem_surface d = new_surface(s->nodes, s->triangles);
    test_random random = {7};
    sfem_int t, n = 0;
    memcpy(d.x, s->x, 3 * (size_t)s->nodes * sizeof *d.x);
    for (t = 0; t < s->triangles; ++t) {
        const int hit = random_below(&random, 20) == 0;
        if (hit && (how == 1 || (how == 2 && t % 2))) continue;
        memcpy(d.tri + 3 * n, s->tri + 3 * t, 3 * sizeof *d.tri);
        if (hit) d.tri[3 * n] = s->tri[3 * t + 1], d.tri[3 * n + 1] = s->tri[3 * t];
        ++n;
    }
    d.triangles = n;
    return d;
}

/* Layers come and go with the length of the edges, two at a time where the lattice is centred. */
static void a_plate_of_few_layers_has_the_number_of_tets_too(void **state)
{
    static const double low[3] = {0, 0, 0}, high[3] = {1, 1, 0.1};
    static const sfem_int wanted[3] = {600, 2000, 5000}; /* 5000 fitted and 2000 of a cage by moved lattices */
    int mode, k;
    (void)state;
    for (mode = SFEM_FITTED; mode <= SFEM_CAGE; ++mode)
        for (k = 0; k < 3; ++k) {
            sfem_surface s;
            sfem_mesher_info info;
            sfem_mesh m;
            memset(&s, 0, sizeof s);
            add_box(&s, low, high);
            m = mesh_of(&s, (sfem_mesher_mode)mode, 0, wanted[k], &info);
            assert_near(m.tets, wanted[k], 0.15, 0);
            sfem_mesh_free(&m);
            drop_surface(&s);
        }
}

/* Two triangles 1000 times as long as wide. Along an axis nothing is inside until the edges are short, then 200 times
 * the tets wanted are: searching that jump to its end would take 40 lattices. Askew, and along the diagonal of their
 * box, nothing is found within the points that a search for so few tets may take. */
static void needles_are_meshed_in_bounded_work(void **state)
{
    static const struct {
        sfem_real end[3];
        sfem_status status;
        const char *words;
    } needle[3] = {{{1000, 0, 0}, SFEM_OK, ""},
                   {{1000, 5, 0.5}, SFEM_BAD_MESH, "shorter size"},
                   {{1000, 1000, 1000}, SFEM_TOO_LARGE, "more tets"}};
    static const sfem_int tri[6] = {0, 2, 1, 0, 1, 3};
    sfem_surface s = new_surface(4, 2);
    int k;
    (void)state;
    s.x[7] = s.x[11] = 1;
    memcpy(s.tri, tri, sizeof tri);
    for (k = 0; k < 3; ++k) {
        sfem_mesher_def def = sfem_default_mesher_def();
        sfem_mesher_info info;
        sfem_error err;
        sfem_mesh m;
        memcpy(s.x + 3, needle[k].end, sizeof needle[k].end);
        def.tets = 60;
        assert_status(sfem_mesh_from_surface(&def, &s, &m, &info, &err), needle[k].status);
        if (needle[k].status != SFEM_OK) {
            assert_names(err, needle[k].words);
            continue;
        }
        assert_sound(&m, 10.7, 164.8);
        assert_true(info.passes * (double)info.lattice < 1.2 * (262144 + 4000 * 60));
        sfem_mesh_free(&m);
    }
    drop_surface(&s);
}

static void flipped_and_missing_triangles_change_little(void **state)
{
    int body, how, mode;
    (void)state;
    if (TEST_SANITIZED) skip();
    for (body = 0; body < 2; ++body)
        for (mode = 0; mode < 2 - body; ++mode) {
            sfem_surface s = tube(body, 120, 30, 0.22); /* apart from itself */
            const double size = mode ? 0.16 : 0.12;
            sfem_mesher_info whole, info;
            sfem_mesh m = mesh_of(&s, (sfem_mesher_mode)mode, size, 0, &whole);
            sfem_mesh_free(&m);
            for (how = mode ? 2 : 0; how < 3; ++how) { /* a cage of an open surface takes long */
                sfem_surface d = damaged(&s, how);
                m = mesh_of(&d, (sfem_mesher_mode)mode, size, 0, &info);
                assert_near(info.volume, whole.volume, 0.01, 0);
                assert_true(how == 0 || info.open_edges > 280);
                assert_true(how == 1 || info.flipped > 85 * (how ? 1 : 3));
                if (mode == SFEM_FITTED) assert_true(hausdorff(&s, &m) < size);
                sfem_mesh_free(&m);
                drop_surface(&d);
            }
            drop_surface(&s);
        }
}

static void doubled_triangles_give_the_same_bits(void **state)
{
    int mode, how;
    (void)state;
    if (TEST_SANITIZED) skip();
    for (mode = 0; mode < 2; ++mode) {
        sfem_surface s = tube(1, 80, 16, 0.3), twice = new_surface(2 * s.nodes, 2 * s.triangles);
        sfem_mesher_info info;
        sfem_mesh m = mesh_of(&s, (sfem_mesher_mode)mode, 0.2, 0, &info);
        const uint64_t once = hash_mesh(&m);
        sfem_int t;
        sfem_mesh_free(&m);
        for (how = 0; how < 2; ++how) { /* the same way; the other way: a surface with two sides */
            memcpy(twice.x, s.x, 3 * (size_t)s.nodes * sizeof *s.x);
            memcpy(twice.x + 3 * s.nodes, s.x, 3 * (size_t)s.nodes * sizeof *s.x);
            memcpy(twice.tri, s.tri, 3 * (size_t)s.triangles * sizeof *s.tri);
            for (t = 0; t < 3 * s.triangles; ++t)
                twice.tri[3 * s.triangles + t] = s.nodes + s.tri[how && t % 3 < 2 ? t + 1 - 2 * (t % 3) : t];
            m = mesh_of(&twice, (sfem_mesher_mode)mode, 0.2, 0, &info);
            assert_true(hash_mesh(&m) == once);
            assert_int_equal(info.doubled, s.triangles);
            sfem_mesh_free(&m);
        }
        drop_surface(&s);
        drop_surface(&twice);
    }
}

static void parts_that_overlap_touch_or_are_hollow_have_the_right_volume(void **state)
{
    static const double corner[5][2][3] = {{{0, 0, 0}, {1, 1, 1}}, {{0.5, 0.5, 0.5}, {1.5, 1.5, 1.5}},
                                           {{1, 0, 0}, {2, 1, 1}}, {{0.2, 0.2, 0.2}, {0.8, 0.8, 0.8}},
                                           {{3, 0, 0}, {4, 1, 1}}};
    sfem_int t, k, swap;
    (void)state;
    for (k = 1; k < 5; ++k) {
        double wanted = k == 1 ? 2 - 0.125 : k == 3 ? 1 - 0.216 : 2;
        double two[2][2][3];
        sfem_mesher_info info;
        sfem_surface s;
        sfem_mesh m;
        memcpy(two[0], corner[0], sizeof two[0]), memcpy(two[1], corner[k], sizeof two[1]);
        s = boxes(2, (const double(*)[2][3])two);
        for (t = 12; t < 24 && k >= 3; ++t) /* a hole inside; a second box, inside out */
            swap = s.tri[3 * t], s.tri[3 * t] = s.tri[3 * t + 1], s.tri[3 * t + 1] = swap;
        m = mesh_of(&s, SFEM_FITTED, 0.057, 0, &info);
        assert_near(info.volume, wanted, 0.02, 0);
        sfem_mesh_free(&m);
        drop_surface(&s);
    }
}

/* Two cubes with an edge, or a corner, in common: the nodes are doubled there. */
static void bodies_that_meet_in_an_edge_or_corner_are_separated(void **state)
{
    static const double edge[2][2][3] = {{{0, 0, 0}, {1, 1, 1}}, {{1, 1, 0}, {2, 2, 1}}};
    static const double corner[2][2][3] = {{{0, 0, 0}, {1, 1, 1}}, {{1, 1, 1}, {2, 2, 2}}};
    int k, mode;
    (void)state;
    for (k = 0; k < 2; ++k)
        for (mode = 0; mode < 2; ++mode) {
            sfem_surface s = boxes(2, k ? corner : edge);
            sfem_mesher_info info;
            sfem_mesh m = mesh_of(&s, (sfem_mesher_mode)mode, 0.2, 0, &info);
            assert_near(info.volume, 2, 0.06, 0);
            sfem_mesh_free(&m);
            drop_surface(&s);
        }
}

/* ---- cages ---- */

static void a_cage_contains_the_surface_and_its_thin_parts(void **state)
{
    static const double corner[2][2][3] = {{{0, 0, 0}, {1, 1, 0.02}}, {{0.5, 0.5, 0.01}, {0.52, 0.51, 1}}};
    static const sfem_real ends[3] = {4, 5, 6}; /* of a box that is made into a needle of 60 cells across the lattice */
    int body, k;
    (void)state;
    for (body = 0; body < 3; ++body) {
        sfem_surface s = body == 1 ? tube(1, 80, 10, 0.2) : boxes(body ? 1 : 2, corner);
        const double volume = body == 1 ? enclosed(&s, s.x) : 0.02 + 0.98 * 0.0002;
        sfem_mesher_info info;
        test_random random = {5};
        sfem_mesh m;
        for (k = 0; k < 12 && body == 2; ++k) s.x[3 * (k / 3) + 12 + k % 3] += ends[k % 3] - (k % 3 == 2 ? 0.02 : 0);
        m = mesh_of(&s, SFEM_CAGE, body == 1 ? 0.15 : 0.1, 0, &info); /* the plate is a fifth of a cell thick */
        for (k = 0; k < 500; ++k) {
            const sfem_int *v = s.tri + 3 * random_below(&random, s.triangles);
            const double a = random_uniform(&random, 0, 1), b = random_uniform(&random, 0, 1 - a);
            double p[3];
            int c;
            for (c = 0; c < 3; ++c) p[c] = a * s.x[3 * v[0] + c] + b * s.x[3 * v[1] + c] + (1 - a - b) * s.x[3 * v[2] + c];
            if (!sfem_mesh_locate(&m, NULL, p, NULL, NULL)) fail_msg("(%g, %g, %g) is outside", p[0], p[1], p[2]);
        }
        for (k = 0; k < s.nodes; ++k) assert_true(sfem_mesh_locate(&m, NULL, s.x + 3 * k, NULL, NULL));
        assert_near(share_volume(&m), info.volume, 1e-12, 0);
        assert_near(info.volume, body == 2 ? enclosed(&s, s.x) : volume, body ? 0.005 : 0.03, 0);
        sfem_mesh_free(&m);
        drop_surface(&s);
    }
}

/* Plates of 0.02 to 0.1, flush and askew, in 80 to 1000 tets of edges between a fifth and ten times as long: chords of
 * tets give 1.3 % at worst, as many single points gave 10 %. */
static void a_cage_of_a_thin_plate_has_its_volume(void **state)
{
    static const double thickness[3] = {0.02, 0.05, 0.1};
    static const sfem_int wanted[3] = {100, 288, 1000};
    int i, j, askew, k;
    (void)state;
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j)
            for (askew = 0; askew < 2; ++askew) {
                const double low[3] = {0, 0, 0}, high[3] = {1, 1, thickness[i]};
                sfem_surface s;
                sfem_mesher_info info;
                sfem_mesh m;
                memset(&s, 0, sizeof s);
                add_box(&s, low, high);
                for (k = 0; k < s.nodes && askew; ++k) {
                    const double x = s.x[3 * k], z = s.x[3 * k + 2];
                    s.x[3 * k] = 0.8 * x - 0.6 * z;
                    s.x[3 * k + 2] = 0.6 * x + 0.8 * z;
                }
                m = mesh_of(&s, SFEM_CAGE, 0, wanted[j], &info);
                assert_near(share_volume(&m), thickness[i], 0.02, 0);
                sfem_mesh_free(&m);
                drop_surface(&s);
            }
}

static void a_cage_has_the_mass_of_what_it_holds(void **state)
{
    sfem_surface s = tube(0, 100, 24, 0.3);
    sfem_material base = linear_material(), materials[SFEM_CAGE_LEVELS + 1];
    sfem_model_def def = linear_model_def();
    sfem_model *model = NULL;
    sfem_error err;
    sfem_mesh m = mesh_of(&s, SFEM_CAGE, 0.12, 0, NULL);
    sfem_int i;
    (void)state;
    assert_status(sfem_cage_materials(&base, 0, materials, &err), SFEM_BAD_ARGUMENT);
    assert_status(sfem_cage_materials(&base, NAN, materials, &err), SFEM_BAD_ARGUMENT);
    assert_ok(sfem_cage_materials(&base, 0.02, materials, &err), err);
    assert_near(materials[0].density, 20, 1e-15, 0);
    assert_near(materials[5].young, 0.25e6, 1e-15, 0);
    assert_near(materials[SFEM_CAGE_LEVELS].density, base.density, 0, 0);
    def.mesh = &m;
    def.materials = materials;
    def.material_count = SFEM_CAGE_LEVELS + 1;
    assert_ok(sfem_model_create(&def, &model, &err), err);
    assert_near(sfem_model_total_mass(model), base.density * enclosed(&s, s.x), 0.02, 0);
    for (i = 0; i < m.nodes; ++i) assert_true(sfem_model_node_mass(model)[i] > 0);
    sfem_model_free(model);
    sfem_mesh_free(&m);
    drop_surface(&s);
}

/* ---- functions ---- */

static sfem_real ball(const sfem_real x[3], void *user)
{
    const double r = *(double *)user;
    return sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]) - r;
}

static sfem_real gyroid(const sfem_real x[3], void *user)
{
    (void)user;
    return sin(x[0]) * cos(x[1]) + sin(x[1]) * cos(x[2]) + sin(x[2]) * cos(x[0]);
}

static sfem_real broken_function(const sfem_real x[3], void *user)
{
    (void)user;
    return x[0] > 0.3 ? NAN : -1;
}

static void functions_are_meshed(void **state)
{
    static const double ends[3] = {1.1, 2 * TEST_PI, 1.5};
    sfem_mesher_def def = sfem_default_mesher_def();
    sfem_mesher_info info;
    sfem_error err;
    sfem_mesh m;
    int k, c, mode;
    (void)state;
    for (k = 0; k < 3; ++k)
        for (mode = 0; mode < 2; ++mode) {
            double box[2][3], r = 1;
            for (c = 0; c < 3; ++c) box[0][c] = k == 1 ? 0 : -ends[k], box[1][c] = ends[k];
            def.mode = (sfem_mesher_mode)mode;
            def.tets = k == 1 ? 16000 : 8000;
            assert_ok(sfem_mesh_from_sdf(&def, k == 0 ? ball : k == 1 ? gyroid : body_blended, &r, (const double(*)[3])box, &m, &info,
                                         &err), err);
            assert_near(m.tets, def.tets, 0.15, 0);
            assert_sound(&m, mode ? 59.999 : 10.7, mode ? 90.001 : 164.8);
            if (k == 0) assert_near(info.volume, 4 * TEST_PI / 3, 0.02, 0);
            if (k == 1) assert_near(info.volume, 4 * TEST_PI * TEST_PI * TEST_PI, 0.03, 0); /* half of the box, by symmetry */
            for (c = 0; c < m.nodes && k == 0 && !mode; ++c) assert_true(ball(m.x + 3 * c, &r) < 1e-3);
            sfem_mesh_free(&m);
        }
}

/* ---- graded ---- */

/* The edges of a body get longer inside, and nothing else changes: the surface has the same triangles, the volume is the
 * same, tets meet face to face. Cages have the tets of the inside only, whose angles are 45, 60, 90 and 120 degrees. */
static void graded_meshes_are_coarse_inside_and_the_same_at_the_surface(void **state)
{
    static const double cube[1][2][3] = {{{0, 0, 0}, {1, 1, 1}}};
    int body, mode, grading;
    (void)state;
    for (body = TEST_SANITIZED ? 2 : 0; body < 3; ++body)
        for (mode = 0; mode < 2; ++mode) {
            const double size = body == 0 ? 1 / 20.0 : 0.1;
            sfem_surface s = body == 0 ? boxes(1, cube) : tube(0, 100, 30, body == 1 ? 0.6 : 0.3), own[2];
            sfem_mesher_info info[2];
            sfem_int tets = 0, t;
            for (grading = 0; grading < 5; grading += 4) {
                const int at = grading > 0;
                sfem_mesher_def def = sfem_default_mesher_def();
                double largest = 0;
                sfem_error err;
                sfem_mesh m;
                def.mode = (sfem_mesher_mode)mode;
                def.size = size;
                def.grading = grading;
                assert_ok(sfem_mesh_from_surface(&def, &s, &m, info + at, &err), err);
                assert_sound(&m, mode == SFEM_FITTED ? 10.7 : 44.999, mode == SFEM_FITTED ? 164.8 : 120.001);
                assert_ok(sfem_mesh_surface(&m, NULL, own + at, &err), err);
                for (t = 0; t < m.tets; ++t) {
                    const sfem_int *v = m.tet + 4 * t;
                    largest = fmax(largest, sfemi_volume6(m.x + 3 * v[0], m.x + 3 * v[1], m.x + 3 * v[2], m.x + 3 * v[3]));
                }
                largest *= 2 / (size * size * size); /* beside a tet of the lattice: a level gives 8 times as much */
                if (!at) {
                    tets = m.tets;
                    assert_true(largest < 4); /* moved points */
                } else {
                    if (body == 0) assert_true(largest > 50);
                    if (body == 1) assert_true(largest > 7.9);
                    assert_true(m.tets <= (body == 0 ? 0.8 : body == 1 ? 0.9 : 1) * tets);
                }
                sfem_mesh_free(&m);
            }
            assert_near(info[1].volume, info[0].volume, mode == SFEM_FITTED ? 1e-10 : 1e-3, 0); /* sums of 100 000 */
            assert_int_equal(own[1].triangles, own[0].triangles);
            sfem_surface_free(own);
            sfem_surface_free(own + 1);
            drop_surface(&s);
        }
}

/* Two hundred thousand tets where lattice ones would be 369 000: edges of 8 times the length in the middle. */
static void a_thick_body_gets_edges_of_eight_times_the_length(void **state)
{
    static const double cube[1][2][3] = {{{0, 0, 0}, {1, 1, 1}}};
    sfem_surface s;
    sfem_mesher_def def = sfem_default_mesher_def();
    double largest = 0;
    sfem_error err;
    sfem_mesh m;
    sfem_int t;
    (void)state;
    if (TEST_SANITIZED) skip();
    s = boxes(1, cube);
    def.size = 1 / 31.3;
    def.grading = 4;
    assert_ok(sfem_mesh_from_surface(&def, &s, &m, NULL, &err), err);
    assert_sound(&m, 10.7, 164.8);
    for (t = 0; t < m.tets; ++t) {
        const sfem_int *v = m.tet + 4 * t;
        largest = fmax(largest, sfemi_volume6(m.x + 3 * v[0], m.x + 3 * v[1], m.x + 3 * v[2], m.x + 3 * v[3]));
    }
    assert_true(2 * largest > 100 * def.size * def.size * def.size);
    assert_in_range(m.tets, 1, 200000);
    sfem_mesh_free(&m);
    drop_surface(&s);
}

static void graded_meshes_have_the_number_of_tets_too(void **state)
{
    static const double corner[1][2][3] = {{{0, 0, 0}, {1, 0.8, 0.6}}};
    static const sfem_int wanted[3] = {2000, 9000, 30000};
    int body, mode, k;
    (void)state;
    for (body = 0; body < 3; ++body) {
        sfem_surface s = body < 2 ? tube(body, 120, 24, 0.3 + 0.3 * body) : boxes(1, corner);
        for (mode = 0; mode < 2; ++mode)
            for (k = 0; k < (TEST_SANITIZED ? 1 : body == 2 ? 3 : 2); ++k) {
                sfem_mesher_def def = sfem_default_mesher_def();
                sfem_error err;
                sfem_mesh m;
                def.mode = (sfem_mesher_mode)mode;
                def.grading = 3;
                def.tets = wanted[k];
                assert_ok(sfem_mesh_from_surface(&def, &s, &m, NULL, &err), err);
                assert_near(m.tets, wanted[k], 0.15, 0);
                assert_sound(&m, mode == SFEM_FITTED ? 10.7 : 44.999, mode == SFEM_FITTED ? 164.8 : 120.001);
                sfem_mesh_free(&m);
            }
        drop_surface(&s);
    }
}

/* ---- hostile input ---- */

static void hostile_surfaces_get_sentences(void **state)
{
    static const double corner[1][2][3] = {{{0, 0, 0}, {1, 1, 1}}};
    int k, mode;
    (void)state;
    for (mode = 0; mode < 2; ++mode)
        for (k = 0; k < 17; ++k) {
            static const struct {
                sfem_status status;
                const char *words;
            } wanted[17] = {{SFEM_NOT_FINITE, "vertex 5"},      {SFEM_NOT_FINITE, "vertex 7"}, {SFEM_BAD_MESH, "triangle 3"},
                            {SFEM_BAD_MESH, "triangle 11"},     {SFEM_BAD_MESH, "no triangles"}, {SFEM_BAD_ARGUMENT, "set x"},
                            {SFEM_BAD_MESH, "open sheet"},      {SFEM_BAD_MESH, "open sheet"},  {SFEM_BAD_MESH, "an area"},
                            {SFEM_TOO_LARGE, "stray vertex"},   {SFEM_BAD_ARGUMENT, "unit"},    {SFEM_BAD_ARGUMENT, "tets is 0"},
                            {SFEM_BAD_ARGUMENT, "size is"},     {SFEM_BAD_ARGUMENT, "mode"},    {SFEM_BAD_MESH, "negative"},
                            {SFEM_TOO_LARGE, "2.68e+08"},   {SFEM_BAD_ARGUMENT, "grading"}};
            sfem_surface s = boxes(1, corner);
            sfem_real *const x = s.x;
            sfem_mesher_def def = sfem_default_mesher_def();
            sfem_mesh m, before;
            sfem_error err;
            int i;
            memset(&m, 0xa5, sizeof m);
            before = m;
            def.size = 0.25;
            def.mode = (sfem_mesher_mode)mode;
            if (k == 0) s.x[16] = NAN;
            if (k == 1) s.x[21] = INFINITY;
            if (k == 2) s.tri[10] = 8;
            if (k == 3) s.tri[35] = -1;
            if (k == 4) s.triangles = 0;
            if (k == 5) s.x = NULL;
            if (k == 6) s.triangles = 1;
            if (k == 7) s.triangles = 2;
            if (k == 8)
                for (i = 0; i < 24; ++i) s.x[i] = 3;
            if (k == 9) s.x[0] = 1e30;
            if (k == 10) s.x[0] = 1e200;
            if (k == 11) def.size = 0, def.tets = 0;
            if (k == 12) def.size = NAN;
            if (k == 13) def.mode = (sfem_mesher_mode)2;
            if (k == 14) s.nodes = -1;
            if (k == 15) def.size = 1e-4;
            if (k == 16) def.grading = 11;
            assert_status(sfem_mesh_from_surface(&def, &s, &m, NULL, &err), wanted[k].status);
            assert_names(err, wanted[k].words);
            assert_memory_equal(&m, &before, sizeof m);
            s.x = x;
            drop_surface(&s);
        }
}

static void hostile_functions_get_sentences(void **state)
{
    const sfem_real box[2][3] = {{-1, -1, -1}, {1, 1, 1}}, empty[2][3] = {{1, 0, 0}, {0, 1, 1}};
    const sfem_real far[2][3] = {{2, 2, 2}, {3, 3, 3}};
    sfem_mesher_def def = sfem_default_mesher_def();
    sfem_error err;
    sfem_mesh m;
    double r = 1;
    (void)state;
    assert_status(sfem_mesh_from_sdf(&def, broken_function, NULL, box, &m, NULL, &err), SFEM_NOT_FINITE);
    assert_status(sfem_mesh_from_sdf(&def, ball, &r, empty, &m, NULL, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "axis 0");
    assert_status(sfem_mesh_from_sdf(&def, ball, &r, far, &m, NULL, &err), SFEM_BAD_MESH);
}

static sfem_status attempt(sfem_allocator allocator, void *user, sfem_error *err)
{
    const sfem_surface *s = (const sfem_surface *)user;
    sfem_mesher_def def = sfem_default_mesher_def();
    sfem_status status;
    sfem_mesh m;
    memset(&m, 0, sizeof m);
    def.allocator = allocator;
    def.size = TEST_SANITIZED ? 1 : 0.4;
    def.grading = 1;
    status = sfem_mesh_from_surface(&def, s, &m, NULL, err);
    if (status == SFEM_OK) sfem_mesh_free(&m);
    def.mode = SFEM_CAGE;
    if (status == SFEM_OK) status = sfem_mesh_from_surface(&def, s, &m, NULL, err);
    if (status == SFEM_OK) sfem_mesh_free(&m);
    return status;
}

static void every_failing_allocation_leaves_nothing_behind(void **state)
{
    static const double edge[2][2][3] = {{{0, 0, 0}, {1, 1, 1}}, {{1, 1, 0}, {2, 2, 1}}};
    sfem_surface s = boxes(2, edge);
    (void)state;
    assert_true(fail_every_allocation(attempt, &s) > 60);
    drop_surface(&s);
}

static void memory_is_what_the_header_states(void **state)
{
    sfem_surface s = tube(0, 150, 40, 0.4);
    int k;
    (void)state;
    for (k = 0; k < 4; ++k) {
        test_memory memory = {0};
        sfem_mesher_def def = sfem_default_mesher_def();
        sfem_mesher_info info;
        sfem_error err;
        sfem_mesh m;
        def.allocator = test_allocator(&memory);
        def.mode = (sfem_mesher_mode)(k % 2);
        def.grading = k / 2 * 3;
        def.tets = 8000;
        assert_ok(sfem_mesh_from_surface(&def, &s, &m, &info, &err), err);
        if (memory.peak > 400 * (size_t)s.triangles + 16 * (size_t)info.lattice + 400 * (size_t)m.tets)
            fail_msg("%lu bytes", (unsigned long)memory.peak);
        sfem_mesh_free(&m);
        assert_no_leak(memory);
    }
    drop_surface(&s);
}

static void any_number_of_threads_gives_the_same_bits(void **state)
{
    sfem_surface knot = tube(1, 100, 20, 0.3), torus = tube(0, 60, 20, 0.6);
    int mode, threads;
    (void)state;
    for (mode = 0; mode < 4; ++mode) {
        uint64_t one = 0;
        for (threads = 1; threads <= 8; threads += threads == 1 && !TEST_SANITIZED ? 2 : 5) {
            sfem_mesher_def def = sfem_default_mesher_def();
            sfem_error err;
            sfem_mesh m;
            def.mode = (sfem_mesher_mode)(mode % 2);
            def.grading = mode / 2 * 3;
            def.tets = 3000;
            if (mode > 1) def.size = 0.15; /* eight cells across */
            def.exec = thread_exec(threads);
            assert_ok(sfem_mesh_from_surface(&def, mode > 1 ? &torus : &knot, &m, NULL, &err), err);
            if (threads == 1) one = hash_mesh(&m);
            assert_true(hash_mesh(&m) == one);
            sfem_mesh_free(&m);
        }
    }
    drop_surface(&knot);
    drop_surface(&torus);
}

/* ---- files ---- */

/* The tetrahedron of the unit axes. */
static void is_tetrahedron(const void *data, size_t bytes)
{
    sfem_surface s;
    sfem_error err;
    assert_ok(sfem_surface_parse(data, bytes, NULL, &s, &err), err);
    assert_int_equal(s.nodes, 4);
    assert_int_equal(s.triangles, 4);
    assert_near(enclosed(&s, s.x), 1.0 / 6, 1e-15, 0);
    sfem_surface_free(&s);
}

static void all_formats_of_surfaces_give_the_same_tetrahedron(void **state)
{
    static const char *const text[] = {
        "# v\nv 0 0 0\nv 1 0 0 0.1 0.2 0.3\nvt 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1/7 2/8/9 4//3\nf -3 -2 -1\nf 1 4 3\n",
        "solid x y\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0 1 0\nvertex 1 0 0\nendloop\nendfacet\n"
        "facet normal 0 0 1\n outer loop\n vertex 0 0 0\nvertex 1 0 0\nvertex -0 0 1\nendloop\nendfacet\n"
        "facet normal 0 0 1\nouter loop\nvertex 1 0 0\nvertex 0 1 0\nvertex 0 0 1e0\nendloop\nendfacet\n"
        "FACET NORMAL 0 0 1\nOUTER LOOP\nVERTEX 0 0 0\nVERTEX 0 0 1\nVERTEX 0 1 0\nENDLOOP\nENDFACET\nendsolid",
        "OFF 4 4 6\n# c\n0 0 0\n1 0 0\n0 1 0\n\n0 0 1 # c\n3 0 2 1\n3 0 1 3 0.5 0.5 0.5\n3 1 2 3\n3 0 3 2\n",
        "COFF\n4 4\n0 0 0 255 0 0 255\n1 0 0 1 1 1 1\n0 1 0 1 1 1 1\n0 0 1 1 1 1 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2",
        "ply\r\nformat ascii 1.0\r\ncomment c\r\nelement vertex 4\r\nproperty double y\r\nproperty list uchar int l\r\nproperty "
        "float x\r\nproperty float z\r\nelement edge 1\r\nproperty int a\r\nelement face 4\r\nproperty list uchar int "
        "vertex_index\r\nproperty float f\r\nend_header\r\n0 0 0 0\n0 2 5 5 1 0\n1 1 9 0 0\n0 0 0 1\n7\n3 0 2 1 nan\n3 0 1 3 "
        "0\n3 1 2 3 0\n3 0 3 2 0\n"};
    static const unsigned char face[4][3] = {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {0, 3, 2}};
    unsigned char data[1024];
    size_t k, at;
    int big, t, i, c;
    (void)state;
    for (k = 0; k < TEST_COUNT(text); ++k) is_tetrahedron(text[k], strlen(text[k]));
    memset(data, 0, sizeof data); /* binary STL that begins as ASCII does */
    memcpy(data, "solid", 5);
    data[80] = 4;
    for (t = 0, at = 84; t < 4; ++t, at += 2)
        for (at += 12, i = 0; i < 3; ++i)
            for (c = 0; c < 3; ++c, at += 4)
                if (face[t][i] == c + 1) data[at + 2] = 0x80, data[at + 3] = 0x3f;
    is_tetrahedron(data, at);
    for (big = 0; big < 2; ++big) {
        snprintf((char *)data, sizeof data, "ply\nformat binary_%s_endian 1.0\nelement vertex 4\nproperty double x\nproperty "
                 "int16 y\nproperty char z\nelement face 4\nproperty list ushort uint vertex_indices\nend_header\n",
                 big ? "big" : "little");
        at = strlen((char *)data);
        memset(data + at, 0, sizeof data - at);
        for (i = 0; i < 4; ++i, at += 11) {
            if (i == 1) data[at + (big ? 0 : 7)] = 0x3f, data[at + (big ? 1 : 6)] = 0xf0;
            data[at + 8 + (big ? 1 : 0)] = (unsigned char)(i == 2);
            data[at + 10] = (unsigned char)(i == 3);
        }
        for (t = 0; t < 4; ++t, at += 14) {
            data[at + (big ? 1 : 0)] = 3;
            for (i = 0; i < 3; ++i) data[at + 2 + 4 * (size_t)i + (big ? 3 : 0)] = face[t][i];
        }
        is_tetrahedron(data, at);
    }
}

static void bad_surface_files_are_refused_with_their_line(void **state)
{
    static const struct {
        const char *text, *words;
        sfem_int line;
        sfem_status status;
    } bad[] = {
        {"", "no data", 1, SFEM_FORMAT},
        {"hello", "only the surfaces", 1, SFEM_FORMAT},
        {"v 0 0 0\nv 1 0\nf 1 2 3\n", "z of a vertex", 2, SFEM_FORMAT},
        {"v 0 0 nan\n", "not finite", 1, SFEM_NOT_FINITE},
        {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "not in -3 .. 3", 4, SFEM_FORMAT},
        {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n", "count from 1", 4, SFEM_FORMAT},
        {"v 0 0 0\nv 1 0 0\nf 1 2\n", "2 vertices", 3, SFEM_FORMAT},
        {"v 0 0 0\n", "no faces", -1, SFEM_BAD_MESH},
        {"solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nendloop\n", "a vertex of a facet", 5, SFEM_FORMAT},
        {"solid\nvertex 0 0 0\n", "one loop", 2, SFEM_FORMAT},
        {"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "vertex of a face is 3", 6, SFEM_FORMAT},
        {"OFF\n1000000 1 0\n0 0 0\n", "can hold", 2, SFEM_FORMAT},
        {"OFF BINARY\n", "binary OFF", 1, SFEM_FORMAT},
        {"4OFF\n1 1 1\n", "3 dimensions", 1, SFEM_FORMAT},
        {"ply\nformat ascii 2\nelement vertex 1\nproperty float x\nend_header\n0\n", "x, y and z", 6, SFEM_FORMAT},
        {"ply\nelement vertex 1\nend_header\n", "format", 3, SFEM_FORMAT},
        {"ply\nformat middle_endian 1\n", "binary_big_endian", 2, SFEM_FORMAT},
        {"ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\n", "a type of PLY", 4, SFEM_FORMAT},
        {"ply\nformat ascii 1.0\nproperty float x\n", "before any element", 3, SFEM_FORMAT}};
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(bad); ++k) {
        sfem_surface s, before;
        sfem_error err;
        memset(&s, 0x5a, sizeof s);
        before = s;
        assert_status(sfem_surface_parse(bad[k].text, strlen(bad[k].text), NULL, &s, &err), bad[k].status);
        assert_names(err, bad[k].words);
        assert_int_equal(err.line, bad[k].line);
        assert_memory_equal(&s, &before, sizeof s);
    }
}

static void a_mesh_reader_that_gets_a_surface_names_the_cure(void **state)
{
    static const char *const text[] = {"v 0 0 0\n", "# made by hand\no body\nv 0 0 0\n", "solid a\n", "ply\n", "OFF\n1 1 1\n"};
    const char *path = scratch_path("surface.stl");
    sfem_surface s;
    sfem_error err;
    sfem_mesh m;
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(text); ++k) {
        assert_status(sfem_mesh_parse(text[k], strlen(text[k]), NULL, &m, &err), SFEM_FORMAT);
        assert_names(err, "sfem_mesh_from_surface");
    }
    scratch_write(path, "neither text nor anything else");
    assert_status(sfem_mesh_read(path, NULL, &m, &err), SFEM_FORMAT);
    assert_names(err, "sfem_mesh_from_surface");
    assert_status(sfem_surface_read(path, NULL, &s, &err), SFEM_FORMAT);
    assert_names(err, "80 bytes of title");
    remove(path);
    assert_status(sfem_surface_read(path, NULL, &s, &err), SFEM_IO);
}

/* ---- progress ---- */

typedef struct told {
    sfem_real last;
    int calls;
} told;

static void hear(sfem_real part, void *user)
{
    told *t = (told *)user;
    assert_true(part >= t->last && part <= 1);
    t->last = part;
    ++t->calls;
}

static sfem_real ball_distance(const sfem_real x[3], void *user)
{
    (void)user;
    return sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]) - 1;
}

/* By size and by number of tets; the mesh is the same as without. */
static void progress_goes_up_to_1(void **state)
{
    const sfem_real box[2][3] = {{-1.1, -1.1, -1.1}, {1.1, 1.1, 1.1}};
    int k;
    (void)state;
    for (k = 0; k < 4; ++k) {
        sfem_mesher_def def = sfem_default_mesher_def();
        told t = {0, 0};
        sfem_mesh heard, m;
        sfem_error err;
        def.mode = k % 2 ? SFEM_CAGE : SFEM_FITTED;
        def.tets = 1500;
        if (k > 1) def.size = 0.1;
        assert_ok(sfem_mesh_from_sdf(&def, ball_distance, NULL, box, &m, NULL, &err), err);
        def.progress = hear;
        def.progress_user = &t;
        assert_ok(sfem_mesh_from_sdf(&def, ball_distance, NULL, box, &heard, NULL, &err), err);
        assert_true(t.last == 1 && t.calls >= (k > 1 ? 10 : 2));
        assert_int_equal(heard.tets, m.tets);
        assert_memory_equal(heard.x, m.x, 3 * (size_t)m.nodes * sizeof *m.x);
        sfem_mesh_free(&heard);
        sfem_mesh_free(&m);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_tree_gives_the_winding_number_of_all_triangles),
        cmocka_unit_test(a_fitted_mesh_is_near_the_surface_and_fills_its_volume),
        cmocka_unit_test(a_box_keeps_its_volume_and_faces),
        cmocka_unit_test(angles_stay_in_their_bounds_for_random_cuts),
        cmocka_unit_test(the_number_of_tets_is_what_was_asked_for),
        cmocka_unit_test(a_plate_of_few_layers_has_the_number_of_tets_too),
        cmocka_unit_test(needles_are_meshed_in_bounded_work),
        cmocka_unit_test(flipped_and_missing_triangles_change_little),
        cmocka_unit_test(doubled_triangles_give_the_same_bits),
        cmocka_unit_test(parts_that_overlap_touch_or_are_hollow_have_the_right_volume),
        cmocka_unit_test(bodies_that_meet_in_an_edge_or_corner_are_separated),
        cmocka_unit_test(a_cage_contains_the_surface_and_its_thin_parts),
        cmocka_unit_test(a_cage_of_a_thin_plate_has_its_volume),
        cmocka_unit_test(a_cage_has_the_mass_of_what_it_holds),
        cmocka_unit_test(functions_are_meshed),
        cmocka_unit_test(graded_meshes_are_coarse_inside_and_the_same_at_the_surface),
        cmocka_unit_test(a_thick_body_gets_edges_of_eight_times_the_length),
        cmocka_unit_test(graded_meshes_have_the_number_of_tets_too),
        cmocka_unit_test(hostile_surfaces_get_sentences),
        cmocka_unit_test(hostile_functions_get_sentences),
        cmocka_unit_test(every_failing_allocation_leaves_nothing_behind),
        cmocka_unit_test(memory_is_what_the_header_states),
        cmocka_unit_test(any_number_of_threads_gives_the_same_bits),
        cmocka_unit_test(all_formats_of_surfaces_give_the_same_tetrahedron),
        cmocka_unit_test(bad_surface_files_are_refused_with_their_line),
        cmocka_unit_test(a_mesh_reader_that_gets_a_surface_names_the_cure),
        cmocka_unit_test(progress_goes_up_to_1),
    };
    return run_all_tests(tests);
}
