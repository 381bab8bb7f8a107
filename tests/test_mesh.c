/* Meshes: generators, checks, surface, parts, numbering, picking. */
#include "support.h"
#include "linear.h"

/* ---- what the tests share ---- */

static const sfem_int cells435[3] = {4, 3, 5};
static const sfem_real size435[3] = {0.8, 0.3, 1.0};

static sfem_mesh block(sfem_int nx, sfem_int ny, sfem_int nz, sfem_block_cells kind)
{
    sfem_int cells[3];
    sfem_real size[3];
    sfem_error err;
    sfem_mesh m;
    cells[0] = nx, cells[1] = ny, cells[2] = nz;
    size[0] = nx, size[1] = ny, size[2] = nz;
    assert_ok(sfem_mesh_block(cells, size, kind, NULL, &m, &err), err);
    return m;
}

static sfem_mesh ball(sfem_real radius, sfem_int rings)
{
    sfem_error err;
    sfem_mesh m;
    assert_ok(sfem_mesh_ball(radius, rings, NULL, &m, &err), err);
    return m;
}

static sfem_mesh cylinder(sfem_real radius, sfem_real length, sfem_int rings, sfem_int layers)
{
    sfem_error err;
    sfem_mesh m;
    assert_ok(sfem_mesh_cylinder(radius, length, rings, layers, NULL, &m, &err), err);
    return m;
}

/* (b-a)x(c-a).(d-a)/6, written out here once more */
static sfem_real tet_volume(const sfem_real *x, const sfem_int *v)
{
    sfem_real e[3][3];
    int i, k;
    for (i = 0; i < 3; ++i)
        for (k = 0; k < 3; ++k) e[i][k] = x[3 * v[i + 1] + k] - x[3 * v[0] + k];
    return (e[0][0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1]) -
            e[0][1] * (e[1][0] * e[2][2] - e[1][2] * e[2][0]) +
            e[0][2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0])) /
           6;
}

static sfem_real mesh_volume(const sfem_mesh *m)
{
    sfem_real sum = 0;
    sfem_int t;
    for (t = 0; t < m->tets; ++t) sum += tet_volume(m->x, m->tet + 4 * t);
    return sum;
}

/* volume that a surface encloses, by the divergence theorem: positive if it faces outward */
static sfem_real enclosed_volume(const sfem_surface *s, const sfem_real *x)
{
    sfem_real sum = 0;
    sfem_int i;
    for (i = 0; i < s->triangles; ++i) {
        const sfem_real *a = x + 3 * s->tri[3 * i], *b = x + 3 * s->tri[3 * i + 1];
        const sfem_real *c = x + 3 * s->tri[3 * i + 2];
        sum += a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) +
               a[2] * (b[0] * c[1] - b[1] * c[0]);
    }
    return sum / 6;
}

static int compare_edges(const void *a, const void *b)
{
    const sfem_int *p = (const sfem_int *)a, *q = (const sfem_int *)b;
    if (p[0] != q[0]) return p[0] < q[0] ? -1 : 1;
    if (p[1] != q[1]) return p[1] < q[1] ? -1 : 1;
    return 0;
}

/* Every directed edge has its opposite, as often; returns the number of different edges. */
static sfem_int assert_closed(const sfem_surface *s)
{
    sfem_int n = 3 * s->triangles, i, k, distinct = 0, balance = 0;
    sfem_int(*e)[3] = (sfem_int(*)[3])malloc((size_t)n * sizeof *e);
    assert_non_null(e);
    for (i = 0; i < s->triangles; ++i)
        for (k = 0; k < 3; ++k) {
            sfem_int a = s->tri[3 * i + k], b = s->tri[3 * i + (k + 1) % 3];
            assert_int_not_equal(a, b);
            e[3 * i + k][0] = a < b ? a : b;
            e[3 * i + k][1] = a < b ? b : a;
            e[3 * i + k][2] = a < b ? 1 : -1;
        }
    qsort(e, (size_t)n, sizeof *e, compare_edges);
    for (i = 0; i < n; ++i) {
        if (i == 0 || compare_edges(e[i - 1], e[i])) {
            assert_int_equal(balance, 0);
            ++distinct;
        }
        balance += e[i][2];
    }
    assert_int_equal(balance, 0);
    free(e);
    return distinct;
}

/* Right-handed tets that meet face to face, a closed outward surface round the same volume. */
static void assert_sound(const sfem_mesh *m, sfem_int euler, sfem_real quality)
{
    sfem_mesh_report r;
    sfem_surface s;
    sfem_error err;
    sfem_int t;
    assert_ok(sfem_mesh_check(m, &r, &err), err);
    assert_int_equal(r.unused + r.coincident + r.overlapping, 0);
    assert_int_equal(r.components, 1);
    assert_int_equal(r.euler, euler);
    assert_true(r.min_quality > quality);
    assert_true(r.mean_quality > r.min_quality - 1e-12 && r.mean_quality < 1 + 1e-12);
    for (t = 0; t < m->tets; ++t) assert_true(tet_volume(m->x, m->tet + 4 * t) > 0);
    assert_ok(sfem_mesh_surface(m, NULL, &s, &err), err);
    assert_int_equal(assert_closed(&s), r.surface_edges);
    assert_int_equal(s.triangles, r.surface_triangles);
    assert_near(enclosed_volume(&s, m->x), mesh_volume(m), 1e-12, 0);
    assert_near(r.volume, mesh_volume(m), 1e-12, 0);
    sfem_surface_free(&s);
}

static void shuffle(sfem_mesh *m, uint64_t seed)
{
    test_random random = {seed};
    sfem_int i, k, n = m->nodes;
    sfem_int *number = (sfem_int *)malloc((size_t)n * sizeof *number);
    sfem_real *x = (sfem_real *)malloc(3 * (size_t)n * sizeof *x);
    for (i = 0; i < n; ++i) number[i] = i;
    for (i = n - 1; i > 0; --i) {
        sfem_int j = random_below(&random, i + 1), s = number[i];
        number[i] = number[j];
        number[j] = s;
    }
    memcpy(x, m->x, 3 * (size_t)n * sizeof *x);
    for (i = 0; i < n; ++i)
        for (k = 0; k < 3; ++k) m->x[3 * number[i] + k] = x[3 * i + k];
    for (i = 0; i < 4 * m->tets; ++i) m->tet[i] = number[m->tet[i]];
    free(number);
    free(x);
}

/* ---- generators ---- */

