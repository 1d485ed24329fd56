/* Runs generated kernels over batches of samples, LIEID_LANES samples at a time.
 *
 * A kernel is straight-line code on vectors: it reads value j of argument a at in[a] + j * LANES
 * and writes value k of row i at rows[i] + k * ld. Everything here keeps to the samples it is
 * given, so several threads may work on one batch.
 */
#include "lieid_lanes.h"

#include <stdlib.h>

#if defined(__AVX__) || defined(__SSE2__)
#include <immintrin.h>
#endif

enum { SAMPLE, CONSTANT, SINE, COSINE }; /* what an argument is */

typedef void (*lieid_kernel)(const double *const *in, double *const *rows, ptrdiff_t ld);

typedef struct {
    const char *data;     /* NULL: zeros */
    int64_t width;        /* values per sample */
    int64_t sample_bytes; /* from one sample to the next */
    int64_t value_bytes;  /* from one value to the next */
    int64_t role;
} lieid_argument;

typedef struct {
    lieid_kernel kernel;
    int64_t argument_count;
    const int64_t *arguments; /* which of the plan's arguments it takes */
    int64_t row_count;
    const int64_t *row_starts; /* where the values of each row begin */
} lieid_call;

typedef struct {
    int64_t argument_count;
    const lieid_argument *arguments; /* sines and cosines are those of the first one */
    int64_t call_count;
    const lieid_call *calls;
} lieid_plan;

typedef struct {
    double *memory;
    const double **argument; /* per argument: its lanes, or the constants */
    const double **in;
    double **rows;
    double *values;
    double *block;
} lieid_space;

int64_t lieid_lane_count(void) { return LIEID_LANES; }

static size_t whole_lines(size_t doubles) { return (doubles + 7) / 8 * 8; }

/* One allocation for a whole slice of samples; returns 0 or -1. */
static int reserve(lieid_space *space, const lieid_plan *plan, size_t values, size_t block)
{
    size_t most_rows = 1, lanes = 0;
    for (int64_t c = 0; c < plan->call_count; c++)
        if ((size_t)plan->calls[c].row_count > most_rows)
            most_rows = (size_t)plan->calls[c].row_count;
    for (int64_t a = 0; a < plan->argument_count; a++)
        if (plan->arguments[a].role != CONSTANT)
            lanes += whole_lines((size_t)plan->arguments[a].width * LIEID_LANES);
    const size_t count = (size_t)plan->argument_count;
    const size_t pointers = whole_lines(2 * count + most_rows); /* a pointer is no larger */
    const size_t total = lanes + whole_lines(values) + whole_lines(block) + pointers;
    double *next = aligned_alloc(64, total * sizeof(double));
    if (next == NULL) return -1;
    memset(next, 0, total * sizeof(double));
    space->memory = next;
    space->argument = (const double **)(void *)next;
    space->in = space->argument + count;
    space->rows = (double **)(void *)(space->in + count);
    next += pointers;
    space->values = next;
    next += whole_lines(values);
    space->block = next;
    next += whole_lines(block);
    for (int64_t a = 0; a < plan->argument_count; a++) {
        const lieid_argument *argument = &plan->arguments[a];
        if (argument->role == CONSTANT) {
            space->argument[a] = (const double *)(const void *)argument->data;
        } else {
            space->argument[a] = next;
            next += whole_lines((size_t)argument->width * LIEID_LANES);
        }
    }
    return 0;
}

#define AT(k) (*(const double *)(const void *)(p + (k) * step))
#if LIEID_LANES == 8
#define GATHER (lieid_v){AT(0), AT(1), AT(2), AT(3), AT(4), AT(5), AT(6), AT(7)}
#elif LIEID_LANES == 4
#define GATHER (lieid_v){AT(0), AT(1), AT(2), AT(3)}
#elif LIEID_LANES == 2
#define GATHER (lieid_v){AT(0), AT(1)}
#else
#define GATHER AT(0)
#endif

