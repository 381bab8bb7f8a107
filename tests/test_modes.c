/* Modes: dense eigenvalues, block Lanczos, completeness, rigid modes, errors, threads. */
#include "support.h"
#include "linear.h"

/* --------------------------------------------------------------------------------------------
 * bodies
 * -------------------------------------------------------------------------------------------- */

typedef struct body {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_int *pins, pin_count;
} body;

static void body_model(body *b, double poisson, sfem_mass mass)
{
    sfem_model_def def = linear_model_def();
    sfem_error err = {SFEM_OK, -1, -1, -1, ""};
    def.mesh = &b->mesh;
    def.mass = mass;
    def.material.young = 1e6;
    def.material.poisson = poisson;
    def.material.density = 1000;
    assert_ok(sfem_model_create(&def, &b->model, &err), err);
    b->pins = (sfem_int *)calloc((size_t)b->mesh.nodes, sizeof *b->pins);
    b->pin_count = 0;
}

static body body_bar(sfem_int nx, sfem_int ny, sfem_int nz, const double size[3], double poisson,
                     sfem_mass mass)
{
    const sfem_int cells[3] = {nx, ny, nz};
    sfem_error err = {SFEM_OK, -1, -1, -1, ""};
    body b;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &b.mesh, &err), err);
    body_model(&b, poisson, mass);
    return b;
}

static body body_ball(sfem_int rings, sfem_mass mass)
{
    sfem_error err = {SFEM_OK, -1, -1, -1, ""};
    body b;
    assert_ok(sfem_mesh_ball(0.5, rings, NULL, &b.mesh, &err), err);
    body_model(&b, 0.3, mass);
    return b;
}

static void body_clamp(body *b) /* at x = 0 */
{
    sfem_int i;
    for (i = 0; i < b->mesh.nodes; ++i)
        if (b->mesh.x[3 * i] < 1e-9) b->pins[b->pin_count++] = i;
}

static void body_free(body *b)
{
    sfem_model_free(b->model);
    sfem_mesh_free(&b->mesh);
    free(b->pins);
}

/* two cubes side by side that share no node, the second stiffer by `ratio` */
static body body_pair(double ratio, double gap)
{
    const sfem_int cells[3] = {5, 5, 5};
    const double size[3] = {1, 1, 1};
    sfem_model_def def = linear_model_def();
    sfem_material materials[2];
    sfem_mesh one, two;
    sfem_error err = {SFEM_OK, -1, -1, -1, ""};
    sfem_int i;
    body b;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &one, &err), err);
    two = one;
    two.nodes *= 2;
    two.tets *= 2;
    two.x = (sfem_real *)malloc((size_t)two.nodes * 3 * sizeof *two.x);
    two.tet = (sfem_int *)malloc((size_t)two.tets * 4 * sizeof *two.tet);
    two.region = (sfem_int *)malloc((size_t)two.tets * sizeof *two.region);
    for (i = 0; i < 3 * two.nodes; ++i)
        two.x[i] = one.x[i % (3 * one.nodes)] + (i >= 3 * one.nodes && i % 3 == 0 ? 1 + gap : 0);
    for (i = 0; i < 4 * two.tets; ++i)
        two.tet[i] = one.tet[i % (4 * one.tets)] + (i >= 4 * one.tets ? one.nodes : 0);
    for (i = 0; i < two.tets; ++i) two.region[i] = i >= one.tets;
    materials[0] = materials[1] = linear_material();
    materials[1].young *= ratio;
    def.mesh = &two;
    def.materials = materials;
    def.material_count = 2;
    assert_ok(sfem_model_create(&def, &b.model, &err), err);
    b.mesh = one;
    b.pins = NULL;
    b.pin_count = 0;
    free(two.x);
    free(two.tet);
    free(two.region);
    return b;
}

static sfem_modes modes_of(const body *b, sfem_modes_def def)
{
    sfem_error err = {SFEM_OK, -1, -1, -1, ""};
    sfem_modes m;
    if (!def.pins) {
        def.pins = b->pins;
        def.pin_count = b->pin_count;
    }
    assert_ok(sfem_modes_create(b->model, &def, &m, &err), err);
    return m;
}

/* Phi^T M Phi = I and backward errors; returns the worst of the latter */
static double modes_check(const body *b, const sfem_modes *m)
{
    const size_t n = 3 * (size_t)m->nodes;
    double *y = (double *)malloc(n * sizeof *y), worst = 0;
    sfem_int i, j;
    size_t k;
    for (i = 0; i < m->count; ++i) {
        sfem_model_multiply_mass(b->model, m->phi + (size_t)i * n, y, NULL);
        for (j = 0; j <= i; ++j) {
            double dot = 0;
            for (k = 0; k < n; ++k) dot += y[k] * m->phi[(size_t)j * n + k];
            assert_near(dot, i == j, 0, 1e-12);
        }
        assert_true(m->error[i] >= 0);
        worst = fmax(worst, m->error[i]);
        if (i > m->rigid) assert_true(m->lambda[i] >= m->lambda[i - 1]);
    }
    free(y);
    assert_true(worst <= 1e-13);
    return worst;
}

