/* SIMD arithmetic: a vd holds one number of each of PIAFFE_W nodes, one node per lane. C11 with the vector extensions
   of gcc and clang.

   Comparisons and logical operations return 0.0 or 1.0 in each lane; as operands, all numbers but zero are true.
   Arrays of vd are aligned to its size. Do not compile with -ffast-math; -ffp-contract=fast, -fno-math-errno and
   -fno-trapping-math are allowed. With AVX, gcc at -O1 needs -fexpensive-optimizations (-O2 includes it): without it,
   gcc omits vzeroupper before calls of the C library, and each call takes twenty times as long. */
#ifndef PIAFFE_SIMD_H
#define PIAFFE_SIMD_H

#include <math.h>

#ifndef PIAFFE_W
#define PIAFFE_W 1
#endif

#define LANE static inline __attribute__((unused))
#define LANE_CALL static __attribute__((unused, noinline)) /* long and rarely used functions: calls keep the code small */

#if PIAFFE_W == 1
typedef double vd;
typedef long long vi;
typedef unsigned long long vu;
#define K(c) ((double)(c))
#define LANE_OF(v, i) (v)
LANE vi lane_bits(vd a) { union { vd d; vi i; } u; u.d = a; return u.i; }
LANE vd lane_from(vi a) { union { vd d; vi i; } u; u.i = a; return u.d; }
#define LANE_TRUE(c) (-(vi)(c))
#else
typedef double vd __attribute__((vector_size(8 * PIAFFE_W)));
typedef long long vi __attribute__((vector_size(8 * PIAFFE_W)));
typedef unsigned long long vu __attribute__((vector_size(8 * PIAFFE_W)));
#define K(c) ((double)(c) - (vd){0.0}) /* minus, not plus: it keeps the sign of zero */
#define LANE_OF(v, i) (v)[i]
LANE vi lane_bits(vd a) { return (vi)a; }
LANE vd lane_from(vi a) { return (vd)a; }
#define LANE_TRUE(c) ((vi)(c))
#endif

/* ---- selections: in each lane, the bits of a mask are all ones or all zeros */
LANE vd lane_keep(vi mask, vd a) { return lane_from(mask & lane_bits(a)); }
LANE vd lane_select(vi mask, vd a, vd b) { return lane_from((mask & lane_bits(a)) | (~mask & lane_bits(b))); }
LANE vd lane_truth(vi mask) { return lane_keep(mask, K(1.0)); }

LANE vd lane_lt(vd a, vd b) { return lane_truth(LANE_TRUE(a < b)); }
LANE vd lane_le(vd a, vd b) { return lane_truth(LANE_TRUE(a <= b)); }
LANE vd lane_eq(vd a, vd b) { return lane_truth(LANE_TRUE(a == b)); }
LANE vd lane_ne(vd a, vd b) { return lane_truth(LANE_TRUE(a != b)); }
LANE vd lane_not(vd a) { return lane_truth(LANE_TRUE(a == K(0.0))); }
LANE vd lane_and(vd a, vd b) { return lane_truth(LANE_TRUE(a != K(0.0)) & LANE_TRUE(b != K(0.0))); }
LANE vd lane_or(vd a, vd b) { return lane_truth(LANE_TRUE(a != K(0.0)) | LANE_TRUE(b != K(0.0))); }
LANE vd lane_if_else_zero(vd a, vd b) { return lane_keep(LANE_TRUE(a != K(0.0)), b); }
/* like C's fmin and fmax: if one argument is NaN, the result is the other */
LANE vd lane_fmin(vd a, vd b) { return lane_select(LANE_TRUE(a < b) | LANE_TRUE(b != b), a, b); }
LANE vd lane_fmax(vd a, vd b) { return lane_select(LANE_TRUE(a > b) | LANE_TRUE(b != b), a, b); }

#define LANE_SIGN_BIT lane_bits(K(-0.0))
LANE vd lane_fabs(vd a) { return lane_from(lane_bits(a) & ~LANE_SIGN_BIT); }
LANE vd lane_copysign(vd a, vd b)
{
    return lane_from((lane_bits(a) & ~LANE_SIGN_BIT) | (lane_bits(b) & LANE_SIGN_BIT));
}
LANE vd lane_sign(vd a)
{
    return lane_select(LANE_TRUE(a < K(0.0)), K(-1.0), lane_select(LANE_TRUE(a > K(0.0)), K(1.0), a));
}

/* ---- functions of the C library, called for each lane */
#if PIAFFE_W == 1
#define LANE_UNARY(f) LANE vd lane_##f(vd a) { return f(a); }
#define LANE_BINARY(f) LANE vd lane_##f(vd a, vd b) { return f(a, b); }
#else
#define LANE_UNARY(f) \
    LANE_CALL vd lane_##f(vd a) { vd r; for (int i = 0; i < PIAFFE_W; i++) r[i] = f(a[i]); return r; }
#define LANE_BINARY(f) \
    LANE_CALL vd lane_##f(vd a, vd b) { vd r; for (int i = 0; i < PIAFFE_W; i++) r[i] = f(a[i], b[i]); return r; }