enum { AHEAD = 128 };     /* samples */
enum { FAR_APART = 512 }; /* bytes from sample to sample, beyond which prefetching costs more */

/* Samples s .. s + count - 1 into lanes; lanes beyond them repeat the last one. */
static void gather(const lieid_argument *argument, int64_t s, int64_t count, double *lanes)
{
    const char *p = argument->data + s * argument->sample_bytes;
    const int64_t step = argument->sample_bytes;
    if (count == LIEID_LANES) {
        /* the processor's own prefetching stops at every page */
        const int64_t ahead = AHEAD * step, bytes = LIEID_LANES * step;
        if (step <= FAR_APART)
            for (int64_t b = 0; b < bytes; b += 64) __builtin_prefetch(p + ahead + b);
        for (int64_t j = 0; j < argument->width; j++, p += argument->value_bytes)
            lieid_store(lanes + j * LIEID_LANES, GATHER);
        return;
    }
    for (int64_t j = 0; j < argument->width; j++, p += argument->value_bytes)
        for (int64_t k = 0; k < LIEID_LANES; k++)
            lanes[j * LIEID_LANES + k] = AT(k < count ? k : count - 1);
}

/* All sines and cosines of one group; the rare huge angle is mended after the loop. */
static void sines(const double *q, int64_t n, double *sine, double *cosine)
{
    lieid_i far = LIEID_BITS(lieid_splat(0.0));
    for (int64_t j = 0; j < n; j++) {
        lieid_v s, c;
        const lieid_v x = lieid_load(q + j * LIEID_LANES);
        lieid_sincos_near(x, &s, &c);
        far |= LIEID_MASK(lieid_fabs(x) > lieid_splat(LIEID_SINCOS_LIMIT));
        lieid_store(sine + j * LIEID_LANES, s);
        lieid_store(cosine + j * LIEID_LANES, c);
    }
    if (__builtin_expect(lieid_any(far), 0))
        for (int64_t j = 0; j < n * LIEID_LANES; j++)
            if (fabs(q[j]) > LIEID_SINCOS_LIMIT) {
                sine[j] = sin(q[j]);
                cosine[j] = cos(q[j]);
            }
}

static void load_group(const lieid_plan *plan, const lieid_space *space, int64_t s, int64_t count)
{
    double *sine = NULL, *cosine = NULL;
    for (int64_t a = 0; a < plan->argument_count; a++) {
        const lieid_argument *argument = &plan->arguments[a];
        double *lanes = (double *)(uintptr_t)space->argument[a];
        if (argument->role == SAMPLE && argument->data != NULL) gather(argument, s, count, lanes);
        if (argument->role == SINE) sine = lanes;
        if (argument->role == COSINE) cosine = lanes;
    }
    if (sine != NULL && cosine != NULL)
        sines(space->argument[0], plan->arguments[0].width, sine, cosine);
}

/* Values of one group: value k of the whole result at values + k * ld. */
static void evaluate_group(const lieid_plan *plan, const lieid_space *space, double *values,
                           int64_t ld)
{
    for (int64_t c = 0; c < plan->call_count; c++) {
        const lieid_call *call = &plan->calls[c];
        for (int64_t a = 0; a < call->argument_count; a++)
            space->in[a] = space->argument[call->arguments[a]];
        for (int64_t i = 0; i < call->row_count; i++)
            space->rows[i] = values + call->row_starts[i] * ld;
        call->kernel(space->in, space->rows, (ptrdiff_t)ld);
    }
}

#if defined(__has_builtin)
#if __has_builtin(__builtin_shufflevector)
#define LIEID_SHUFFLES 1
#endif
#endif