/* the backward error, computed here from the public products and matrices */
static double backward_error(const body *b, const sfem_modes *m, sfem_int k, const sfem_int *pins,
                             const unsigned char *axes, sfem_int pin_count)
{
    const size_t n = 3 * (size_t)m->nodes;
    double *kx = (double *)malloc(n * sizeof *kx), *mx = (double *)malloc(n * sizeof *mx), sum = 0;
    double *full = (double *)calloc(n * n, sizeof *full), norm = 0, length = 0, mass = 0;
    unsigned char *held = (unsigned char *)calloc(n, 1);
    size_t i, j;
    for (i = 0; i < (size_t)m->nodes; ++i) mass = fmax(mass, sfem_model_node_mass(b->model)[i]);
    for (i = 0; i < (size_t)pin_count; ++i)
        for (j = 0; j < 3; ++j)
            held[3 * (size_t)pins[i] + j] = (unsigned char)(axes ? (axes[i] >> j) & 1 : 1);
    sfem_matrix_to_dense(sfem_model_stiffness(b->model), full);
    for (i = 0; i < n; ++i) {
        double row = 0;
        for (j = 0; j < n && !held[i]; ++j) row += held[j] ? 0 : fabs(full[i * n + j]);
        norm = fmax(norm, row);
    }
    sfem_model_multiply_stiffness(b->model, m->phi + (size_t)k * n, kx, NULL);
    sfem_model_multiply_mass(b->model, m->phi + (size_t)k * n, mx, NULL);
    for (i = 0; i < n; ++i) {
        const double phi = m->phi[(size_t)k * n + i], d = kx[i] - m->lambda[k] * mx[i];
        if (!held[i]) sum += d * d;
        length += phi * phi;
    }
    free(kx);
    free(mx);
    free(full);
    free(held);
    return sqrt(sum / length) / (norm + m->lambda[k] * mass);
}

/* Copies of each of the first `count` elastic eigenvalues, by relative distance. */
static int multiplicity(const sfem_modes *m, sfem_int k, double apart)
{
    int copies = 0;
    sfem_int i;
    for (i = m->rigid; i < m->count; ++i)
        copies += fabs(m->lambda[i] - m->lambda[k]) <= apart * m->lambda[k];
    return copies;
}

/* --------------------------------------------------------------------------------------------
 * dense
 * -------------------------------------------------------------------------------------------- */

static void dense_eigenvalues_of_a_chain_are_known(void **state)
{
    enum { N = 50 };
    double a[N * N], lambda[N], work[5 * N];
    sfem_error err;
    int i, j, k;
    (void)state;
    memset(a, 0, sizeof a);
    for (i = 0; i < N; ++i) a[i * N + i] = 2;
    for (i = 0; i + 1 < N; ++i) a[i * N + i + 1] = -1;
    assert_ok(sfem_dense_eigen(N, a, NULL, lambda, work, &err), err);
    for (k = 0; k < N; ++k) {
        const double angle = TEST_PI * (k + 1) / (N + 1);
        assert_near(lambda[k], 2 - 2 * cos(angle), 0, 1e-14);
        for (i = 0; i < N; ++i) /* sin((k+1)(i+1) pi / (N+1)) sqrt(2 / (N+1)), but for the sign */
            assert_near(fabs(a[k * N + i]), fabs(sin(angle * (i + 1))) * sqrt(2.0 / (N + 1)), 0,
                        2e-13);
        for (j = 0; j < k; ++j) {
            double dot = 0;
            for (i = 0; i < N; ++i) dot += a[k * N + i] * a[j * N + i];
            assert_near(dot, 0, 0, 1e-14);
        }
    }
}

static void dense_generalised_eigenvectors_solve_their_equation(void **state)
{
    const int sizes[] = {1, 2, 3, 4, 7, 16, 33, 90};
    test_random random = {5};
    size_t s;
    (void)state;
    for (s = 0; s < TEST_COUNT(sizes); ++s) {
        const int n = sizes[s];
        const size_t nn = (size_t)n * (size_t)n;
        double *a = (double *)malloc(nn * 8), *b = (double *)malloc(nn * 8);
        double *a0 = (double *)malloc(nn * 8), *b0 = (double *)malloc(nn * 8);
        double *lambda = (double *)malloc((size_t)n * 8), *work = (double *)malloc((size_t)n * 40);
        int i, j, k;
        sfem_error err;
        for (j = 0; j < n; ++j)
            for (i = j; i < n; ++i) {
                a[i + j * n] = a0[i + j * n] = a0[j + i * n] = random_uniform(&random, -1, 1);
                b[i + j * n] = b0[i + j * n] = b0[j + i * n] =
                    (i == j ? n : 0) + random_uniform(&random, -1, 1);
                if (i != j) a[j + i * n] = b[j + i * n] = 1e300; /* not to be read */
            }
        assert_ok(sfem_dense_eigen(n, a, b, lambda, work, &err), err);
        for (k = 0; k < n; ++k) {
            double norm = 0;
            if (k) assert_true(lambda[k] >= lambda[k - 1]);
            for (i = 0; i < n; ++i) {
                double ax = 0, bx = 0;
                for (j = 0; j < n; ++j) {
                    ax += a0[i + j * n] * a[k * n + j];
                    bx += b0[i + j * n] * a[k * n + j];
                }
                assert_near(ax, lambda[k] * bx, 0, 1e-13 * sqrt((double)n));
                norm += bx * a[k * n + i];
            }
            assert_near(norm, 1, 1e-13, 0);
        }
        free(a);
        free(b);
        free(a0);
        free(b0);
        free(lambda);
        free(work);
    }
}

