/* The L D L^T of an n x n matrix, and the isotropic majorant that is factored as one. */
#define SFEM_STATIC
#define SFEM_MINIMAL
#define SFEM_ENABLE_DAMAGE
#define SFEM_ENABLE_NEWTON
#define SFEM_ENABLE_MESHIO
#define SOFTFEM_IMPLEMENTATION
#include "support.h"
#include "linear.h"

/* --------------------------------------------------------------------------------------------
 * matrices
 * -------------------------------------------------------------------------------------------- */

/* n x n, and S (x) I as 3x3 blocks of the same pattern */
typedef struct pair {
    sfem_matrix scalar, block;
    sfem_real *x; /* [n][3] coordinates */
} pair;

/* mass + Laplacian with random weights, on the nodes of a grid in random order */
static pair grid(sfem_int nx, sfem_int ny, sfem_int nz, uint64_t seed)
{
    const sfem_int n = nx * ny * nz, side[3] = {nx, ny, nz};
    sfem_int *name = (sfem_int *)malloc((size_t)n * sizeof *name), *i, *j, k, count = 0;
    sfem_real *value;
    test_random random = {seed};
    sfem_error err;
    pair p;
    int c;
    memset(&p, 0, sizeof p);
    p.x = (sfem_real *)malloc(3 * (size_t)n * sizeof *p.x);
    i = (sfem_int *)malloc(7 * (size_t)n * sizeof *i);
    j = (sfem_int *)malloc(7 * (size_t)n * sizeof *j);
    value = (sfem_real *)calloc(63 * (size_t)n, sizeof *value);
    for (k = 0; k < n; ++k) name[k] = k;
    for (k = n - 1; k > 0; --k) {
        const sfem_int other = random_below(&random, k + 1), t = name[k];
        name[k] = name[other];
        name[other] = t;
    }
    for (k = 0; k < n; ++k) {
        const sfem_int at[3] = {k % nx, k / nx % ny, k / nx / ny}, step[3] = {1, nx, nx * ny};
        double diagonal = random_uniform(&random, 0.01, 0.1);
        for (c = 0; c < 3; ++c) p.x[3 * name[k] + c] = at[c];
        for (c = 0; c < 3; ++c) {
            const double w = random_uniform(&random, 0.1, 1);
            if (at[c] + 1 == side[c]) continue;
            diagonal += w;
            i[count] = name[k];
            j[count] = name[k + step[c]];
            value[9 * count++] = -w;
            i[count] = j[count] = name[k + step[c]];
            value[9 * count++] = w;
        }
        i[count] = j[count] = name[k];
        value[9 * count++] = diagonal;
    }
    for (k = 0; k < count; ++k) value[9 * k + 4] = value[9 * k + 8] = value[9 * k];
    assert_ok(sfem_matrix_create(n, count, i, j, value, NULL, &p.block, &err), err);
    p.scalar = p.block;
    p.scalar.val = (sfem_real *)malloc((size_t)p.block.row[n] * sizeof(sfem_real));
    for (k = 0; k < p.block.row[n]; ++k) p.scalar.val[k] = p.block.val[9 * k];
    free(name);
    free(i);
    free(j);
    free(value);
    return p;
}

static void drop_pair(pair *p)
{
    free(p->scalar.val);
    sfem_matrix_free(&p->block);
    free(p->x);
}

static sfem_ldl *make(const pair *p, int scalar, sfem_ordering ordering, int mixed, int keep,
                      sfem_int threads)
{
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_ldl *ldl;
    sfem_error err;
    def.x = p->x;
    def.scalar = scalar;
    def.ordering = ordering;
    def.precision = mixed ? SFEM_MIXED : SFEM_DOUBLE;
    def.keep = keep;
    if (threads > 1) def.exec = thread_exec(threads);
    assert_ok(sfem_ldl_create(&def, scalar ? &p->scalar : &p->block, &ldl, &err), err);
    return ldl;
}

static void solve(const sfem_ldl *ldl, sfem_int rhs, sfem_real *x, sfem_int threads)
{
    const sfem_exec exec = thread_exec(threads);
    sfem_real *work = (sfem_real *)malloc(sfem_ldl_work_size(ldl, rhs) * sizeof *work);
    sfem_ldl_solve(ldl, rhs, x, work, &exec);
    free(work);
}