/* Value sources[k] of every lane to to[k], the lanes stride apart. */
static inline void transpose(const double *values, const int32_t *sources, double *to,
                             int64_t stride)
{
#define ROW(k) lieid_load(values + (int64_t)sources[k] * LIEID_LANES)
#if LIEID_LANES == 8 && defined(LIEID_SHUFFLES)
#define LOW(a, b) __builtin_shufflevector(a, b, 0, 8, 2, 10, 4, 12, 6, 14)
#define HIGH(a, b) __builtin_shufflevector(a, b, 1, 9, 3, 11, 5, 13, 7, 15)
#define LOW2(a, b) __builtin_shufflevector(a, b, 0, 1, 8, 9, 4, 5, 12, 13)
#define HIGH2(a, b) __builtin_shufflevector(a, b, 2, 3, 10, 11, 6, 7, 14, 15)
#define LOW4(a, b) __builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11)
#define HIGH4(a, b) __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15)
    const lieid_v r0 = ROW(0), r1 = ROW(1), r2 = ROW(2), r3 = ROW(3);
    const lieid_v r4 = ROW(4), r5 = ROW(5), r6 = ROW(6), r7 = ROW(7);
    const lieid_v a0 = LOW(r0, r1), a1 = HIGH(r0, r1), a2 = LOW(r2, r3), a3 = HIGH(r2, r3);
    const lieid_v a4 = LOW(r4, r5), a5 = HIGH(r4, r5), a6 = LOW(r6, r7), a7 = HIGH(r6, r7);
    const lieid_v b0 = LOW2(a0, a2), b1 = LOW2(a1, a3), b2 = HIGH2(a0, a2), b3 = HIGH2(a1, a3);
    const lieid_v b4 = LOW2(a4, a6), b5 = LOW2(a5, a7), b6 = HIGH2(a4, a6), b7 = HIGH2(a5, a7);
    lieid_store(to, LOW4(b0, b4));
    lieid_store(to + stride, LOW4(b1, b5));
    lieid_store(to + 2 * stride, LOW4(b2, b6));
    lieid_store(to + 3 * stride, LOW4(b3, b7));
    lieid_store(to + 4 * stride, HIGH4(b0, b4));
    lieid_store(to + 5 * stride, HIGH4(b1, b5));
    lieid_store(to + 6 * stride, HIGH4(b2, b6));
    lieid_store(to + 7 * stride, HIGH4(b3, b7));
#elif LIEID_LANES == 4 && defined(LIEID_SHUFFLES)
    const lieid_v r0 = ROW(0), r1 = ROW(1), r2 = ROW(2), r3 = ROW(3);
    const lieid_v a0 = __builtin_shufflevector(r0, r1, 0, 4, 2, 6);
    const lieid_v a1 = __builtin_shufflevector(r0, r1, 1, 5, 3, 7);
    const lieid_v a2 = __builtin_shufflevector(r2, r3, 0, 4, 2, 6);
    const lieid_v a3 = __builtin_shufflevector(r2, r3, 1, 5, 3, 7);
    lieid_store(to, __builtin_shufflevector(a0, a2, 0, 1, 4, 5));
    lieid_store(to + stride, __builtin_shufflevector(a1, a3, 0, 1, 4, 5));
    lieid_store(to + 2 * stride, __builtin_shufflevector(a0, a2, 2, 3, 6, 7));
    lieid_store(to + 3 * stride, __builtin_shufflevector(a1, a3, 2, 3, 6, 7));
#else
    for (int64_t lane = 0; lane < LIEID_LANES; lane++)
        for (int64_t k = 0; k < LIEID_LANES; k++)
            to[lane * stride + k] = values[(int64_t)sources[k] * LIEID_LANES + lane];
#endif
}

/* Copy past the caches: memory that is written once need not be read first. */
static void stream(double *to, const double *from, int64_t count)
{
#if defined(__AVX512F__)
    enum { LINE = 8 };
#elif defined(__AVX__)
    enum { LINE = 4 };
#elif defined(__SSE2__)
    enum { LINE = 2 };
#endif
#if defined(__SSE2__)
    int64_t k = 0;
    while (k < count && (uintptr_t)(to + k) % 64 != 0) { to[k] = from[k]; k++; }
    const int64_t end = k + (count - k) / 8 * 8;
    for (; k < end; k += LINE) {
#if defined(__AVX512F__)
        _mm512_stream_pd(to + k, _mm512_loadu_pd(from + k));
#elif defined(__AVX__)
        _mm256_stream_pd(to + k, _mm256_loadu_pd(from + k));
#else
        _mm_stream_pd(to + k, _mm_loadu_pd(from + k));
#endif
    }
    for (; k < count; k++) to[k] = from[k];
#else
    memcpy(to, from, (size_t)count * sizeof(double));
#endif
}