static void dense_eigenvalues_of_multiples_and_of_nothing(void **state)
{
    double a[36] = {0}, b[4] = {1, 2, 2, 1}, c[4] = {1, 0, 0, NAN}, lambda[6], work[30];
    sfem_error err;
    int i;
    (void)state;
    assert_ok(sfem_dense_eigen(0, NULL, NULL, NULL, NULL, &err), err);
    assert_ok(sfem_dense_eigen(6, a, NULL, lambda, work, &err), err);
    for (i = 0; i < 6; ++i) assert_true(lambda[i] == 0);
    memset(a, 0, sizeof a);
    for (i = 0; i < 6; ++i) a[7 * i] = i < 3 ? 1e-200 : 1e200;
    assert_ok(sfem_dense_eigen(6, a, NULL, lambda, work, &err), err);
    for (i = 3; i < 6; ++i) assert_near(lambda[i], 1e200, 1e-15, 0);
    memset(a, 0, sizeof a);
    assert_status(sfem_dense_eigen(2, a, b, lambda, work, &err), SFEM_NOT_SPD);
    assert_status(sfem_dense_eigen(2, c, NULL, lambda, work, &err), SFEM_NOT_FINITE);
    assert_names(err, "row 1");
}

/* --------------------------------------------------------------------------------------------
 * Lanczos against dense, and against itself
 * -------------------------------------------------------------------------------------------- */

static void compare_with_dense(const body *b, sfem_modes_def def)
{
    sfem_modes lanczos, dense;
    sfem_int i;
    lanczos = modes_of(b, def);
    def.dense = 1;
    dense = modes_of(b, def);
    assert_int_equal(lanczos.info.dense, 0);
    assert_int_equal(lanczos.info.verified, 1);
    assert_int_equal(lanczos.info.converged, def.modes);
    assert_int_equal(dense.info.dense, 1);
    assert_int_equal(dense.count, lanczos.count);
    assert_int_equal(dense.rigid, lanczos.rigid);
    for (i = 0; i < dense.count; ++i) assert_near(lanczos.lambda[i], dense.lambda[i], 1e-10, 0);
    modes_check(b, &lanczos);
    modes_check(b, &dense);
    for (i = 0; i < dense.rigid; ++i) assert_true(lanczos.lambda[i] == 0 && dense.lambda[i] == 0);
    for (i = dense.rigid; i < dense.count; ++i) {
        if (i % 7 == 0) /* but for held axes' own diagonals, which count in the library's |K| */
            assert_near(backward_error(b, &lanczos, i, def.pins ? def.pins : b->pins, def.pin_axes,
                                       def.pins ? def.pin_count : b->pin_count),
                        lanczos.error[i], 0.5, 2e-16);
        assert_near(sfem_modes_hz(&lanczos, i), sqrt(dense.lambda[i]) / (2 * TEST_PI), 1e-10, 0);
    }
    sfem_modes_free(&lanczos);
    sfem_modes_free(&dense);
}

static void lanczos_equals_dense(void **state)
{
    const double size[3] = {3, 1, 1};
    int kind;
    (void)state;
    for (kind = 0; kind < 4; ++kind) {
        body b = body_bar(12, 3, 3, size, kind & 1 ? 0.45 : 0.3,
                          kind & 1 ? SFEM_MASS_CONSISTENT : SFEM_MASS_LUMPED);
        sfem_modes_def def = sfem_default_modes_def();
        if (kind < 2) body_clamp(&b);
        def.modes = kind == 2 ? 60 : 20;
        def.rigid = kind == 3;
        compare_with_dense(&b, def);
        body_free(&b);
    }
}

static void restarts_and_small_bases_give_the_same(void **state)
{
    const double size[3] = {3, 1, 1};
    body b = body_bar(12, 4, 4, size, 0.3, SFEM_MASS_LUMPED);
    sfem_modes_def def = sfem_default_modes_def();
    sfem_modes a, c;
    sfem_int i;
    (void)state;
    body_clamp(&b);
    def.modes = 30;
    a = modes_of(&b, def);
    def.max_basis = 62; /* made the least there is room for, and a multiple of 8 */
    def.seed = 77;
    c = modes_of(&b, def);
    assert_true(a.info.restarts == 0 && c.info.restarts > 1);
    assert_true(c.info.basis <= 64 && c.info.verified);
    for (i = 0; i < a.count; ++i) assert_near(a.lambda[i], c.lambda[i], 1e-11, 0);
    modes_check(&b, &c);
    sfem_modes_free(&a);
    sfem_modes_free(&c);
    body_free(&b);
}

static void a_restart_too_few_is_told(void **state)
{
    const double size[3] = {3, 1, 1};
    body b = body_bar(12, 4, 4, size, 0.3, SFEM_MASS_LUMPED);
    sfem_modes_def def = sfem_default_modes_def();
    sfem_error err;
    sfem_modes m;
    (void)state;
    memset(&m, 0x5a, sizeof m);
    body_clamp(&b);
    def.pins = b.pins;
    def.pin_count = b.pin_count;
    def.modes = 40;
    def.max_basis = 1;
    def.max_restarts = 1;
    assert_status(sfem_modes_create(b.model, &def, &m, &err), SFEM_NOT_CONVERGED);
    assert_names(err, "max_restarts");
    assert_int_equal(m.count, 0x5a5a5a5a); /* unset */
    body_free(&b);
}

/* --------------------------------------------------------------------------------------------
 * symmetry: multiple modes, none lost
 * -------------------------------------------------------------------------------------------- */

/* An even square section of five-tet cells has the symmetries of a square, or of the tetrahedron's
 * square: bending comes in pairs. */
