/* Arithmetic on LIEID_LANES samples at once, for code that lieid-casadi generates.
 *
 * Needs GCC or clang (vector extensions); LIEID_LANES 1 is plain C with the same formulas, so that
 * results do not depend on the number of lanes. Compile with -ffp-contract=off for the same bits
 * on every processor, and -fno-math-errno for vector square roots.
 *
 * lieid_sincos and lieid_exp use the reductions and polynomials of fdlibm (Copyright (C) 1993 by
 * Sun Microsystems, Inc., freely distributable with this notice): error below 1 ulp.
 */
#ifndef LIEID_LANES_H
#define LIEID_LANES_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifndef LIEID_LANES
#define LIEID_LANES 1
#endif

#if LIEID_LANES > 1
typedef double lieid_v __attribute__((vector_size(8 * LIEID_LANES)));
typedef int64_t lieid_i __attribute__((vector_size(8 * LIEID_LANES)));
typedef uint64_t lieid_w __attribute__((vector_size(8 * LIEID_LANES)));
typedef double lieid_u __attribute__((vector_size(8 * LIEID_LANES), aligned(8), may_alias));
#define LIEID_BITS(x) ((lieid_i)(x))
#define LIEID_REAL(i) ((lieid_v)(i))
#define LIEID_MASK(comparison) ((lieid_i)(comparison))
#define LIEID_LANE(x, k) ((x)[k])
static inline lieid_v lieid_splat(double x) { return x - (lieid_v){0.0}; }
static inline lieid_v lieid_load(const double *p) { return *(const lieid_u *)p; }
static inline void lieid_store(double *p, lieid_v x) { *(lieid_u *)p = x; }
#else
typedef double lieid_v;
typedef int64_t lieid_i;
typedef uint64_t lieid_w;
#define LIEID_MASK(comparison) (-(int64_t)(comparison))
#define LIEID_LANE(x, k) (x)
static inline lieid_i LIEID_BITS(double x) { lieid_i i; memcpy(&i, &x, sizeof i); return i; }
static inline lieid_v LIEID_REAL(int64_t i) { lieid_v x; memcpy(&x, &i, sizeof x); return x; }
static inline lieid_v lieid_splat(double x) { return x; }
static inline lieid_v lieid_load(const double *p) { return *p; }
static inline void lieid_store(double *p, lieid_v x) { *p = x; }
#endif

/* bits moved left, those beyond the last one lost */
#define LIEID_SHIFTED(i, count) ((lieid_i)((lieid_w)(i) << (count)))

/* a where the mask is set, else b */
static inline lieid_v lieid_select(lieid_i mask, lieid_v a, lieid_v b)
{
    return LIEID_REAL((LIEID_BITS(a) & mask) | (LIEID_BITS(b) & ~mask));
}

/* 1.0 where the mask is set, else 0.0: CasADi's truth values */
static inline lieid_v lieid_truth(lieid_i mask)
{
    return LIEID_REAL(LIEID_BITS(lieid_splat(1.0)) & mask);
}

#define LIEID_LT(a, b) lieid_truth(LIEID_MASK((a) < (b)))
#define LIEID_LE(a, b) lieid_truth(LIEID_MASK((a) <= (b)))
#define LIEID_EQ(a, b) lieid_truth(LIEID_MASK((a) == (b)))
#define LIEID_NE(a, b) lieid_truth(LIEID_MASK((a) != (b)))
#define LIEID_NONZERO(a) LIEID_MASK((a) != lieid_splat(0.0))
#define LIEID_NOT(a) lieid_truth(~LIEID_NONZERO(a))
#define LIEID_AND(a, b) lieid_truth(LIEID_NONZERO(a) & LIEID_NONZERO(b))
#define LIEID_OR(a, b) lieid_truth(LIEID_NONZERO(a) | LIEID_NONZERO(b))
#define LIEID_IF_ELSE_ZERO(a, b) lieid_select(LIEID_NONZERO(a), (b), lieid_splat(0.0))

static inline lieid_v lieid_fabs(lieid_v x)
{
    return LIEID_REAL(LIEID_BITS(x) & ~LIEID_BITS(lieid_splat(-0.0)));
}

