/* portable_math.h - exp, log, pow, sin, cos and their kin from +, -, *, /, sqrt and floor alone, which IEEE 754 rounds
 * alike everywhere. C libraries differ in the last bit of the former; with these a page and a native program that are
 * compiled with -ffp-contract=off compute the same bits. Errors are a few units in the last place (tests/test_scenes.c).
 *
 * Include it before softfem.h: it takes the place of the functions of math.h.
 */
#ifndef SFEM_EXAMPLES_PORTABLE_MATH_H
#define SFEM_EXAMPLES_PORTABLE_MATH_H

#include <math.h>

#define PM_STATIC static __attribute__((unused))
#define PM_LN2_HIGH 6.93147180369123816490e-01 /* 33 bits: its multiples by whole numbers up to 2^20 are exact */
#define PM_LN2_LOW 1.90821492927058770002e-10

/* exp: x = k ln 2 + r, |r| <= ln 2/2, and Taylor's series of r */
PM_STATIC double pm_exp_series(double r) /* (e^r - 1) */
{
    double sum = 0;
    int n;
    for (n = 17; n >= 1; --n) sum = (1 + sum) * r / n;
    return sum;
}

PM_STATIC double pm_exp(double x)
{
    double k, r;
    if (!(fabs(x) < 800)) return x > 0 ? HUGE_VAL : x < 0 ? 0 : x; /* x itself: NaN */
    k = floor(x / 6.93147180559945286e-01 + 0.5);
    r = (x - k * PM_LN2_HIGH) - k * PM_LN2_LOW;
    return ldexp(1 + pm_exp_series(r), (int)k);
}

PM_STATIC double pm_expm1(double x) { return fabs(x) < 0.5 ? pm_exp_series(x) : pm_exp(x) - 1; }

/* log: x = m 2^e, m in [sqrt(1/2), sqrt 2), and the series of 2 artanh((m-1)/(m+1)) */
PM_STATIC double pm_log(double x)
{
    double s, z, sum = 0;
    int e, n;
    if (!(x > 0)) return x < 0 ? -(HUGE_VAL - HUGE_VAL) : x == 0 ? -HUGE_VAL : x;
    if (!(x < HUGE_VAL)) return x;
    x = frexp(x, &e);
    if (x < 7.07106781186547524e-01) x *= 2, --e;
    s = (x - 1) / (x + 1);
    z = s * s;
    for (n = 23; n >= 3; n -= 2) sum = (sum + 1.0 / n) * z;
    return e * PM_LN2_HIGH + (2 * s + (2 * s * sum + e * PM_LN2_LOW));
}

PM_STATIC double pm_log1p(double x)
{
    const double u = 1 + x;
    return u - 1 == 0 ? x : u < HUGE_VAL ? pm_log(u) * (x / (u - 1)) : u;
}

PM_STATIC double pm_log10(double x) { return pm_log(x) / 2.30258509299404568402; }
PM_STATIC double pm_log2(double x) { return pm_log(x) / 6.93147180559945309417e-01; }

PM_STATIC double pm_pow(double x, double y)
{
    const double whole = floor(y);
    double power = 1;
    int n, k;
    if (y == whole && fabs(y) <= 64) {
        n = (int)fabs(y);
        for (k = 0; k < n; ++k) power *= x;
        return y < 0 ? 1 / power : power;
    }
    if (x == 0) return y > 0 ? 0 : HUGE_VAL;
    if (x > 0) return pm_exp(y * pm_log(x));
    if (y != whole) return HUGE_VAL - HUGE_VAL;
    power = pm_exp(y * pm_log(-x));
    return whole / 2 == floor(whole / 2) ? power : -power;
}

/* sin, cos: x = k pi/2 + r, |r| <= pi/4, pi/2 in three parts, and the series of r; good up to |x| = 1e6 */
PM_STATIC int pm_quadrant(double x, double *r)
{
    const double k = floor(x / 1.57079632679489661923 + 0.5);
    *r = ((x - k * 1.57079632673412561417e+00) - k * 6.07710050630396597660e-11) - k * 2.02226624879595063154e-21;
    return (int)(k - 4 * floor(k / 4));
}

PM_STATIC double pm_sin_series(double r)
{
    const double z = r * r;
    double sum = 0;
    int n;
    for (n = 19; n >= 3; n -= 2) sum = -(1 + sum) * z / (n * (n - 1));
    return r + r * sum;
}