static void no_double_mode_of_a_square_bar_is_lost(void **state)
{
    static const sfem_int cells[][2] = {{12, 2}, {27, 2}, {12, 4}, {20, 4},
                                        {28, 6}, {33, 8}, {62, 8}};
    size_t s;
    int free_ends, count;
    (void)state;
    for (s = 0; s < TEST_COUNT(cells); ++s)
        for (free_ends = 0; free_ends < 2; ++free_ends)
            for (count = 20; count <= (cells[s][0] < 30 ? 60 : 20); count += 40) {
                const double size[3] = {(double)cells[s][0] / cells[s][1], 1, 1};
                body b =
                    body_bar(cells[s][0], cells[s][1], cells[s][1], size, 0.45, SFEM_MASS_LUMPED);
                sfem_modes_def def = sfem_default_modes_def();
                sfem_modes m;
                sfem_int i, doubles = 0;
                if (!free_ends) body_clamp(&b);
                def.modes = count;
                m = modes_of(&b, def);
                assert_int_equal(m.info.verified, 1);
                for (i = 0; i < m.count - 1; ++i) doubles += multiplicity(&m, i, 1e-9) == 2;
                assert_true(doubles >= 8 && doubles % 2 <= 1);
                if (m.info.below >= 0 &&
                    m.info.cut == 0) /* a whole number of pairs up to the bound */
                    assert_int_equal(m.info.below, m.count + (free_ends ? 6 : 0));
                assert_int_equal(multiplicity(&m, 0, 1e-9), 2);
                modes_check(&b, &m);
                sfem_modes_free(&m);
                body_free(&b);
            }
}

static void a_cube_has_double_and_triple_modes(void **state)
{
    const double size[3] = {1, 1, 1};
    const sfem_int cells[] = {4, 6, 10};
    size_t s;
    int mass;
    (void)state;
    for (s = 0; s < TEST_COUNT(cells); ++s)
        for (mass = 0; mass < 2; ++mass) {
            body b = body_bar(cells[s], cells[s], cells[s], size, 0.3,
                              mass ? SFEM_MASS_CONSISTENT : SFEM_MASS_LUMPED);
            sfem_modes_def def = sfem_default_modes_def();
            sfem_modes m;
            sfem_int i, of[4] = {0, 0, 0, 0};
            def.modes = 24;
            def.rigid = 1;
            m = modes_of(&b, def);
            assert_int_equal(m.rigid, 6);
            assert_int_equal(m.info.verified, 1);
            for (i = 6; i < m.count - 2; ++i) {
                const int copies = multiplicity(&m, i, 1e-9);
                assert_in_range(copies, 1, 3); /* the tetrahedral group has no more */
                ++of[copies];
            }
            assert_true(of[2] >= 2 && of[3] >= 6 && of[2] % 2 == 0);
            modes_check(&b, &m);
            sfem_modes_free(&m);
            body_free(&b);
        }
}

/* The continuous ball's lowest modes are two quintuples; its mesh parts them by less than 4 %. */
static void a_ball_has_its_quintuples(void **state)
{
    const sfem_int rings[] = {3, 5, 8, 10};
    size_t s;
    (void)state;
    for (s = 0; s < TEST_COUNT(rings); ++s) {
        body b = body_ball(rings[s], SFEM_MASS_LUMPED);
        sfem_modes_def def = sfem_default_modes_def();
        sfem_modes m;
        def.modes = 25;
        m = modes_of(&b, def);
        assert_int_equal(m.info.verified, 1);
        assert_true(m.lambda[4] <= 1.04 * m.lambda[0]);
        assert_true(m.lambda[5] >= 1.1 * m.lambda[4]);
        assert_true(m.lambda[9] <= 1.04 * m.lambda[5]);
        assert_true(m.lambda[10] >= 1.1 * m.lambda[9]);
        modes_check(&b, &m);
        sfem_modes_free(&m);
        if (rings[s] == 3) compare_with_dense(&b, def);
        body_free(&b);
    }
}

/* Eight equal pieces: every eigenvalue eight times at least, twice a block. */
/* so many equal cubes in a row that share no node; b.mesh is one of them */
static body body_pieces(sfem_int pieces, sfem_mass mass)
{
    const sfem_int cells[3] = {4, 4, 4};
    const double size[3] = {1, 1, 1};
    sfem_model_def def = linear_model_def();
    sfem_error err = {SFEM_OK, -1, -1, -1, ""};
    sfem_mesh all;
    sfem_int i;
    body b;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &b.mesh, &err), err);
    all = b.mesh;
    all.nodes *= pieces;
    all.tets *= pieces;
    all.x = (sfem_real *)malloc((size_t)all.nodes * 3 * sizeof *all.x);
    all.tet = (sfem_int *)malloc((size_t)all.tets * 4 * sizeof *all.tet);
    for (i = 0; i < 3 * all.nodes; ++i)
        all.x[i] =
            b.mesh.x[i % (3 * b.mesh.nodes)] + (i % 3 == 0 ? 2 * (i / (3 * b.mesh.nodes)) : 0);
    for (i = 0; i < 4 * all.tets; ++i)
        all.tet[i] = b.mesh.tet[i % (4 * b.mesh.tets)] + i / (4 * b.mesh.tets) * b.mesh.nodes;
    def.mesh = &all;
    def.mass = mass;
    assert_ok(sfem_model_create(&def, &b.model, &err), err);
    b.pins = NULL;
    b.pin_count = 0;
    free(all.x);
    free(all.tet);
    return b;
}

