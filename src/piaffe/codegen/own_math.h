/* Functions in place of those of libm, which differ in their last bit from one library to the next: all that generated code can
 * call, but square roots, roundings, fmod and remainder, which are exact and so the same everywhere, as IEEE 754 says. Compile
 * without contraction of products. Errors are below 2e-15, relative to the result, or absolute where it is below 1; sin and cos for
 * |x| < 1e5. */
#ifndef PIAFFE_OWN_MATH_H
#define PIAFFE_OWN_MATH_H

#ifndef _POSIX_C_SOURCE
#define _POSIX_C_SOURCE 200809L /* before the first header of the system */
#endif
#include <math.h>
#include <stdint.h>
#include <string.h>

#define OWN_FUNCTION static inline __attribute__((unused))

OWN_FUNCTION int64_t own_bits(double x)
{
    int64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

OWN_FUNCTION double own_number(int64_t bits)
{
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* see lane_sincos of simd.h */
OWN_FUNCTION void own_sincos(double x, double *sine, double *cosine)
{
    const double magic = 6755399441055744.0, shifted = x * 6.36619772367581382433e-01 + magic, n = shifted - magic;
    double r = x - n * 1.57079632673412561417e+00;
    r = r - n * 6.07710050630396597660e-11;
    r = r - n * 2.02226624879595063154e-21;
    const double z = r * r;
    const double s = -1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04
        + z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10))));
    const double c = 4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * (2.48015872894767294178e-05
        + z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))));
    const double half = 0.5 * z, head = 1.0 - half;
    const double sin_r = r + (r * z) * s, cos_r = head + (((1.0 - head) - half) + (z * z) * c);
    const int64_t quadrant = own_bits(shifted);
    const double a = quadrant & 1 ? cos_r : sin_r, b = quadrant & 1 ? sin_r : cos_r;
    *sine = quadrant & 2 ? -a : a;
    *cosine = (quadrant + 1) & 2 ? -b : b;
}

OWN_FUNCTION double own_sin(double x)
{
    double s, c;
    return own_sincos(x, &s, &c), s;
}

OWN_FUNCTION double own_cos(double x)
{
    double s, c;
    return own_sincos(x, &s, &c), c;
}

OWN_FUNCTION double own_tan(double x)
{
    double s, c;
    return own_sincos(x, &s, &c), s / c;
}

/* see lane_atan2 of simd.h */
OWN_FUNCTION double own_atan2(double y, double x)
{
    const double ay = fabs(y), ax = fabs(x);
    const int steep = ay > ax;
    const double hi = steep ? ay : ax, lo = steep ? ax : ay;
    const int far = lo > hi * 0.66;
    const double t = (far ? lo - hi : lo) / (far ? lo + hi : hi == 0.0 ? 1.0 : hi), z = t * t;
    const double p = -6.485021904942025371773e+01 + z * (-1.228866684490136173410e+02 + z * (-7.500855792314704667340e+01
        + z * (-1.615753718733365076637e+01 + z * -8.750608600031904122785e-01)));
    const double q = 1.945506571482613964425e+02 + z * (4.853903996359136964868e+02 + z * (4.328810604912902668951e+02
        + z * (1.650270098316988542046e+02 + z * (2.485846490142306297962e+01 + z))));
    double r = t + t * (z * (p / q));
    if (far) r = r + 3.061616997868382943065e-17, r = r + 7.85398163397448309616e-01;
    if (steep) r = 1.57079632679489661923e+00 - (r - 6.123233995736765886130e-17);
    if (signbit(x)) r = 3.14159265358979323846e+00 - (r - 1.224646799147353177226e-16);
    return copysign(r, y);
}

OWN_FUNCTION double own_atan(double x) { return own_atan2(x, 1.0); }
OWN_FUNCTION double own_asin(double x) { return own_atan2(x, sqrt((1.0 - x) * (1.0 + x))); }
OWN_FUNCTION double own_acos(double x) { return own_atan2(sqrt((1.0 - x) * (1.0 + x)), x); }
OWN_FUNCTION double own_hypot(double x, double y) { return sqrt(x * x + y * y); }

/* ln 2 in two parts, of which the first one times a whole number below 2^11 is exact */
#define OWN_LN2_HIGH 6.93147180369123816490e-01
#define OWN_LN2_LOW 1.90821492927058770002e-10

/* x = 2^k (1 + f), sqrt(1/2) < 1 + f < sqrt(2); log(1 + f) = f - f^2/2 + s (f^2/2 + R(s^2)) with s = f / (2 + f) */
OWN_FUNCTION double own_log(double x)
{
    if (!(x > 0.0) || x == INFINITY) return x > 0.0 ? x : x == 0.0 ? -INFINITY : NAN;
    int64_t k = 0;
    if (x < 2.2250738585072014e-308) x *= 18014398509481984.0, k = -54;
    int64_t bits = own_bits(x);
    k += (bits >> 52) - 1023;
    double m = own_number((bits & 0xfffffffffffff) | 0x3ff0000000000000);
    if (m > 1.4142135623730951) m *= 0.5, k++;
    const double f = m - 1.0, s = f / (2.0 + f), z = s * s, w = z * z;
    const double even = w * (3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01));
    const double odd = z * (6.666666666666735130e-01 + w * (2.857142874366239149e-01 + w * (1.818357216161805012e-01
        + w * 1.479819860511658591e-01)));
    const double half = 0.5 * f * f, n = (double)k;
    return n * OWN_LN2_HIGH - ((half - (s * (half + (odd + even)) + n * OWN_LN2_LOW)) - f);
}