static void a_block_has_its_volume_and_numbering(void **state)
{
    int kind;
    (void)state;
    for (kind = 0; kind < 2; ++kind) {
        sfem_mesh m;
        sfem_error err;
        sfem_int i, j, k;
        assert_ok(sfem_mesh_block(cells435, size435, (sfem_block_cells)kind, NULL, &m, &err), err);
        assert_int_equal(m.nodes, 5 * 4 * 6);
        assert_int_equal(m.tets, (kind == SFEM_CELL_5_TETS ? 5 : 6) * 4 * 3 * 5);
        assert_null(m.region);
        assert_near(mesh_volume(&m), 0.8 * 0.3 * 1.0, 1e-13, 0);
        for (i = 0; i <= 4; ++i)
            for (j = 0; j <= 3; ++j)
                for (k = 0; k <= 5; ++k) {
                    const sfem_real *x = m.x + 3 * ((i * 4 + j) * 6 + k);
                    assert_near(x[0], 0.8 * i / 4, 1e-15, 0);
                    assert_near(x[1], 0.3 * j / 3, 1e-15, 0);
                    assert_near(x[2], 1.0 * k / 5, 1e-15, 0);
                }
        assert_true(m.x[3 * (m.nodes - 1)] == 0.8); /* the far corner to the bit */
        assert_sound(&m, 2, 0.3);
        sfem_mesh_free(&m);
    }
}

static void blocks_of_any_parity_are_sound(void **state)
{
    sfem_int n[3];
    int kind;
    (void)state;
    for (kind = 0; kind < 2; ++kind)
        for (n[0] = 1; n[0] < 4; ++n[0])
            for (n[1] = 1; n[1] < 4; ++n[1])
                for (n[2] = 1; n[2] < 4; ++n[2]) {
                    sfem_mesh m = block(n[0], n[1], n[2], (sfem_block_cells)kind);
                    sfem_mesh_report r;
                    assert_sound(&m, 2, kind == SFEM_CELL_5_TETS ? 0.76 : 0.65);
                    assert_status(sfem_mesh_check(&m, &r, NULL), SFEM_OK);
                    assert_int_equal(r.surface_triangles,
                                     4 * (n[0] * n[1] + n[1] * n[2] + n[0] * n[2]));
                    assert_near(r.max_edge, sqrt(kind == SFEM_CELL_5_TETS ? 2 : 3), 1e-15, 0);
                    assert_near(r.min_edge, 1, 1e-15, 0);
                    sfem_mesh_free(&m);
                }
}

/* Nodes on the surface, flat triangles between: the error falls as the square of the edge. */
static void the_ball_converges_to_its_volume(void **state)
{
    const sfem_real exact = 4 * TEST_PI / 3 * 8;
    sfem_real last = 0, error;
    sfem_int rings;
    (void)state;
    for (rings = 1; rings <= 16; rings *= 2) {
        sfem_mesh m = ball(2, rings);
        sfem_int i, on_sphere = 0;
        assert_int_equal(m.tets, 20 * rings * rings * rings);
        assert_sound(&m, 2, 0.53);
        for (i = 0; i < m.nodes; ++i) {
            const sfem_real *x = m.x + 3 * i;
            sfem_real r = sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
            assert_true(r < 2 + 1e-14);
            on_sphere += r > 2 - 1e-14;
        }
        assert_int_equal(on_sphere, 10 * rings * rings + 2);
        error = exact - mesh_volume(&m);
        assert_true(error > 0);
        if (rings > 2) assert_near(last / error, 4, 0.1, 0);
        last = error;
        sfem_mesh_free(&m);
    }
}

static void the_cylinder_is_a_polygonal_prism_that_converges(void **state)
{
    sfem_int rings;
    (void)state;
    for (rings = 1; rings <= 8; rings *= 2) {
        sfem_mesh m = cylinder(0.5, 2, rings, 4 * rings);
        sfem_int sides = 6 * rings;
        /* the polygon's area is n/2 r^2 sin(2 pi/n) = pi r^2 (1 - (2 pi/n)^2 / 6 + ..) */
        sfem_real area = 0.5 * sides * 0.25 * sin(2 * TEST_PI / sides);
        sfem_mesh_report r;
        assert_int_equal(m.nodes, (3 * rings * (rings + 1) + 1) * (4 * rings + 1));
        assert_int_equal(m.tets, 18 * rings * rings * 4 * rings);
        assert_near(mesh_volume(&m), 2 * area, 1e-12, 0);
        assert_near(mesh_volume(&m), TEST_PI * 0.5, 6.6 / (sides * sides), 0);
        assert_sound(&m, 2, 0.55);
        assert_status(sfem_mesh_check(&m, &r, NULL), SFEM_OK);
        assert_true(r.box[0][0] == 0 && r.box[1][0] == 2);
        assert_near(r.box[1][1], 0.5, 1e-15, 0);
        sfem_mesh_free(&m);
    }
}

static void generators_refuse_what_they_cannot_make(void **state)
{
    const sfem_int huge[3] = {2000000000, 2000000000, 2000000000}, no[3] = {3, 0, 2};
    const sfem_real flat[3] = {1, 1, 0}, nan3[3] = {1, NAN, 1};
    sfem_mesh m, before;
    sfem_error err;
    (void)state;
    memset(&m, 0x5a, sizeof m);
    before = m;
    assert_status(sfem_mesh_block(no, size435, SFEM_CELL_5_TETS, NULL, &m, &err),
                  SFEM_BAD_ARGUMENT);
    assert_names(err, "count 1 is 0");
    assert_status(sfem_mesh_block(cells435, flat, SFEM_CELL_5_TETS, NULL, &m, &err),
                  SFEM_BAD_ARGUMENT);
    assert_names(err, "length 2 is 0");
    assert_status(sfem_mesh_block(cells435, nan3, SFEM_CELL_5_TETS, NULL, &m, &err),
                  SFEM_BAD_ARGUMENT);
    assert_status(sfem_mesh_block(cells435, size435, (sfem_block_cells)7, NULL, &m, &err),
                  SFEM_BAD_ARGUMENT);
    assert_status(sfem_mesh_block(huge, size435, SFEM_CELL_6_TETS, NULL, &m, &err), SFEM_TOO_LARGE);
    assert_status(sfem_mesh_cylinder(-1, 1, 2, 2, NULL, &m, &err), SFEM_BAD_ARGUMENT);
    assert_status(sfem_mesh_cylinder(1, INFINITY, 2, 2, NULL, &m, &err), SFEM_BAD_ARGUMENT);
    assert_status(sfem_mesh_cylinder(1, 1, -2, 2, NULL, &m, &err), SFEM_BAD_ARGUMENT);
    assert_status(sfem_mesh_cylinder(1, 1, 2, 0, NULL, &m, NULL), SFEM_BAD_ARGUMENT);
    assert_status(sfem_mesh_cylinder(1, 1, 2000000, 2000000, NULL, &m, &err), SFEM_TOO_LARGE);
    assert_status(sfem_mesh_ball(0, 2, NULL, &m, &err), SFEM_BAD_ARGUMENT);
    assert_status(sfem_mesh_ball(1, 0, NULL, &m, &err), SFEM_BAD_ARGUMENT);
    assert_status(sfem_mesh_ball(1, 2147483647, NULL, &m, &err), SFEM_TOO_LARGE);
    assert_memory_equal(&m, &before, sizeof m);
}