/* |b - S x| over |S| |x| + |b| for all right sides, b and x [rhs][n] */
static double residual(const sfem_matrix *s, sfem_int rhs, const sfem_real *b, const sfem_real *x)
{
    sfem_real *r = (sfem_real *)malloc((size_t)s->n * sizeof *r);
    double worst = 0, top_x = 0, top_b = 0, top_s = 0;
    sfem_int i, k, q;
    for (q = 0; q < rhs; ++q, b += s->n, x += s->n) {
        memcpy(r, b, (size_t)s->n * sizeof *r);
        for (i = 0; i < s->n; ++i)
            for (k = s->row[i]; k < s->row[i + 1]; ++k) {
                r[i] -= s->val[k] * x[s->col[k]];
                if (s->col[k] != i) r[s->col[k]] -= s->val[k] * x[i];
                top_s = fmax(top_s, fabs(s->val[k]));
            }
        for (i = 0; i < s->n; ++i) {
            worst = fmax(worst, fabs(r[i]));
            top_x = fmax(top_x, fabs(x[i]));
            top_b = fmax(top_b, fabs(b[i]));
        }
    }
    free(r);
    return worst / (top_s * top_x + top_b);
}

/* --------------------------------------------------------------------------------------------
 * the factor
 * -------------------------------------------------------------------------------------------- */

static void it_solves_for_any_size_ordering_and_number_of_right_sides(void **state)
{
    const sfem_int sides[][3] = {{1, 1, 1},  {2, 1, 1}, {5, 1, 1},  {3, 3, 2},
                                 {13, 2, 1}, {7, 6, 5}, {40, 5, 4}, {13, 14, 12}};
    size_t s;
    int ordering, mixed;
    sfem_int rhs;
    (void)state;
    for (s = 0; s < TEST_COUNT(sides); ++s) {
        pair p = grid(sides[s][0], sides[s][1], sides[s][2], 7 + s);
        const size_t n = (size_t)p.scalar.n;
        sfem_real *b = (sfem_real *)malloc(19 * n * sizeof *b),
                  *x = (sfem_real *)malloc(19 * n * sizeof *x);
        test_random random = {3};
        random_fill(&random, b, 19 * n, -1, 1);
        for (ordering = SFEM_ORDER_BEST; ordering <= SFEM_ORDER_NATURAL; ++ordering)
            for (mixed = 0; mixed < 2; ++mixed) {
                sfem_ldl *ldl = make(&p, 1, (sfem_ordering)ordering, mixed, 0, 1);
                assert_int_equal(sfem_ldl_get_info(ldl).n, p.scalar.n);
                for (rhs = 1; rhs <= 19; rhs += rhs < 4 ? 1 : 5) {
                    memcpy(x, b, (size_t)rhs * n * sizeof *x);
                    solve(ldl, rhs, x, 1);
                    assert_true(residual(&p.scalar, rhs, b, x) < (mixed ? 4e-6 : 1e-13));
                }
                sfem_ldl_free(ldl);
            }
        free(b);
        free(x);
        drop_pair(&p);
    }
}

static void it_is_a_ninth_of_the_factor_of_the_blocks(void **state)
{
    pair p = grid(16, 15, 14, 1);
    const size_t n = (size_t)p.scalar.n;
    sfem_ldl *scalar = make(&p, 1, SFEM_ORDER_DISSECTION, 0, 0, 1),
             *block = make(&p, 0, SFEM_ORDER_DISSECTION, 0, 0, 1);
    const sfem_ldl_info si = sfem_ldl_get_info(scalar), bi = sfem_ldl_get_info(block);
    sfem_real *x = (sfem_real *)malloc(3 * n * sizeof *x),
              *y = (sfem_real *)malloc(3 * n * sizeof *y);
    test_random random = {3};
    size_t i;
    int c;
    (void)state;
    assert_true(si.nnz * 6 < bi.nnz && si.nnz * 12 > bi.nnz); /* other supernodes are merged */
    assert_near(si.flops * 27, bi.flops, 0.1, 0);
    assert_true(si.factor_bytes * 5 < bi.factor_bytes);
    random_fill(&random, x, 3 * n, -1, 1);
    for (i = 0; i < n; ++i)
        for (c = 0; c < 3; ++c) y[(size_t)c * n + i] = x[3 * i + (size_t)c];
    solve(block, 1, x, 1);
    solve(scalar, 3, y, 1);
    for (i = 0; i < n; ++i)
        for (c = 0; c < 3; ++c)
            assert_near(y[(size_t)c * n + i], x[3 * i + (size_t)c], 1e-11, 1e-11);
    sfem_ldl_free(scalar);
    sfem_ldl_free(block);
    free(x);
    free(y);
    drop_pair(&p);
}

