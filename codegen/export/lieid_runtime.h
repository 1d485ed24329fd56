/* Functions of exported models in addition to sin, cos, exp, tanh, fabs and sqrt.
 *
 * C99 and C++, IEEE 754 doubles; no allocation, no state, no other function of the mathematical
 * library. lieid_log and lieid_atan use the reductions and polynomials of fdlibm (Copyright (C)
 * 1993 by Sun Microsystems, Inc., freely distributable with this notice): error below 1 ulp; the
 * others are good to a few ulp.
 */
#ifndef LIEID_RUNTIME_H
#define LIEID_RUNTIME_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* -1, 0 or 1; NaN stays NaN */
static inline double lieid_sign(double x)
{
    return x > 0.0 ? 1.0 : (x < 0.0 ? -1.0 : x);
}

/* The sign of a velocity: within ± width[j] a polynomial of degree 7 whose first three derivatives
 * vanish at the ends, with slope 35 / (16 width[j]) at rest; sharp without widths or where one is 0. */
static inline double lieid_direction(double dq, const double *width, int j)
{
    if (width == NULL || !(dq < width[j] && dq > -width[j])) return lieid_sign(dq);
    const double x = dq / width[j], s = x * x;
    return x * (35.0 - s * (35.0 - s * (21.0 - 5.0 * s))) / 16.0;
}

/* the other operand where one is NaN, as fmin and fmax */
static inline double lieid_fmin(double a, double b) { return a < b || b != b ? a : b; }
static inline double lieid_fmax(double a, double b) { return a > b || b != b ? a : b; }

