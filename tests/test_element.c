/* Materials and tets: rotations, stresses, tangents, edge lengths, forces of a model. */
#define SFEM_STATIC
#define SFEM_MINIMAL
#define SFEM_ENABLE_MODEL
#define SOFTFEM_IMPLEMENTATION
#include "support.h"
#include "linear.h"
#include "blocks.h"

#define LAWS 4
static const sfem_law laws[LAWS] = {SFEM_LINEAR, SFEM_COROTATIONAL, SFEM_STVK, SFEM_NEOHOOKEAN};
static const sfem_real lambda = 3.0, mu = 1.5; /* nu = 1/3 */

/* --------------------------------------------------------------------------------------------
 * matrices, and the states F that are tried
 * -------------------------------------------------------------------------------------------- */

static void multiply(const double *a, const double *b, double *c)
{
    int i, j;
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j)
            c[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
}

static void transpose(const double *a, double *t)
{
    int i;
    for (i = 0; i < 9; ++i) t[3 * (i % 3) + i / 3] = a[i];
}

static double determinant(const double *a)
{
    return a[0] * (a[4] * a[8] - a[5] * a[7]) - a[1] * (a[3] * a[8] - a[5] * a[6]) +
           a[2] * (a[3] * a[7] - a[4] * a[6]);
}

static double norm(const double *a, int n)
{
    double sum = 0, size = 0;
    int i;
    for (i = 0; i < n; ++i) size = fmax(size, fabs(a[i]));
    if (size == 0) return 0;
    for (i = 0; i < n; ++i) sum += a[i] / size * (a[i] / size);
    return size * sqrt(sum);
}

static void random_rotation(test_random *r, double q[9]) /* of a random unit quaternion */
{
    double a[4], n = 0;
    int i;
    for (i = 0; i < 4; ++i) a[i] = random_normal(r), n += a[i] * a[i];
    for (i = 0; i < 4; ++i) a[i] /= sqrt(n);
    q[0] = 1 - 2 * (a[2] * a[2] + a[3] * a[3]);
    q[4] = 1 - 2 * (a[1] * a[1] + a[3] * a[3]);
    q[8] = 1 - 2 * (a[1] * a[1] + a[2] * a[2]);
    q[1] = 2 * (a[1] * a[2] - a[0] * a[3]), q[3] = 2 * (a[1] * a[2] + a[0] * a[3]);
    q[2] = 2 * (a[1] * a[3] + a[0] * a[2]), q[6] = 2 * (a[1] * a[3] - a[0] * a[2]);
    q[5] = 2 * (a[2] * a[3] - a[0] * a[1]), q[7] = 2 * (a[2] * a[3] + a[0] * a[1]);
}

/* F = U diag(s) V^T with random rotations */
static void random_with(test_random *r, double s0, double s1, double s2, double f[9])
{
    double u[9], v[9], vt[9];
    int i;
    random_rotation(r, u);
    random_rotation(r, v);
    transpose(v, vt);
    for (i = 0; i < 3; ++i) vt[i] *= s0, vt[3 + i] *= s1, vt[6 + i] *= s2;
    multiply(u, vt, f);
}

enum { ORDINARY, STRETCHED, FLAT, INVERTED, STATES };

/* singular values that keep s1 + s2 above .2, off the corotational pole */
static void random_state(test_random *r, int state, double f[9])
{
    const double a = random_uniform(r, 0.6, 1.6), b = random_uniform(r, 0.6, 1.6);
    switch (state) {
    case ORDINARY:
        random_with(r, a, b, random_uniform(r, 0.5, 1.6), f);
        break;
    case STRETCHED:
        random_with(r, 3 * a, b, random_uniform(r, 0.1, 0.5), f);
        break;
    case FLAT:
        random_with(r, a, b, 0, f);
        break;
    default:
        random_with(r, a, b, -random_uniform(r, 0.05, 0.4), f);
    }
}

/* d/dt of a function at t = 0 from four values, error O(h^4) */
#define H 1e-3
static double derivative(const double at[4]) /* t = -2h, -h, h, 2h */
{
    return (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * H);
}
static const double offset[4] = {-2 * H, -H, H, 2 * H};

/* --------------------------------------------------------------------------------------------
 * rotations
 * -------------------------------------------------------------------------------------------- */

static void check_polar(const double f[9])
{
    const double size = norm(f, 9);
    double r[9], s[9], t[9], rtr[9], rtf[9], rs[9];
    int i;
    sfem_polar(f, r, s);
    transpose(r, t);
    multiply(t, r, rtr);
    for (i = 0; i < 9; ++i) assert_near(rtr[i], i % 4 == 0, 0, 1e-13);
    assert_near(determinant(r), 1, 0, 1e-13);
    multiply(t, f, rtf);
    for (i = 0; i < 9; ++i) {
        rtf[i] = size > 0 ? rtf[i] / size : 0;
        s[i] = size > 0 ? s[i] / size : 0;
    }
    assert_near(rtf[1], rtf[3], 0, 1e-13);
    assert_near(rtf[2], rtf[6], 0, 1e-13);
    assert_near(rtf[5], rtf[7], 0, 1e-13);
    multiply(r, s, rs);
    for (i = 0; i < 9; ++i) assert_near(rs[i], size > 0 ? f[i] / size : 0, 0, 1e-13);
    /* nearest: tr S is the sum of the singular values, the last one signed */
    {
        double u[9], v[9], w[3];
        sfem_signed_svd(f, u, w, v);
        if (size > 0) assert_near(s[0] + s[4] + s[8], (w[0] + w[1] + w[2]) / size, 0, 1e-13);
    }
}

static void polar_holds_on_any_matrix(void **state)
{
    static const double fixed[][9] = {{0, 0, 0, 0, 0, 0, 0, 0, 0},
                                      {1, 0, 0, 0, 1, 0, 0, 0, 1},
                                      {-1, 0, 0, 0, 1, 0, 0, 0, 1},
                                      {-1, 0, 0, 0, -1, 0, 0, 0, -1},
                                      {1, 0, 0, 0, 0, 0, 0, 0, 0},
                                      {0, 0, 0, 0, 0, 0, 0, 0, -1},
                                      {1, 1, 1, 1, 1, 1, 1, 1, 1},
                                      {0, 1, 0, 0, 0, 1, 1, 0, 0},
                                      {1, 0, 0, 0, 1, 0, 0, 0, 0},
                                      {1, 0, 0, 0, 1, 0, 0, 0, -1},
                                      {1, 0, 0, 0, .3, 0, 0, 0, -.3},
                                      {1, 0, 0, 0, 1e-9, 0, 0, 0, -1e-9},
                                      {1, 0, 0, 0, 1e-300, 0, 0, 0, 1},
                                      {1e200, 0, 0, 0, 1e-200, 0, 0, 0, 1},
                                      {1e-320, 0, 0, 0, 1e-320, 0, 0, 0, 1e-320}};
    static const double scales[] = {1e-280, 1e-160, 1e-20, 1, 1e20, 1e160, 1e300};
    test_random r = {1};
    double f[9];
    size_t k, m;
    int i, n;
    (void)state;
    for (k = 0; k < TEST_COUNT(fixed); ++k) check_polar(fixed[k]);
    for (m = 0; m < TEST_COUNT(scales); ++m)
        for (n = 0; n < 2000; ++n) {
            const double a = pow(10, -random_uniform(&r, 0, 18)), b = random_uniform(&r, 0, 1);
            switch (n % 8) {
            case 0:
                random_with(&r, 1, 1 - 0.1 * b, 1 + 0.1 * b, f);
                break;
            case 1:
                random_with(&r, 1, b, 0, f);
                break;
            case 2:
                random_with(&r, 1, b, -a, f);
                break;
            case 3:
                random_with(&r, 1, a, -a, f);
                break; /* undetermined */
            case 4:
                random_with(&r, 1, a, a * b, f);
                break;
            case 5:
                random_with(&r, 1, 0, 0, f);
                break;
            case 6:
                random_with(&r, 1, 1, -1, f);
                break;
            default:
                random_fill(&r, f, 9, -1, 1);
            }
            for (i = 0; i < 9; ++i) f[i] *= scales[m];
            check_polar(f);
        }
}