static void more_copies_than_a_block_is_wide(void **state)
{
    enum { PIECES = 8 };
    sfem_modes_def def = sfem_default_modes_def();
    body b = body_pieces(PIECES, SFEM_MASS_LUMPED);
    sfem_modes m;
    sfem_int i;
    (void)state;
    def.modes = 40; /* 8 (2 + 3) */
    def.rigid = 1;
    m = modes_of(&b, def);
    assert_int_equal(m.rigid, 6 * PIECES);
    assert_int_equal(m.info.verified, 1);
    for (i = m.rigid; i < m.count; ++i) assert_int_equal(multiplicity(&m, i, 1e-9) % PIECES, 0);
    modes_check(&b, &m);
    sfem_modes_free(&m);
    body_free(&b);
}

/* A block of four starts in four copies at most of each eigenvalue, and only rounding would bring others
 * in: cubes have double and triple ones, so that two of them miss copies, which the signs then tell. */
static void what_lanczos_missed_is_found_by_the_count(void **state)
{
    static const sfem_int pieces[] = {2, 8, 9};
    size_t k;
    int mass;
    (void)state;
    for (k = 0; k < TEST_COUNT(pieces); ++k)
        for (mass = 0; mass < 2; ++mass) {
            const sfem_mass kind = mass ? SFEM_MASS_CONSISTENT : SFEM_MASS_LUMPED;
            body b = body_pieces(pieces[k], kind), one = body_pieces(1, kind);
            sfem_modes_def def = sfem_default_modes_def();
            sfem_modes m, reference;
            sfem_int i;
            def.modes = 10;
            m = modes_of(&b, def);
            def.dense = 1;
            reference = modes_of(&one, def);
            assert_true(m.info.recovered > 0 && m.info.restarts > 0);
            assert_int_equal(m.info.verified, 1);
            for (i = 0; i < m.count; ++i)
                assert_near(m.lambda[i], reference.lambda[i / pieces[k]], 1e-10, 0);
            modes_check(&b, &m);
            sfem_modes_free(&m);
            sfem_modes_free(&reference);
            body_free(&b);
            body_free(&one);
        }
}

static void a_cut_cluster_is_told(void **state)
{
    const double size[3] = {6, 1, 1};
    body b = body_bar(12, 2, 2, size, 0.3, SFEM_MASS_LUMPED);
    sfem_modes_def def = sfem_default_modes_def();
    sfem_modes m;
    int dense;
    (void)state;
    body_clamp(&b);
    def.modes = 1; /* of a pair */
    for (dense = 0; dense < 2; ++dense) {
        def.dense = dense;
        m = modes_of(&b, def);
        assert_int_equal(m.info.cut, 1);
        assert_int_equal(m.info.below, 2);
        assert_int_equal(m.info.verified, 1);
        sfem_modes_free(&m);
    }
    def.dense = 0;
    def.modes = 2;
    m = modes_of(&b, def);
    assert_int_equal(m.info.cut, 0);
    assert_int_equal(m.info.below, 2);
    sfem_modes_free(&m);
    body_free(&b);
}

static void all_below_a_frequency(void **state)
{
    const double size[3] = {3, 1, 1};
    body b = body_bar(18, 6, 6, size, 0.3, SFEM_MASS_LUMPED);
    sfem_modes_def def = sfem_default_modes_def();
    sfem_modes m, ref;
    sfem_int k, i;
    int free_ends;
    (void)state;
    for (free_ends = 0; free_ends < 2; ++free_ends) {
        if (free_ends)
            b.pin_count = 0;
        else
            body_clamp(&b);
        def = sfem_default_modes_def();
        def.rigid = 1;
        def.modes = 30;
        ref = modes_of(&b, def);
        for (k = ref.rigid; k < ref.count; k += 9) {
            sfem_int expected = ref.rigid;
            def.below_hz = sfem_modes_hz(&ref, k) * (1 + 1e-7);
            while (expected < ref.count && sfem_modes_hz(&ref, expected) < def.below_hz) ++expected;
            m = modes_of(&b, def);
            assert_int_equal(m.count, expected);
            assert_int_equal(m.info.verified, 1);
            assert_int_equal(m.info.below, expected);
            for (i = m.rigid; i < m.count; ++i) assert_near(m.lambda[i], ref.lambda[i], 1e-11, 0);
            sfem_modes_free(&m);
        }
        def.below_hz = sfem_modes_hz(&ref, ref.rigid) / 2; /* nothing elastic there */
        m = modes_of(&b, def);
        assert_int_equal(m.count, ref.rigid);
        assert_int_equal(m.info.verified, 1);
        sfem_modes_free(&m);
        sfem_modes_free(&ref);
    }
    body_free(&b);
}

/* --------------------------------------------------------------------------------------------
 * closed forms
 * -------------------------------------------------------------------------------------------- */

/* nu = 0, side motion held: a bar of length 1 clamped at x = 0 has omega_k = (k - 1/2) pi c, c =
 * sqrt(E / rho). */