static inline uint64_t lieid_bits(double x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

static inline double lieid_real(uint64_t bits)
{
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

static inline double lieid_copysign(double size, double sign)
{
    const uint64_t bit = UINT64_C(1) << 63;
    return lieid_real((lieid_bits(size) & ~bit) | (lieid_bits(sign) & bit));
}

/* e^x - 1 without cancellation at 0: 2 t / (1 - t), t = tanh(x / 2) */
static inline double lieid_expm1(double x)
{
    const double t = tanh(0.5 * x);
    return x < 1.0 && x > -1.0 ? 2.0 * t / (1.0 - t) : exp(x) - 1.0;
}

static inline double lieid_log(double x)
{
    double k = 0.0;
    if (!(x > 0.0)) return x == 0.0 ? -HUGE_VAL : sqrt(x); /* NaN */
    if (x > 1.7976931348623157e308) return x;
    if (x < 2.2250738585072014e-308) { x *= 18014398509481984.0; k = -54.0; }
    /* x = 2^k (1 + f), 1 + f between sqrt(1/2) and sqrt(2) */
    const uint64_t bits = lieid_bits(x);
    double m = lieid_real((bits & UINT64_C(0x000fffffffffffff)) | UINT64_C(0x3ff0000000000000));
    k += (double)(int)(bits >> 52) - 1023.0;
    if (m > 1.4142135623730951) { m *= 0.5; k += 1.0; }
    const double f = m - 1.0;
    const double s = f / (2.0 + f);
    const double z = s * s;
    double r = 1.531383769920937332e-01 + z * 1.479819860511658591e-01;
    r = 1.818357216161805012e-01 + z * r;
    r = 2.222219843214978396e-01 + z * r;
    r = 2.857142874366239149e-01 + z * r;
    r = 3.999999999940941908e-01 + z * r;
    r = z * (6.666666666666735130e-01 + z * r);
    const double half = 0.5 * f * f;
    return k * 6.93147180369123816490e-01
           - ((half - (s * (half + r) + k * 1.90821492927058770002e-10)) - f);
}

static inline double lieid_log1p(double x)
{
    const double u = 1.0 + x;
    return u == 1.0 ? x : lieid_log(u) * (x / (u - 1.0));
}

/* Whole exponents up to 64 by products, others by e^(y log x); a negative x has whole powers only. */
static inline double lieid_pow(double x, double y)
{
    if (y >= -64.0 && y <= 64.0 && y == (double)(int)y) {
        double power = x, result = 1.0;
        for (int k = y < 0.0 ? -(int)y : (int)y; k > 0; k /= 2) {
            if (k % 2 == 1) result *= power;
            power *= power;
        }
        return y < 0.0 ? 1.0 / result : result;
    }
    if (x == 0.0) return y > 0.0 ? 0.0 : HUGE_VAL;
    return exp(y * lieid_log(x));
}

static inline double lieid_tan(double x) { return sin(x) / cos(x); }

static inline double lieid_sinh(double x)
{
    const double e = lieid_expm1(fabs(x));
    return lieid_copysign(0.5 * (e + e / (e + 1.0)), x);
}

static inline double lieid_cosh(double x) { return 0.5 * (exp(x) + exp(-x)); }

static inline double lieid_atan(double x)
{
    const double size = fabs(x);
    double t = size, high = 0.0, low = 0.0;
    if (size >= 2.4375) {
        t = -1.0 / size;
        high = 1.57079632679489655800e+00;
        low = 6.12323399573676603587e-17;
    } else if (size >= 1.1875) {
        t = (size - 1.5) / (1.0 + 1.5 * size);
        high = 9.82793723247329054082e-01;
        low = 1.39033110312309984516e-17;
    } else if (size >= 0.6875) {
        t = (size - 1.0) / (size + 1.0);
        high = 7.85398163397448278999e-01;
        low = 3.06161699786838301793e-17;
    } else if (size >= 0.4375) {
        t = (2.0 * size - 1.0) / (2.0 + size);
        high = 4.63647609000806093515e-01;
        low = 2.26987774529616870924e-17;
    }
    const double z = t * t;
    double p = -3.65315727442169155270e-02 + z * 1.62858201153657823623e-02;
    p = 4.97687799461593236017e-02 + z * p;
    p = -5.83357013379057348645e-02 + z * p;
    p = 6.66107313738753120669e-02 + z * p;
    p = -7.69187620504482999495e-02 + z * p;
    p = 9.09088713343650656196e-02 + z * p;
    p = -1.11111104054623557880e-01 + z * p;
    p = 1.42857142725034663711e-01 + z * p;
    p = -1.99999999998764832476e-01 + z * p;
    p = z * (3.33333333333329318027e-01 + z * p);
    return lieid_copysign(high - ((t * p - low) - t), x);
}

static inline double lieid_atan2(double y, double x)
{
    const double pi = 3.14159265358979311600e+00, rest = 1.22464679914735317720e-16;
    if (x != x || y != y) return x + y;
    if (y == 0.0 && x == 0.0) return lieid_copysign(1.0, x) > 0.0 ? y : lieid_copysign(pi, y);
    if (x == 0.0) return lieid_copysign(0.5 * pi, y);
    const double angle = lieid_atan(fabs(y / x));
    return lieid_copysign(x > 0.0 ? angle : pi - (angle - rest), y);
}

static inline double lieid_asin(double x) { return lieid_atan2(x, sqrt((1.0 - x) * (1.0 + x))); }
static inline double lieid_acos(double x) { return lieid_atan2(sqrt((1.0 - x) * (1.0 + x)), x); }

static inline double lieid_hypot(double a, double b)
{
    const double large = lieid_fmax(fabs(a), fabs(b)), small = lieid_fmin(fabs(a), fabs(b));
    const double ratio = large > 0.0 ? small / large : 0.0;
    return large * sqrt(1.0 + ratio * ratio);
}

static inline double lieid_floor(double x)
{
    if (!(fabs(x) < 4503599627370496.0)) return x;
    const double whole = (double)(int64_t)x;
    return whole > x ? whole - 1.0 : whole;
}

static inline double lieid_ceil(double x) { return -lieid_floor(-x); }

#endif