#endif
LANE_UNARY(sqrt)
LANE_UNARY(exp)
LANE_UNARY(log)
LANE_UNARY(log1p)
LANE_UNARY(expm1)
LANE_UNARY(tan)
LANE_UNARY(asin)
LANE_UNARY(acos)
LANE_UNARY(sinh)
LANE_UNARY(cosh)
LANE_UNARY(tanh)
LANE_UNARY(asinh)
LANE_UNARY(acosh)
LANE_UNARY(atanh)
LANE_UNARY(erf)
LANE_UNARY(floor)
LANE_UNARY(ceil)
LANE_BINARY(pow)
LANE_BINARY(fmod)
LANE_BINARY(remainder)
LANE_BINARY(hypot)

/* ---- store n equal numbers */
LANE void lane_fill(vd *restrict r, int n, vd a)
{
    for (int i = 0; i < n; i++)
        r[i] = a;
}

/* ---- sine and cosine of all lanes at once

   x = n pi/2 + r with |r| <= pi/4; pi/2 is the sum of three parts of at most 33 bits, so that n times a part is exact
   for |n| < 2^20. The polynomials are the usual double-precision minimax polynomials. The error is below 1e-15 for
   |x| < 1e5. The result is NaN for infinite x, and undefined for |x| > 1e15. */
LANE_CALL void lane_sincos(vd x, vd *sine, vd *cosine)
{
    const vd magic = K(6755399441055744.0); /* 1.5 2^52: the low bits of the sum are the nearest integer */
    const vd shifted = x * K(6.36619772367581382433e-01) + magic;
    const vd n = shifted - magic;
    vd r = x - n * K(1.57079632673412561417e+00);
    r = r - n * K(6.07710050630396597660e-11);
    r = r - n * K(2.02226624879595063154e-21);
    const vd z = r * r;
    const vd s = K(-1.66666666666666324348e-01) + z * (K(8.33333333332248946124e-03)
        + z * (K(-1.98412698298579493134e-04) + z * (K(2.75573137070700676789e-06)
        + z * (K(-2.50507602534068634195e-08) + z * K(1.58969099521155010221e-10)))));
    const vd c = K(4.16666666666666019037e-02) + z * (K(-1.38888888888741095749e-03)
        + z * (K(2.48015872894767294178e-05) + z * (K(-2.75573143513906633035e-07)
        + z * (K(2.08757232129817482790e-09) + z * K(-1.13596475577881948265e-11)))));
    const vd half = K(0.5) * z, head = K(1.0) - half;
    const vd sin_r = r + (r * z) * s;
    const vd cos_r = head + (((K(1.0) - head) - half) + (z * z) * c);
    const vi quadrant = lane_bits(shifted);
    const vi odd = -(quadrant & 1);
    *sine = lane_from(lane_bits(lane_select(odd, cos_r, sin_r)) ^ (vi)((vu)(quadrant & 2) << 62));
    *cosine = lane_from(lane_bits(lane_select(odd, sin_r, cos_r)) ^ (vi)((vu)((quadrant + 1) & 2) << 62));
}

/* ---- inverse tangent of all lanes at once: relative error below 1e-15; NaN for two infinities

   atan(lo / hi) with 0 <= lo <= hi, minus pi/4 if the quotient exceeds 0.66, by a rational minimax approximation. */
#if PIAFFE_W == 1
LANE_BINARY(atan2)
LANE_UNARY(atan)
#else
LANE_CALL vd lane_atan2(vd y, vd x)
{
    const vd ay = lane_fabs(y), ax = lane_fabs(x);
    const vi steep = LANE_TRUE(ay > ax);
    const vd hi = lane_select(steep, ay, ax), lo = lane_select(steep, ax, ay);
    const vi far = LANE_TRUE(lo > hi * K(0.66));
    const vd below = lane_select(LANE_TRUE(hi == K(0.0)), K(1.0), hi);
    const vd t = lane_select(far, lo - hi, lo) / lane_select(far, lo + hi, below);
    const vd z = t * t;
    const vd p = K(-6.485021904942025371773e+01) + z * (K(-1.228866684490136173410e+02)
        + z * (K(-7.500855792314704667340e+01) + z * (K(-1.615753718733365076637e+01)
        + z * K(-8.750608600031904122785e-01))));
    const vd q = K(1.945506571482613964425e+02) + z * (K(4.853903996359136964868e+02)
        + z * (K(4.328810604912902668951e+02) + z * (K(1.650270098316988542046e+02)
        + z * (K(2.485846490142306297962e+01) + z))));
    vd r = t + t * (z * (p / q));
    r = r + lane_keep(far, K(3.061616997868382943065e-17));
    r = r + lane_keep(far, K(7.85398163397448309616e-01));
    r = lane_select(steep, K(1.57079632679489661923e+00) - (r - K(6.123233995736765886130e-17)), r);
    const vi behind = LANE_TRUE(lane_copysign(K(1.0), x) < K(0.0));
    r = lane_select(behind, K(3.14159265358979323846e+00) - (r - K(1.224646799147353177226e-16)), r);
    return lane_copysign(r, y);
}
LANE vd lane_atan(vd a) { return lane_atan2(a, K(1.0)); }
#endif

#endif