/* Dense results of samples first .. last - 1, size doubles each, at out + sample * size.
 *
 * Chunk c gathers LANES values, sources[c * LANES ...] (value_count is the zero), to offset
 * offsets[c] of each sample's result; a chunk that reaches over a result's end comes first and
 * carries zeros there. Structural zeros between chunks stay as they are in the block.
 * Returns 0, or -1 without memory.
 */
int lieid_dense(const lieid_plan *plan, int64_t first, int64_t last, double *out, int64_t size,
                int64_t value_count, int64_t chunk_count, const int64_t *offsets,
                const int32_t *sources, int past_caches)
{
    lieid_space space;
    if (reserve(&space, plan, (size_t)(value_count + 1) * LIEID_LANES,
                (size_t)(size + 1) * LIEID_LANES) != 0)
        return -1;
    for (int64_t s = first; s < last; s += LIEID_LANES) {
        const int64_t count = last - s < LIEID_LANES ? last - s : LIEID_LANES;
        load_group(plan, &space, s, count);
        evaluate_group(plan, &space, space.values, LIEID_LANES);
        for (int64_t c = 0; c < chunk_count; c++)
            transpose(space.values, sources + c * LIEID_LANES, space.block + offsets[c], size);
        if (past_caches)
            stream(out + s * size, space.block, count * size);
        else
            memcpy(out + s * size, space.block, (size_t)(count * size) * sizeof(double));
    }
#if defined(__SSE2__)
    if (past_caches) _mm_sfence();
#endif
    free(space.memory);
    return 0;
}

/* Values of samples first .. last - 1, one after the other: value k of sample s at
 * out[k * ld + s - first]. Returns 0, or -1 without memory.
 */
int lieid_columns(const lieid_plan *plan, int64_t first, int64_t last, double *out, int64_t ld,
                  int64_t value_count)
{
    lieid_space space;
    if (reserve(&space, plan, (size_t)value_count * LIEID_LANES, 0) != 0) return -1;
    for (int64_t s = first; s < last; s += LIEID_LANES) {
        const int64_t count = last - s < LIEID_LANES ? last - s : LIEID_LANES;
        load_group(plan, &space, s, count);
        if (count == LIEID_LANES) {
            evaluate_group(plan, &space, out + (s - first), ld);
            continue;
        }
        evaluate_group(plan, &space, space.values, LIEID_LANES);
        for (int64_t k = 0; k < value_count; k++)
            memcpy(out + k * ld + (s - first), space.values + k * LIEID_LANES,
                   (size_t)count * sizeof(double));
    }
    free(space.memory);
    return 0;
}

#if LIEID_LANES == 1
/* States of effects with memory, row after row: states (samples, state_count) with the first row
 * given. At sample s argument a begins at arguments[a] + (s - 1) * steps[a], steps in doubles.
 * Returns 0, or -1 without memory.
 */
int lieid_states(lieid_kernel kernel, int64_t argument_count, const double *const *arguments,
                 const int64_t *steps, int64_t state_count, double *states, int64_t samples)
{
    const double **in = malloc(((size_t)argument_count + 1) * sizeof *in);
    double **rows = malloc(((size_t)state_count + 1) * sizeof *rows);
    const int failed = in == NULL || rows == NULL;
    for (int64_t s = 1; s < samples && !failed; s++) {
        for (int64_t a = 0; a < argument_count; a++) in[a] = arguments[a] + (s - 1) * steps[a];
        for (int64_t i = 0; i < state_count; i++) rows[i] = states + s * state_count + i;
        kernel(in, rows, 1);
    }
    free(in);
    free(rows);
    return failed ? -1 : 0;
}
#endif