static void freeing_twice_is_harmless(void **state)
{
    static const sfem_mesh zero;
    static const sfem_surface no_surface;
    sfem_surface s;
    sfem_mesh m = ball(1, 2);
    (void)state;
    assert_status(sfem_mesh_surface(&m, NULL, &s, NULL), SFEM_OK);
    sfem_mesh_free(&m);
    assert_memory_equal(&m, &zero, sizeof m);
    sfem_mesh_free(&m);
    sfem_mesh_free(NULL);
    sfem_surface_free(&s);
    assert_memory_equal(&s, &no_surface, sizeof s);
    sfem_surface_free(&s);
    sfem_surface_free(NULL);
}

/* ---- checks ---- */

/* the unit corner tet and its mirror image below, on the face 0 1 2 */
static const sfem_real two_x[15] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, -1};
static const sfem_int two_tets[8] = {0, 1, 2, 3, 0, 2, 1, 4};

static void arrays_are_copied_turned_and_checked(void **state)
{
    sfem_int tet[8];
    sfem_real x[15];
    sfem_mesh m;
    sfem_error err;
    (void)state;
    memcpy(tet, two_tets, sizeof tet);
    memcpy(x, two_x, sizeof x);
    tet[6] = 4, tet[7] = 1; /* left-handed */
    assert_ok(sfem_mesh_copy(5, x, 2, tet, NULL, &m, &err), err);
    assert_memory_equal(m.tet, two_tets, sizeof two_tets);
    assert_memory_equal(m.x, two_x, sizeof two_x);
    assert_int_equal(tet[6], 4); /* the caller's are as they were */
    assert_near(mesh_volume(&m), 1. / 3, 1e-15, 0);
    sfem_mesh_free(&m);
    tet[4] = 5;
    assert_status(sfem_mesh_copy(5, x, 2, tet, NULL, &m, &err), SFEM_BAD_MESH);
    assert_string_equal(err.text, "tet 1 names node 5, the mesh has 5");
    assert_int_equal(err.tet, 1);
    assert_int_equal(err.node, 5);
    assert_status(sfem_mesh_copy(0, x, 0, tet, NULL, &m, &err), SFEM_BAD_MESH);
    assert_names(err, "empty");
}

static void every_fault_is_found_and_named(void **state)
{
    static const struct {
        sfem_int tet[4]; /* instead of the second one */
        sfem_int node;   /* whose z becomes .. */
        sfem_real z;
        sfem_status status;
        sfem_int err_node, err_tet;
        const char *text;
    } fault[] = {
        {{0, 2, 1, 4}, 4, -1, SFEM_OK, -1, -1, ""},
        {{0, 2, 1, 99}, 4, -1, SFEM_BAD_MESH, 99, 1, "tet 1 names node 99, the mesh has 5"},
        {{0, -1, 1, 4}, 4, -1, SFEM_BAD_MESH, -1, 1, "tet 1 names node -1, the mesh has 5"},
        {{0, 2, 2, 4}, 4, -1, SFEM_BAD_MESH, 2, 1, "tet 1 names node 2 twice"},
        {{0, 1, 2, 4}, 4, -1, SFEM_BAD_MESH, -1, 1, "tet 1 (nodes 0 1 2 4) is inverted"},
        {{0, 2, 1, 4}, 4, 0, SFEM_BAD_MESH, -1, 1, "tet 1 (nodes 0 2 1 4) is flat"},
        {{0, 2, 1, 4}, 4, -1e-13, SFEM_BAD_MESH, -1, 1, "flat"},
        {{0, 2, 1, 4}, 4, -1e-11, SFEM_OK, -1, -1, ""},
        {{0, 2, 1, 4}, 4, NAN, SFEM_NOT_FINITE, 4, -1, "node 4 is at (0, 0, nan)"},
        {{0, 2, 1, 4}, 3, INFINITY, SFEM_NOT_FINITE, 3, -1, "node 3 is at (0, 0, inf)"},
        {{0, 2, 1, 3}, 4, NAN, SFEM_NOT_FINITE, 4, -1, "node 4"},
    };
    size_t i;
    (void)state;
    for (i = 0; i < TEST_COUNT(fault); ++i) {
        sfem_real x[15];
        sfem_int tet[8];
        sfem_mesh m;
        sfem_mesh_report r;
        sfem_error err = {SFEM_OK, -1, -1, -1, ""};
        int with_report;
        memset(&m, 0, sizeof m);
        memcpy(x, two_x, sizeof x);
        memcpy(tet, two_tets, sizeof tet);
        memcpy(tet + 4, fault[i].tet, sizeof fault[i].tet);
        x[3 * fault[i].node + 2] = fault[i].z;
        m.nodes = 5, m.tets = 2, m.x = x, m.tet = tet;
        for (with_report = 0; with_report < 2; ++with_report) {
            assert_status(sfem_mesh_check(&m, with_report ? &r : NULL, &err), fault[i].status);
            assert_names(err, fault[i].text);
            assert_int_equal(err.tet, fault[i].err_tet);
            assert_int_equal(err.node, fault[i].err_node);
        }
        assert_int_equal(r.out_of_range, i == 1 || i == 2);
        assert_int_equal(r.repeated, i == 3);
        assert_int_equal(r.inverted, i == 4 || i == 10);
        assert_int_equal(r.flat, i == 5 || i == 6);
        assert_int_equal(r.not_finite, i >= 8);
        assert_int_equal(r.components, r.out_of_range || r.repeated ? -1 : 1);
    }
}