static void polar_of_nothing_is_no_rotation(void **state)
{
    static const double zero[9] = {0}, needle[9] = {0, 0, 0, 0, 0, 0, 0, 0, 2};
    double r[9];
    int i;
    (void)state;
    sfem_polar(zero, r, NULL);
    for (i = 0; i < 9; ++i) assert_near(r[i], i % 4 == 0, 0, 0);
    sfem_polar(needle, r, NULL);
    for (i = 0; i < 9; ++i) assert_near(r[i], i % 4 == 0, 0, 1e-15);
}

static void polar_may_overwrite_its_argument(void **state)
{
    test_random r = {3};
    double f[9], g[9], s[9], rotation[9];
    (void)state;
    random_state(&r, ORDINARY, f);
    memcpy(g, f, sizeof g);
    sfem_polar(f, rotation, s);
    sfem_polar(g, g, NULL);
    assert_all_near(g, rotation, 9, 0, 0);
}

static void svd_keeps_small_singular_values(void **state)
{
    test_random r = {5};
    double f[9], u[9], v[9], s[3], product[9], vt[9], t[9];
    int n, i;
    (void)state;
    for (n = 0; n < 3000; ++n) {
        const double small = pow(10, -random_uniform(&r, 1, 30)), sign = n % 2 ? -1 : 1;
        random_with(&r, 1, 0.8, 0.5 * sign, f); /* columns of any length, at healthy angles */
        for (i = 0; i < 9; i += 3) f[i + 1] *= 0.3, f[i + 2] *= small;
        sfem_signed_svd(f, u, s, v);
        assert_near(s[0] * s[1] * s[2], 0.4 * 0.3 * sign * small, 1e-13, 0);
        assert_near(determinant(u), 1, 0, 1e-14);
        assert_near(determinant(v), 1, 0, 1e-14);
        assert_true(s[0] >= s[1] && s[1] >= fabs(s[2]));
        transpose(v, vt);
        for (i = 0; i < 9; ++i) vt[i] *= s[i / 3];
        multiply(u, vt, product);
        assert_all_near(product, f, 9, 1e-14, 0);
        transpose(u, t);
        multiply(t, u, product);
        for (i = 0; i < 9; ++i) assert_near(product[i], i % 4 == 0, 0, 1e-14);
    }
}

/* --------------------------------------------------------------------------------------------
 * laws
 * -------------------------------------------------------------------------------------------- */

static void stress_is_the_gradient_of_energy(void **state)
{
    test_random r = {7};
    double f[9], g[9], p[9], d[9], at[4];
    int law, kind, n, i, k;
    (void)state;
    for (law = 0; law < LAWS; ++law)
        for (kind = 0; kind < STATES; ++kind)
            for (n = 0; n < 100; ++n) {
                random_state(&r, kind, f);
                sfem_law_stress(laws[law], lambda, mu, f, p);
                for (i = 0; i < 9; ++i) {
                    for (k = 0; k < 4; ++k) {
                        memcpy(g, f, sizeof g);
                        g[i] += offset[k];
                        at[k] = sfem_law_energy(laws[law], lambda, mu, g);
                    }
                    d[i] = derivative(at);
                }
                assert_all_near(p, d, 9, 1e-8, 1e-9);
            }
}

static void tangent_is_the_derivative_of_stress(void **state)
{
    test_random r = {9};
    double f[9], g[9], p[4][9], tangent[81], d[9], at[4], column[9];
    int law, kind, n, i, k, a;
    (void)state;
    for (law = 0; law < LAWS; ++law)
        for (kind = 0; kind < STATES; ++kind)
            for (n = 0; n < 50; ++n) {
                random_state(&r, kind, f);
                sfem_law_tangent(laws[law], lambda, mu, f, SFEM_TANGENT_EXACT, tangent);
                for (i = 0; i < 9; ++i) {
                    for (k = 0; k < 4; ++k) {
                        memcpy(g, f, sizeof g);
                        g[i] += offset[k];
                        sfem_law_stress(laws[law], lambda, mu, g, p[k]);
                    }
                    for (a = 0; a < 9; ++a) {
                        for (k = 0; k < 4; ++k) at[k] = p[k][a];
                        d[a] = derivative(at);
                        column[a] = tangent[9 * a + i];
                    }
                    assert_all_near(column, d, 9, 1e-6, 1e-6 * mu);
                }
            }
}

static void rotations_do_not_change_energy(void **state)
{
    test_random r = {11};
    double f[9], q[9], qf[9], fq[9], p[9], pq[9], qp[9];
    int law, kind, n;
    (void)state;
    for (law = 1; law < LAWS; ++law)
        for (kind = 0; kind < STATES; ++kind)
            for (n = 0; n < 300; ++n) {
                double energy;
                random_state(&r, kind, f);
                random_rotation(&r, q);
                multiply(q, f, qf);
                multiply(f, q, fq);
                energy = sfem_law_stress(laws[law], lambda, mu, f, p);
                assert_near(sfem_law_stress(laws[law], lambda, mu, qf, pq), energy, 1e-12, 1e-13);
                multiply(q, p, qp);
                assert_all_near(pq, qp, 9, 1e-12, 1e-12);
                assert_near(sfem_law_energy(laws[law], lambda, mu, fq), energy, 1e-12, 1e-13);
            }
}

static void all_laws_are_hooke_for_small_strains(void **state)
{
    const double eps = 1e-6;
    test_random r = {13};
    double g[9], f[9], q[9], qf[9], p[9], hooke[9], qh[9];
    int law, n, i, j;
    (void)state;
    for (law = 0; law < LAWS; ++law)
        for (n = 0; n < 200; ++n) {
            const double l = random_uniform(&r, -0.4, 20) * mu;
            double energy = 0, trace, hooke_energy = 0;
            random_fill(&r, g, 9, -eps, eps);
            trace = g[0] + g[4] + g[8];
            for (i = 0; i < 3; ++i)
                for (j = 0; j < 3; ++j) {
                    hooke[3 * i + j] =
                        mu * (g[3 * i + j] + g[3 * j + i]) + (i == j ? l * trace : 0);
                    f[3 * i + j] = g[3 * i + j] + (i == j);
                    hooke_energy += hooke[3 * i + j] * g[3 * i + j] / 2;
                }
            energy = sfem_law_stress(laws[law], l, mu, f, p);
            /* the next order is eps^2; F itself is rounded to 1e-16 */
            assert_all_near(p, hooke, 9, 0, 20 * (l + 2 * mu) * eps * eps + 1e-15 * (l + 2 * mu));
            assert_near(energy, hooke_energy, 0, 100 * (l + 2 * mu) * eps * eps * eps);
            if (law == 0) continue;
            random_rotation(&r, q); /* and in a turned body, but for the rounding of F */
            multiply(q, f, qf);
            sfem_law_stress(laws[law], l, mu, qf, p);
            multiply(q, hooke, qh);
            assert_all_near(p, qh, 9, 0, 20 * (l + 2 * mu) * eps * eps + 1e-14 * (l + 2 * mu));
        }
}