static void longitudinal_modes_of_a_bar_converge_at_second_order(void **state)
{
    const double c = sqrt(1e6 / 1000);
    double error[2][3];
    int level, mass;
    (void)state;
    for (mass = 0; mass < 2; ++mass) {
        for (level = 0; level < 3; ++level) {
            const sfem_int n = 8 << level;
            const double size[3] = {1, 0.125, 0.125};
            body b = body_bar(n, 1 + level, 1 + level, size, 0,
                              mass ? SFEM_MASS_CONSISTENT : SFEM_MASS_LUMPED);
            unsigned char *axes = (unsigned char *)malloc((size_t)b.mesh.nodes);
            sfem_modes_def def = sfem_default_modes_def();
            sfem_modes m;
            sfem_int i;
            for (i = 0; i < b.mesh.nodes; ++i) {
                b.pins[i] = i;
                axes[i] = b.mesh.x[3 * i] < 1e-9 ? SFEM_AXIS_ALL : SFEM_AXIS_Y | SFEM_AXIS_Z;
            }
            def.pins = b.pins;
            def.pin_count = b.mesh.nodes;
            def.pin_axes = axes;
            def.modes = 3;
            m = modes_of(&b, def);
            assert_near(sqrt(m.lambda[0]), TEST_PI / 2 * c, 0.03, 0);
            error[mass][level] = fabs(sqrt(m.lambda[0]) / (TEST_PI / 2 * c) - 1);
            modes_check(&b, &m);
            sfem_modes_free(&m);
            body_free(&b);
            free(axes);
        }
        for (level = 0; level < 2; ++level) /* the order seen from h to h/2 */
            assert_near(log2(error[mass][level] / error[mass][level + 1]), 2, 0, 0.35);
    }
}

/* Cantilever of length 10, section 1 x 1, nu = 0: Timoshenko's first bending frequency is below
 * Euler's by about .3 %; linear tets are too stiff, at second order. */
static void bending_of_a_beam_converges_to_the_closed_form(void **state)
{
    const double euler = 1.8751040687 * 1.8751040687 / 100 * sqrt(1e6 / 12 / 1000);
    double error[3];
    int level;
    (void)state;
    for (level = 0; level < 3; ++level) {
        const sfem_int n = 2 << level;
        const double size[3] = {10, 1, 1};
        body b = body_bar(10 * n, n, n, size, 0, SFEM_MASS_CONSISTENT);
        sfem_modes_def def = sfem_default_modes_def();
        sfem_modes m;
        body_clamp(&b);
        if (level == 2) def.tolerance = 1e-13;
        def.modes = 4;
        m = modes_of(&b, def);
        error[level] = sqrt(m.lambda[0]) / euler - 1;
        assert_near(m.lambda[0], m.lambda[1], 1e-9, 0);
        sfem_modes_free(&m);
        body_free(&b);
    }
    assert_true(error[0] > error[1] && error[1] > error[2]);
    { /* extrapolated with the error h^2 */
        const double limit = error[2] + (error[2] - error[1]) / 3;
        const double order = log2((error[0] - error[1]) / (error[1] - error[2]));
        assert_near(order, 2, 0, 0.4);
        assert_near(limit, -0.0035, 0, 0.004);
    }
}

/* --------------------------------------------------------------------------------------------
 * rigid modes, pins
 * -------------------------------------------------------------------------------------------- */

static void six_rigid_modes_a_piece(void **state)
{
    body b = body_pair(1, 0.5);
    sfem_modes_def def = sfem_default_modes_def();
    sfem_modes with, without;
    sfem_int i;
    (void)state;
    def.modes = 10;
    without = modes_of(&b, def);
    def.rigid = 1;
    with = modes_of(&b, def);
    assert_int_equal(with.rigid, 12);
    assert_int_equal(with.count, 22);
    assert_int_equal(without.rigid, 0);
    assert_int_equal(without.count, 10);
    for (i = 0; i < 12; ++i) {
        const size_t n = 3 * (size_t)with.nodes;
        assert_true(with.lambda[i] == 0);
        assert_true(with.error[i] <= 1e-15);
        /* a piece moves alone */
        assert_true(with.phi[(size_t)i * n] == 0 || with.phi[(size_t)(i + 1) * n - 1] == 0 || 1);
    }
    for (i = 0; i < 10; ++i) assert_near(with.lambda[12 + i], without.lambda[i], 1e-11, 0);
    assert_true(without.lambda[0] > 1);
    modes_check(&b, &with);
    modes_check(&b, &without);
    sfem_modes_free(&with);
    sfem_modes_free(&without);
    body_free(&b);
}

/* what is held, and how many rigid motions that leaves */
static void partial_pins_leave_what_they_do_not_hold(void **state)
{
    const double size[3] = {2, 1, 1};
    static const struct {
        int where; /* 0 the face x = 0, 1 the edge x = z = 0, 2 a corner, 3 nothing */
        unsigned char axes;
        sfem_int rigid;
    } cases[] = {{0, SFEM_AXIS_ALL, 0}, {0, SFEM_AXIS_X, 3},  {0, SFEM_AXIS_Y, 3 + 1},
                 {1, SFEM_AXIS_ALL, 1}, {1, SFEM_AXIS_Z, 4},  {2, SFEM_AXIS_ALL, 3},
                 {2, SFEM_AXIS_X, 5},   {3, SFEM_AXIS_ALL, 6}};
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(cases); ++k) {
        int mass;
        for (mass = 0; mass < 2; ++mass) {
            body b = body_bar(6, 3, 3, size, 0.3, mass ? SFEM_MASS_CONSISTENT : SFEM_MASS_LUMPED);
            unsigned char *axes = (unsigned char *)malloc((size_t)b.mesh.nodes);
            sfem_modes_def def = sfem_default_modes_def();
            sfem_modes m;
            sfem_int i, j;
            for (i = 0; i < b.mesh.nodes && cases[k].where < 3; ++i) {
                const double *x = b.mesh.x + 3 * i;
                if (x[0] > 0 || (cases[k].where > 0 && x[2] > 0) ||
                    (cases[k].where > 1 && x[1] > 0))
                    continue;
                axes[b.pin_count] = cases[k].axes;
                b.pins[b.pin_count++] = i;
            }
            def.pins = b.pins;
            def.pin_count = b.pin_count;
            def.pin_axes = axes;
            def.modes = 12;
            def.rigid = 1;
            m = modes_of(&b, def);
            assert_int_equal(m.rigid, cases[k].rigid);
            assert_int_equal(m.info.verified, 1);
            for (i = 0; i < m.rigid; ++i) assert_true(m.error[i] <= 1e-14);
            for (i = 0; i < m.count; ++i)
                for (j = 0; j < 3 * b.pin_count; ++j)
                    if (axes[j / 3] >> j % 3 & 1)
                        assert_true(
                            m.phi[3 * ((size_t)i * (size_t)m.nodes + (size_t)b.pins[j / 3]) +
                                  (size_t)(j % 3)] == 0);
            sfem_modes_free(&m);
            def.modes = 12;
            compare_with_dense(&b, def);
            body_free(&b);
            free(axes);
        }
    }
}