static void an_empty_mesh_is_a_fault(void **state)
{
    sfem_mesh m;
    sfem_mesh_report r;
    sfem_error err;
    (void)state;
    memset(&m, 0, sizeof m);
    assert_status(sfem_mesh_check(&m, &r, &err), SFEM_BAD_MESH);
    assert_string_equal(err.text, "the mesh is empty: 0 nodes, 0 tets");
    assert_int_equal(r.worst_tet, -1);
}

/* Counts are data: a reader of the caller's may have taken them from a file. */
static void negative_counts_are_a_fault(void **state)
{
    static const sfem_int counts[4][2] = {{-3, 0}, {-3, 1}, {4, -2}, {INT32_MIN, INT32_MIN}};
    sfem_real x[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1}, bary[4];
    const sfem_real origin[3] = {-1, 0.1, 0.1}, direction[3] = {1, 0, 0};
    sfem_int tet[4] = {0, 1, 2, 3}, label[4], count;
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(counts); ++k) {
        sfem_model_def def = linear_model_def();
        sfem_model *model = NULL;
        sfem_mesh_report r;
        sfem_surface surface;
        sfem_mesh m, out;
        sfem_error err;
        char wanted[80];
        memset(&m, 0, sizeof m);
        m.nodes = counts[k][0], m.tets = counts[k][1], m.x = x, m.tet = tet;
        def.mesh = &m;
        snprintf(wanted, sizeof wanted, "%ld nodes and %ld tets", (long)m.nodes, (long)m.tets);
        assert_status(sfem_mesh_check(&m, NULL, &err), SFEM_BAD_MESH);
        assert_names(err, wanted);
        assert_status(sfem_mesh_check(&m, &r, &err), SFEM_BAD_MESH);
        assert_int_equal(r.components, -1);
        assert_status(sfem_mesh_copy(m.nodes, x, m.tets, tet, NULL, &out, &err), SFEM_BAD_MESH);
        assert_names(err, wanted);
        assert_status(sfem_mesh_surface(&m, NULL, &surface, &err), SFEM_BAD_MESH);
        assert_names(err, wanted);
        assert_status(sfem_mesh_components(&m, label, &count, &err), SFEM_BAD_MESH);
        assert_status(sfem_mesh_renumber(&m, NULL, &err), SFEM_BAD_MESH);
        assert_status(sfem_mesh_remove_unused(&m, NULL, &err), SFEM_BAD_MESH);
        assert_status(sfem_model_create(&def, &model, &err), SFEM_BAD_MESH);
        assert_names(err, wanted);
        assert_int_equal(sfem_mesh_orient(&m), 0);
        assert_int_equal(m.nodes, counts[k][0]);
        assert_int_equal(m.tets, counts[k][1]);
        if (m.tets > 0) continue;
        assert_int_equal(mesh_bandwidth(&m), 0);
        assert_int_equal(sfem_mesh_pick_ray(&m, NULL, origin, direction, &count, bary, NULL), 0);
        assert_int_equal(sfem_mesh_locate(&m, NULL, origin, &count, bary), 0);
    }
}

static void quality_is_one_for_the_regular_tet_at_any_scale(void **state)
{
    static const sfem_real scales[] = {1, 1e-90, 1e90, 1e-250, 1e250};
    sfem_real x[12] = {1, 1, 1, -1, 1, -1, 1, -1, -1, -1, -1, 1}, scaled[12];
    sfem_int tet[4] = {0, 1, 2, 3};
    sfem_mesh_report r;
    sfem_mesh m;
    size_t i, k;
    (void)state;
    memset(&m, 0, sizeof m);
    m.nodes = 4, m.tets = 1, m.x = scaled, m.tet = tet;
    for (i = 0; i < TEST_COUNT(scales); ++i) {
        for (k = 0; k < 12; ++k) scaled[k] = x[k] * scales[i];
        assert_status(sfem_mesh_check(&m, &r, NULL), SFEM_OK);
        assert_near(r.min_quality, 1, 1e-14, 0);
        assert_near(r.min_edge / scales[i], sqrt(8.0), 1e-14, 0);
    }
    /* the corner tet: V = 1/6, squared edges 1 1 1 2 2 2: q = 6 sqrt(2)/6 / 1.5^1.5 */
    m.x = (sfem_real *)two_x;
    assert_status(sfem_mesh_check(&m, &r, NULL), SFEM_OK);
    assert_near(r.min_quality, sqrt(2.0) / pow(1.5, 1.5), 1e-14, 0);
    assert_near(r.max_volume, 1. / 6, 1e-15, 0);
}

static void orient_turns_left_handed_tets_only(void **state)
{
    sfem_mesh m = ball(1, 3);
    test_random random = {7};
    sfem_int t, turned = 0;
    (void)state;
    for (t = 0; t < m.tets; ++t) {
        sfem_int *v = m.tet + 4 * t, s = v[0];
        if (random_below(&random, 3)) continue;
        v[0] = v[1], v[1] = s;
        ++turned;
    }
    assert_status(sfem_mesh_check(&m, NULL, NULL), SFEM_BAD_MESH);
    assert_int_equal(sfem_mesh_orient(&m), turned);
    assert_int_equal(sfem_mesh_orient(&m), 0);
    assert_sound(&m, 2, 0.53);
    sfem_mesh_free(&m);
}

static void the_report_counts_what_is_suspicious(void **state)
{
    /* the two tets, the first a second time, a node like node 3, and one that is far away */
    sfem_real x[21] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, -1, -0.0, 0, 1, 9, 9, 9};
    sfem_int tet[12] = {0, 1, 2, 3, 0, 2, 1, 4, 0, 1, 2, 5};
    sfem_mesh m;
    sfem_mesh_report r;
    sfem_error err;
    (void)state;
    memset(&m, 0, sizeof m);
    m.nodes = 7, m.tets = 3, m.x = x, m.tet = tet;
    assert_ok(sfem_mesh_check(&m, &r, &err), err);
    assert_int_equal(r.unused, 1);
    assert_int_equal(r.coincident, 1);
    assert_int_equal(r.overlapping, 1); /* face 0 1 2 has two tets above */
    assert_int_equal(r.components, 1);
    assert_near(r.volume, 0.5, 1e-15, 0);
    assert_true(r.box[1][2] == 9 && r.box[0][2] == -1);
    assert_int_equal(r.worst_tet, 0);
}

/* ---- surface and parts ---- */