PM_STATIC double pm_cos_series(double r)
{
    const double z = r * r;
    double sum = 0;
    int n;
    for (n = 20; n >= 2; n -= 2) sum = -(1 + sum) * z / (n * (n - 1));
    return 1 + sum;
}

PM_STATIC double pm_sin(double x)
{
    double r;
    int k;
    if (!(fabs(x) < 1e15)) return x - x;
    k = pm_quadrant(x, &r);
    return k == 0 ? pm_sin_series(r) : k == 1 ? pm_cos_series(r) : k == 2 ? -pm_sin_series(r) : -pm_cos_series(r);
}

PM_STATIC double pm_cos(double x)
{
    double r;
    int k;
    if (!(fabs(x) < 1e15)) return x - x;
    k = pm_quadrant(x, &r);
    return k == 0 ? pm_cos_series(r) : k == 1 ? -pm_sin_series(r) : k == 2 ? -pm_cos_series(r) : pm_sin_series(r);
}

/* atan: twice atan(t) = 2 atan(t/(1 + sqrt(1 + t^2))), and the series */
PM_STATIC double pm_atan(double x)
{
    const double t0 = fabs(x) > 1 ? 1 / fabs(x) : fabs(x);
    const double t1 = t0 / (1 + sqrt(1 + t0 * t0)), t = t1 / (1 + sqrt(1 + t1 * t1)), z = t * t;
    double sum = 0;
    int n;
    if (!(x == x)) return x;
    for (n = 25; n >= 3; n -= 2) sum = -(sum + 1.0 / n) * z;
    sum = 4 * (t + t * sum);
    if (fabs(x) > 1) sum = 1.57079632679489661923 - sum;
    return x < 0 ? -sum : sum;
}

PM_STATIC double pm_atan2(double y, double x)
{
    const double pi = 3.14159265358979323846;
    if (!(y == y && x == x)) return x + y;
    if (x == 0 && y == 0) return x < 0 || 1 / x < 0 ? (1 / y < 0 ? -pi : pi) : y;
    if (fabs(x) >= fabs(y)) return pm_atan(y / x) + (x < 0 ? (y < 0 || 1 / y < 0 ? -pi : pi) : 0);
    return (y < 0 ? -pi / 2 : pi / 2) - pm_atan(x / y);
}

PM_STATIC double pm_acos(double x) { return pm_atan2(sqrt((1 - x) * (1 + x)), x); }

PM_STATIC double pm_sinh(double x)
{
    const double e = pm_expm1(fabs(x)), s = 0.5 * (e + e / (1 + e));
    return x < 0 ? -s : s;
}

PM_STATIC double pm_cosh(double x) { return 0.5 * (pm_exp(x) + pm_exp(-x)); }

PM_STATIC double pm_tanh(double x)
{
    const double e = fabs(x) < 20 ? pm_expm1(2 * fabs(x)) : 0, t = fabs(x) < 20 ? e / (e + 2) : 1;
    return x < 0 ? -t : x > 0 ? t : x;
}

PM_STATIC double pm_hypot(double x, double y)
{
    const double a = fmax(fabs(x), fabs(y)), b = fmin(fabs(x), fabs(y));
    return a > 0 ? a * sqrt(1 + (b / a) * (b / a)) : a;
}

#ifndef PM_NAMES_ONLY
#undef exp
#undef expm1
#undef log
#undef log1p
#undef log10
#undef log2
#undef pow
#undef sin
#undef cos
#undef atan2
#undef acos
#undef sinh
#undef cosh
#undef tanh
#undef hypot
#define exp(x) pm_exp(x)
#define expm1(x) pm_expm1(x)
#define log(x) pm_log(x)
#define log1p(x) pm_log1p(x)
#define log10(x) pm_log10(x)
#define log2(x) pm_log2(x)
#define pow(x, y) pm_pow(x, y)
#define sin(x) pm_sin(x)
#define cos(x) pm_cos(x)
#define atan2(y, x) pm_atan2(y, x)
#define acos(x) pm_acos(x)
#define sinh(x) pm_sinh(x)
#define cosh(x) pm_cosh(x)
#define tanh(x) pm_tanh(x)
#define hypot(x, y) pm_hypot(x, y)
#endif

#endif
