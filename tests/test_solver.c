/* The sparse and dense solvers: ordering, L D L^T, solves, conjugate gradients, matrices. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <dirent.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include "softfem.h"
#include "block_fem.h"

/* --- helpers --------------------------------------------------------------------------------- */

static double noise(uint32_t *state) /* in [-1, 1) */
{
    *state = *state * 1664525u + 1013904223u;
    return (double)(int32_t)*state / 2147483648.;
}

/* The sum of graph edges (i, j) of weight -B B^T and, on the diagonal, what makes it definite:
 * block row i gets sign[i] (or +1) times a dominant diagonal. */
static sfem_matrix edges_matrix(sfem_int n, sfem_int edges, const sfem_int *ei, const sfem_int *ej,
                                const double *sign, uint32_t seed)
{
    const sfem_int count = edges + n;
    sfem_int *bi = (sfem_int *)malloc((size_t)(count + 1) * sizeof *bi);
    sfem_int *bj = (sfem_int *)malloc((size_t)(count + 1) * sizeof *bj), e, i;
    double *bv = (double *)calloc((size_t)(count + 1) * 9, sizeof *bv);
    double *sum = (double *)calloc((size_t)n * 3 + 1, sizeof *sum);
    sfem_matrix a;
    sfem_error err;
    int r, c;
    for (e = 0; e < edges; ++e) {
        bi[e] = ei[e];
        bj[e] = ej[e];
        for (r = 0; r < 3; ++r)
            for (c = 0; c < 3; ++c) {
                const double v = ei[e] == ej[e] ? 0 : noise(&seed);
                bv[9 * e + 3 * r + c] = v;
                sum[3 * ei[e] + r] += fabs(v);
                sum[3 * ej[e] + c] += fabs(v);
            }
    }
    for (i = 0; i < n; ++i) {
        bi[edges + i] = bj[edges + i] = i;
        for (r = 0; r < 3; ++r)
            bv[9 * (size_t)(edges + i) + 4 * (size_t)r] =
                (sign ? sign[i] : 1) * (sum[3 * i + r] + 0.1);
    }
    assert_int_equal(sfem_matrix_create(n, count, bi, bj, bv, NULL, &a, &err), SFEM_OK);
    free(bi);
    free(bj);
    free(bv);
    free(sum);
    return a;
}

static sfem_matrix random_matrix(sfem_int n, sfem_int edges, const double *sign, uint32_t seed)
{
    sfem_int *ei = (sfem_int *)malloc((size_t)(edges + 1) * sizeof *ei), e;
    sfem_int *ej = (sfem_int *)malloc((size_t)(edges + 1) * sizeof *ej);
    sfem_matrix a;
    for (e = 0; e < edges; ++e) {
        ei[e] = (sfem_int)((noise(&seed) + 1) / 2 * n);
        ej[e] = (sfem_int)((noise(&seed) + 1) / 2 * n);
    }
    a = edges_matrix(n, edges, ei, ej, sign, seed);
    free(ei);
    free(ej);
    return a;
}

static double largest(size_t n, const double *v)
{
    double m = 0;
    size_t i;
    for (i = 0; i < n; ++i)
        if (!(fabs(v[i]) <= m)) m = fabs(v[i]); /* NaN stays */
    return m;
}

/* |b - A x| / (|A| |x| + |b|), infinity norms: what a backward stable solver keeps near 1e-16. */
static double backward_error(const sfem_matrix *a, const double *x, const double *b)
{
    const size_t n = 3 * (size_t)a->n;
    double *r = (double *)malloc((n + 1) * sizeof *r), *sum = (double *)calloc(n + 1, sizeof *sum);
    double e;
    sfem_int i, k;
    int p, q;
    for (i = 0; i < a->n; ++i)
        for (k = a->row[i]; k < a->row[i + 1]; ++k)
            for (p = 0; p < 3; ++p)
                for (q = 0; q < 3; ++q) {
                    const double v = fabs(a->val[9 * k + 3 * p + q]);
                    sum[3 * i + p] += v;
                    if (a->col[k] != i) sum[3 * a->col[k] + q] += v;
                }
    sfem_matrix_multiply(a, x, r, NULL);
    for (i = 0; i < 3 * a->n; ++i) r[i] -= b[i];
    e = largest(n, r) / (largest(n, sum) * largest(n, x) + largest(n, b) + 1e-300);
    free(r);
    free(sum);
    return e;
}

/* Factorises, solves for rhs right sides with one factor, and returns the largest backward error.
 */
static double solve_error(const sfem_ldl_def *def, const sfem_matrix *a, sfem_int rhs,
                          sfem_ldl_info *info)
{
    const size_t n = 3 * (size_t)a->n;
    sfem_ldl *ldl = NULL;
    sfem_error err;
    double *b = (double *)malloc((n * (size_t)rhs + 1) * sizeof *b), e = 0;
    double *x = (double *)malloc((n * (size_t)rhs + 1) * sizeof *x), *work;
    uint32_t seed = 7;
    sfem_int r;
    size_t i;
    assert_int_equal(sfem_ldl_create(def, a, &ldl, &err), SFEM_OK);
    work = (double *)malloc(sfem_ldl_work_size(ldl, rhs) * sizeof *work);
    for (i = 0; i < n * (size_t)rhs; ++i) x[i] = b[i] = noise(&seed);
    sfem_ldl_solve(ldl, rhs, x, work, NULL);
    for (r = 0; r < rhs; ++r) {
        const double one = backward_error(a, x + (size_t)r * n, b + (size_t)r * n);
        if (!(one <= e)) e = one;
    }
    if (info) *info = sfem_ldl_get_info(ldl);
    sfem_ldl_free(ldl);
    free(b);
    free(x);
    free(work);
    return e;
}

static sfem_ldl_def ordered(sfem_ordering ordering)
{
    sfem_ldl_def def = sfem_default_ldl_def();
    def.ordering = ordering;
    return def;
}

/* Eigenvalues of a full symmetric matrix by Jacobi's rotations: slow, and independent. */
static void jacobi(size_t n, double *a)
{
    size_t p, q, i;
    int sweep;
    for (sweep = 0; sweep < 30; ++sweep) {
        double off = 0;
        for (p = 0; p < n; ++p)
            for (q = p + 1; q < n; ++q) {
                const double apq = a[p * n + q];
                double theta, t, c, s;
                if (apq == 0) continue;
                off += fabs(apq);
                theta = (a[q * n + q] - a[p * n + p]) / (2 * apq);
                t = (theta < 0 ? -1 : 1) / (fabs(theta) + sqrt(theta * theta + 1));
                c = 1 / sqrt(t * t + 1);
                s = t * c;
                for (i = 0; i < n; ++i) {
                    const double u = a[p * n + i], v = a[q * n + i];
                    a[p * n + i] = c * u - s * v;
                    a[q * n + i] = s * u + c * v;
                }
                for (i = 0; i < n; ++i) {
                    const double u = a[i * n + p], v = a[i * n + q];
                    a[i * n + p] = c * u - s * v;
                    a[i * n + q] = s * u + c * v;
                }
            }
        if (off == 0) return;
    }
}

/* Own threads, so that the tests do not depend on OpenMP, nor the thread sanitizer on its runtime.
 */
typedef struct crew {
    sfem_int count, next;
    sfem_task task;
    void *data;
    pthread_mutex_t lock;
} crew;

static void *crew_work(void *user)
{
    crew *c = (crew *)user;
    for (;;) {
        sfem_int i;
        pthread_mutex_lock(&c->lock);
        i = c->next++;
        pthread_mutex_unlock(&c->lock);
        if (i >= c->count) return NULL;
        c->task(c->data, i);
    }
}