static void its_bits_are_the_same_for_any_number_of_threads(void **state)
{
    pair p = grid(24, 24, 24, 2); /* heavy enough to be cut into tasks */
    const size_t n = (size_t)p.scalar.n;
    sfem_real *x = (sfem_real *)malloc(3 * n * sizeof *x);
    uint64_t hash[2][3];
    sfem_int k;
    int mixed;
    (void)state;
    for (mixed = 0; mixed < 2; ++mixed)
        for (k = 0; k < 3; ++k) {
            sfem_ldl *ldl = make(&p, 1, SFEM_ORDER_BEST, mixed, 0, 1 + k);
            test_random random = {3};
            assert_true(ldl->symbolic->tasks > 4);
            random_fill(&random, x, 3 * n, -1, 1);
            solve(ldl, 3, x, 1 + k);
            hash[mixed][k] = hash_reals(x, 3 * n);
            assert_true(hash[mixed][k] == hash[mixed][0]);
            sfem_ldl_free(ldl);
        }
    free(x);
    drop_pair(&p);
}

static void it_is_renewed_whole_or_in_part(void **state)
{
    pair p = grid(9, 8, 8, 4);
    const size_t n = (size_t)p.scalar.n;
    sfem_ldl *part = make(&p, 1, SFEM_ORDER_BEST, 0, 1, 1), *whole, *like;
    sfem_real *b = (sfem_real *)malloc(n * sizeof *b), *x = (sfem_real *)malloc(n * sizeof *x);
    test_random random = {3};
    const sfem_int node[2] = {5, 100};
    sfem_error err;
    uint64_t hash;
    (void)state;
    random_fill(&random, b, n, -1, 1);
    whole = make(&p, 1, SFEM_ORDER_BEST, 0, 0, 1);
    p.scalar.val[p.scalar.row[6] - 1] += 3;
    p.scalar.val[p.scalar.row[101] - 1] += 5;
    assert_ok(sfem_ldl_refactor_nodes(part, &p.scalar, 2, node, &err), err);
    assert_ok(sfem_ldl_refactor(whole, &p.scalar, &err), err);
    assert_ok(sfem_ldl_create_like(whole, &p.scalar, NULL, &like, &err), err);
    memcpy(x, b, n * sizeof *x);
    solve(whole, 1, x, 1);
    hash = hash_reals(x, n);
    assert_true(residual(&p.scalar, 1, b, x) < 1e-13);
    memcpy(x, b, n * sizeof *x);
    solve(part, 1, x, 1);
    assert_true(hash_reals(x, n) == hash);
    memcpy(x, b, n * sizeof *x);
    solve(like, 1, x, 1);
    assert_true(hash_reals(x, n) == hash);
    sfem_ldl_free(part);
    sfem_ldl_free(whole);
    sfem_ldl_free(like);
    free(b);
    free(x);
    drop_pair(&p);
}

