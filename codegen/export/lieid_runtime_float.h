/* The functions of lieid_runtime.h for values of type float.
 *
 * Those of a few operations are computed in float, the others in double: they are rare.
 */
#ifndef LIEID_RUNTIME_FLOAT_H
#define LIEID_RUNTIME_FLOAT_H

#include "lieid_runtime.h"

/* -1, 0 or 1; NaN stays NaN */
static inline float lieid_signf(float x)
{
    return x > 0.0f ? 1.0f : (x < 0.0f ? -1.0f : x);
}

static inline float lieid_directionf(float dq, const float *width, int j)
{
    if (width == NULL || !(dq < width[j] && dq > -width[j])) return lieid_signf(dq);
    const float x = dq / width[j], s = x * x;
    return x * (35.0f - s * (35.0f - s * (21.0f - 5.0f * s))) / 16.0f;
}

static inline float lieid_fminf(float a, float b) { return a < b || b != b ? a : b; }
static inline float lieid_fmaxf(float a, float b) { return a > b || b != b ? a : b; }
static inline float lieid_copysignf(float a, float b) { return (float)lieid_copysign((double)a, (double)b); }
static inline float lieid_expm1f(float x) { return (float)lieid_expm1((double)x); }
static inline float lieid_logf(float x) { return (float)lieid_log((double)x); }
static inline float lieid_log1pf(float x) { return (float)lieid_log1p((double)x); }
static inline float lieid_powf(float x, float y) { return (float)lieid_pow((double)x, (double)y); }
static inline float lieid_tanf(float x) { return (float)lieid_tan((double)x); }
static inline float lieid_sinhf(float x) { return (float)lieid_sinh((double)x); }
static inline float lieid_coshf(float x) { return (float)lieid_cosh((double)x); }
static inline float lieid_asinf(float x) { return (float)lieid_asin((double)x); }
static inline float lieid_acosf(float x) { return (float)lieid_acos((double)x); }
static inline float lieid_atanf(float x) { return (float)lieid_atan((double)x); }
static inline float lieid_atan2f(float y, float x) { return (float)lieid_atan2((double)y, (double)x); }
static inline float lieid_hypotf(float a, float b) { return (float)lieid_hypot((double)a, (double)b); }
static inline float lieid_floorf(float x) { return (float)lieid_floor((double)x); }
static inline float lieid_ceilf(float x) { return (float)lieid_ceil((double)x); }

#endif