static void crew_for(sfem_int count, sfem_task task, void *data, void *user)
{
    const int threads = *(const int *)user;
    pthread_t id[8];
    crew c;
    int i;
    c.count = count;
    c.next = 0;
    c.task = task;
    c.data = data;
    pthread_mutex_init(&c.lock, NULL);
    for (i = 0; i < threads; ++i) pthread_create(id + i, NULL, crew_work, &c);
    for (i = 0; i < threads; ++i) pthread_join(id[i], NULL);
    pthread_mutex_destroy(&c.lock);
}

/* An allocator that fails once, and counts. */
typedef struct budget {
    long left, live, made;
} budget;

static void *budget_allocate(size_t bytes, void *user)
{
    budget *b = (budget *)user;
    if (b->left == 0) return NULL;
    --b->left;
    ++b->live;
    ++b->made;
    return malloc(bytes);
}

static void budget_release(void *memory, void *user)
{
    --((budget *)user)->live;
    free(memory);
}

static sfem_allocator budget_allocator(budget *b, long left)
{
    sfem_allocator a;
    b->left = left;
    b->live = b->made = 0;
    a.allocate = budget_allocate;
    a.release = budget_release;
    a.user = b;
    return a;
}

/* --- matrices -------------------------------------------------------------------------------- */

static void a_matrix_adds_its_blocks_and_keeps_the_lower_half(void **state)
{
    const sfem_int i[] = {2, 0, 0, 2}, j[] = {0, 2, 0, 0};
    double v[36], full[81];
    sfem_matrix a;
    sfem_error err;
    int k;
    (void)state;
    for (k = 0; k < 36; ++k) v[k] = k;
    assert_int_equal(sfem_matrix_create(3, 4, i, j, v, NULL, &a, &err), SFEM_OK);
    assert_int_equal(a.row[3], 4); /* three diagonal blocks and (2, 0) */
    sfem_matrix_to_dense(&a, full);
    for (k = 0; k < 9; ++k) { /* blocks 0 and 3 as given, block 1 transposed */
        const int r = k / 3, c = k % 3;
        assert_true(full[(6 + r) * 9 + c] == v[k] + v[27 + k] + v[9 + 3 * c + r]);
        assert_true(full[c * 9 + 6 + r] == full[(6 + r) * 9 + c]);
        assert_true(full[r * 9 + c] == v[18 + k]);
        assert_true(full[(3 + r) * 9 + 3 + c] == 0);
    }
    sfem_matrix_free(&a);
}

static void products_agree_with_the_dense_and_csr_forms(void **state)
{
    sfem_matrix a = random_matrix(1500, 6000, NULL, 3);
    const size_t n = 4500, count = sfem_matrix_csr_count(&a);
    sfem_int *row = (sfem_int *)malloc((n + 1) * sizeof *row);
    sfem_int *col = (sfem_int *)malloc(count * sizeof *col);
    double *val = (double *)malloc(count * sizeof *val), *x = (double *)malloc(n * sizeof *x);
    double *y = (double *)malloc(3 * n * sizeof *y), *z = y + n, *w = z + n;
    sfem_matrix_upper upper;
    sfem_exec exec;
    sfem_error err;
    uint32_t seed = 1;
    int threads;
    size_t i;
    sfem_int k;
    (void)state;
    for (i = 0; i < n; ++i) x[i] = noise(&seed);
    assert_int_equal(sfem_matrix_to_csr(&a, row, col, val, &err), SFEM_OK);
    assert_int_equal(row[n], (sfem_int)count);
    for (i = 0; i < n; ++i) {
        z[i] = 0;
        for (k = row[i]; k < row[i + 1]; ++k) {
            z[i] += val[k] * x[col[k]];
            if (k > row[i]) assert_true(col[k] > col[k - 1]);
        }
    }
    sfem_matrix_multiply(&a, x, y, NULL);
    for (i = 0; i < n; ++i) assert_true(fabs(y[i] - z[i]) <= 1e-13 * (1 + fabs(z[i])));
    assert_int_equal(sfem_matrix_upper_create(&a, NULL, &upper, &err), SFEM_OK);
    a.upper = &upper;
    memset(&exec, 0, sizeof exec);
    sfem_matrix_multiply(&a, x, y, NULL);
    for (i = 0; i < n; ++i) assert_true(fabs(y[i] - z[i]) <= 1e-13 * (1 + fabs(z[i])));
    for (threads = 1; threads <= 8; threads *= 2) {
        exec.threads = 8;
        exec.parallel_for = crew_for;
        exec.user = &threads;
        sfem_matrix_multiply(&a, x, w, &exec);
        assert_memory_equal(w, y, n * sizeof *y);
    }
    sfem_matrix_upper_free(&upper);
    sfem_matrix_free(&a);
    free(row);
    free(col);
    free(val);
    free(x);
    free(y);
}

static void wrong_matrices_are_refused_by_name(void **state)
{
    const sfem_int i[] = {0, 3}, j[] = {0, 0};
    sfem_int row[] = {0, 1, 3}, col[] = {0, 0, 1};
    double val[27] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_ldl *ldl = NULL;
    sfem_matrix a;
    sfem_error err;
    (void)state;
    assert_int_equal(sfem_matrix_create(3, 2, i, j, NULL, NULL, &a, &err), SFEM_BAD_ARGUMENT);
    assert_non_null(strstr(err.text, "(3, 0)"));
    assert_int_equal(sfem_matrix_create(-1, 0, NULL, NULL, NULL, NULL, &a, &err),
                     SFEM_BAD_ARGUMENT);
    assert_int_equal(sfem_matrix_create(INT32_MAX / 3 + 1, 0, NULL, NULL, NULL, NULL, &a, &err),
                     SFEM_TOO_LARGE);
    memset(&a, 0, sizeof a);
    a.n = 2;
    a.row = row;
    a.col = col;
    a.val = val;
    assert_int_equal(sfem_matrix_check(&a, &err), SFEM_OK);
    col[2] = 0;
    assert_int_equal(sfem_matrix_check(&a, &err), SFEM_BAD_ARGUMENT);
    assert_int_equal(err.node, 1);
    assert_int_equal(sfem_ldl_create(&def, &a, &ldl, &err), SFEM_BAD_ARGUMENT);
    col[2] = 1;
    col[1] = -1;
    assert_int_equal(sfem_matrix_check(&a, &err), SFEM_BAD_ARGUMENT);
    col[1] = 0;
    row[0] = 1;
    assert_int_equal(sfem_matrix_check(&a, &err), SFEM_BAD_ARGUMENT);
    row[0] = 0;
    a.n = INT32_MAX / 3 + 1;
    assert_int_equal(sfem_ldl_create(&def, &a, &ldl, &err), SFEM_TOO_LARGE);
    a.n = 2;
    val[9] = NAN;
    assert_int_equal(sfem_matrix_check(&a, &err), SFEM_NOT_FINITE);
    assert_int_equal(err.node, 1);
    def.ordering = SFEM_ORDER_DISSECTION;
    assert_int_equal(sfem_ldl_create(&def, &a, &ldl, &err), SFEM_BAD_ARGUMENT); /* no coordinates */
    assert_null(ldl);
}

/* --- L D L^T --------------------------------------------------------------------------------- */

static void random_definite_matrices_are_solved_to_rounding(void **state)
{
    sfem_int n;
    (void)state;
    for (n = 1; n <= 70; n += n < 20 ? 1 : 7) {
        sfem_int density;
        for (density = 0; density <= 3; ++density) {
            sfem_matrix a = random_matrix(n, n * density, NULL, (uint32_t)(100 * n + density));
            sfem_ldl_def def = ordered(density % 2 ? SFEM_ORDER_NATURAL : SFEM_ORDER_AMD);
            sfem_ldl_info info;
            assert_true(solve_error(&def, &a, 1, &info) < 1e-15);
            assert_int_equal(info.negative, 0);
            assert_true(solve_error(&def, &a, 11, NULL) < 1e-15);
            def.precision = SFEM_MIXED;
            assert_true(solve_error(&def, &a, 1, NULL) < 3e-7);
            assert_true(solve_error(&def, &a, 9, NULL) < 3e-7);
            sfem_matrix_free(&a);
        }
    }
}