/* x = k ln 2 + r, |r| <= ln 2 / 2; exp(r) = 1 + 2 r / (R(r^2) - r) */
OWN_FUNCTION double own_exp(double x)
{
    if (!(x < 709.782712893384)) return x > 0.0 ? INFINITY : x;
    if (x < -745.2) return 0.0;
    const double n = floor(x * 1.44269504088896338700 + 0.5), high = x - n * OWN_LN2_HIGH, low = n * OWN_LN2_LOW, r = high - low;
    const double z = r * r;
    const double c = r - z * (1.66666666666666019037e-01 + z * (-2.77777777770155933842e-03 + z * (6.61375632143793436117e-05
        + z * (-1.65339022054652515390e-06 + z * 4.13813679705723846039e-08))));
    const double y = 1.0 - ((low - (r * c) / (2.0 - c)) - high);
    const int64_t k = (int64_t)n;
    if (k >= -1021) return k == 1024 ? y * 2.0 * own_number((int64_t)2046 << 52) : y * own_number((k + 1023) << 52);
    return y * own_number((k + 1023 + 1000) << 52) * own_number((int64_t)23 << 52);
}

/* Small whole powers by products, others by exp and log. */
OWN_FUNCTION double own_pow(double x, double y)
{
    const double size = fabs(y);
    if (floor(size) != size || size > 64.0) {
        if (x == 0.0) return y > 0.0 ? 0.0 : INFINITY;
        const int whole = floor(size) == size;
        const double power = own_exp(y * own_log(whole ? fabs(x) : x));
        return x < 0.0 && whole && fmod(size, 2.0) == 1.0 ? -power : power;
    }
    double power = 1.0;
    for (int i = 0; i < (int)size; i++) power *= x;
    return y < 0.0 ? 1.0 / power : power;
}

/* W. Kahan: the error of 1 + x divides out. */
OWN_FUNCTION double own_log1p(double x)
{
    const double u = 1.0 + x;
    if (u == 1.0 || u == INFINITY) return x;
    return own_log(u) * x / (u - 1.0);
}

OWN_FUNCTION double own_expm1(double x)
{
    const double u = own_exp(x);
    if (u == 1.0) return x;
    if (u == INFINITY || u - 1.0 == -1.0) return u - 1.0;
    return (u - 1.0) * x / own_log(u);
}

OWN_FUNCTION double own_sinh(double x)
{
    const double size = fabs(x);
    if (size < 22.0) {
        const double e = own_expm1(size);
        return copysign(0.5 * (e + e / (e + 1.0)), x);
    }
    const double root = own_exp(0.5 * size); /* exp(x) may overflow */
    return copysign(size < 709.0 ? 0.5 * own_exp(size) : 0.5 * root * root, x);
}

OWN_FUNCTION double own_cosh(double x)
{
    const double size = fabs(x), e = own_exp(size), root = own_exp(0.5 * size);
    return size < 709.0 ? 0.5 * (e + 1.0 / e) : 0.5 * root * root;
}

OWN_FUNCTION double own_tanh(double x)
{
    const double size = fabs(x), e = own_expm1(2.0 * size);
    return size > 22.0 ? copysign(1.0, x) : copysign(e / (e + 2.0), x);
}

OWN_FUNCTION double own_asinh(double x)
{
    const double size = fabs(x), square = size * size;
    if (size > 1e8) return copysign(own_log(size) + 6.93147180559945309417e-01, x);
    return copysign(own_log1p(size + square / (1.0 + sqrt(square + 1.0))), x);
}

OWN_FUNCTION double own_acosh(double x)
{
    const double over = x - 1.0;
    if (x > 1e8) return own_log(x) + 6.93147180559945309417e-01;
    return own_log1p(over + sqrt(2.0 * over + over * over));
}

OWN_FUNCTION double own_atanh(double x)
{
    const double size = fabs(x);
    return copysign(0.5 * own_log1p(2.0 * size / (1.0 - size)), x);
}

/* A series of positive terms; for larger x the continued fraction of 1 - erf. */
OWN_FUNCTION double own_erf(double x)
{
    const double size = fabs(x), square = size * size;
    if (!(size < 6.0)) return size > 0.0 ? copysign(1.0, x) : x;
    if (size >= 3.0) {
        double fraction = size;
        for (int k = 60; k > 0; k--) fraction = size + 0.5 * (double)k / fraction;
        return copysign(1.0 - 5.64189583547756286948e-01 * own_exp(-square) / fraction, x);
    }
    double sum = size, term = size;
    for (int k = 1; term > 1e-18 * sum; k++) term *= 2.0 * square / (2.0 * (double)k + 1.0), sum += term;
    return copysign(1.12837916709551257390e+00 * own_exp(-square) * sum, x);
}

#define sin own_sin
#define cos own_cos
#define tan own_tan
#define asin own_asin
#define acos own_acos
#define atan own_atan
#define atan2 own_atan2
#define exp own_exp
#define log own_log
#define pow own_pow
#define hypot own_hypot
#define log1p own_log1p
#define expm1 own_expm1
#define sinh own_sinh
#define cosh own_cosh
#define tanh own_tanh
#define asinh own_asinh
#define acosh own_acosh
#define atanh own_atanh
#define erf own_erf
#endif