static void energy_is_least_at_rest(void **state)
{
    static const double identity[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    static const double poisson[] = {-0.9, -0.3, 0, 0.3, 0.45, 0.499};
    test_random r = {15};
    double f[9], p[9];
    int law, n, i;
    size_t k;
    (void)state;
    for (law = 0; law < LAWS; ++law)
        for (k = 0; k < TEST_COUNT(poisson); ++k) {
            sfem_real l, m;
            sfem_law_lame(1, poisson[k], &l, &m);
            assert_near(sfem_law_stress(laws[law], l, m, identity, p), 0, 0, 0);
            for (i = 0; i < 9; ++i) assert_near(p[i], 0, 0, 1e-15 * (fabs(l) + m));
            for (n = 0; n < 5000; ++n) {
                const double scale = pow(10, random_uniform(&r, -8, 1));
                random_fill(&r, f, 9, -scale, scale);
                for (i = 0; i < 9; i += 4) f[i] += n % 2;
                assert_true(sfem_law_energy(laws[law], l, m, f) >= 0);
            }
        }
}

static void stvk_is_weak_in_compression_and_blind_to_mirrors(void **state)
{
    double f[9] = {1, 0, 0, 0, 1, 0, 0, 0, -1}, p[9], before = 0;
    int i;
    (void)state;
    assert_near(sfem_law_energy(SFEM_STVK, lambda, mu, f), 0, 0, 0);
    assert_true(sfem_law_energy(SFEM_COROTATIONAL, lambda, mu, f) > mu);
    assert_true(sfem_law_energy(SFEM_NEOHOOKEAN, lambda, mu, f) > mu);
    f[8] = 1;
    for (i = 99; i >= 0;
         --i) { /* nu = 0: the push grows down to 1/sqrt 3 of the length, no further */
        f[0] = i / 100.0;
        sfem_law_stress(SFEM_STVK, 0, mu, f, p);
        if (i >= 58) assert_true(-p[0] > before);
        if (i < 57) assert_true(-p[0] < before);
        before = -p[0];
    }
    assert_near(before, 0, 0, 0);
}

/* --------------------------------------------------------------------------------------------
 * projected tangents
 * -------------------------------------------------------------------------------------------- */

/* least eigenvalue of a symmetric matrix [n][n]: Jacobi, largest entry first */
static double least_eigenvalue(const double *matrix, int n)
{
    double a[144], least;
    int i, j, p, q, turn;
    memcpy(a, matrix, (size_t)(n * n) * sizeof *a);
    for (turn = 0; turn < 5000; ++turn) {
        double c, s, angle;
        for (p = 0, q = 1, i = 0; i < n; ++i)
            for (j = i + 1; j < n; ++j)
                if (fabs(a[n * i + j]) > fabs(a[n * p + q])) p = i, q = j;
        if (fabs(a[n * p + q]) < 1e-15 * norm(a, n * n)) break;
        angle = 0.5 * atan2(2 * a[n * p + q], a[n * p + p] - a[n * q + q]);
        c = cos(angle), s = sin(angle);
        for (i = 0; i < n; ++i) {
            const double x = a[n * p + i], y = a[n * q + i];
            a[n * p + i] = c * x + s * y;
            a[n * q + i] = -s * x + c * y;
        }
        for (i = 0; i < n; ++i) {
            const double x = a[n * i + p], y = a[n * i + q];
            a[n * i + p] = c * x + s * y;
            a[n * i + q] = -s * x + c * y;
        }
    }
    for (i = 1, least = a[0]; i < n; ++i) least = fmin(least, a[(n + 1) * i]);
    return least;
}

static void projected_tangent_is_the_nearest_semidefinite_one(void **state)
{
    test_random r = {17};
    double f[9], exact[81], psd[81], change[81];
    int law, kind, n, i, j, indefinite[LAWS] = {0};
    (void)state;
    for (law = 0; law < LAWS; ++law)
        for (kind = 0; kind < STATES; ++kind)
            for (n = 0; n < 60; ++n) {
                double size, along = 0;
                random_state(&r, kind, f);
                sfem_law_tangent(laws[law], lambda, mu, f, SFEM_TANGENT_EXACT, exact);
                sfem_law_tangent(laws[law], lambda, mu, f, SFEM_TANGENT_PSD, psd);
                size = norm(exact, 81);
                for (i = 0; i < 9; ++i)
                    for (j = 0; j < i; ++j) {
                        assert_near(exact[9 * i + j], exact[9 * j + i], 0, 1e-13 * size);
                        assert_near(psd[9 * i + j], psd[9 * j + i], 0, 1e-13 * size);
                    }
                assert_true(least_eigenvalue(psd, 9) >= -1e-12 * size);
                /* the nearest X >= 0 of A has X - A >= 0 and <X - A, X> = 0 */
                for (i = 0; i < 81; ++i) {
                    change[i] = psd[i] - exact[i];
                    along += change[i] * psd[i];
                }
                assert_true(least_eigenvalue(change, 9) >= -1e-12 * size);
                assert_near(along, 0, 0, 1e-12 * size * size);
                if (least_eigenvalue(exact, 9) < -1e-10 * size)
                    ++indefinite[law];
                else
                    assert_all_near(psd, exact, 81, 1e-10, 0);
            }
    assert_int_equal(indefinite[0], 0);
    for (law = 1; law < LAWS; ++law) assert_true(indefinite[law] > 10);
}

static void frozen_tangent_turns_hooke_with_the_tet(void **state)
{
    test_random r = {19};
    double f[9], frozen[81], rotation[9], t[9], df[9], local[9], hooke[9], want[9], got[9], trace;
    int kind, n, i, j;
    (void)state;
    for (kind = 0; kind < STATES; ++kind)
        for (n = 0; n < 100; ++n) {
            random_state(&r, kind, f);
            random_fill(&r, df, 9, -1, 1);
            sfem_polar(f, rotation, NULL);
            transpose(rotation, t);
            multiply(t, df, local);
            trace = local[0] + local[4] + local[8];
            for (i = 0; i < 3; ++i)
                for (j = 0; j < 3; ++j)
                    hooke[3 * i + j] =
                        mu * (local[3 * i + j] + local[3 * j + i]) + (i == j ? lambda * trace : 0);
            multiply(rotation, hooke, want);
            sfem_law_tangent(SFEM_COROTATIONAL, lambda, mu, f, SFEM_TANGENT_FROZEN, frozen);
            for (i = 0; i < 9; ++i)
                for (j = 0, got[i] = 0; j < 9; ++j) got[i] += frozen[9 * i + j] * df[j];
            assert_all_near(got, want, 9, 1e-12, 1e-12);
        }
}

static void degenerate_states_give_finite_numbers(void **state)
{
    static const double fixed[][9] = {
        {0, 0, 0, 0, 0, 0, 0, 0, 0},   {1, 0, 0, 0, 0, 0, 0, 0, 0},
        {1, 0, 0, 0, 1, 0, 0, 0, -1},  {-1, 0, 0, 0, -1, 0, 0, 0, -1},
        {1, 1, 1, 1, 1, 1, 1, 1, 1},   {9, 0, 0, 0, 1, 0, 0, 0, -1},
        {1e8, 0, 0, 0, 0, 0, 0, 0, 0}, {1e-9, 0, 0, 0, 1e-9, 0, 0, 0, -1e-9}};
    double p[9], tangent[81];
    size_t k;
    int law, kind, i;
    (void)state;
    for (law = 0; law < LAWS; ++law)
        for (k = 0; k < TEST_COUNT(fixed); ++k) {
            assert_true(isfinite(sfem_law_stress(laws[law], lambda, mu, fixed[k], p)));
            for (i = 0; i < 9; ++i) assert_true(isfinite(p[i]));
            for (kind = SFEM_TANGENT_EXACT; kind <= SFEM_TANGENT_FROZEN; ++kind) {
                sfem_law_tangent(laws[law], lambda, mu, fixed[k], (sfem_tangent)kind, tangent);
                for (i = 0; i < 81; ++i) assert_true(isfinite(tangent[i]));
                if (kind != SFEM_TANGENT_EXACT)
                    assert_true(least_eigenvalue(tangent, 9) >= -1e-10 * norm(tangent, 81));
            }
        }
}

/* --------------------------------------------------------------------------------------------
 * one tet
 * -------------------------------------------------------------------------------------------- */

static void random_tet(test_random *r, double x[12])
{
    static const double corner[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
    int i;
    for (i = 0; i < 12; ++i) x[i] = corner[i] + random_uniform(r, -0.2, 0.2);
}

/* displacements that give the tet this F, and a translation */
static void displace(test_random *r, const double x[12], const double f[9], double u[12])
{
    double shift[3];
    int a, i;
    random_fill(r, shift, 3, -5, 5);
    for (a = 0; a < 4; ++a)
        for (i = 0; i < 3; ++i)
            u[3 * a + i] = f[3 * i] * x[3 * a] + f[3 * i + 1] * x[3 * a + 1] +
                           f[3 * i + 2] * x[3 * a + 2] - x[3 * a + i] + shift[i];
}

static void tet_stiffness_is_the_derivative_of_its_forces(void **state)
{
    test_random r = {21};
    double x[12], u[12], v[12], f[9], force[12], k[144], side[4][12], at[4], d[12], column[12],
        none[144];
    int law, kind, n, i, j, a;
    (void)state;
    for (law = 0; law < LAWS; ++law)
        for (kind = 0; kind < STATES; ++kind)
            for (n = 0; n < 20; ++n) {
                random_tet(&r, x);
                random_state(&r, kind, f);
                displace(&r, x, f, u);
                sfem_law_tet(laws[law], lambda, mu, x, u, SFEM_TANGENT_EXACT, force, k);
                for (i = 0; i < 12; ++i) {
                    double energy[4];
                    for (j = 0; j < 4; ++j) {
                        memcpy(v, u, sizeof v);
                        v[i] += 0.5 * offset[j];
                        energy[j] = sfem_law_tet(laws[law], lambda, mu, x, v, SFEM_TANGENT_EXACT,
                                                 side[j], NULL);
                    }
                    assert_near(force[i], 2 * derivative(energy), 1e-7, 1e-8);
                    for (a = 0; a < 12; ++a) {
                        for (j = 0; j < 4; ++j) at[j] = side[j][a];
                        d[a] = 2 * derivative(at);
                        column[a] = k[12 * a + i];
                    }
                    assert_all_near(column, d, 12, 1e-6, 1e-7);
                }
                sfem_law_tet(laws[law], lambda, mu, x, u, SFEM_TANGENT_PSD, NULL, none);
                assert_true(least_eigenvalue(none, 12) >= -1e-10 * norm(none, 144));
            }
}

static void tet_forces_carry_no_momentum(void **state)
{
    test_random r = {23};
    double x[12], u[12], f[9], force[12];
    int law, kind, n, i, a;
    (void)state;
    for (law = 0; law < LAWS; ++law)
        for (kind = 0; kind < STATES; ++kind)
            for (n = 0; n < 200; ++n) {
                double size;
                random_tet(&r, x);
                random_state(&r, kind, f);
                displace(&r, x, f, u);
                sfem_law_tet(laws[law], lambda, mu, x, u, SFEM_TANGENT_EXACT, force, NULL);
                size = norm(force, 12);
                for (i = 0; i < 3; ++i) {
                    const int j = (i + 1) % 3, k = (i + 2) % 3;
                    double sum = 0, torque = 0;
                    for (a = 0; a < 12; a += 3) {
                        sum += force[a + i];
                        torque += (x[a + j] + u[a + j] - u[j]) * force[a + k] -
                                  (x[a + k] + u[a + k] - u[k]) * force[a + j];
                    }
                    assert_near(sum, 0, 0, 1e-14 * size + 1e-300);
                    if (law) assert_near(torque, 0, 0, 1e-12 * (size + 1));
                }
            }
}

/* --------------------------------------------------------------------------------------------
 * edge lengths
 * -------------------------------------------------------------------------------------------- */

static void edge_lengths_give_the_tensor_and_its_invariants(void **state)
{
    test_random r = {25};
    double x[12], u[12], y[12], f[9], t[9], want[9], c[9], d2[6], invariants[5], fibre[3], cc[9];
    int n, i, kind;
    (void)state;
    for (n = 0; n < 1000; ++n)
        for (kind = 0; kind < STATES; ++kind) {
            sfem_edge_shape shape;
            double ca[3];
            random_tet(&r, x);
            random_state(&r, kind, f);
            displace(&r, x, f, u);
            for (i = 0; i < 12; ++i) y[i] = x[i] + u[i];
            sfem_edge_prepare(3, x, &shape);
            assert_int_equal(shape.rank, 6);
            sfem_edge_lengths2(3, y, d2);
            sfem_edge_cauchy_green(&shape, d2, c);
            transpose(f, t);
            multiply(t, f, want);
            assert_all_near(c, want, 9, 1e-11, 1e-12);
            random_fill(&r, fibre, 3, -1, 1);
            sfem_edge_invariants(&shape, d2, fibre, invariants);
            multiply(want, want, cc);
            for (i = 0; i < 3; ++i)
                ca[i] = want[3 * i] * fibre[0] + want[3 * i + 1] * fibre[1] +
                        want[3 * i + 2] * fibre[2];
            assert_near(invariants[0], want[0] + want[4] + want[8], 1e-11, 0);
            assert_near(invariants[1], cc[0] + cc[4] + cc[8], 1e-11, 0);
            assert_near(invariants[2], determinant(f) * determinant(f), 1e-10, 1e-10);
            assert_near(invariants[3], fibre[0] * ca[0] + fibre[1] * ca[1] + fibre[2] * ca[2],
                        1e-10, 1e-11);
            assert_near(invariants[4], ca[0] * ca[0] + ca[1] * ca[1] + ca[2] * ca[2], 1e-10, 1e-11);
            sfem_edge_invariants(&shape, d2, NULL, invariants);
            assert_near(invariants[3], 0, 0, 0);
        }
}

static void edge_energies_equal_the_usual_ones(void **state)
{
    static const sfem_law both[] = {SFEM_STVK, SFEM_NEOHOOKEAN};
    test_random r = {27};
    double x[12], u[12], y[12], f[9], d2[6], slope[6], force[12], want[12];
    int law, n, i;
    (void)state;
    for (law = 0; law < 2; ++law)
        for (n = 0; n < 1000; ++n) {
            sfem_edge_shape shape;
            double energy;
            random_tet(&r, x);
            random_state(&r, ORDINARY, f);
            displace(&r, x, f, u);
            for (i = 0; i < 12; ++i) y[i] = x[i] + u[i];
            sfem_edge_prepare(3, x, &shape);
            sfem_edge_lengths2(3, y, d2);
            energy = sfem_edge_energy(&shape, both[law], lambda, mu, d2, slope);
            sfem_edge_forces(&shape, y, slope, force);
            assert_near(shape.volume * energy,
                        sfem_law_tet(both[law], lambda, mu, x, u, SFEM_TANGENT_EXACT, want, NULL),
                        1e-10, 1e-11);
            assert_all_near(force, want, 12, 1e-9, 1e-10);
        }
}

static void triangles_are_in_plane_strain(void **state)
{
    static const sfem_law both[] = {SFEM_STVK, SFEM_NEOHOOKEAN};
    test_random r = {29};
    double d2[3], slope[3], force[6], c[4], invariants[5], at[4], fibre[2] = {0.6, 0.8};
    int law, n, i, k;
    (void)state;
    for (law = 0; law < 2; ++law)
        for (n = 0; n < 300; ++n) {
            double x[6] = {0, 0, 1, 0, 0, 1}, y[6], f[9] = {0, 0, 0, 0, 0, 0, 0, 0, 1};
            sfem_edge_shape shape;
            double energy;
            for (i = 0; i < 6; ++i) x[i] += random_uniform(&r, -0.2, 0.2);
            for (i = 0; i < 4; ++i)
                f[3 * (i / 2) + i % 2] = random_uniform(&r, -0.4, 0.4) + (i % 3 == 0);
            for (i = 0; i < 6; ++i)
                y[i] = f[3 * (i % 2)] * x[i & ~1] + f[3 * (i % 2) + 1] * x[i | 1] + 2;
            sfem_edge_prepare(2, x, &shape);
            assert_int_equal(shape.rank, 3);
            sfem_edge_lengths2(2, y, d2);
            sfem_edge_cauchy_green(&shape, d2, c);
            assert_near(c[0], f[0] * f[0] + f[3] * f[3], 1e-12, 1e-12);
            assert_near(c[1], f[0] * f[1] + f[3] * f[4], 1e-12, 1e-12);
            assert_near(c[3], f[1] * f[1] + f[4] * f[4], 1e-12, 1e-12);
            sfem_edge_invariants(&shape, d2, fibre, invariants);
            assert_near(invariants[2], pow(f[0] * f[4] - f[1] * f[3], 2), 1e-11, 1e-12);
            assert_near(invariants[3], 0.36 * c[0] + 0.96 * c[1] + 0.64 * c[3], 1e-12, 1e-12);
            energy = sfem_edge_energy(&shape, both[law], lambda, mu, d2, slope);
            assert_near(energy, sfem_law_energy(both[law], lambda, mu, f), 1e-11, 1e-12);
            sfem_edge_forces(&shape, y, slope, force);
            for (i = 0; i < 6; ++i) {
                for (k = 0; k < 4; ++k) {
                    double z[6];
                    memcpy(z, y, sizeof z);
                    z[i] += 0.1 * offset[k];
                    sfem_edge_lengths2(2, z, d2);
                    at[k] =
                        shape.volume * sfem_edge_energy(&shape, both[law], lambda, mu, d2, NULL);
                }
                assert_near(force[i], 10 * derivative(at), 1e-6, 1e-8);
            }
        }
}

/* A flat tet: C fits the lengths exactly where they are consistent with one, and of all that do it has
 * least norm: nothing in the directions that the edges do not see. */
static void flat_tets_have_the_tensor_of_least_norm(void **state)
{
    test_random r = {31};
    int n, i, k;
    (void)state;
    for (n = 0; n < 200; ++n) {
        double x[12], y[12], q[9], z[12], d2[6], c[9], slope[6], force[12], normal[3], cn[3];
        const double a = random_uniform(&r, 0.7, 1.4), b = random_uniform(&r, 0.7, 1.4);
        sfem_edge_shape shape;
        random_tet(&r, x);
        random_rotation(&r, q);
        for (k = 0; k < 12; k += 3) {
            x[k + 2] = 0;
            if (k == 9) x[k] = x[k + 1] = 0.9;
            for (i = 0; i < 3; ++i) {
                z[k + i] = q[3 * i] * x[k] + q[3 * i + 1] * x[k + 1];
                y[k + i] = q[3 * i] * a * x[k] + q[3 * i + 1] * b * x[k + 1];
            }
        }
        for (i = 0; i < 3; ++i) normal[i] = q[3 * i + 2];
        sfem_edge_prepare(3, z, &shape);
        assert_int_equal(shape.rank, 3);
        assert_near(shape.volume, 0, 0, 1e-15);
        sfem_edge_lengths2(3, y, d2);
        sfem_edge_cauchy_green(&shape, d2, c);
        for (i = 0; i < 3; ++i) {
            cn[i] = c[3 * i] * normal[0] + c[3 * i + 1] * normal[1] + c[3 * i + 2] * normal[2];
            assert_near(cn[i], 0, 0, 1e-12);
            for (k = 0; k < 3; ++k)
                assert_near(c[3 * i + k],
                            a * a * q[3 * i] * q[3 * k] + b * b * q[3 * i + 1] * q[3 * k + 1], 0,
                            1e-11);
        }
        assert_true(isfinite(sfem_edge_energy(&shape, SFEM_NEOHOOKEAN, lambda, mu, d2, slope)));
        sfem_edge_forces(&shape, y, slope, force);
        for (i = 0; i < 12; ++i) assert_true(isfinite(force[i]));
    }
}

static void edges_of_a_point_give_nothing(void **state)
{
    const double x[12] = {0};
    double d2[6] = {1, 1, 1, 1, 1, 1}, c[9];
    sfem_edge_shape shape;
    int i;
    (void)state;
    sfem_edge_prepare(3, x, &shape);
    assert_int_equal(shape.rank, 0);
    sfem_edge_cauchy_green(&shape, d2, c);
    for (i = 0; i < 9; ++i) assert_near(c[i], 0, 0, 0);
}

/* --------------------------------------------------------------------------------------------
 * a model
 * -------------------------------------------------------------------------------------------- */

typedef struct body {
    sfem_model *model;
    sfem_material material[LAWS];
    const sfem_mesh *mesh;
    sfem_int *tet_material;
    double *u, *force, *rotation, *work;
} body;

/* A jittered block; law < LAWS: of one law, else all four in turn. */
static body make_body_of(sfem_int nx, sfem_int ny, sfem_int nz, int law, int state, unsigned seed)
{
    const sfem_int cells[3] = {nx, ny, nz};
    const sfem_real size[3] = {0.1 * nx, 0.1 * ny, 0.1 * nz};
    sfem_model_def def = linear_model_def();
    test_random r = {seed};
    sfem_mesh mesh;
    sfem_error err;
    body b;
    double q[9];
    sfem_int i, k;
    assert_ok(block_mesh(cells, size, 0.01, &r.state, &mesh, &err), err);
    b.tet_material = (sfem_int *)calloc((size_t)mesh.tets, sizeof *b.tet_material);
    for (i = 0; i < mesh.tets; ++i) b.tet_material[i] = law < LAWS ? law : random_below(&r, LAWS);
    for (i = 0; i < LAWS; ++i) {
        b.material[i] = linear_material();
        b.material[i].young = 1000.0 * (1 + i);
        b.material[i].poisson = 0.2 + 0.08 * i;
        b.material[i].law = laws[i];
    }
    def.mesh = &mesh;
    def.materials = b.material;
    def.material_count = LAWS;
    def.tet_material = b.tet_material;
    assert_ok(sfem_model_create(&def, &b.model, &err), err);
    sfem_mesh_free(&mesh);
    b.mesh = sfem_model_mesh(b.model);
    b.u = (double *)calloc(3 * (size_t)b.mesh->nodes, sizeof(double));
    b.force = (double *)calloc(3 * (size_t)b.mesh->nodes, sizeof(double));
    b.rotation = (double *)calloc(9 * (size_t)b.mesh->tets, sizeof(double));
    b.work = (double *)calloc(sfem_model_work_size(b.model), sizeof(double));
    random_rotation(&r, q);
    for (i = 0; i < b.mesh->nodes;
         ++i) { /* turned, and moved by 3 % or, inverting, 100 % of a cell */
        const double *x = b.mesh->x + 3 * i, d = state == INVERTED ? 0.1 : 0.003;
        for (k = 0; k < 3; ++k)
            b.u[3 * i + k] = q[3 * k] * x[0] + q[3 * k + 1] * x[1] + q[3 * k + 2] * x[2] - x[k] +
                             random_uniform(&r, -d, d);
    }
    return b;
}

static void free_body(body *b)
{
    sfem_model_free(b->model);
    free(b->tet_material);
    free(b->u);
    free(b->force);
    free(b->rotation);
    free(b->work);
}

static void tet_of(const body *b, sfem_int t, double x[12], double u[12], sfem_real *l,
                   sfem_real *m, sfem_law *law)
{
    const sfem_material *material = b->material + b->tet_material[t];
    int a;
    for (a = 0; a < 4; ++a) {
        memcpy(x + 3 * a, b->mesh->x + 3 * b->mesh->tet[4 * t + a], 3 * sizeof *x);
        memcpy(u + 3 * a, b->u + 3 * b->mesh->tet[4 * t + a], 3 * sizeof *u);
    }
    sfem_law_lame(material->young, material->poisson, l, m);
    *law = material->law;
}

static void deformation(const double x[12], const double u[12], double f[9])
{
    double g[4][3];
    int i;
    sfemi_element_gradients_of(x, x + 3, x + 6, x + 9, g);
    sfemi_element_deform(u, u + 3, u + 6, u + 9, g, f);
    for (i = 0; i < 9; i += 4) f[i] += 1;
}

static void model_forces_are_the_sum_over_tets(void **state)
{
    int law, kind, path;
    (void)state;
    for (law = 0; law <= LAWS; ++law)
        for (kind = 0; kind <= INVERTED; kind += INVERTED)
            for (path = 0; path < 2; ++path) { /* 5 x 4 x 3 cells: chunks and blocks with a rest */
                body b = make_body_of(5, 4, 3, law, kind, 33);
                double *sum = (double *)calloc(3 * (size_t)b.mesh->nodes, sizeof *sum);
                double *spin = (double *)calloc(12 * (size_t)b.model->chunks.copies, sizeof *spin);
                double *spins = (double *)calloc(18 * (size_t)b.mesh->nodes, sizeof *spins);
                double stiffest = 0;
                double energy = 0, got, r[9], f[9], x[12], u[12], force[12];
                sfemi_forces ask;
                sfem_int t, inverted = 0, counted = -1;
                int a, i;
                memset(&ask, 0, sizeof ask);
                ask.u = b.u;
                ask.precision = SFEM_DOUBLE;
                ask.force = b.force;
                ask.rotation = b.rotation;
                ask.inverted = &counted;
                ask.spin = spin;
                ask.sum = spins;
                ask.work = b.work;
                if (path == 0) {
                    got = sfemi_fem_forces(b.model, b.model->chunks.block, &ask);
                } else { /* the path of processors without vectors */
                    sfemi_forces_job job = {&ask, b.model, b.model->chunks.block, b.work, NULL, NULL, NULL, 0,
                                            sfemi_blocks_d_0};
                    const sfemi_chunks *c = &b.model->chunks;
                    job.energy = b.work + 4 * c->copies;
                    job.inverted = job.energy + c->count;
                    job.moved = job.inverted + c->count;
                    for (t = 0; t * SFEMI_CHUNK_TASK < c->count; ++t) sfemi_forces_chunks(&job, t);
                    sfemi_forces_nodes(&job, 0);
                    for (t = 0, got = counted = 0; t < c->count; ++t) {
                        got += job.energy[t];
                        counted += (sfem_int)job.inverted[t];
                    }
                }
                for (t = 0; t < b.mesh->tets; ++t)
                    stiffest = fmax(stiffest, b.model->lambda[t] + 2 * b.model->mu[t]);
                for (t = 0; t < b.mesh->tets; ++t) {
                    sfem_real l, m;
                    sfem_law tet_law;
                    tet_of(&b, t, x, u, &l, &m, &tet_law);
                    energy += sfem_law_tet(tet_law, l, m, x, u, SFEM_TANGENT_EXACT, force, NULL);
                    for (a = 0; a < 4; ++a)
                        for (i = 0; i < 3; ++i)
                            sum[3 * b.mesh->tet[4 * t + a] + i] += force[3 * a + i];
                    deformation(x, u, f);
                    inverted += determinant(f) <= 0;
                    sfem_polar(f, r, NULL);
                    for (i = 0; i < 9; ++i)
                        assert_near(b.rotation[9 * t + i], tet_law ? r[i] : i % 4 == 0, 0, 1e-11);
                    for (a = 0; a < 4; ++a) /* the second half: V R by nodes, times lambda + 2 mu over the largest */
                        for (i = 0; i < 9; ++i)
                            spins[9 * (b.mesh->nodes + b.mesh->tet[4 * t + a]) + i] +=
                                b.model->volume[t] * (b.model->lambda[t] + 2 * b.model->mu[t]) / stiffest *
                                b.rotation[9 * t + i];
                }
                assert_all_near(spins, spins + 9 * b.mesh->nodes, 9 * b.mesh->nodes, 1e-12, 0);
                free(spin);
                free(spins);
                assert_near(got, energy, 1e-12, 0);
                assert_all_near(b.force, sum, 3 * b.mesh->nodes, 1e-11, 0);
                assert_int_equal(counted, inverted);
                assert_true((kind == INVERTED) == (inverted > 0));
                free(sum);
                free_body(&b);
            }
}

static void model_forces_are_the_gradient_of_energy(void **state)
{
    int law, kind, n, k;
    (void)state;
    for (law = 0; law <= LAWS; ++law)
        for (kind = 0; kind <= INVERTED; kind += INVERTED) {
            body b = make_body_of(3, 3, 3, law, kind, 35);
            const sfem_int size = 3 * b.mesh->nodes;
            double *force = (double *)calloc((size_t)size, sizeof *force);
            test_random r = {37};
            sfem_model_forces(b.model, b.u, SFEM_DOUBLE, force, NULL, NULL, b.work, NULL);
            for (n = 0; n < 30; ++n) {
                const sfem_int i = random_below(&r, size);
                const double u = b.u[i];
                double at[4];
                for (k = 0; k < 4; ++k) {
                    b.u[i] = u + 1e-2 * offset[k];
                    at[k] = sfem_model_forces(b.model, b.u, SFEM_DOUBLE, b.force, NULL, NULL,
                                              b.work, NULL);
                }
                b.u[i] = u;
                assert_near(force[i], 100 * derivative(at), 1e-6, 1e-8 * norm(force, size));
            }
            free(force);
            free_body(&b);
        }
}

static void model_tangent_is_the_derivative_of_forces(void **state)
{
    int law, n, k;
    sfem_int i;
    (void)state;
    for (law = 0; law <= LAWS; ++law) {
        body b = make_body_of(3, 3, 3, law, ORDINARY, 39);
        const sfem_int size = 3 * b.mesh->nodes;
        double *du = (double *)calloc((size_t)size, sizeof *du),
               *want = (double *)calloc((size_t)size, sizeof *du);
        double *got = (double *)calloc((size_t)size, sizeof *du),
               *u = (double *)calloc((size_t)size, sizeof *du);
        test_random r = {41};
        sfem_matrix tangent;
        sfem_error err;
        assert_ok(sfem_model_combine(b.model, 0, 0, 0, NULL, &tangent, &err), err);
        sfem_model_tangent(b.model, b.u, SFEM_TANGENT_EXACT, &tangent, NULL);
        for (n = 0; n < 5; ++n) {
            random_fill(&r, du, (size_t)size, -1, 1);
            memset(want, 0, (size_t)size * sizeof *want);
            for (k = 0; k < 4; ++k) {
                static const double weight[4] = {1, -8, 8, -1};
                for (i = 0; i < size; ++i) u[i] = b.u[i] + 1e-2 * offset[k] * du[i];
                sfem_model_forces(b.model, u, SFEM_DOUBLE, b.force, NULL, NULL, b.work, NULL);
                for (i = 0; i < size; ++i) want[i] += weight[k] * b.force[i] / (12e-2 * H);
            }
            sfem_matrix_multiply(&tangent, du, got, NULL);
            assert_all_near(got, want, size, 1e-6, 0);
        }
        if (law == 0) { /* that of K, anywhere */
            const sfem_matrix *stiffness = sfem_model_stiffness(b.model);
            assert_all_near(tangent.val, stiffness->val, 9 * stiffness->row[stiffness->n], 1e-13,
                            0);
        }
        sfem_matrix_free(&tangent);
        free(du), free(want), free(got), free(u);
        free_body(&b);
    }
}

static void model_tangents_at_rest_are_the_stiffness(void **state)
{
    body b = make_body_of(3, 2, 2, LAWS, ORDINARY, 43);
    const sfem_matrix *stiffness = sfem_model_stiffness(b.model);
    sfem_matrix tangent;
    sfem_error err;
    int kind;
    (void)state;
    assert_ok(sfem_model_combine(b.model, 0, 0, 0, NULL, &tangent, &err), err);
    memset(b.u, 0, 3 * (size_t)b.mesh->nodes * sizeof *b.u);
    for (kind = SFEM_TANGENT_EXACT; kind <= SFEM_TANGENT_FROZEN; ++kind) {
        sfem_model_tangent(b.model, b.u, (sfem_tangent)kind, &tangent, NULL);
        assert_all_near(tangent.val, stiffness->val, 9 * stiffness->row[stiffness->n], 1e-12, 0);
    }
    sfem_matrix_free(&tangent);
    free_body(&b);
}

static void translation_and_rotation_cost_no_force(void **state)
{
    int law, rotated, i;
    (void)state;
    for (law = 0; law <= LAWS; ++law)
        for (rotated = 0; rotated < 2; ++rotated) {
            body b = make_body_of(4, 3, 3, law, ORDINARY, 45);
            const sfem_int nodes = b.mesh->nodes;
            const double c = rotated ? cos(2.0) : 1, s = rotated ? sin(2.0) : 0;
            double energy;
            if (rotated && (law == 0 || law == LAWS)) {
                free_body(&b);
                continue;
            }
            for (i = 0; i < nodes; ++i) {
                const double *x = b.mesh->x + 3 * i;
                b.u[3 * i] = c * x[0] - s * x[1] - x[0] + 64;
                b.u[3 * i + 1] = s * x[0] + c * x[1] - x[1];
                b.u[3 * i + 2] = -32;
            }
            energy =
                sfem_model_forces(b.model, b.u, SFEM_DOUBLE, b.force, NULL, NULL, b.work, NULL);
            /* u is rounded to 64 * 1e-16 of a cell of .1: strains of 1e-13, stresses times .1^2 */
            for (i = 0; i < 3 * nodes; ++i) assert_near(b.force[i], 0, 0, rotated ? 1e-10 : 1e-13);
            if (law == 0) assert_near(energy, 0, 0, 0);
            free_body(&b);
        }
}

static void model_keeps_momentum_at_any_state(void **state)
{
    int law, kind, i;
    sfem_int n;
    (void)state;
    for (law = 1; law < LAWS; ++law)
        for (kind = 0; kind <= INVERTED; kind += INVERTED) {
            body b = make_body_of(5, 3, 4, law, kind, 47);
            const double size = norm(b.force, 3 * b.mesh->nodes);
            sfem_model_forces(b.model, b.u, SFEM_DOUBLE, b.force, NULL, NULL, b.work, NULL);
            for (i = 0; i < 3; ++i) {
                const int j = (i + 1) % 3, k = (i + 2) % 3;
                double sum = 0, torque = 0;
                for (n = 0; n < 3 * b.mesh->nodes; n += 3) {
                    sum += b.force[n + i];
                    torque += (b.mesh->x[n + j] + b.u[n + j]) * b.force[n + k] -
                              (b.mesh->x[n + k] + b.u[n + k]) * b.force[n + j];
                }
                assert_near(sum, 0, 0, 1e-12 * (size + 100));
                assert_near(torque, 0, 0, 1e-12 * (size + 100));
            }
            free_body(&b);
        }
}

static void forces_and_tangents_have_the_same_bits_for_any_threads(void **state)
{
    body b = make_body_of(8, 7, 8, LAWS, INVERTED, 49); /* 9 chunks */
    const size_t size = 3 * (size_t)b.mesh->nodes;
    uint64_t want[2] = {0, 0}, want_tangent = 0, hash;
    sfem_matrix tangent;
    sfem_error err;
    sfem_int threads;
    int mixed;
    (void)state;
    assert_ok(sfem_model_combine(b.model, 0, 0, 0, NULL, &tangent, &err), err);
    for (threads = 1; threads <= 8; ++threads) {
        const sfem_exec exec = thread_exec(threads);
        for (mixed = 0; mixed < 2; ++mixed) {
            const double energy = sfem_model_forces(b.model, b.u, mixed ? SFEM_MIXED : SFEM_DOUBLE,
                                                    b.force, b.rotation, NULL, b.work, &exec);
            hash = hash_reals(b.force, size) ^ hash_reals(&energy, 1) ^
                   hash_reals(b.rotation, 9 * (size_t)b.mesh->tets);
            if (threads == 1) want[mixed] = hash;
            assert_true(hash == want[mixed]);
        }
        sfem_model_tangent(b.model, b.u, SFEM_TANGENT_PSD, &tangent, &exec);
        hash = hash_reals(tangent.val, 9 * (size_t)tangent.row[tangent.n]);
        if (threads == 1) want_tangent = hash;
        assert_true(hash == want_tangent);
    }
    sfem_matrix_free(&tangent);
    free_body(&b);
}

/* Float forces err by a few 2^-24 of the modulus, times the area a node sees. */
static void mixed_forces_err_by_rounding_of_the_strain(void **state)
{
    static const double strain[] = {1e-3, 1e-2, 1e-1};
    int law, k;
    sfem_int i;
    (void)state;
    for (law = 0; law < LAWS; ++law)
        for (k = 0; k < 3; ++k) {
            body b = make_body_of(6, 5, 5, law, ORDINARY, 51);
            const sfem_int size = 3 * b.mesh->nodes;
            double *exact = (double *)calloc((size_t)size, sizeof *exact), energy, mixed;
            test_random r = {53};
            for (i = 0; i < size; ++i) b.u[i] = 0.05 * strain[k] * random_uniform(&r, -1, 1);
            energy = sfem_model_forces(b.model, b.u, SFEM_DOUBLE, exact, NULL, NULL, b.work, NULL);
            mixed = sfem_model_forces(b.model, b.u, SFEM_MIXED, b.force, NULL, NULL, b.work, NULL);
            for (i = 0; i < size; ++i) b.force[i] -= exact[i];
            assert_true(norm(b.force, size) < 4e-7 / strain[k] * norm(exact, size));
            assert_true(norm(b.force, size) > 1e-9 * norm(exact, size)); /* float indeed */
            assert_near(mixed, energy, 1e-6 / strain[k], 0);
            free(exact);
            free_body(&b);
        }
}

static void mixed_forces_survive_any_state(void **state)
{
    int law;
    sfem_int i;
    (void)state;
    for (law = 0; law <= LAWS; ++law) {
        body b = make_body_of(6, 5, 5, law, INVERTED, 55);
        const sfem_int size = 3 * b.mesh->nodes;
        double *exact = (double *)calloc((size_t)size, sizeof *exact);
        sfem_int inverted;
        sfem_model_forces(b.model, b.u, SFEM_DOUBLE, exact, NULL, NULL, b.work, NULL);
        sfem_model_forces(b.model, b.u, SFEM_MIXED, b.force, NULL, NULL, b.work, NULL);
        for (i = 0; i < size; ++i) b.force[i] -= exact[i];
        assert_true(norm(b.force, size) < 1e-5 * norm(exact, size));
        for (i = 0; i < size; ++i) b.u[i] = -b.mesh->x[i]; /* at one point */
        assert_true(isfinite(sfem_model_forces(b.model, b.u, SFEM_MIXED, b.force, b.rotation,
                                               &inverted, b.work, NULL)));
        assert_true(inverted > 0);
        for (i = 0; i < size; ++i) assert_true(isfinite(b.force[i]));
        for (i = 0; i < size; ++i) b.u[i] = i % 3 ? -b.mesh->x[i] : 0; /* on one line */
        assert_true(isfinite(sfem_model_forces(b.model, b.u, SFEM_DOUBLE, b.force, b.rotation,
                                               &inverted, b.work, NULL)));
        for (i = 0; i < size; ++i) assert_true(isfinite(b.force[i]));
        b.u[0] = NAN;
        assert_true(!sfemi_finite(
            sfem_model_forces(b.model, b.u, SFEM_DOUBLE, b.force, NULL, NULL, b.work, NULL)));
        free(exact);
        free_body(&b);
    }
}

/* Turned inside out and left to slide down its energy, a body comes back to a state of rest. */
static void inverted_tets_recover(void **state)
{
    static const double start[12] = {0, 0, 0, 1, 0, 0,
                                     0, 1, 0, 0, 0, -0.6}; /* node 3 through the face */
    static const double x[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
    int law, n, i;
    (void)state;
    for (law = 1; law < LAWS; ++law) {
        double u[12], f[9], force[12];
        for (i = 0; i < 12; ++i) u[i] = start[i] - x[i] + 1e-3 * (i % 5);
        for (n = 0; n < 3000; ++n) {
            sfem_law_tet(laws[law], lambda, mu, x, u, SFEM_TANGENT_EXACT, force, NULL);
            for (i = 0; i < 12; ++i) u[i] -= 0.05 * force[i];
        }
        deformation(x, u, f);
        if (laws[law] == SFEM_STVK)
            assert_near(determinant(f), -1, 0, 1e-3); /* as its comment says */
        else
            assert_near(determinant(f), 1, 0, 1e-3);
    }
}

static sfem_status create_attempt(sfem_allocator allocator, void *user, sfem_error *err)
{
    sfem_model_def def = *(const sfem_model_def *)user;
    sfem_model *model = NULL;
    sfem_status status;
    def.allocator = allocator;
    status = sfem_model_create(&def, &model, err);
    sfem_model_free(model);
    return status;
}

static void model_survives_failing_allocations(void **state)
{
    body b = make_body_of(2, 2, 2, LAWS, ORDINARY, 57);
    sfem_model_def def = linear_model_def();
    (void)state;
    def.mesh = b.mesh;
    def.materials = b.material;
    def.material_count = LAWS;
    def.tet_material = b.tet_material;
    assert_true(fail_every_allocation(create_attempt, &def) > 10);
    free_body(&b);
}

static void unknown_laws_are_refused(void **state)
{
    body b = make_body_of(1, 1, 1, 0, ORDINARY, 59);
    sfem_model_def def = linear_model_def();
    sfem_model *model;
    sfem_error err;
    (void)state;
    def.mesh = b.mesh;
    def.material.law = (sfem_law)7;
    assert_status(sfem_model_create(&def, &model, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "law 7");
    free_body(&b);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(polar_holds_on_any_matrix),
        cmocka_unit_test(polar_of_nothing_is_no_rotation),
        cmocka_unit_test(polar_may_overwrite_its_argument),
        cmocka_unit_test(svd_keeps_small_singular_values),
        cmocka_unit_test(stress_is_the_gradient_of_energy),
        cmocka_unit_test(tangent_is_the_derivative_of_stress),
        cmocka_unit_test(rotations_do_not_change_energy),
        cmocka_unit_test(all_laws_are_hooke_for_small_strains),
        cmocka_unit_test(energy_is_least_at_rest),
        cmocka_unit_test(stvk_is_weak_in_compression_and_blind_to_mirrors),
        cmocka_unit_test(projected_tangent_is_the_nearest_semidefinite_one),
        cmocka_unit_test(frozen_tangent_turns_hooke_with_the_tet),
        cmocka_unit_test(degenerate_states_give_finite_numbers),
        cmocka_unit_test(tet_stiffness_is_the_derivative_of_its_forces),
        cmocka_unit_test(tet_forces_carry_no_momentum),
        cmocka_unit_test(edge_lengths_give_the_tensor_and_its_invariants),
        cmocka_unit_test(edge_energies_equal_the_usual_ones),
        cmocka_unit_test(triangles_are_in_plane_strain),
        cmocka_unit_test(flat_tets_have_the_tensor_of_least_norm),
        cmocka_unit_test(edges_of_a_point_give_nothing),
        cmocka_unit_test(model_forces_are_the_sum_over_tets),
        cmocka_unit_test(model_forces_are_the_gradient_of_energy),
        cmocka_unit_test(model_tangent_is_the_derivative_of_forces),
        cmocka_unit_test(model_tangents_at_rest_are_the_stiffness),
        cmocka_unit_test(translation_and_rotation_cost_no_force),
        cmocka_unit_test(model_keeps_momentum_at_any_state),
        cmocka_unit_test(forces_and_tangents_have_the_same_bits_for_any_threads),
        cmocka_unit_test(mixed_forces_err_by_rounding_of_the_strain),
        cmocka_unit_test(mixed_forces_survive_any_state),
        cmocka_unit_test(inverted_tets_recover),
        cmocka_unit_test(model_survives_failing_allocations),
        cmocka_unit_test(unknown_laws_are_refused),
    };
    return run_all_tests(tests);
}
