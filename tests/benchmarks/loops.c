/* What the benchmarks time inside C: a kernel called once per sample, and the processor's peak. */
#include "lieid_lanes.h"

typedef void (*kernel)(const double *const *in, double *const *rows, ptrdiff_t ld);

/* One sample: sines and cosines of n joints, then the kernel (one lane). Everything by value of
 * pointers, as a controller would call it. */
__attribute__((noinline)) static void evaluate(kernel function, int64_t n, const double *q,
                                               const double *dq, const double *ddq,
                                               const double *parameters, double *const *rows)
{
    double sine[64], cosine[64];
    for (int64_t j = 0; j < n; j++) lieid_sincos(q[j], &sine[j], &cosine[j]);
    const double *in[] = {q, sine, cosine, dq, ddq, parameters};
    function(in, rows, 1);
}

void samples_one_by_one(kernel function, int64_t n, int64_t samples, const double *q,
                        const double *dq, const double *ddq, const double *parameters,
                        double *const *rows)
{
    for (int64_t s = 0; s < samples; s++) {
        evaluate(function, n, q + s * n, dq + s * n, ddq + s * n, parameters, rows);
        __asm__ volatile("" ::: "memory");
    }
}