static void what_is_wrong_with_a_matrix_is_named(void **state)
{
    pair p = grid(6, 5, 4, 4);
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_ldl *ldl = NULL;
    sfem_error err;
    sfem_cg_def cg = sfem_default_cg_def();
    sfem_real *x, *work;
    (void)state;
    def.scalar = 1;
    def.positive = 0;
    assert_status(sfem_ldl_create(&def, &p.scalar, &ldl, &err), SFEM_BAD_ARGUMENT);
    def.positive = 1;
    def.ordering = SFEM_ORDER_NATURAL;
    assert_ok(sfem_ldl_create(&def, &p.scalar, &ldl, &err), err);
    cg.preconditioner = ldl; /* of another kind than the matrix of a cg */
    x = (sfem_real *)calloc(6 * (size_t)p.scalar.n, sizeof *x);
    work = (sfem_real *)malloc(sfem_cg_work_size(&cg, &p.block) * sizeof *work);
    assert_status(sfem_cg_solve(&cg, &p.block, x, x + 3 * p.scalar.n, work, NULL, &err),
                  SFEM_MISMATCH);
    free(x);
    free(work);
    sfem_ldl_free(ldl);
    p.scalar.val[p.scalar.row[18] - 1] = -1;
    assert_status(sfem_ldl_create(&def, &p.scalar, &ldl, &err), SFEM_NOT_SPD);
    assert_int_equal(err.node, 17);
    p.scalar.val[p.scalar.row[18] - 1] = NAN;
    assert_status(sfem_ldl_create(&def, &p.scalar, &ldl, &err), SFEM_NOT_FINITE);
    assert_int_equal(err.node, 17);
    drop_pair(&p);
}

static sfem_status attempt(sfem_allocator allocator, void *user, sfem_error *err)
{
    const pair *p = (const pair *)user;
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_ldl *ldl = NULL;
    sfem_status status;
    def.scalar = def.precision = SFEM_MIXED;
    def.x = p->x;
    def.allocator = allocator;
    status = sfem_ldl_create(&def, &p->scalar, &ldl, err);
    sfem_ldl_free(ldl);
    return status;
}

static void every_allocation_may_fail(void **state)
{
    pair p = grid(5, 4, 3, 4);
    (void)state;
    assert_true(fail_every_allocation(attempt, &p) > 10);
    drop_pair(&p);
}

/* --------------------------------------------------------------------------------------------
 * the majorant
 * -------------------------------------------------------------------------------------------- */

typedef struct scene {
    sfem_mesh mesh;
    sfem_model *model;
    unsigned char *mask;
} scene;

static scene block(const sfem_int *cells, int damped)
{
    const sfem_real size[3] = {0.4, 0.2, 0.2}, rest[2] = {0, 1e-3};
    sfem_model_def def = linear_model_def();
    sfem_int i, *region;
    sfem_material material[2];
    sfem_error err;
    scene s;
    memset(&s, 0, sizeof s);
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &s.mesh, &err), err);
    region = (sfem_int *)calloc((size_t)s.mesh.tets, sizeof *region);
    for (i = 0; i < s.mesh.tets; ++i) region[i] = i % 2;
    for (i = 0; i < 2; ++i) {
        material[i] = linear_material();
        material[i].young = 1e5;
        material[i].law = SFEM_COROTATIONAL;
        if (damped) material[i].stiffness_damping = rest[i];
    }
    def.mesh = &s.mesh;
    def.materials = material;
    def.material_count = 2;
    def.tet_material = region;
    assert_ok(sfem_model_create(&def, &s.model, &err), err);
    s.mask = (unsigned char *)calloc((size_t)s.mesh.nodes, 1);
    free(region);
    return s;
}

static void drop_scene(scene *s)
{
    sfem_model_free(s->model);
    sfem_mesh_free(&s->mesh);
    free(s->mask);
}