static void each_surface_triangle_belongs_to_the_tet_behind_it(void **state)
{
    sfem_mesh m = cylinder(1, 1, 3, 2);
    sfem_surface s;
    sfem_int i, k, j;
    (void)state;
    assert_status(sfem_mesh_surface(&m, NULL, &s, NULL), SFEM_OK);
    for (i = 0; i < s.triangles; ++i) {
        sfem_int behind[4], found = 0;
        const sfem_int *v = m.tet + 4 * s.tet[i];
        assert_true(i == 0 || s.tet[i] >= s.tet[i - 1]);
        for (k = 0; k < 4; ++k) {
            int in_face = 0;
            for (j = 0; j < 3; ++j) in_face |= s.tri[3 * i + j] == v[k];
            found += in_face;
            if (!in_face) behind[3] = v[k];
        }
        assert_int_equal(found, 3);
        for (j = 0; j < 3; ++j) behind[j] = s.tri[3 * i + j];
        assert_true(tet_volume(m.x, behind) <
                    0); /* the fourth node is inside, below the triangle */
    }
    sfem_surface_free(&s);
    sfem_mesh_free(&m);
}

/* A block with a cell taken out has two surfaces, one with a channel is a ring. */
static void cavities_and_channels_show_in_the_euler_number(void **state)
{
    int channel;
    (void)state;
    for (channel = 0; channel < 2; ++channel) {
        sfem_mesh m = block(3, 3, 3, SFEM_CELL_6_TETS);
        sfem_mesh_report r;
        sfem_surface s;
        sfem_int t, k, n = 0;
        for (t = 0; t < m.tets; ++t) {
            sfem_real c[3] = {0, 0, 0};
            for (k = 0; k < 12; ++k) c[k % 3] += m.x[3 * m.tet[4 * t + k / 3] + k % 3] / 4;
            if (c[0] > 1 && c[0] < 2 && c[1] > 1 && c[1] < 2 && (channel || (c[2] > 1 && c[2] < 2)))
                continue;
            memmove(m.tet + 4 * n++, m.tet + 4 * t, 4 * sizeof *m.tet);
        }
        m.tets = n;
        assert_status(sfem_mesh_check(&m, &r, NULL), SFEM_OK);
        assert_int_equal(r.components, 1);
        assert_int_equal(r.euler, channel ? 0 : 4);
        assert_status(sfem_mesh_surface(&m, NULL, &s, NULL), SFEM_OK);
        assert_closed(&s);
        assert_near(enclosed_volume(&s, m.x), channel ? 24 : 26, 1e-13, 0);
        sfem_surface_free(&s);
        sfem_mesh_free(&m);
    }
}

static void the_surface_of_overlapping_tets_is_closed(void **state)
{
    sfem_int tet[16] = {0, 1, 2, 3, 0, 2, 1, 4, 0, 1, 2, 3, 1, 2, 0, 3};
    sfem_mesh m;
    sfem_surface s;
    (void)state;
    memset(&m, 0, sizeof m);
    m.nodes = 5, m.tets = 4, m.x = (sfem_real *)two_x, m.tet = tet;
    assert_status(sfem_mesh_surface(&m, NULL, &s, NULL), SFEM_OK);
    assert_int_equal(s.triangles, 3 + 2 + 3 * 3); /* one of the faces 0 1 2 met its opposite */
    assert_closed(&s);
    assert_near(enclosed_volume(&s, two_x), 4. / 6, 1e-15, 0);
    sfem_surface_free(&s);
}

static void parts_are_labelled_by_their_lowest_node(void **state)
{
    /* three tets: nodes 1 3 5 7, 2 4 6 8 and 8 9 10 11; 0 and 12 unused */
    sfem_int tet[12] = {7, 5, 3, 1, 11, 10, 9, 8, 2, 8, 4, 6}, label[13], count, i;
    static const sfem_int wanted[13] = {-1, 0, 1, 0, 1, 0, 1, 0, 1, 1, 1, 1, -1};
    sfem_real x[39] = {0};
    sfem_mesh m;
    sfem_error err;
    (void)state;
    memset(&m, 0, sizeof m);
    m.nodes = 13, m.tets = 3, m.x = x, m.tet = tet;
    assert_ok(sfem_mesh_components(&m, label, &count, &err), err);
    assert_int_equal(count, 2);
    for (i = 0; i < 13; ++i) assert_int_equal(label[i], wanted[i]);
    tet[5] = 13;
    assert_status(sfem_mesh_components(&m, label, NULL, &err), SFEM_BAD_MESH);
    assert_string_equal(err.text, "tet 1 names node 13, the mesh has 13: numbered from 1? Node numbers start at 0");
}

/* A chain of tets, each on the last face of the one before, numbered against the grain. */
static void a_long_chain_is_one_part_whatever_its_numbering(void **state)
{
    enum { n = 20000 };
    sfem_int *tet = (sfem_int *)malloc(4 * n * sizeof *tet), *label, count, t, k;
    sfem_real *x = (sfem_real *)calloc(3 * (n + 3), sizeof *x);
    int order;
    sfem_mesh m;
    (void)state;
    label = (sfem_int *)malloc((n + 3) * sizeof *label);
    memset(&m, 0, sizeof m);
    m.nodes = n + 3, m.tets = n, m.x = x, m.tet = tet;
    for (order = 0; order < 2; ++order) {
        for (t = 0; t < n; ++t)
            for (k = 0; k < 4; ++k) tet[4 * t + k] = order ? t + k : n + 2 - t - k;
        assert_status(sfem_mesh_components(&m, label, &count, NULL), SFEM_OK);
        assert_int_equal(count, 1);
        for (t = 0; t < n + 3; ++t) assert_int_equal(label[t], 0);
        assert_status(sfem_mesh_renumber(&m, NULL, NULL), SFEM_OK);
        assert_int_equal(mesh_bandwidth(&m), 3);
    }
    free(tet);
    free(x);
    free(label);
}

/* ---- numbering ---- */