static void quasi_definite_matrices_give_their_inertia(void **state)
{
    double sign[60];
    sfem_int n = 60, i, trial;
    (void)state;
    for (trial = 0; trial < 20; ++trial) {
        sfem_ldl_def def = ordered(SFEM_ORDER_AMD);
        sfem_ldl_info info;
        uint32_t seed = (uint32_t)trial;
        sfem_matrix a;
        sfem_int negative = 0;
        for (i = 0; i < n; ++i) {
            sign[i] = noise(&seed) < 0 ? -1 : 1;
            negative += 3 * (sign[i] < 0);
        }
        a = random_matrix(n, 150, sign, seed);
        def.positive = 0;
        assert_true(solve_error(&def, &a, 1, &info) < 1e-14);
        assert_int_equal(info.negative, negative);
        assert_true(info.residual < 1e-13);
        assert_true(solve_error(&def, &a, 8, &info) < 1e-14);
        def.precision = SFEM_MIXED;
        assert_true(solve_error(&def, &a, 1, &info) < 1e-5);
        sfem_matrix_free(&a);
    }
}

/* K - sigma M for the K and M of a beam: the negative pivots count the eigenvalues below sigma. */
static void inertia_counts_eigenvalues_below_a_shift(void **state)
{
    block_fem f = block_fem_create(5, 2, 2, 1);
    const size_t n = 3 * (size_t)f.n;
    double *dense = (double *)malloc(n * n * sizeof *dense), *val;
    const size_t blocks = (size_t)f.a.row[f.n];
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_matrix s = f.a;
    size_t i, j;
    int trial;
    (void)state;
    val = (double *)malloc(9 * blocks * sizeof *val);
    sfem_matrix_to_dense(&f.a, dense);
    for (i = 0; i < n; ++i) /* scaled by M^-1/2, which is diagonal */
        for (j = 0; j < n; ++j) {
            const double mi = f.m.val[9 * (f.m.row[i / 3 + 1] - 1) + 4 * (sfem_int)(i % 3)];
            const double mj = f.m.val[9 * (f.m.row[j / 3 + 1] - 1) + 4 * (sfem_int)(j % 3)];
            dense[i * n + j] /= sqrt(mi * mj);
        }
    jacobi(n, dense);
    def.positive = 0;
    s.val = val;
    for (trial = 1; trial < 12; ++trial) {
        const double at = dense[(size_t)trial * 17 % n * (n + 1)];
        double below = 0, above = 1e300, sigma;
        sfem_int count = 0;
        sfem_ldl_info info;
        for (i = 0; i < n; ++i) { /* in the middle between two eigenvalues */
            const double l = dense[i * (n + 1)];
            if (l <= at * (1 + 1e-6) && l > below) below = l; /* equal ones together */
            if (l > at * (1 + 1e-6) && l < above) above = l;
        }
        sigma = above < 1e300 ? (below + above) / 2 : 2 * below;
        for (i = 0; i < n; ++i) count += dense[i * (n + 1)] < sigma;
        for (i = 0; i < 9 * blocks; ++i) val[i] = f.a.val[i] - sigma * f.m.val[i];
        assert_true(solve_error(&def, &s, 1, &info) < 1e-9);
        assert_int_equal(info.negative, count);
    }
    free(val);
    free(dense);
    block_fem_free(&f);
}

/* [0 1; 1 0] has no L D L^T without pivoting; a small number instead of the 0 has a useless one. */
static void indefinite_matrices_that_need_pivoting_are_refused(void **state)
{
    const sfem_int i[] = {0, 1, 1}, j[] = {0, 1, 0};
    static const double small[] = {0, 1e-18, 1e-12};
    size_t k;
    (void)state;
    for (k = 0; k < 3; ++k) {
        double v[27] = {1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 0, 0, 0, 1,
                        0, 0, 0, 1, 1, 2, 3, 4, 5, 7, 2, 8, 1};
        sfem_ldl_def def = ordered(SFEM_ORDER_NATURAL);
        sfem_ldl *ldl = NULL;
        sfem_matrix a;
        sfem_error err;
        v[0] = v[4] = v[8] = v[9] = v[13] = v[17] = small[k];
        v[1] = v[3] = small[k] / 3;
        assert_int_equal(sfem_matrix_create(2, 3, i, j, v, NULL, &a, &err), SFEM_OK);
        def.positive = 0;
        assert_int_equal(sfem_ldl_create(&def, &a, &ldl, &err), SFEM_SINGULAR);
        assert_true(err.node == 0 || err.node == 1);
        assert_null(ldl);
        sfem_matrix_free(&a);
    }
}

static void graphs_of_every_shape_are_solved(void **state)
{
    enum { N = 400 };
    static const char *const shape[] = {"points", "pieces", "path", "star", "two stars", "clique"};
    sfem_int ei[N * 10], ej[N * 10], i, k, edges;
    size_t s;
    (void)state;
    for (s = 0; s < sizeof shape / sizeof *shape; ++s) {
        sfem_matrix a;
        int ordering;
        for (edges = 0, i = 0; i < N; ++i) {
            if (s == 1)
                for (k = 1; k <= 3; ++k)
                    if (i % 8 + k < 8) {
                        ei[edges] = i;
                        ej[edges++] = i + k;
                    }
            if (s == 2 && i) {
                ei[edges] = i;
                ej[edges++] = i - 1;
            }
            if ((s == 3 || s == 4) && i) {
                ei[edges] = i;
                ej[edges++] = 0;
            }
            if (s == 4 && i != N / 2) {
                ei[edges] = N / 2;
                ej[edges++] = i;
            }
            if (s == 5)
                for (k = 0; k < i && i < 60; ++k) {
                    ei[edges] = i;
                    ej[edges++] = k;
                }
        }
        a = edges_matrix(N, edges, ei, ej, NULL, 5);
        for (ordering = SFEM_ORDER_BEST; ordering <= SFEM_ORDER_NATURAL; ++ordering) {
            sfem_ldl_def def = ordered((sfem_ordering)ordering);
            double x[3 * N];
            for (i = 0; i < 3 * N; ++i) x[i] = (double)(i * 7919 % 1000); /* means nothing */
            if (s == 0) memset(x, 0, sizeof x);
            def.x = x;
            if (!(solve_error(&def, &a, 1, NULL) < 1e-15)) fail_msg("%s, %d", shape[s], ordering);
        }
        sfem_matrix_free(&a);
    }
}

static void a_star_is_ordered_from_its_tips(void **state)
{
    sfem_int ei[3000], ej[3000], i;
    sfem_ldl_def def = ordered(SFEM_ORDER_AMD);
    sfem_ldl_info info;
    sfem_matrix a;
    (void)state;
    for (i = 0; i < 3000; ++i) {
        ei[i] = 0;
        ej[i] = i + 1;
    }
    a = edges_matrix(3001, 3000, ei, ej, NULL, 5);
    assert_true(solve_error(&def, &a, 1, &info) < 1e-15);
    assert_true(info.nnz < 3001 * 24); /* the hub first would fill all of it */
    sfem_matrix_free(&a);
}

static void the_empty_matrix_is_allowed(void **state)
{
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_matrix a;
    sfem_ldl_info info;
    sfem_error err;
    (void)state;
    assert_int_equal(sfem_matrix_create(0, 0, NULL, NULL, NULL, NULL, &a, &err), SFEM_OK);
    (void)solve_error(&def, &a, 1, &info);
    assert_int_equal(info.n, 0);
    def.positive = 0;
    (void)solve_error(&def, &a, 9, &info);
    sfem_matrix_free(&a);
}

