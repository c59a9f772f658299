/* What the files of the kernels share. `pcwlad_geo/matching/kernels` calls them; what it calls is EXPORTed.

   Arrays are C-contiguous. Windows are flat: rows of `width` numbers, of which the first `cols` count; what
   lies between is finite and has weight 0. Vectors of eight numbers may read and write it, and the rows after the
   last. Compilers make vectors of some loops only, and each of other ones: those that count are written so. */

#ifndef PCWLAD_GEO_KERNELS_H
#define PCWLAD_GEO_KERNELS_H

#include <stdint.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

#define LANES 8 /* numbers in a vector: what AVX2 holds */
#define MOMENTS 15
#define MIN_CONTRAST 1e-6 /* a window whose variance is a smaller share of its mean square is flat in float32 */
#define LARGEST_TERMS 6 /* of a deformed window, in a component; of a local surface */

typedef float Vector __attribute__((vector_size(4 * LANES), aligned(4), may_alias)); /* any eight in a row */
typedef int32_t Bits __attribute__((vector_size(4 * LANES)));

static inline int64_t smaller(int64_t a, int64_t b) { return a < b ? a : b; }
static inline int64_t larger(int64_t a, int64_t b) { return a > b ? a : b; }
static inline int64_t rounded_up(int64_t count) { return (count + LANES - 1) / LANES * LANES; }
static inline double least(double a, double b) { return a < b ? a : b; }
static inline double most(double a, double b) { return a > b ? a : b; }
static inline Vector load(const float *from) { return *(const Vector *)from; }
static inline void store(float *to, Vector v) { *(Vector *)to = v; }
static inline Vector magnitude(Vector v) { return (Vector)((Bits)v & 0x7fffffff); }
static inline Vector positive(Vector v) { return (Vector)((Bits)(v > 0.0f) & (Bits)v); } /* or 0 */

/* A map, or its spline coefficients. With a step of 2 its even columns come before its odd ones. */
typedef struct {
    const float *values;
    int64_t rows, cols;
} Plane;

/* Complex numbers: two arrays of one shape. */
typedef struct {
    float *real, *imaginary;
} Planes;

/* Take two arrays of so many numbers from memory of which some are in use; without memory only count them. */
static inline Planes planes_of(float *memory, int64_t *used, int64_t count)
{
    Planes planes = {memory ? memory + *used : 0, memory ? memory + *used + count : 0};
    *used += 2 * count;
    return planes;
}

/* A window: its rows and columns of pixels, their distance, px, half a side of the local correlation, numbers in a
   row. */
typedef struct {
    int64_t rows, cols, step, correlation_half, width;
} Shape;

/* The window of a channel, the sides of the correlation included: the reference, the sampled target and its
   derivatives by column and row. */
typedef struct {
    float *reference, *value, *slope_x, *slope_y;
} Window;

/* Reference = offset + gain * sampled; 1 / sigma of what is left, 0 for plain least squares. */
typedef struct {
    float offset, gain, per_sigma;
} Gain;

Planes transform(Planes from, Planes to, int64_t length, int64_t width, const float (*roots)[2]);
int sample_shift(Plane plane, double row, double col, Shape shape, float *scratch, Window out);
int sample_deformed(Plane plane, double row, double col, const double linear[2][2], Shape shape, int slopes,
                    Window out);
void copy_window(Plane plane, int64_t row, int64_t col, Shape shape, float *out);
void reference_moments(Shape shape, const float *reference, float *columns, float *mean, float *precision);
void mutual_structure(Shape shape, Window window, float *columns, float *mean, float *precision,
                      const float *valid, float *structure);
double fit_gain(Shape shape, const float *weight, Window window, double *offset, double *gain);
double sum_of_deviations(Shape shape, const float *weight, Window window, Gain gain);
void weighted_moments(Shape shape, const float *weight, const float *monomial, Window window, Gain gain,
                      float *row_memory, double moments[MOMENTS]);
void add_block_scores(Shape shape, const float *weight, Window window, Gain gain, double fit[3][2], double scale,
                      int64_t blocks, float *row_memory, double (*scores)[2]);
int invert(double *matrix, int64_t n, int64_t stride);

#endif