static void renumbering_narrows_a_shuffled_mesh_and_keeps_its_shape(void **state)
{
    sfem_mesh m = block(12, 6, 5, SFEM_CELL_5_TETS), old;
    sfem_int *new_of_old, *seen, *tet_of, i, k, lattice = mesh_bandwidth(&m), wide;
    sfem_error err;
    (void)state;
    shuffle(&m, 3);
    wide = mesh_bandwidth(&m);
    assert_true(wide > 8 * lattice);
    m.region = (sfem_int *)malloc((size_t)m.tets * sizeof *m.region);
    for (i = 0; i < m.tets; ++i) m.region[i] = i;
    old = m;
    old.x = (sfem_real *)malloc(3 * (size_t)m.nodes * sizeof *old.x);
    old.tet = (sfem_int *)malloc(4 * (size_t)m.tets * sizeof *old.tet);
    memcpy(old.x, m.x, 3 * (size_t)m.nodes * sizeof *old.x);
    memcpy(old.tet, m.tet, 4 * (size_t)m.tets * sizeof *old.tet);
    new_of_old = (sfem_int *)malloc((size_t)m.nodes * sizeof *new_of_old);
    seen = (sfem_int *)calloc((size_t)m.nodes, sizeof *seen);
    tet_of = (sfem_int *)calloc((size_t)m.tets, sizeof *tet_of);
    assert_ok(sfem_mesh_renumber(&m, new_of_old, &err), err);
    /* the lattice's own bandwidth is that of a slice; a level of the search is a skewed one */
    assert_true(mesh_bandwidth(&m) < 2 * lattice);
    for (i = 0; i < m.nodes; ++i) {
        assert_in_range(new_of_old[i], 0, m.nodes - 1);
        assert_int_equal(seen[new_of_old[i]]++, 0);
        for (k = 0; k < 3; ++k) assert_true(m.x[3 * new_of_old[i] + k] == old.x[3 * i + k]);
    }
    for (i = 0; i < m.tets; ++i) { /* region still is the tet's old number */
        sfem_int was = m.region[i], low = m.nodes, last_low = m.nodes;
        assert_int_equal(tet_of[was]++, 0);
        for (k = 0; k < 4; ++k) {
            assert_int_equal(m.tet[4 * i + k], new_of_old[old.tet[4 * was + k]]);
            if (m.tet[4 * i + k] < low) low = m.tet[4 * i + k];
            if (i && m.tet[4 * i - 4 + k] < last_low) last_low = m.tet[4 * i - 4 + k];
        }
        assert_true(i == 0 || last_low <= low);
    }
    free(m.region);
    m.region = NULL;
    assert_sound(&m, 2, 0.76);
    free(old.x);
    free(old.tet);
    free(new_of_old);
    free(seen);
    free(tet_of);
    sfem_mesh_free(&m);
}

static void renumbering_keeps_parts_together_and_puts_unused_nodes_last(void **state)
{
    sfem_int tet[12] = {7, 5, 3, 1, 11, 10, 9, 8, 2, 8, 4, 6}, new_of_old[13], label[13], count, i;
    sfem_real x[39];
    sfem_mesh m;
    (void)state;
    memset(&m, 0, sizeof m);
    m.nodes = 13, m.tets = 3, m.x = x, m.tet = tet;
    for (i = 0; i < 39; ++i) x[i] = i;
    assert_status(sfem_mesh_renumber(&m, new_of_old, NULL), SFEM_OK);
    assert_int_equal(new_of_old[0], 11);
    assert_int_equal(new_of_old[12], 12);
    assert_status(sfem_mesh_components(&m, label, &count, NULL), SFEM_OK);
    for (i = 0; i < 13; ++i) assert_int_equal(label[i], i < 4 ? 0 : i < 11 ? 1 : -1);
    assert_status(sfem_mesh_remove_unused(&m, new_of_old, NULL), SFEM_OK);
    assert_int_equal(m.nodes, 11);
    assert_int_equal(new_of_old[11], -1);
}

static void unused_nodes_are_removed_in_order(void **state)
{
    sfem_real x[21] = {9, 9, 9, 0, 0, 0, 1, 0, 0, 9, 9, 9, 0, 1, 0, 0, 0, 1, 9, 9, 9};
    sfem_int tet[4] = {1, 2, 4, 5}, new_of_old[7], i;
    static const sfem_int wanted[7] = {-1, 0, 1, -1, 2, 3, -1}, wanted_tet[4] = {0, 1, 2, 3};
    sfem_mesh m;
    sfem_error err;
    (void)state;
    memset(&m, 0, sizeof m);
    m.nodes = 7, m.tets = 1, m.x = x, m.tet = tet;
    assert_ok(sfem_mesh_remove_unused(&m, new_of_old, &err), err);
    assert_int_equal(m.nodes, 4);
    for (i = 0; i < 7; ++i) assert_int_equal(new_of_old[i], wanted[i]);
    assert_memory_equal(tet, wanted_tet, sizeof tet);
    assert_memory_equal(x, two_x, 12 * sizeof *x);
    assert_ok(sfem_mesh_remove_unused(&m, NULL, &err), err);
    assert_int_equal(m.nodes, 4);
    tet[0] = 4;
    assert_status(sfem_mesh_remove_unused(&m, NULL, &err), SFEM_BAD_MESH);
    assert_int_equal(m.nodes, 4);
}

/* ---- picking ---- */

/* a large smooth motion; the ball stays free of inverted tets */
static sfem_real *twisted(const sfem_mesh *m)
{
    sfem_real *x = (sfem_real *)malloc(3 * (size_t)m->nodes * sizeof *x);
    sfem_int i;
    for (i = 0; i < m->nodes; ++i) {
        const sfem_real *r = m->x + 3 * i;
        sfem_real c = cos(r[2]), s = sin(r[2]);
        x[3 * i] = 10 + c * r[0] - s * r[1];
        x[3 * i + 1] = s * r[0] + c * r[1];
        x[3 * i + 2] = 2 * r[2];
    }
    return x;
}

static void assert_bary(const sfem_real *x, const sfem_int *v, const sfem_real b[4],
                        const sfem_real point[3], sfem_real atol)
{
    int i, k;
    assert_near(b[0] + b[1] + b[2] + b[3], 1, 1e-14, 0);
    for (k = 0; k < 4; ++k) assert_true(b[k] >= 0);
    for (k = 0; k < 3; ++k) {
        sfem_real p = 0;
        for (i = 0; i < 4; ++i) p += b[i] * x[3 * v[i] + k];
        assert_near(p, point[k], 0, atol);
    }
}