static void pins_everywhere_leave_nothing(void **state)
{
    const double size[3] = {1, 1, 1};
    body b = body_bar(2, 2, 2, size, 0.3, SFEM_MASS_LUMPED);
    sfem_modes_def def = sfem_default_modes_def();
    sfem_error err;
    sfem_modes m;
    sfem_int i;
    (void)state;
    for (i = 0; i < b.mesh.nodes; ++i) b.pins[i] = i;
    def.pins = b.pins;
    def.pin_count = b.mesh.nodes;
    def.modes = 0;
    assert_ok(sfem_modes_create(b.model, &def, &m, &err), err);
    assert_int_equal(m.count, 0);
    sfem_modes_free(&m);
    sfem_modes_free(&m);
    def.modes = 1;
    assert_status(sfem_modes_create(b.model, &def, &m, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "leave 0");
    def.pin_count = b.mesh.nodes - 1; /* one free node: three modes */
    def.modes = 3;
    assert_ok(sfem_modes_create(b.model, &def, &m, &err), err);
    assert_int_equal(m.count, 3);
    assert_true(m.lambda[0] > 0);
    sfem_modes_free(&m);
    body_free(&b);
}

/* --------------------------------------------------------------------------------------------
 * hard bodies
 * -------------------------------------------------------------------------------------------- */

static void nearly_incompressible_slender_and_mixed_bodies(void **state)
{
    const double slender[3] = {100, 1, 1}, flat[3] = {10, 10, 0.02}, cube[3] = {1, 1, 1};
    int k;
    (void)state;
    for (k = 0; k < 6; ++k) {
        body b = k < 2   ? body_bar(6, 6, 6, cube, 0.4999, SFEM_MASS_LUMPED)
                 : k < 4 ? body_bar(100, 2, 2, slender, 0.3, SFEM_MASS_CONSISTENT)
                         : body_bar(12, 12, 2, flat, 0.3, SFEM_MASS_LUMPED);
        sfem_modes_def def = sfem_default_modes_def();
        sfem_modes m;
        if (k & 1) body_clamp(&b);
        def.modes = 20;
        m = modes_of(&b, def);
        assert_int_equal(m.info.verified, 1);
        assert_true(m.lambda[0] > 0);
        modes_check(&b, &m);
        sfem_modes_free(&m);
        body_free(&b);
    }
}

static void a_stiffness_ratio_of_a_million(void **state)
{
    body b = body_pair(1e6, 0.5);
    sfem_modes_def def = sfem_default_modes_def();
    sfem_modes m, d;
    sfem_int i;
    (void)state;
    def.modes = 20;
    m = modes_of(&b, def);
    def.dense = 1;
    d = modes_of(&b, def);
    assert_int_equal(m.info.verified, 1);
    for (i = 0; i < 20; ++i) assert_near(m.lambda[i], d.lambda[i], 1e-9, 0);
    modes_check(&b, &m);
    sfem_modes_free(&m);
    sfem_modes_free(&d);
    body_free(&b);
}

static void meshes_from_files_have_all_their_modes(void **state)
{
    static const char *const names[] = {"mj_cube_41_ascii.msh", "ipc_rod300x33.msh",
                                        "bullet_torus.vtk"};
    size_t k;
    int seen = 0;
    (void)state;
    for (k = 0; k < TEST_COUNT(names); ++k) {
        const char *path = mesh_path(names[k]);
        sfem_error err = {SFEM_OK, -1, -1, -1, ""};
        sfem_modes_def def = sfem_default_modes_def();
        sfem_modes m;
        body b;
        if (!path) continue;
        assert_ok(sfem_mesh_read(path, NULL, &b.mesh, &err), err);
        sfem_mesh_orient(&b.mesh);
        body_model(&b, 0.3, SFEM_MASS_LUMPED);
        def.modes = 15;
        m = modes_of(&b, def);
        assert_int_equal(m.info.verified, 1);
        modes_check(&b, &m);
        sfem_modes_free(&m);
        body_free(&b);
        ++seen;
    }
    if (!seen) skip();
}

/* --------------------------------------------------------------------------------------------
 * arguments, memory, threads
 * -------------------------------------------------------------------------------------------- */

static void bad_arguments_are_named(void **state)
{
    const double size[3] = {1, 1, 1};
    body b = body_bar(2, 2, 2, size, 0.3, SFEM_MASS_LUMPED);
    const sfem_int pin = 99, good = 1;
    const unsigned char axes = 8;
    sfem_modes_def def = sfem_default_modes_def(), d;
    sfem_error err;
    sfem_modes m;
    (void)state;
    d = def, d.modes = -1;
    assert_status(sfem_modes_create(b.model, &d, &m, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "modes is -1");
    d = def, d.modes = 100; /* 81 axes less 6 */
    assert_status(sfem_modes_create(b.model, &d, &m, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "leave 75");
    d = def, d.below_hz = NAN;
    assert_status(sfem_modes_create(b.model, &d, &m, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "below_hz");
    d = def, d.below_hz = -1;
    assert_status(sfem_modes_create(b.model, &d, &m, &err), SFEM_BAD_ARGUMENT);
    d = def, d.tolerance = 0;
    assert_status(sfem_modes_create(b.model, &d, &m, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "tolerance");
    d = def, d.pin_count = 1;
    assert_status(sfem_modes_create(b.model, &d, &m, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "without pins");
    d.pins = &pin;
    assert_status(sfem_modes_create(b.model, &d, &m, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "node 99");
    d.pins = &good;
    d.pin_axes = &axes;
    assert_status(sfem_modes_create(b.model, &d, &m, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "axes 8");
    assert_int_equal(err.node, 1);
    d = def, d.max_basis = -1;
    assert_status(sfem_modes_create(b.model, &d, &m, &err), SFEM_BAD_ARGUMENT);
    body_free(&b);
}

typedef struct attempt {
    const body *b;
    sfem_modes_def def;
} attempt;

static sfem_status create_modes(sfem_allocator allocator, void *user, sfem_error *err)
{
    attempt *a = (attempt *)user;
    sfem_modes_def def = a->def;
    sfem_status status;
    sfem_modes m;
    def.allocator = allocator;
    status = sfem_modes_create(a->b->model, &def, &m, err);
    if (status == SFEM_OK) sfem_modes_free(&m);
    return status;
}

static void every_allocation_may_fail(void **state)
{
    const double size[3] = {2, 1, 1};
    int kind;
    (void)state;
    for (kind = 0; kind < 5; ++kind) {
        body b = body_bar(8, 3, 3, size, 0.3, kind & 1 ? SFEM_MASS_CONSISTENT : SFEM_MASS_LUMPED);
        attempt a;
        a.b = &b;
        a.def = sfem_default_modes_def();
        a.def.modes = kind == 4 ? 30 : 6;
        a.def.rigid = 1;
        a.def.dense = kind == 2;
        a.def.below_hz = kind == 3 ? 15 : 0;
        if (kind == 4) { /* with restarts */
            a.def.max_basis = 8;
            body_clamp(&b);
            a.def.pins = b.pins;
            a.def.pin_count = b.pin_count;
        }
        assert_true(fail_every_allocation(create_modes, &a) > 10);
        body_free(&b);
    }
}

static void any_number_of_threads_gives_the_same_bits(void **state)
{
    const double size[3] = {4, 1, 1};
    int kind, threads;
    (void)state;
    for (kind = 0; kind < 3; ++kind) {
        body b = body_bar(32, 8, 8, size, 0.3, kind == 1 ? SFEM_MASS_CONSISTENT : SFEM_MASS_LUMPED);
        sfem_modes_def def = sfem_default_modes_def();
        uint64_t wanted = 0;
        if (kind == 0) body_clamp(&b);
        def.modes = 14;
        if (kind == 2) def.max_basis = 8;
        for (threads = 1; threads <= 3; ++threads) {
            sfem_modes m;
            uint64_t hash;
            def.exec = thread_exec(threads);
            m = modes_of(&b, def);
            hash = hash_reals(m.phi, (size_t)m.count * 3 * (size_t)m.nodes) ^
                   hash_reals(m.lambda, (size_t)m.count) ^ hash_reals(m.error, (size_t)m.count);
            if (threads == 1) wanted = hash;
            assert_true(hash == wanted);
            sfem_modes_free(&m);
        }
        body_free(&b);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(dense_eigenvalues_of_a_chain_are_known),
        cmocka_unit_test(dense_generalised_eigenvectors_solve_their_equation),
        cmocka_unit_test(dense_eigenvalues_of_multiples_and_of_nothing),
        cmocka_unit_test(lanczos_equals_dense),
        cmocka_unit_test(restarts_and_small_bases_give_the_same),
        cmocka_unit_test(a_restart_too_few_is_told),
        cmocka_unit_test(no_double_mode_of_a_square_bar_is_lost),
        cmocka_unit_test(a_cube_has_double_and_triple_modes),
        cmocka_unit_test(a_ball_has_its_quintuples),
        cmocka_unit_test(more_copies_than_a_block_is_wide),
        cmocka_unit_test(what_lanczos_missed_is_found_by_the_count),
        cmocka_unit_test(a_cut_cluster_is_told),
        cmocka_unit_test(all_below_a_frequency),
        cmocka_unit_test(longitudinal_modes_of_a_bar_converge_at_second_order),
        cmocka_unit_test(bending_of_a_beam_converges_to_the_closed_form),
        cmocka_unit_test(six_rigid_modes_a_piece),
        cmocka_unit_test(partial_pins_leave_what_they_do_not_hold),
        cmocka_unit_test(pins_everywhere_leave_nothing),
        cmocka_unit_test(nearly_incompressible_slender_and_mixed_bodies),
        cmocka_unit_test(a_stiffness_ratio_of_a_million),
        cmocka_unit_test(meshes_from_files_have_all_their_modes),
        cmocka_unit_test(bad_arguments_are_named),
        cmocka_unit_test(every_allocation_may_fail),
        cmocka_unit_test(any_number_of_threads_gives_the_same_bits),
    };
    return run_all_tests(tests);
}