/* -1, 0 or 1; NaN stays NaN */
static inline lieid_v lieid_sign(lieid_v x)
{
    const lieid_v zero = lieid_splat(0.0);
    const lieid_v up = lieid_select(LIEID_MASK(x > zero), lieid_splat(1.0), x);
    return lieid_select(LIEID_MASK(x < zero), lieid_splat(-1.0), up);
}

/* the other operand where one is NaN, as fmin and fmax */
static inline lieid_v lieid_fmin(lieid_v a, lieid_v b)
{
    return lieid_select(LIEID_MASK(a < b) | LIEID_MASK(b != b), a, b);
}

static inline lieid_v lieid_fmax(lieid_v a, lieid_v b)
{
    return lieid_select(LIEID_MASK(a > b) | LIEID_MASK(b != b), a, b);
}

/* functions without a vector form of their own, lane by lane */
#if LIEID_LANES > 1
#define LIEID_EACH(name, f)                                                     \
    static inline lieid_v name(lieid_v x)                                       \
    {                                                                           \
        lieid_v y;                                                              \
        for (int k = 0; k < LIEID_LANES; k++) y[k] = f(x[k]);                   \
        return y;                                                               \
    }
#define LIEID_EACH_PAIR(name, f)                                                \
    static inline lieid_v name(lieid_v a, lieid_v b)                            \
    {                                                                           \
        lieid_v y;                                                              \
        for (int k = 0; k < LIEID_LANES; k++) y[k] = f(a[k], b[k]);             \
        return y;                                                               \
    }
#else
#define LIEID_EACH(name, f) static inline lieid_v name(lieid_v x) { return f(x); }
#define LIEID_EACH_PAIR(name, f) static inline lieid_v name(lieid_v a, lieid_v b) { return f(a, b); }
#endif
LIEID_EACH(lieid_sqrt, sqrt)
LIEID_EACH(lieid_tan, tan)
LIEID_EACH(lieid_asin, asin)
LIEID_EACH(lieid_acos, acos)
LIEID_EACH(lieid_atan, atan)
LIEID_EACH(lieid_sinh, sinh)
LIEID_EACH(lieid_cosh, cosh)
LIEID_EACH(lieid_tanh, tanh)
LIEID_EACH(lieid_log, log)
LIEID_EACH(lieid_log1p, log1p)
LIEID_EACH(lieid_expm1, expm1)
LIEID_EACH(lieid_erf, erf)
LIEID_EACH(lieid_floor, floor)
LIEID_EACH(lieid_ceil, ceil)
LIEID_EACH_PAIR(lieid_pow, pow)
LIEID_EACH_PAIR(lieid_atan2, atan2)
LIEID_EACH_PAIR(lieid_fmod, fmod)
LIEID_EACH_PAIR(lieid_hypot, hypot)
LIEID_EACH_PAIR(lieid_copysign, copysign)

#define LIEID_ROUNDER 6755399441055744.0 /* 1.5 * 2^52: adding it rounds to a whole number */
#define LIEID_SINCOS_LIMIT 1.0e5         /* the reduction below is good to 1 ulp up to it */

static inline int lieid_any(lieid_i mask)
{
#if LIEID_LANES > 1
    int64_t all = 0;
    for (int k = 0; k < LIEID_LANES; k++) all |= mask[k];
    return all != 0;
#else
    return mask != 0;
#endif
}

/* Sine and cosine for |x| <= LIEID_SINCOS_LIMIT: pi/2 in three pieces of 33 bits, the rest of the
 * reduced argument carried along. */