/* Every ordering on both kinds of blocks, and as much fill as is known to be needed. */
static void blocks_of_tets_are_solved_with_every_ordering(void **state)
{
    int five, ordering;
    (void)state;
    for (five = 0; five < 2; ++five) {
        block_fem f = block_fem_create(16, 8, 8, five);
        double flops[4];
        for (ordering = SFEM_ORDER_BEST; ordering <= SFEM_ORDER_NATURAL; ++ordering) {
            sfem_ldl_def def = ordered((sfem_ordering)ordering);
            sfem_ldl_info info;
            def.x = f.x;
            assert_true(solve_error(&def, &f.a, 1, &info) < 1e-15);
            flops[ordering] = info.flops;
            assert_int_equal(info.n, f.n);
            assert_true(ordering == SFEM_ORDER_BEST || info.ordering == (sfem_ordering)ordering);
        }
        assert_true(flops[SFEM_ORDER_BEST] <= 1.1 * flops[SFEM_ORDER_AMD]);
        assert_true(flops[SFEM_ORDER_DISSECTION] < 1.3 * flops[SFEM_ORDER_AMD]);
        assert_true(flops[SFEM_ORDER_AMD] < 0.8 * flops[SFEM_ORDER_NATURAL]);
        block_fem_free(&f);
    }
}

static void dissection_beats_minimum_degree_on_large_blocks(void **state)
{
    block_fem f = block_fem_create(40, 10, 10, 1);
    sfem_ldl_def def = ordered(SFEM_ORDER_BEST);
    sfem_ldl_info best, amd;
    (void)state;
    def.x = f.x;
    assert_true(solve_error(&def, &f.a, 3, &best) < 1e-14);
    def.ordering = SFEM_ORDER_AMD;
    assert_true(solve_error(&def, &f.a, 1, &amd) < 1e-14);
    assert_int_equal(best.ordering, SFEM_ORDER_DISSECTION);
    assert_true(best.flops < 0.9 * amd.flops);
    block_fem_free(&f);
}

/* Floats hold no coordinate beyond 3e38, and none at all of those below 1e-45. */
static void dissection_does_not_depend_on_the_unit_of_length(void **state)
{
    static const int exponent[] = {-1040, -200, 130, 1014};
    block_fem f = block_fem_create(16, 6, 6, 1);
    const size_t n = 3 * (size_t)f.n;
    sfem_ldl_def def = ordered(SFEM_ORDER_DISSECTION);
    sfem_ldl *ldl = NULL;
    sfem_ldl_info whole;
    sfem_error err;
    double *x = (double *)malloc(n * sizeof *x);
    size_t i, k;
    (void)state;
    def.x = f.x;
    assert_int_equal(sfem_ldl_create(&def, &f.a, &ldl, &err), SFEM_OK);
    whole = sfem_ldl_get_info(ldl);
    sfem_ldl_free(ldl);
    def.x = x;
    for (k = 0; k < sizeof exponent / sizeof *exponent; ++k) {
        for (i = 0; i < n; ++i) x[i] = ldexp(f.x[i], exponent[k]);
        assert_int_equal(sfem_ldl_create(&def, &f.a, &ldl, &err), SFEM_OK);
        assert_true(sfem_ldl_get_info(ldl).flops == whole.flops);
        sfem_ldl_free(ldl);
    }
    for (i = 0; i < n; ++i) x[i] = i % 3 == 0 ? (i % 2 ? 1.7e308 : -1.7e308) : f.x[i]; /* sums overflow */
    assert_int_equal(sfem_ldl_create(&def, &f.a, &ldl, &err), SFEM_OK);
    sfem_ldl_free(ldl);
    for (i = 0; i < n; ++i) x[i] = i % 3 == 0 ? (i % 2 ? 1e-44 : 0) : f.x[i]; /* a float divided by this overflows */
    assert_int_equal(sfem_ldl_create(&def, &f.a, &ldl, &err), SFEM_OK);
    sfem_ldl_free(ldl);
    free(x);
    block_fem_free(&f);
}

static void the_solution_does_not_depend_on_the_numbering(void **state)
{
    block_fem f = block_fem_create(10, 4, 4, 0);
    const size_t n = 3 * (size_t)f.n;
    sfem_int *to = (sfem_int *)malloc((size_t)f.n * sizeof *to), i, k;
    sfem_int *bi = (sfem_int *)malloc((size_t)f.a.row[f.n] * sizeof *bi);
    sfem_int *bj = (sfem_int *)malloc((size_t)f.a.row[f.n] * sizeof *bj);
    double *b = (double *)malloc(2 * n * sizeof *b), *c = b + n, *work;
    sfem_ldl_def def = ordered(SFEM_ORDER_AMD);
    sfem_ldl *one = NULL, *two = NULL;
    sfem_matrix p;
    sfem_error err;
    uint32_t seed = 11;
    (void)state;
    for (i = 0; i < f.n; ++i) to[i] = i;
    for (i = f.n - 1; i > 0; --i) {
        const sfem_int j = (sfem_int)((noise(&seed) + 1) / 2 * (i + 1)), t = to[i];
        to[i] = to[j];
        to[j] = t;
    }
    for (i = 0; i < f.n; ++i) {
        for (k = f.a.row[i]; k < f.a.row[i + 1]; ++k) {
            bi[k] = to[i];
            bj[k] = to[f.a.col[k]];
        }
        for (k = 0; k < 3; ++k) c[3 * to[i] + k] = b[3 * i + k] = noise(&seed);
    }
    assert_int_equal(sfem_matrix_create(f.n, f.a.row[f.n], bi, bj, f.a.val, NULL, &p, &err),
                     SFEM_OK);
    assert_int_equal(sfem_ldl_create(&def, &f.a, &one, &err), SFEM_OK);
    assert_int_equal(sfem_ldl_create(&def, &p, &two, &err), SFEM_OK);
    work =
        (double *)malloc((sfem_ldl_work_size(one, 1) + sfem_ldl_work_size(two, 1)) * sizeof *work);
    sfem_ldl_solve(one, 1, b, work, NULL);
    sfem_ldl_solve(two, 1, c, work, NULL);
    for (i = 0; i < f.n; ++i) /* cond(A) is 1e3 here */
        for (k = 0; k < 3; ++k)
            assert_true(fabs(c[3 * to[i] + k] - b[3 * i + k]) < 1e-12 * largest(n, b));
    sfem_ldl_free(one);
    sfem_ldl_free(two);
    sfem_matrix_free(&p);
    block_fem_free(&f);
    free(to);
    free(bi);
    free(bj);
    free(b);
    free(work);
}

/* Nodes pulled almost into the plane of their neighbours: cond(A) about 1e12, which spoils the
 * solution but not the residual. */
static void slivers_leave_a_small_backward_error(void **state)
{
    block_fem f = block_fem_create(12, 4, 4, 1), g;
    sfem_ldl_def def = sfem_default_ldl_def();
    double *x = (double *)malloc((size_t)f.n * 3 * sizeof *x);
    const size_t nnz = 9 * (size_t)f.a.row[f.n];
    size_t k;
    sfem_int i;
    double most = 0, least = 1e300;
    (void)state;
    g = f;
    g.a.val = (double *)malloc(nnz * sizeof *x);
    /* scale by D A D, D from 1 to 1e-6 from node to node: slivers stiffen single nodes this way */
    for (i = 0; i < f.n; ++i) {
        sfem_int e;
        for (e = f.a.row[i]; e < f.a.row[i + 1]; ++e) {
            const double d =
                pow(10, -(double)(i * 37 % 7)) * pow(10, -(double)(f.a.col[e] * 37 % 7));
            for (k = 0; k < 9; ++k) g.a.val[9 * (size_t)e + k] = d * f.a.val[9 * (size_t)e + k];
            if (f.a.col[e] == i) {
                if (d * f.a.val[9 * e] > most) most = d * f.a.val[9 * e];
                if (d * f.a.val[9 * e] < least) least = d * f.a.val[9 * e];
            }
        }
    }
    assert_true(most / least > 1e11);
    assert_true(solve_error(&def, &g.a, 1, NULL) < 1e-15);
    assert_true(solve_error(&def, &g.a, 8, NULL) < 1e-15);
    def.precision = SFEM_MIXED;
    assert_true(solve_error(&def, &g.a, 1, NULL) < 1e-5);
    free(g.a.val);
    free(x);
    block_fem_free(&f);
}