static void points_are_located_in_rest_and_in_motion(void **state)
{
    sfem_mesh m = ball(1, 4);
    sfem_real *moved = twisted(&m);
    test_random random = {11};
    int i, moving;
    (void)state;
    for (moving = 0; moving < 2; ++moving)
        for (i = 0; i < 300; ++i) {
            const sfem_real *x = moving ? moved : m.x;
            sfem_int chosen = random_below(&random, m.tets), tet;
            sfem_real b[4], sum = 0, bary[4], point[3] = {0, 0, 0};
            int k, j;
            for (k = 0; k < 4; ++k) sum += b[k] = random_uniform(&random, 0.01, 1);
            for (k = 0; k < 4; ++k)
                for (j = 0; j < 3; ++j) point[j] += b[k] / sum * x[3 * m.tet[4 * chosen + k] + j];
            assert_int_equal(sfem_mesh_locate(&m, moving ? moved : NULL, point, &tet, bary), 1);
            assert_int_equal(tet, chosen);
            assert_bary(x, m.tet + 4 * tet, bary, point, 1e-13);
            for (k = 0; k < 4; ++k) assert_near(bary[k], b[k] / sum, 1e-10, 0);
        }
    free(moved);
    sfem_mesh_free(&m);
}

static void nodes_and_points_on_faces_are_located(void **state)
{
    sfem_mesh m = ball(0.37, 3);
    sfem_surface s;
    sfem_int i, tet;
    sfem_real bary[4], point[3];
    int k;
    (void)state;
    for (i = 0; i < m.nodes; ++i) {
        assert_int_equal(sfem_mesh_locate(&m, NULL, m.x + 3 * i, &tet, bary), 1);
        assert_bary(m.x, m.tet + 4 * tet, bary, m.x + 3 * i, 1e-10);
    }
    assert_status(sfem_mesh_surface(&m, NULL, &s, NULL), SFEM_OK);
    for (i = 0; i < s.triangles; ++i) {
        for (k = 0; k < 3; ++k)
            point[k] = (m.x[3 * s.tri[3 * i] + k] + m.x[3 * s.tri[3 * i + 1] + k] +
                        m.x[3 * s.tri[3 * i + 2] + k]) /
                       3;
        assert_int_equal(sfem_mesh_locate(&m, NULL, point, &tet, bary), 1);
        assert_int_equal(tet, s.tet[i]);
        for (k = 0; k < 3; ++k) point[k] *= 1 + 1e-6;
        assert_int_equal(sfem_mesh_locate(&m, NULL, point, &tet, bary), 0);
    }
    sfem_surface_free(&s);
    sfem_mesh_free(&m);
}

static void outside_nothing_is_located_or_written(void **state)
{
    sfem_mesh m = ball(1, 2);
    const sfem_real out[3] = {0, 0, 1.01}, away[3] = {0, 0, 1}, none[3] = {0, 0, 0};
    const sfem_real nowhere[3] = {NAN, 0, 0};
    sfem_int tet = 77;
    sfem_real bary[4] = {5, 5, 5, 5}, distance = 5;
    (void)state;
    assert_int_equal(sfem_mesh_locate(&m, NULL, out, &tet, bary), 0);
    assert_int_equal(sfem_mesh_locate(&m, NULL, nowhere, &tet, bary), 0);
    assert_int_equal(sfem_mesh_pick_ray(&m, NULL, out, away, &tet, bary, &distance), 0);
    assert_int_equal(sfem_mesh_pick_ray(&m, NULL, out, none, &tet, bary, &distance), 0);
    assert_int_equal(sfem_mesh_pick_ray(&m, NULL, out, nowhere, &tet, bary, &distance), 0);
    assert_true(tet == 77 && bary[0] == 5 && distance == 5);
    assert_int_equal(sfem_mesh_locate(&m, NULL, none, NULL, NULL), 1);
    sfem_mesh_free(&m);
}

static void a_ray_meets_a_block_where_it_should(void **state)
{
    sfem_mesh m = block(4, 3, 2, SFEM_CELL_5_TETS);
    test_random random = {5};
    int i;
    (void)state;
    for (i = 0; i < 1000; ++i) {
        sfem_real origin[3] = {7, 0, 0}, target[3] = {4, 0, 0}, direction[3], bary[4], distance;
        sfem_real along = 0, scale = pow(10, random_uniform(&random, -100, 100));
        sfem_int tet;
        int k;
        target[1] = random_uniform(&random, 0, 3);
        target[2] = random_uniform(&random, 0, 2);
        origin[1] = random_uniform(&random, -9, 9);
        origin[2] = random_uniform(&random, -9, 9);
        if (i < 60) target[1] = 1 + i % 2, target[2] = 1; /* at nodes, past which nothing slips */
        if (i < 20) target[1] = i % 4, target[2] = i / 4 % 3; /* straight, and along edges, too */
        if (i < 20) origin[1] = target[1], origin[2] = target[2];
        for (k = 0; k < 3; ++k) direction[k] = target[k] - origin[k];
        for (k = 0; k < 3; ++k) along += direction[k] * direction[k];
        for (k = 0; k < 3; ++k) direction[k] *= scale;
        assert_int_equal(sfem_mesh_pick_ray(&m, NULL, origin, direction, &tet, bary, &distance), 1);
        assert_near(distance, sqrt(along), 1e-8, 0);
        assert_bary(m.x, m.tet + 4 * tet, bary, target, 1e-7);
        for (k = 0; k < 3; ++k) direction[k] = -direction[k];
        assert_int_equal(sfem_mesh_pick_ray(&m, NULL, origin, direction, &tet, bary, &distance), 0);
    }
    sfem_mesh_free(&m);
}

static void a_ray_that_starts_inside_is_there_already(void **state)
{
    sfem_mesh m = ball(1, 3);
    sfem_real *moved = twisted(&m);
    const sfem_real direction[3] = {0, 0, -3}, origin[3] = {10.1, 0.2, 0.3};
    sfem_real bary[4], distance;
    sfem_int tet, located;
    (void)state;
    assert_int_equal(sfem_mesh_pick_ray(&m, moved, origin, direction, &tet, bary, &distance), 1);
    assert_true(distance == 0);
    assert_int_equal(sfem_mesh_locate(&m, moved, origin, &located, NULL), 1);
    assert_int_equal(tet, located);
    assert_bary(moved, m.tet + 4 * tet, bary, origin, 1e-13);
    free(moved);
    sfem_mesh_free(&m);
}