static inline void lieid_sincos_near(lieid_v x, lieid_v *sine, lieid_v *cosine)
{
    const lieid_v shifted = x * 6.36619772367581382433e-01 + LIEID_ROUNDER;
    const lieid_i quadrant = LIEID_BITS(shifted);
    const lieid_v turns = shifted - LIEID_ROUNDER;
    const lieid_v first = x - turns * 1.57079632673412561417e+00;
    const lieid_v second = turns * 6.07710050630396597660e-11;
    const lieid_v r = first - second;
    const lieid_v rest = ((first - r) - second) - turns * 2.02226624879595063154e-21;
    const lieid_v z = r * r;
    const lieid_v cube = z * r;

    lieid_v p = -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10;
    p = 2.75573137070700676789e-06 + z * p;
    p = -1.98412698298579493134e-04 + z * p;
    p = 8.33333333332248946124e-03 + z * p;
    const lieid_v s = r - ((z * (0.5 * rest - cube * p) - rest) - cube * -1.66666666666666324348e-01);

    p = 2.08757232129817482790e-09 + z * -1.13596475577881948265e-11;
    p = -2.75573143513906633035e-07 + z * p;
    p = 2.48015872894767294178e-05 + z * p;
    p = -1.38888888888741095749e-03 + z * p;
    p = 4.16666666666666019037e-02 + z * p;
    const lieid_v half = 0.5 * z;
    const lieid_v w = 1.0 - half;
    const lieid_v c = w + (((1.0 - w) - half) + (z * (z * p) - r * rest));

    const lieid_i odd = -(quadrant & 1);
    *sine = LIEID_REAL(LIEID_BITS(lieid_select(odd, c, s)) ^ LIEID_SHIFTED(quadrant & 2, 62));
    *cosine = LIEID_REAL(LIEID_BITS(lieid_select(odd, s, c)) ^ LIEID_SHIFTED((quadrant + 1) & 2, 62));
}

/* Lanes beyond the limit, infinities among them, go to the C library, which reduces by any size. */
static inline void lieid_sincos(lieid_v x, lieid_v *sine, lieid_v *cosine)
{
    const lieid_v far = lieid_fabs(x);
    lieid_sincos_near(x, sine, cosine);
    if (__builtin_expect(lieid_any(LIEID_MASK(far > lieid_splat(LIEID_SINCOS_LIMIT))), 0)) {
#if LIEID_LANES > 1
        for (int k = 0; k < LIEID_LANES; k++)
            if (far[k] > LIEID_SINCOS_LIMIT) {
                (*sine)[k] = sin(x[k]);
                (*cosine)[k] = cos(x[k]);
            }
#else
        *sine = sin(x);
        *cosine = cos(x);
#endif
    }
}

static inline lieid_v lieid_sin(lieid_v x)
{
    lieid_v s, c;
    lieid_sincos(x, &s, &c);
    return s;
}

static inline lieid_v lieid_cos(lieid_v x)
{
    lieid_v s, c;
    lieid_sincos(x, &s, &c);
    return c;
}

/* 2^k for whole k from -1022 to 1023 */
static inline lieid_v lieid_power_of_two(lieid_v k)
{
    return LIEID_REAL(LIEID_SHIFTED(LIEID_BITS(k + LIEID_ROUNDER) + 1023, 52));
}

static inline lieid_v lieid_exp(lieid_v x)
{
    lieid_v t = lieid_select(LIEID_MASK(x > lieid_splat(710.0)), lieid_splat(710.0), x);
    t = lieid_select(LIEID_MASK(t < lieid_splat(-746.0)), lieid_splat(-746.0), t);
    const lieid_v k = (t * 1.44269504088896338700e+00 + LIEID_ROUNDER) - LIEID_ROUNDER;
    const lieid_v high = t - k * 6.93147180369123816490e-01;
    const lieid_v low = k * 1.90821492927058770002e-10;
    const lieid_v r = high - low;
    const lieid_v z = r * r;
    lieid_v p = -1.65339022054652515390e-06 + z * 4.13813679705723846039e-08;
    p = 6.61375632143793436117e-05 + z * p;
    p = -2.77777777770155933842e-03 + z * p;
    p = 1.66666666666666019037e-01 + z * p;
    const lieid_v c = r - z * p;
    const lieid_v y = 1.0 - ((low - (r * c) / (2.0 - c)) - high);
    /* in two steps, since 2^1024 does not exist and tiny results lose bits only once */
    const lieid_v half = (k * 0.5 + LIEID_ROUNDER) - LIEID_ROUNDER;
    return (y * lieid_power_of_two(half)) * lieid_power_of_two(k - half);
}

#endif
