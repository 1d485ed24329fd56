/* Independent additions and multiplications in registers: the most that this processor does. */
#include "lieid_lanes.h"

#define EACH(op) op(0) op(1) op(2) op(3) op(4) op(5) op(6)

double peak(int64_t rounds)
{
    lieid_v a[7], b[7], sum = lieid_splat(0.0);
    for (int k = 0; k < 7; k++) a[k] = b[k] = lieid_splat(1.0 + k);
    lieid_v factor = lieid_splat(1.0), term = lieid_splat(0.0);
    __asm__ volatile("" : "+x"(factor), "+x"(term));
    for (int64_t r = 0; r < rounds; r++) {
#define STEP(k)            \
    a[k] = a[k] * factor;  \
    b[k] = b[k] + term;
        EACH(STEP)
    }
    for (int k = 0; k < 7; k++) sum += a[k] + b[k];
    return LIEID_LANE(sum, 0);
}
