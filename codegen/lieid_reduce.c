/* Householder reduction of columns that stay in cache into a triangular factor (TSQR).
 *
 * [R; B] becomes [R'; 0] for an upper triangular R (count, count), row after row, and a block of
 * columns B. Reflections are gathered PANEL at a time (compact WY form: Schreiber, Van Loan, SIAM
 * J. Sci. Stat. Comput. 1989), so that nearly all work is products of small matrices in registers.
 */
#include "lieid_lanes.h"

#if defined(__FMA__) || defined(__AVX512F__)
#include <immintrin.h>
#endif

#if LIEID_LANES == 8
enum { PANEL = 8, GROUP = 3 }; /* PANEL * GROUP sums stay in registers */
#else
enum { PANEL = 4, GROUP = 2 };
#endif

#if defined(__clang__)
#define UNROLL _Pragma("clang loop unroll(full)")
#else
#define UNROLL _Pragma("GCC unroll 8")
#endif
#define INLINE static inline __attribute__((always_inline))

/* a + b * c; fused where the processor can, for this alone needs no equal bits */
INLINE lieid_v plus_product(lieid_v a, lieid_v b, lieid_v c)
{
#if LIEID_LANES == 8 && defined(__AVX512F__)
    return (lieid_v)_mm512_fmadd_pd((__m512d)b, (__m512d)c, (__m512d)a);
#elif LIEID_LANES == 4 && defined(__FMA__)
    return (lieid_v)_mm256_fmadd_pd((__m256d)b, (__m256d)c, (__m256d)a);
#else
    return a + b * c;
#endif
}

INLINE double total(lieid_v x)
{
#if LIEID_LANES == 8
    return ((LIEID_LANE(x, 0) + LIEID_LANE(x, 4)) + (LIEID_LANE(x, 1) + LIEID_LANE(x, 5)))
           + ((LIEID_LANE(x, 2) + LIEID_LANE(x, 6)) + (LIEID_LANE(x, 3) + LIEID_LANE(x, 7)));
#else
    double sum = 0.0;
    UNROLL
    for (int k = 0; k < LIEID_LANES; k++) sum += LIEID_LANE(x, k);
    return sum;
#endif
}

/* sums[i * PANEL + c] = v_i . b_c over count samples, a multiple of the lanes */
INLINE void products(double *const *v, const int rows, double *const *b, const int columns,
                     int64_t count, double *sums)
{
    lieid_v sum[PANEL * PANEL];
    UNROLL
    for (int i = 0; i < rows; i++) {
        UNROLL
        for (int c = 0; c < columns; c++) sum[i * PANEL + c] = lieid_splat(0.0);
    }
    for (int64_t s = 0; s < count; s += LIEID_LANES) {
        lieid_v right[PANEL];
        UNROLL
        for (int c = 0; c < columns; c++) right[c] = lieid_load(b[c] + s);
        UNROLL
        for (int i = 0; i < rows; i++) {
            const lieid_v left = lieid_load(v[i] + s);
            UNROLL
            for (int c = 0; c < columns; c++)
                sum[i * PANEL + c] = plus_product(sum[i * PANEL + c], left, right[c]);
        }
    }
    UNROLL
    for (int i = 0; i < rows; i++) {
        UNROLL
        for (int c = 0; c < columns; c++) sums[i * PANEL + c] = total(sum[i * PANEL + c]);
    }
}

/* b_c -= sum over i of v_i * factors[i * PANEL + c] */
INLINE void subtract(double *const *v, const int rows, double *const *b, const int columns,
                     int64_t count, const double *factors)
{
    lieid_v factor[PANEL * PANEL];
    UNROLL
    for (int i = 0; i < rows; i++) {
        UNROLL
        for (int c = 0; c < columns; c++)
            factor[i * PANEL + c] = lieid_splat(-factors[i * PANEL + c]);
    }
    for (int64_t s = 0; s < count; s += LIEID_LANES) {
        lieid_v right[PANEL];
        UNROLL
        for (int c = 0; c < columns; c++) right[c] = lieid_load(b[c] + s);
        UNROLL
        for (int i = 0; i < rows; i++) {
            const lieid_v left = lieid_load(v[i] + s);
            UNROLL
            for (int c = 0; c < columns; c++)
                right[c] = plus_product(right[c], left, factor[i * PANEL + c]);
        }
        UNROLL
        for (int c = 0; c < columns; c++) lieid_store(b[c] + s, right[c]);
    }
}