/* True slivers: a layer of cells squashed to 1e-6 of its height. */
static void squashed_cells_leave_a_small_backward_error(void **state)
{
    block_fem f = block_fem_create(8, 4, 4, 0), g;
    sfem_ldl_def def = sfem_default_ldl_def();
    static const sfem_int cut6[6][4] = {{0, 1, 3, 7}, {0, 3, 2, 7}, {0, 2, 6, 7},
                                        {0, 6, 4, 7}, {0, 4, 5, 7}, {0, 5, 1, 7}};
    enum { X = 9, Y = 5, Z = 5 };
    double x[X * Y * Z * 3];
    unsigned char clamp[X * Y * Z] = {0};
    sfem_int tet[8 * 4 * 4 * 6 * 4], count = 0, i, j, k, c, v;
    (void)state;
    for (k = 0; k < Z; ++k)
        for (j = 0; j < Y; ++j)
            for (i = 0; i < X; ++i) {
                double *at = x + 3 * (i + X * (j + Y * k));
                at[0] = i < 4 ? i : 3 + 1e-6 + (i - 4); /* the cells between i = 3 and 4 are flat */
                at[1] = j;
                at[2] = k;
                clamp[i + X * (j + Y * k)] = i == 0;
            }
    for (k = 0; k < Z - 1; ++k)
        for (j = 0; j < Y - 1; ++j)
            for (i = 0; i < X - 1; ++i)
                for (c = 0; c < 6; ++c, ++count)
                    for (v = 0; v < 4; ++v) {
                        const sfem_int o = cut6[c][v];
                        tet[4 * count + v] =
                            i + (o & 1) + X * (j + (o >> 1 & 1) + Y * (k + (o >> 2)));
                    }
    g = block_fem_assemble(X * Y * Z, x, count, tet, clamp, 1e6, .45, 1000, 1, 0); /* K alone */
    assert_true(solve_error(&def, &g.a, 1, NULL) < 1e-14);
    assert_true(solve_error(&def, &g.a, 4, NULL) < 1e-14);
    block_fem_free(&f);
    block_fem_free(&g);
}

static void lost_pivots_name_their_node(void **state)
{
    block_fem f = block_fem_create(12, 4, 4, 1);
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_ldl *ldl = NULL;
    sfem_error err;
    const sfem_int node = 77;
    double *d = f.a.val + 9 * (f.a.row[node + 1] - 1), before[9];
    (void)state;
    memcpy(before, d, sizeof before);
    d[4] = -1; /* on the diagonal: whatever is eliminated first, this pivot is negative */
    assert_int_equal(sfem_ldl_create(&def, &f.a, &ldl, &err), SFEM_NOT_SPD);
    assert_int_equal(err.node, node);
    assert_non_null(strstr(err.text, "direction 1"));
    assert_null(ldl);
    d[4] = before[4];
    assert_int_equal(sfem_ldl_create(&def, &f.a, &ldl, &err), SFEM_OK);
    d[4] = NAN;
    assert_int_equal(sfem_ldl_refactor(ldl, &f.a, &err), SFEM_NOT_FINITE);
    assert_int_equal(err.node, node);
    d[4] = before[4];
    f.a.val[9 * f.a.row[50] + 5] =
        INFINITY; /* off the diagonal, or it is not the last of its row */
    assert_int_equal(sfem_ldl_refactor(ldl, &f.a, &err), SFEM_NOT_FINITE);
    assert_int_equal(err.node, 50);
    sfem_ldl_free(ldl);
    block_fem_free(&f);
}

static void a_free_body_without_mass_is_refused(void **state)
{
    block_fem f = block_fem_create(6, 3, 3, 1), g;
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_ldl *ldl = NULL;
    sfem_error err;
    sfem_int tet[] = {0, 1, 2, 3, 1, 2, 3, 4};
    double x[] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 1};
    unsigned char clamp[5] = {0};
    (void)state;
    g = block_fem_assemble(5, x, 2, tet, clamp, 1e6, .3, 1000, 1, 0);
    assert_int_equal(sfem_ldl_create(&def, &g.a, &ldl, &err), SFEM_NOT_SPD);
    def.positive = 0;
    assert_int_equal(sfem_ldl_create(&def, &g.a, &ldl, &err), SFEM_SINGULAR);
    block_fem_free(&f);
    block_fem_free(&g);
}

static void refactoring_gives_the_bits_of_a_new_factor_and_allocates_nothing(void **state)
{
    block_fem f = block_fem_create(20, 7, 7, 1);
    const size_t n = 3 * (size_t)f.n, nnz = 9 * (size_t)f.a.row[f.n];
    double *first = (double *)malloc(nnz * sizeof *first), *x = (double *)malloc(3 * n * sizeof *x);
    double *y = x + n, *z = y + n, *work;
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_ldl *old = NULL, *made = NULL;
    sfem_error err;
    budget b;
    long made_before;
    size_t i;
    (void)state;
    def.x = f.x;
    def.allocator = budget_allocator(&b, -1);
    memcpy(first, f.a.val, nnz * sizeof *first);
    assert_int_equal(sfem_ldl_create(&def, &f.a, &old, &err), SFEM_OK);
    for (i = 0; i < nnz; ++i) f.a.val[i] *= 1.25;
    assert_int_equal(sfem_ldl_create(&def, &f.a, &made, &err), SFEM_OK);
    made_before = b.made;
    assert_int_equal(sfem_ldl_refactor(old, &f.a, &err), SFEM_OK);
    work = (double *)malloc(sfem_ldl_work_size(old, 1) * sizeof *work);
    for (i = 0; i < n; ++i) x[i] = y[i] = z[i] = cos((double)i);
    sfem_ldl_solve(old, 1, x, work, NULL);
    assert_int_equal(b.made, made_before);
    sfem_ldl_solve(made, 1, y, work, NULL);
    assert_memory_equal(x, y, n * sizeof *x);
    memcpy(f.a.val, first, nnz * sizeof *first);
    f.a.val[9 * (f.a.row[5 + 1] - 1)] = -1e9; /* a failure in between leaves nothing behind */
    assert_int_equal(sfem_ldl_refactor(old, &f.a, &err), SFEM_NOT_SPD);
    for (i = 0; i < nnz; ++i) f.a.val[i] = 1.25 * first[i];
    assert_int_equal(sfem_ldl_refactor(old, &f.a, &err), SFEM_OK);
    sfem_ldl_solve(old, 1, z, work, NULL);
    assert_memory_equal(x, z, n * sizeof *x);
    sfem_ldl_free(old);
    sfem_ldl_free(made);
    assert_int_equal(b.live, 0);
    free(first);
    free(x);
    free(work);
    block_fem_free(&f);
}