/* A x = b by the product with the majorant, an independent route; is the factor scalar? */
static int solves(const scene *s, sfem_int rhs)
{
    const sfem_int nodes = s->mesh.nodes;
    const size_t n = 3 * (size_t)nodes;
    sfem_real *b = (sfem_real *)malloc(4 * n * sizeof *b), *x = b + n, *y = b + 2 * n, *work;
    sfem_real *all = (sfem_real *)calloc((size_t)rhs * n, sizeof *all);
    test_random random = {9};
    const sfem_exec exec = thread_exec(1);
    sfemi_factor_key key;
    sfem_factor *f;
    sfem_int made = 0;
    sfem_error err;
    int scalar, c;
    size_t i;
    memset(&key, 0, sizeof key);
    key.ck = 0.01;
    key.cm = 1.5;
    key.cd = 0.1;
    key.upper_bound = 1;
    key.mask = s->mask;
    assert_ok(sfemi_factor_get(s->model, &key, &exec, &f, &made, &err), err);
    work = (sfem_real *)malloc(sfemi_factor_work_size(f, rhs) * sizeof *work);
    random_fill(&random, b, n, -1, 1);
    memcpy(all + (size_t)(rhs - 1) * n, b, n * sizeof *b);
    sfemi_factor_solve(f, nodes, rhs, all, all, work, &exec);
    memcpy(x, all + (size_t)(rhs - 1) * n, n * sizeof *x);
    for (i = 0; i < n; ++i)
        if (s->mask[i / 3] >> (i % 3) & 1) {
            assert_true(x[i] == b[i]); /* left alone */
            x[i] = 0;
        }
    sfemi_factor_multiply_upper_bound(s->model, x, y);
    for (i = 0; i < n; ++i) y[i] = key.ck * y[i] + key.cm * s->model->node_mass[i / 3] * x[i];
    if (s->model->damping) {
        memcpy(b + 3 * n, x, n * sizeof *x);
        for (i = 0; i < n; ++i) b[3 * n + i] *= key.cd;
        sfemi_fem_add_damping_rest(s->model, b + 3 * n, y);
    }
    for (i = 0, c = 0; i < n; ++i) {
        if (s->mask[i / 3] >> (i % 3) & 1) continue;
        assert_near(y[i], b[i], 0, 1e-10);
        ++c;
    }
    assert_true(c > 0);
    scalar = f->scalar;
    sfemi_factor_release(s->model, f);
    free(work);
    free(all);
    free(b);
    return scalar;
}

static void the_majorant_is_factored_as_a_scalar_unless_axes_or_damping_forbid(void **state)
{
    const sfem_int cells[3] = {4, 2, 2};
    scene s = block(cells, 0);
    sfem_int rhs;
    (void)state;
    for (rhs = 1; rhs < 5; ++rhs) assert_true(solves(&s, rhs));
    s.mask[3] = s.mask[10] = SFEM_AXIS_ALL;
    for (rhs = 1; rhs < 5; ++rhs) assert_true(solves(&s, rhs));
    s.mask[10] = SFEM_AXIS_Y;
    assert_false(solves(&s, 3));
    drop_scene(&s);
    s = block(cells, 1);
    assert_false(solves(&s, 1));
    drop_scene(&s);
}

static void factors_of_both_kinds_live_in_one_model(void **state)
{
    const sfem_int cells[3] = {4, 2, 2};
    scene s = block(cells, 0);
    const sfem_exec exec = thread_exec(1);
    sfemi_factor_key key;
    sfem_factor *f[3], *again;
    sfem_int made = 0, k;
    sfem_error err;
    (void)state;
    memset(&key, 0, sizeof key);
    key.cm = 1;
    for (k = 0; k < 3; ++k) { /* blocks, scalar, scalar on the analysis of the one before */
        key.ck = 0.01 * (k + 1);
        key.upper_bound = k > 0;
        key.mask = s.mask;
        assert_ok(sfemi_factor_get(s.model, &key, &exec, &f[k], &made, &err), err);
        assert_int_equal(f[k]->scalar, k > 0);
    }
    assert_int_equal(made, 3);
    assert_ptr_not_equal(f[0]->ldl->symbolic, f[1]->ldl->symbolic);
    assert_ptr_equal(f[1]->ldl->symbolic, f[2]->ldl->symbolic);
    assert_ok(sfemi_factor_get(s.model, &key, &exec, &again, &made, &err), err);
    assert_ptr_equal(again, f[2]);
    assert_int_equal(made, 3);
    sfemi_factor_release(s.model, again);
    for (k = 0; k < 3; ++k) sfemi_factor_release(s.model, f[k]);
    drop_scene(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(it_solves_for_any_size_ordering_and_number_of_right_sides),
        cmocka_unit_test(it_is_a_ninth_of_the_factor_of_the_blocks),
        cmocka_unit_test(its_bits_are_the_same_for_any_number_of_threads),
        cmocka_unit_test(it_is_renewed_whole_or_in_part),
        cmocka_unit_test(what_is_wrong_with_a_matrix_is_named),
        cmocka_unit_test(every_allocation_may_fail),
        cmocka_unit_test(the_majorant_is_factored_as_a_scalar_unless_axes_or_damping_forbid),
        cmocka_unit_test(factors_of_both_kinds_live_in_one_model),
    };
    return run_all_tests(tests);
}