/* Rays through nodes, edges and faces of the inside: no gap between tets lets one through. */
static void no_ray_slips_between_tets(void **state)
{
    sfem_mesh m = ball(1, 4);
    test_random random = {19};
    int i;
    (void)state;
    for (i = 0; i < 2000; ++i) {
        sfem_real target[3], origin[3], direction[3], distance;
        const sfem_int *v = m.tet + 4 * random_below(&random, m.tets);
        int k;
        for (k = 0; k < 3; ++k) {
            target[k] =
                i % 3 == 0 ? m.x[3 * v[0] + k] : (m.x[3 * v[0] + k] + m.x[3 * v[1] + k]) / 2;
            target[k] *= 0.999; /* off the silhouette */
            origin[k] = 3 * random_normal(&random);
        }
        for (k = 0; k < 3; ++k) direction[k] = target[k] - origin[k];
        assert_int_equal(sfem_mesh_pick_ray(&m, NULL, origin, direction, NULL, NULL, &distance), 1);
        assert_true(distance <= sqrt(direction[0] * direction[0] + direction[1] * direction[1] +
                                     direction[2] * direction[2]) +
                                    1e-9);
    }
    sfem_mesh_free(&m);
}

static void flat_tets_are_passed_over_when_picking(void **state)
{
    sfem_mesh m = block(1, 1, 1, SFEM_CELL_6_TETS);
    sfem_real x[24];
    const sfem_real origin[3] = {5, 0.5, 0.4}, direction[3] = {-1, 0, 0};
    sfem_int i;
    (void)state;
    memcpy(x, m.x, sizeof x);
    for (i = 0; i < 8; ++i) x[3 * i + 2] = 0.4; /* squashed into the plane of the ray */
    assert_int_equal(sfem_mesh_pick_ray(&m, x, origin, direction, NULL, NULL, NULL), 0);
    assert_int_equal(sfem_mesh_locate(&m, x, x, NULL, NULL), 0);
    for (i = 0; i < 8; ++i) x[3 * i + 2] = 1 - m.x[3 * i + 2]; /* inside out: still found */
    assert_int_equal(sfem_mesh_pick_ray(&m, x, origin, direction, NULL, NULL, NULL), 1);
    sfem_mesh_free(&m);
}

/* ---- memory ---- */

static sfem_status make_each(sfem_allocator allocator, void *user, sfem_error *err)
{
    const int which = *(const int *)user;
    sfem_status status = SFEM_OK;
    sfem_mesh m, before;
    if (which < 4) {
        if (which == 0)
            status = sfem_mesh_block(cells435, size435, SFEM_CELL_5_TETS, &allocator, &m, err);
        if (which == 1) status = sfem_mesh_cylinder(1, 1, 2, 2, &allocator, &m, err);
        if (which == 2) status = sfem_mesh_ball(1, 2, &allocator, &m, err);
        if (which == 3) status = sfem_mesh_copy(5, two_x, 2, two_tets, &allocator, &m, err);
        if (status == SFEM_OK) sfem_mesh_free(&m);
        return status;
    }
    m = ball(1, 2);
    m.region = (sfem_int *)calloc((size_t)m.tets, sizeof *m.region);
    before = m;
    m.allocator = allocator; /* for scratch; the mesh itself is malloc's */
    if (which == 4) {
        sfem_mesh_report r;
        status = sfem_mesh_check(&m, &r, err);
    } else if (which == 5) {
        sfem_surface s;
        status = sfem_mesh_surface(&m, &allocator, &s, err);
        if (status == SFEM_OK) sfem_surface_free(&s);
    } else {
        uint64_t hash = hash_reals(m.x, 3 * (size_t)m.nodes) ^
                        hash_bytes(m.tet, 4 * (size_t)m.tets * sizeof *m.tet);
        status =
            which == 6 ? sfem_mesh_renumber(&m, NULL, err) : sfem_mesh_remove_unused(&m, NULL, err);
        if (status != SFEM_OK)
            assert_true(hash == (hash_reals(m.x, 3 * (size_t)m.nodes) ^
                                 hash_bytes(m.tet, 4 * (size_t)m.tets * sizeof *m.tet)));
    }
    free(before.region);
    before.region = NULL;
    sfem_mesh_free(&before);
    return status;
}

static void every_allocation_may_fail(void **state)
{
    static const size_t least[8] = {2, 2, 2, 2, 8, 5, 10, 1};
    int which;
    (void)state;
    for (which = 0; which < 8; ++which)
        assert_true(fail_every_allocation(make_each, &which) >= least[which]);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_block_has_its_volume_and_numbering),
        cmocka_unit_test(blocks_of_any_parity_are_sound),
        cmocka_unit_test(the_ball_converges_to_its_volume),
        cmocka_unit_test(the_cylinder_is_a_polygonal_prism_that_converges),
        cmocka_unit_test(generators_refuse_what_they_cannot_make),
        cmocka_unit_test(freeing_twice_is_harmless),
        cmocka_unit_test(arrays_are_copied_turned_and_checked),
        cmocka_unit_test(every_fault_is_found_and_named),
        cmocka_unit_test(an_empty_mesh_is_a_fault),
        cmocka_unit_test(negative_counts_are_a_fault),
        cmocka_unit_test(quality_is_one_for_the_regular_tet_at_any_scale),
        cmocka_unit_test(orient_turns_left_handed_tets_only),
        cmocka_unit_test(the_report_counts_what_is_suspicious),
        cmocka_unit_test(each_surface_triangle_belongs_to_the_tet_behind_it),
        cmocka_unit_test(cavities_and_channels_show_in_the_euler_number),
        cmocka_unit_test(the_surface_of_overlapping_tets_is_closed),
        cmocka_unit_test(parts_are_labelled_by_their_lowest_node),
        cmocka_unit_test(a_long_chain_is_one_part_whatever_its_numbering),
        cmocka_unit_test(renumbering_narrows_a_shuffled_mesh_and_keeps_its_shape),
        cmocka_unit_test(renumbering_keeps_parts_together_and_puts_unused_nodes_last),
        cmocka_unit_test(unused_nodes_are_removed_in_order),
        cmocka_unit_test(points_are_located_in_rest_and_in_motion),
        cmocka_unit_test(nodes_and_points_on_faces_are_located),
        cmocka_unit_test(outside_nothing_is_located_or_written),
        cmocka_unit_test(a_ray_meets_a_block_where_it_should),
        cmocka_unit_test(a_ray_that_starts_inside_is_there_already),
        cmocka_unit_test(no_ray_slips_between_tets),
        cmocka_unit_test(flat_tets_are_passed_over_when_picking),
        cmocka_unit_test(every_allocation_may_fail),
    };
    return run_all_tests(tests);
}