static void a_partial_refactorisation_has_the_bits_of_a_full_one(void **state)
{
    block_fem f = block_fem_create(30, 8, 8, 1);
    const size_t n = 3 * (size_t)f.n;
    double *x = (double *)malloc(2 * n * sizeof *x), *y = x + n, *work;
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_ldl *part = NULL, *full = NULL;
    sfem_error err;
    int trial, positive;
    (void)state;
    def.x = f.x;
    for (positive = 0; positive < 2; ++positive) {
        def.keep = 1;
        def.positive = positive;
        assert_int_equal(sfem_ldl_create(&def, &f.a, &part, &err), SFEM_OK);
        def.keep = 0;
        work = (double *)malloc(sfem_ldl_work_size(part, 1) * sizeof *work);
        for (trial = 0; trial < 5; ++trial) {
            sfem_int node[3];
            size_t i;
            int k;
            for (k = 0; k < 3; ++k) {
                node[k] = (trial * 997 + k * 331) % f.n;
                f.a.val[9 * (f.a.row[node[k] + 1] - 1)] *= 1.5;
            }
            assert_int_equal(sfem_ldl_refactor_nodes(part, &f.a, 3, node, &err), SFEM_OK);
            assert_int_equal(sfem_ldl_create(&def, &f.a, &full, &err), SFEM_OK);
            for (i = 0; i < n; ++i) x[i] = y[i] = cos((double)i);
            sfem_ldl_solve(part, 1, x, work, NULL);
            sfem_ldl_solve(full, 1, y, work, NULL);
            assert_memory_equal(x, y, n * sizeof *x);
            sfem_ldl_free(full);
        }
        sfem_ldl_free(part);
        free(work);
    }
    free(x);
    block_fem_free(&f);
}

static void factors_that_share_an_analysis_may_be_freed_in_any_order(void **state)
{
    block_fem f = block_fem_create(6, 3, 3, 1), g = block_fem_create(6, 3, 2, 1);
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_ldl *a = NULL, *b = NULL, *c = NULL;
    sfem_error err;
    budget m;
    (void)state;
    def.allocator = budget_allocator(&m, -1);
    assert_int_equal(sfem_ldl_create(&def, &f.a, &a, &err), SFEM_OK);
    assert_int_equal(sfem_ldl_create_like(a, &f.a, NULL, &b, &err), SFEM_OK);
    sfem_ldl_free(a);
    assert_int_equal(sfem_ldl_create_like(b, &f.a, NULL, &c, &err), SFEM_OK);
    sfem_ldl_free(b);
    assert_int_equal(sfem_ldl_refactor(c, &f.a, &err), SFEM_OK);
    assert_int_equal(sfem_ldl_create_like(c, &g.a, NULL, &a, &err), SFEM_MISMATCH);
    assert_int_equal(sfem_ldl_refactor(c, &g.a, &err), SFEM_MISMATCH);
    sfem_ldl_free(c);
    sfem_ldl_free(NULL);
    assert_int_equal(m.live, 0);
    block_fem_free(&f);
    block_fem_free(&g);
}

static void every_failing_allocation_is_survived(void **state)
{
    block_fem f = block_fem_create(24, 8, 8, 1);
    long fail;
    int kind;
    (void)state;
    for (kind = 0; kind < 3; ++kind) {
        sfem_ldl_def def = sfem_default_ldl_def();
        sfem_ldl *ldl = NULL, *like = NULL;
        sfem_error err;
        sfem_status status = SFEM_OUT_OF_MEMORY;
        budget b;
        def.ordering = kind == 0   ? SFEM_ORDER_BEST
                       : kind == 1 ? SFEM_ORDER_NATURAL
                                   : SFEM_ORDER_AMD;
        def.x = f.x;
        def.positive = kind != 2;
        def.precision = kind == 2 ? SFEM_MIXED : SFEM_DOUBLE;
        if (kind == 1) { /* small, natural: fills little time */
            block_fem_free(&f);
            f = block_fem_create(6, 3, 3, 1);
            def.x = f.x;
        }
        for (fail = 0; status == SFEM_OUT_OF_MEMORY; ++fail) {
            def.allocator = budget_allocator(&b, fail);
            status = sfem_ldl_create(&def, &f.a, &ldl, &err);
            if (status == SFEM_OK) {
                b.left = fail % 7;
                if (sfem_ldl_create_like(ldl, &f.a, NULL, &like, &err) == SFEM_OK) sfem_ldl_free(like);
                sfem_ldl_free(ldl);
            } else {
                assert_int_equal(err.status, SFEM_OUT_OF_MEMORY);
                assert_null(ldl);
            }
            assert_int_equal(b.live, 0);
        }
        assert_int_equal(status, SFEM_OK);
        assert_true(fail > 20);
    }
    for (fail = 0;; ++fail) {
        budget b;
        const sfem_allocator m = budget_allocator(&b, fail);
        const sfem_int i[] = {1}, j[] = {0};
        sfem_matrix a;
        sfem_matrix_upper u;
        if (sfem_matrix_create(2, 1, i, j, NULL, &m, &a, NULL) == SFEM_OK) {
            if (sfem_matrix_upper_create(&a, &m, &u, NULL) == SFEM_OK) {
                sfem_matrix_upper_free(&u);
                sfem_matrix_free(&a);
                assert_int_equal(b.live, 0);
                break;
            }
            sfem_matrix_free(&a);
        }
        assert_int_equal(b.live, 0);
    }
    block_fem_free(&f);
}

static void any_number_of_threads_gives_the_same_bits(void **state)
{
    int kind;
    (void)state;
    for (kind = 0; kind < 3; ++kind) {
        block_fem f = block_fem_create(kind == 1 ? 20 : 24, kind == 1 ? 4 : 8, 8, kind != 2);
        const size_t n = 3 * (size_t)f.n;
        double *x = (double *)malloc(9 * n * sizeof *x), *y = (double *)malloc(9 * n * sizeof *y),
               *work;
        int threads;
        for (threads = 1; threads <= 5; threads += threads == 1 ? 1 : 3) { /* 1, 2, 5 */
            sfem_ldl_def def = sfem_default_ldl_def();
            sfem_ldl *ldl = NULL;
            sfem_error err;
            size_t i;
            int round;
            def.x = f.x;
            def.precision = kind == 1 ? SFEM_MIXED : SFEM_DOUBLE;
            def.positive = kind != 0;
            def.exec.threads = threads;
            def.exec.parallel_for = crew_for;
            def.exec.user = &threads;
            assert_int_equal(sfem_ldl_create(&def, &f.a, &ldl, &err), SFEM_OK);
            work = (double *)malloc(sfem_ldl_work_size(ldl, 9) * sizeof *work);
            for (round = 0; round < 2; ++round) {
                for (i = 0; i < 9 * n; ++i) x[i] = sin((double)i);
                sfem_ldl_solve(ldl, 1, x, work, &def.exec);
                sfem_ldl_solve(ldl, 8, x + n, work, &def.exec);
                if (threads == 1) memcpy(y, x, 9 * n * sizeof *x);
                assert_memory_equal(x, y, 9 * n * sizeof *x);
                assert_int_equal(sfem_ldl_refactor(ldl, &f.a, &err), SFEM_OK);
            }
            sfem_ldl_free(ldl);
            free(work);
        }
        free(x);
        free(y);
        block_fem_free(&f);
    }
}

typedef struct shared_solve {
    const sfem_ldl *ldl;
    double *x[8], *work[8];
} shared_solve;

static void shared_solve_task(void *data, sfem_int i)
{
    const shared_solve *s = (const shared_solve *)data;
    sfem_ldl_solve(s->ldl, 1, s->x[i], s->work[i], NULL);
}

static void many_threads_may_solve_with_one_factor(void **state)
{
    block_fem f = block_fem_create(12, 5, 5, 1);
    const size_t n = 3 * (size_t)f.n;
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_ldl *ldl = NULL;
    shared_solve s;
    int i, threads = 4;
    size_t k;
    (void)state;
    assert_int_equal(sfem_ldl_create(&def, &f.a, &ldl, NULL), SFEM_OK);
    s.ldl = ldl;
    for (i = 0; i < 8; ++i) {
        s.x[i] = (double *)malloc(n * sizeof **s.x);
        s.work[i] = (double *)malloc(sfem_ldl_work_size(ldl, 1) * sizeof **s.work);
        for (k = 0; k < n; ++k) s.x[i][k] = sin((double)k);
    }
    crew_for(8, shared_solve_task, &s, &threads);
    for (i = 0; i < 8; ++i) {
        assert_memory_equal(s.x[i], s.x[0], n * sizeof **s.x);
        free(s.work[i]);
    }
    for (i = 0; i < 8; ++i) free(s.x[i]);
    sfem_ldl_free(ldl);
    block_fem_free(&f);
}