/* Columns b_0 .. b_(rest - 1) lose v * steps; v is scaled to a reflection. */
INLINE void rest_of_panel(double *v, double *const *b, const int rest, int64_t count, double scale,
                          const double *steps)
{
    const lieid_v by = lieid_splat(scale);
    lieid_v step[PANEL];
    double *to[PANEL];
    UNROLL
    for (int l = 0; l < rest; l++) {
        step[l] = lieid_splat(-steps[l]);
        to[l] = b[l];
    }
    for (int64_t s = 0; s < count; s += LIEID_LANES) {
        const lieid_v left = lieid_load(v + s);
        UNROLL
        for (int l = 0; l < rest; l++)
            lieid_store(to[l] + s, plus_product(lieid_load(to[l] + s), left, step[l]));
        lieid_store(v + s, left * by);
    }
}

/* Reflect away columns first .. first + width - 1; v_i is left in b[i] and T in t. */
static void reduce_panel(double *const *b, const int width, int64_t count, double *r, int64_t ld,
                         double *t)
{
    double *all[PANEL];
    for (int i = 0; i < PANEL; i++) all[i] = b[i < width ? i : 0];
    for (int c = 0; c < width; c++) {
        double dots[PANEL * PANEL], steps[PANEL * PANEL] = {0.0};
        products(all, PANEL, all + c, 1, count, dots);
        const double square = dots[c * PANEL], before = r[c * ld + c];
        const double length = sqrt(before * before + square);
        const int null = square == 0.0;
        const double after = before > 0.0 ? -length : length;
        const double tau = null ? 0.0 : (after - before) / after;
        const double scale = null ? 0.0 : 1.0 / (before - after);
        if (!null) r[c * ld + c] = after;
        for (int l = c + 1; l < width; l++) {
            const double step = tau * (r[c * ld + l] + scale * dots[l * PANEL]);
            r[c * ld + l] -= step;
            steps[l] = step * scale;
        }
        switch (width - c - 1) { /* columns that follow in the panel */
#define REST(count_)                                                              \
        case count_:                                                              \
            rest_of_panel(b[c], all + c + 1, count_, count, scale, steps + c + 1); \
            break;
            REST(0) REST(1) REST(2) REST(3)
#if LIEID_LANES == 8
            REST(4) REST(5) REST(6) REST(7)
#endif
        }
        for (int i = 0; i < c; i++) {
            double sum = 0.0;
            for (int k = i; k < c; k++) sum += t[i * PANEL + k] * scale * dots[k * PANEL];
            t[i * PANEL + c] = -tau * sum;
        }
        t[c * PANEL + c] = tau;
    }
}

/* Apply a whole panel's reflections to `columns` columns and their part of R. */
INLINE void apply(double *const *v, const double *t, double *const *b, const int columns,
                  int64_t count, double *r, int64_t ld)
{
    double sums[PANEL * PANEL], steps[PANEL * PANEL];
    products(v, PANEL, b, columns, count, sums);
    for (int c = 0; c < columns; c++)
        for (int i = 0; i < PANEL; i++) {
            double step = 0.0;
            for (int k = 0; k <= i; k++)
                step += t[k * PANEL + i] * (sums[k * PANEL + c] + r[k * ld + c]);
            steps[i * PANEL + c] = step;
        }
    for (int i = 0; i < PANEL; i++)
        for (int c = 0; c < columns; c++) r[i * ld + c] -= steps[i * PANEL + c];
    subtract(v, PANEL, b, columns, count, steps);
}

/* Reduce `count` samples, a multiple of the lanes, of columns b[0 .. size - 1] into R. */
static void reduce(double *const *b, int64_t size, int64_t count, double *r)
{
    for (int64_t first = 0; first < size; first += PANEL) {
        double t[PANEL * PANEL];
        double *corner = r + first * size + first;
        const int width = size - first < PANEL ? (int)(size - first) : PANEL;
        reduce_panel(b + first, width, count, corner, size, t);
        int64_t c = first + PANEL;
        for (; c + GROUP <= size; c += GROUP)
            apply(b + first, t, b + c, GROUP, count, r + first * size + c, size);
        for (; c < size; c++)
            apply(b + first, t, b + c, 1, count, r + first * size + c, size);
    }
}

/* Reduce a Fortran-ordered matrix (samples, size), ld doubles from column to column, into R.
 * Its memory is used up. Rows up to a multiple of the lanes must be there; they count, so zeros.
 */
void lieid_reduce_matrix(double *matrix, int64_t samples, int64_t size, int64_t ld,
                         double **columns, double *r)
{
    const int64_t whole = (samples + LIEID_LANES - 1) / LIEID_LANES * LIEID_LANES;
    for (int64_t k = 0; k < size; k++) columns[k] = matrix + k * ld;
    reduce(columns, size, whole, r);
}