static void the_float_copy_survives_extreme_units(void **state)
{
    static const double unit[] = {1e-150, 1e-30, 1, 1e30, 1e150};
    size_t k, i;
    (void)state;
    for (k = 0; k < 5; ++k) {
        block_fem f = block_fem_create(6, 3, 3, 1);
        const size_t n = 3 * (size_t)f.n, nnz = 9 * (size_t)f.a.row[f.n];
        sfem_ldl_def def = sfem_default_ldl_def();
        sfem_ldl *ldl = NULL;
        double *x = (double *)malloc(2 * n * sizeof *x), *b = x + n, *work;
        for (i = 0; i < nnz; ++i) f.a.val[i] *= unit[k];
        def.precision = SFEM_MIXED;
        assert_int_equal(sfem_ldl_create(&def, &f.a, &ldl, NULL), SFEM_OK);
        work = (double *)malloc(sfem_ldl_work_size(ldl, 1) * sizeof *work);
        for (i = 0; i < n; ++i) x[i] = b[i] = 1e-100 * cos((double)i);
        sfem_ldl_solve(ldl, 1, x, work, NULL);
        for (i = 0; i < nnz; ++i) f.a.val[i] /= unit[k];
        for (i = 0; i < n; ++i) {
            x[i] *= unit[k] * 1e100;
            b[i] *= 1e100;
        }
        assert_true(backward_error(&f.a, x, b) < 1e-6);
        sfem_ldl_free(ldl);
        free(x);
        free(work);
        block_fem_free(&f);
    }
}

/* Meshes that nobody made for this library: only where a directory of them is given. */
/* The plain .veg of some meshes, no more: what the library does not read itself. */
static sfem_mesh read_veg(const char *path)
{
    FILE *file = fopen(path, "r");
    sfem_int per, id;
    sfem_mesh m;
    char line[512];
    int part = 0;
    memset(&m, 0, sizeof m);
    assert_non_null(file);
    while (fgets(line, sizeof line, file)) {
        int a, b, c, g;
        double p, q, r;
        if (!strncmp(line, "*VERTICES", 9)) {
            part = 1;
            if (fscanf(file, "%d %d", &m.nodes, &per) != 2) m.nodes = 0;
            m.x = (double *)calloc((size_t)m.nodes * 3 + 3, sizeof *m.x);
        } else if (!strncmp(line, "*ELEMENTS", 9)) {
            part = 2;
            if (!fgets(line, sizeof line, file) || fscanf(file, "%d %d", &m.tets, &per) != 2)
                m.tets = 0;
            m.tet = (sfem_int *)calloc((size_t)m.tets * 4 + 4, sizeof *m.tet);
        } else if (line[0] == '*')
            part = 0;
        else if (part == 1 && sscanf(line, "%d%*[ ,]%lf%*[ ,]%lf%*[ ,]%lf", &id, &p, &q, &r) == 4) {
            m.x[3 * id - 3] = p;
            m.x[3 * id - 2] = q;
            m.x[3 * id - 1] = r;
        } else if (part == 2 &&
                   sscanf(line, "%d%*[ ,]%d%*[ ,]%d%*[ ,]%d%*[ ,]%d", &id, &a, &b, &c, &g) == 5) {
            m.tet[4 * id - 4] = a - 1;
            m.tet[4 * id - 3] = b - 1;
            m.tet[4 * id - 2] = c - 1;
            m.tet[4 * id - 1] = g - 1;
        }
    }
    fclose(file);
    return m;
}

static void solve_mesh(const char *name, const sfem_mesh *m)
{
    unsigned char *clamp = (unsigned char *)malloc((size_t)m->nodes + 1);
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_ldl_info best, amd;
    block_fem f;
    sfem_int i;
    memset(clamp, 1, (size_t)m->nodes + 1); /* nodes of no tet are left out */
    for (i = 0; i < 4 * m->tets; ++i) clamp[m->tet[i]] = 0;
    f = block_fem_assemble(m->nodes, m->x, m->tets, m->tet, clamp, 1e6, .45, 1000, 1. / 14400, 1);
    def.x = f.x;
    if (!(solve_error(&def, &f.a, 1, &best) < 1e-14)) fail_msg("%s", name);
    def.ordering = SFEM_ORDER_AMD;
    if (!(solve_error(&def, &f.a, 8, &amd) < 1e-14)) fail_msg("%s", name);
    assert_true(best.flops <= 1.5 * amd.flops);
    def.precision = SFEM_MIXED;
    if (!(solve_error(&def, &f.a, 1, NULL) < 1e-4)) fail_msg("%s", name);
    block_fem_free(&f);
    free(clamp);
}

static void given_meshes_are_solved(void **state)
{
    const char *folder = getenv("SFEM_MESHES");
    DIR *d = folder ? opendir(folder) : NULL;
    struct dirent *e;
    int solved = 0;
    (void)state;
    if (!d) skip();
    while ((e = readdir(d)) != NULL) {
        const size_t length = strlen(e->d_name);
        char path[1024];
        sfem_mesh m;
        snprintf(path, sizeof path, "%s/%s", folder, e->d_name);
        if (length > 4 && !strcmp(e->d_name + length - 4, ".veg")) {
            m = read_veg(path);
            solve_mesh(e->d_name, &m);
            free(m.x);
            free(m.tet);
        } else if (!sfem_mesh_read(path, NULL, &m, NULL)) {
            solve_mesh(e->d_name, &m);
            sfem_mesh_free(&m);
        } else {
            continue;
        }
        ++solved;
    }
    closedir(d);
    assert_true(solved > 0);
}

/* --- dense ----------------------------------------------------------------------------------- */

static void dense_factors_solve_and_count(void **state)
{
    size_t n, i, j;
    (void)state;
    for (n = 1; n <= 60; n += 1 + n / 8) {
        double *a = (double *)calloc(n * n, sizeof *a), *l = (double *)malloc(n * n * sizeof *l);
        double *b = (double *)malloc(4 * n * sizeof *b), *x = b + 2 * n;
        sfem_int negative = -1, wanted = 0;
        uint32_t seed = (uint32_t)n;
        int kind;
        for (kind = 0; kind < 2; ++kind) {
            double bound = 0;
            for (wanted = 0, i = 0; i < n; ++i) {
                for (j = 0; j < i; ++j) a[i + j * n] = a[j + i * n] = noise(&seed) / (double)n;
                a[i + i * n] = kind && i % 3 == 1 ? -2 : 2;
                wanted += a[i + i * n] < 0;
            }
            memcpy(l, a, n * n * sizeof *l);
            for (i = 0; i < 2 * n; ++i) x[i] = b[i] = noise(&seed);
            if (kind == 0) {
                assert_int_equal(sfem_dense_cholesky((sfem_int)n, l, NULL), SFEM_OK);
                sfem_dense_cholesky_solve((sfem_int)n, l, 2, x);
            } else {
                assert_int_equal(sfem_dense_ldl((sfem_int)n, l, &negative, NULL), SFEM_OK);
                assert_int_equal(negative, wanted);
                sfem_dense_ldl_solve((sfem_int)n, l, 2, x);
            }
            for (i = 0; i < 2 * n; ++i) {
                double r = b[i];
                for (j = 0; j < n; ++j) r -= a[i % n + j * n] * x[i / n * n + j];
                if (fabs(r) > bound) bound = fabs(r);
            }
            assert_true(bound < 1e-14);
        }
        free(a);
        free(l);
        free(b);
    }
}

static void dense_factors_refuse_what_they_cannot_do(void **state)
{
    double a[9] = {1, 2, 3, 2, 1, 4, 3, 4, 1}, b[9] = {0, 1, 1, 1, 0, 1, 1, 1, 0},
           c[9] = {1, 0, NAN};
    sfem_int negative = 5;
    sfem_error err;
    (void)state;
    assert_int_equal(sfem_dense_cholesky(3, a, &err), SFEM_NOT_SPD);
    assert_int_equal(sfem_dense_ldl(3, b, &negative, &err), SFEM_SINGULAR);
    assert_int_equal(negative, 5);
    c[4] = c[8] = 1;
    assert_int_equal(sfem_dense_cholesky(3, c, &err), SFEM_NOT_FINITE);
}

/* --- conjugate gradients --------------------------------------------------------------------- */

static void conjugate_gradients_report_what_they_did(void **state)
{
    block_fem f = block_fem_create(10, 4, 4, 1);
    const size_t n = 3 * (size_t)f.n;
    double *b = (double *)malloc(2 * n * sizeof *b), *x = b + n, *work;
    sfem_cg_def def = sfem_default_cg_def();
    sfem_ldl_def how = sfem_default_ldl_def();
    sfem_ldl *ldl = NULL;
    sfem_cg_info info;
    sfem_error err;
    size_t i;
    int kind;
    (void)state;
    for (kind = 0; kind < 3; ++kind) { /* Jacobi, the float factor, the double factor */
        if (kind) {
            how.precision = kind == 1 ? SFEM_MIXED : SFEM_DOUBLE;
            assert_int_equal(sfem_ldl_create(&how, &f.a, &ldl, &err), SFEM_OK);
        }
        def.preconditioner = ldl;
        def.tolerance = 1e-11;
        work = (double *)malloc(sfem_cg_work_size(&def, &f.a) * sizeof *work);
        for (i = 0; i < n; ++i) {
            b[i] = sin((double)i);
            x[i] = 0;
        }
        assert_int_equal(sfem_cg_solve(&def, &f.a, b, x, work, &info, &err), SFEM_OK);
        assert_true(info.converged && info.residual <= 1e-11);
        assert_true(backward_error(&f.a, x, b) < 1e-11);
        assert_in_range(info.iterations, 1, kind == 0 ? 400 : kind == 1 ? 4 : 2);
        assert_int_equal(sfem_cg_solve(&def, &f.a, b, x, work, &info, &err),
                         SFEM_OK); /* from there */
        assert_int_equal(info.iterations, 0);
        free(work);
        sfem_ldl_free(ldl);
        ldl = NULL;
    }
    def.preconditioner = NULL;
    work = (double *)malloc(sfem_cg_work_size(&def, &f.a) * sizeof *work);
    def.max_iterations = 3;
    memset(x, 0, n * sizeof *x);
    assert_int_equal(sfem_cg_solve(&def, &f.a, b, x, work, &info, &err), SFEM_NOT_CONVERGED);
    assert_true(!info.converged && info.iterations == 3 && info.residual > 1e-11 &&
                info.residual < 1);
    b[4] = NAN;
    assert_int_equal(sfem_cg_solve(&def, &f.a, b, x, work, &info, &err), SFEM_NOT_FINITE);
    b[4] = 1;
    f.a.val[9 * (f.a.row[31] - 1) + 4] = -1;
    assert_int_equal(sfem_cg_solve(&def, &f.a, b, x, work, &info, &err), SFEM_NOT_SPD);
    assert_int_equal(err.node, 30);
    memset(b, 0, n * sizeof *b); /* no load: x = 0 at once */
    memset(x, 0, n * sizeof *x);
    f.a.val[9 * (f.a.row[31] - 1) + 4] = 1e6;
    assert_int_equal(sfem_cg_solve(&def, &f.a, b, x, work, &info, &err), SFEM_OK);
    assert_true(info.converged && info.iterations == 0);
    free(b);
    free(work);
    block_fem_free(&f);
}

static void conjugate_gradients_give_the_same_bits_for_any_threads(void **state)
{
    block_fem f = block_fem_create(20, 8, 8, 1);
    const size_t n = 3 * (size_t)f.n;
    double *b = (double *)malloc(3 * n * sizeof *b), *x = b + n, *y = x + n, *work;
    sfem_cg_def def = sfem_default_cg_def();
    sfem_matrix_upper upper;
    int threads;
    size_t i;
    (void)state;
    assert_int_equal(sfem_matrix_upper_create(&f.a, NULL, &upper, NULL), SFEM_OK);
    f.a.upper = &upper;
    work = (double *)malloc(sfem_cg_work_size(&def, &f.a) * sizeof *work);
    for (threads = 1; threads <= 4; threads *= 2) {
        for (i = 0; i < n; ++i) {
            b[i] = sin((double)i);
            x[i] = 0;
        }
        def.exec.threads = threads;
        def.exec.parallel_for = crew_for;
        def.exec.user = &threads;
        assert_int_equal(sfem_cg_solve(&def, &f.a, b, x, work, NULL, NULL), SFEM_OK);
        if (threads == 1) memcpy(y, x, n * sizeof *x);
        assert_memory_equal(x, y, n * sizeof *x);
    }
    sfem_matrix_upper_free(&upper);
    free(b);
    free(work);
    block_fem_free(&f);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_matrix_adds_its_blocks_and_keeps_the_lower_half),
        cmocka_unit_test(products_agree_with_the_dense_and_csr_forms),
        cmocka_unit_test(wrong_matrices_are_refused_by_name),
        cmocka_unit_test(random_definite_matrices_are_solved_to_rounding),
        cmocka_unit_test(quasi_definite_matrices_give_their_inertia),
        cmocka_unit_test(inertia_counts_eigenvalues_below_a_shift),
        cmocka_unit_test(indefinite_matrices_that_need_pivoting_are_refused),
        cmocka_unit_test(graphs_of_every_shape_are_solved),
        cmocka_unit_test(a_star_is_ordered_from_its_tips),
        cmocka_unit_test(the_empty_matrix_is_allowed),
        cmocka_unit_test(blocks_of_tets_are_solved_with_every_ordering),
        cmocka_unit_test(dissection_beats_minimum_degree_on_large_blocks),
        cmocka_unit_test(dissection_does_not_depend_on_the_unit_of_length),
        cmocka_unit_test(the_solution_does_not_depend_on_the_numbering),
        cmocka_unit_test(slivers_leave_a_small_backward_error),
        cmocka_unit_test(squashed_cells_leave_a_small_backward_error),
        cmocka_unit_test(lost_pivots_name_their_node),
        cmocka_unit_test(a_free_body_without_mass_is_refused),
        cmocka_unit_test(refactoring_gives_the_bits_of_a_new_factor_and_allocates_nothing),
        cmocka_unit_test(a_partial_refactorisation_has_the_bits_of_a_full_one),
        cmocka_unit_test(factors_that_share_an_analysis_may_be_freed_in_any_order),
        cmocka_unit_test(every_failing_allocation_is_survived),
        cmocka_unit_test(any_number_of_threads_gives_the_same_bits),
        cmocka_unit_test(many_threads_may_solve_with_one_factor),
        cmocka_unit_test(the_float_copy_survives_extreme_units),
        cmocka_unit_test(given_meshes_are_solved),
        cmocka_unit_test(dense_factors_solve_and_count),
        cmocka_unit_test(dense_factors_refuse_what_they_cannot_do),
        cmocka_unit_test(conjugate_gradients_report_what_they_did),
        cmocka_unit_test(conjugate_gradients_give_the_same_bits_for_any_threads),
    };
    const char *filter = getenv("SFEM_FILTER");
    if (filter && *filter) cmocka_set_test_filter(filter);
    return cmocka_run_group_tests(tests, NULL, NULL);
}
