/* The loops of the phase congruency (Kovesi 1999). */

#include "kernels.h"

#define SCALES 4
#define ORIENTATIONS 6

/* The spectrum of an image and the filters of one orientation, (m, width) by frequency along both axes of the image,
   of which the second one, of n pixels, has no negative ones; the radial filters and the radius have no negative ones
   along the first axis either. From the number `reach` on a scale is zero along the second. */
typedef struct {
    const float *real, *imaginary;
    const float *radial, *inverse_radius; /* (SCALES, m / 2 + 1, width), (m / 2 + 1, width) */
    const float *across, *along;          /* parts of the frequency in the direction of the filter, (width,), (m,) */
    const int64_t *reach;
    int64_t n, m, width;
} Filtered;

/* Transform back, with the roots of the transform; the result is `count` times as large. */
static Planes transformed_back(Planes from, Planes to, int64_t count, const float (*roots)[2])
{
    Planes exchanged[] = {{from.imaginary, from.real}, {to.imaginary, to.real}};
    Planes done = transform(exchanged[0], exchanged[1], count, LANES, roots), back = {done.imaginary, done.real};
    return back;
}

/* The angular filter of some frequencies, (m, LANES), over the number of pixels, which both transforms leave. */
static void fill_angular(const Filtered *of, int64_t start, float *out)
{
    float per_pixel = 1.0f / (float)(of->n * of->m);
    for (int64_t col = 0; col < of->m; col++) {
        Vector inverse_radius = load(of->inverse_radius + smaller(col, of->m - col) * of->width + start);
        Vector cosine = (load(of->across + start) + of->along[col]) * inverse_radius;
        Vector part = positive(2.0f * cosine - 1.0f); /* (1 + cos 3 angle) / 2 up to 60 degrees, by the cosine */
        store(out + col * LANES, 0.5f * per_pixel * (1.0f + cosine) * part * part);
    }
}

/* Filter some frequencies by one scale and transform them along the first axis, into the rows (n, cols) of out. */
static void transform_first(const Filtered *of, int64_t scale, int64_t start, const float *angular, Planes one,
                            Planes other, const float (*roots)[2], int64_t cols, Planes out)
{
    for (int64_t col = 0; col < of->m; col++) {
        int64_t row = smaller(col, of->m - col), at = col * of->width + start, to = col * LANES;
        const float *radial = of->radial + (scale * (of->m / 2 + 1) + row) * of->width + start;
        Vector factor = load(angular + to) * load(radial);
        store(one.real + to, load(of->real + at) * factor);
        store(one.imaginary + to, load(of->imaginary + at) * factor);
    }
    Planes done = transformed_back(one, other, of->m, roots);
    for (int64_t i = 0; i < smaller(LANES, of->reach[scale] - start); i++) {
        float *real = out.real + (start + i) * cols, *imaginary = out.imaginary + (start + i) * cols;
        for (int64_t col = 0; col < of->m; col++) {
            real[col] = done.real[col * LANES + i];
            imaginary[col] = done.imaginary[col * LANES + i];
        }
    }
}

/* 1 / (1 + exp(gain * (cut_off - width))), by the continued fraction of tanh, good to 1e-7: a call of exp would keep
   the loop from the vector units. */
static inline float sigmoid(float width, float cut_off, float gain)
{
    float t = 0.5f * gain * (width - cut_off), square = t * t;
    float above = 135135.0f + square * (17325.0f + square * (378.0f + square));
    float below = 135135.0f + square * (62370.0f + square * (3150.0f + 28.0f * square));
    return 0.5f + 0.5f * t * above / below;
}

/* Combine the responses of one orientation by scale, n numbers each, into its phase congruency. */
static void combine_scales(const Planes responses[SCALES], float epsilon, float cut_off, float gain, int64_t n,
                           float *restrict out)
{
    for (int64_t i = 0; i < n; i++) {
        float even = 0.0f, odd = 0.0f, sum = 0.0f, largest = 0.0f, across = 0.0f;
        for (int scale = 0; scale < SCALES; scale++) {
            float real = responses[scale].real[i], imaginary = responses[scale].imaginary[i];
            float amplitude = __builtin_sqrtf(real * real + imaginary * imaginary);
            even += real;
            odd += imaginary;
            sum += amplitude;
            largest = largest > amplitude ? largest : amplitude;
        }
        for (int scale = 0; scale < SCALES; scale++)
            across += __builtin_fabsf(responses[scale].real[i] * odd - responses[scale].imaginary[i] * even);
        float square = even * even + odd * odd;
        float energy = (square - across) / (__builtin_sqrtf(square) + epsilon);
        energy = energy > 0.0f ? energy : 0.0f;
        float width = (sum / (largest + epsilon) - 1.0f) / (float)(SCALES - 1);
        out[i] = sigmoid(width, cut_off, gain) * energy / (sum + epsilon);
    }
}

/* Fill in the phase congruency of one orientation where `out` has rows and cols, at most n and m; its numbers are so
   far apart along both. `roots` are those of n and then of m. `memory` is as large as Python makes it. */
EXPORT void oriented_map(const Filtered *of, const float (*roots)[2], float epsilon, float cut_off, float gain,
                         float *memory, int64_t rows, int64_t cols, int64_t row_apart, int64_t col_apart, float *out)
{
    int64_t most = larger(of->n, of->m) * LANES, used = 0;
    int64_t padded = rounded_up(of->m) + LANES; /* rows of 2^k numbers would fall on the same cache lines */
    Planes strips[SCALES], spare = planes_of(memory, &used, most), spectra[SCALES];
    for (int scale = 0; scale < SCALES; scale++) strips[scale] = planes_of(memory, &used, most);
    for (int scale = 0; scale < SCALES; scale++) spectra[scale] = planes_of(memory, &used, of->reach[scale] * padded);
    float *plane = memory + used;
    for (int64_t start = 0; start < of->reach[0]; start += LANES) {
        fill_angular(of, start, plane);
        for (int scale = 0; scale < SCALES && start < of->reach[scale]; scale++)
            transform_first(of, scale, start, plane, strips[0], spare, roots + of->n, padded, spectra[scale]);
    }
    for (int64_t start = 0; start < cols; start += LANES) {
        for (int scale = 0; scale < SCALES; scale++) {
            Planes strip = strips[scale];
            for (int64_t row = 0; row < of->n; row++) {
                int64_t at = row * padded + start, to = row * LANES;
                Vector none = {0};
                store(strip.real + to, row < of->reach[scale] ? load(spectra[scale].real + at) : none);
                store(strip.imaginary + to, row < of->reach[scale] ? load(spectra[scale].imaginary + at) : none);
            }
            strips[scale] = transformed_back(strip, spare, of->n, roots);
            if (strips[scale].real != strip.real) spare = strip;
        }
        combine_scales(strips, epsilon, cut_off, gain, rows * LANES, plane);
        for (int64_t row = 0; row < rows; row++)
            for (int64_t i = 0; i < smaller(LANES, cols - start); i++)
                out[row * row_apart + (start + i) * col_apart] = plane[row * LANES + i];
    }
}

/* Fill `out`, (n,), with the maximum moment of the oriented maps, (6, n); the (3, 6) `coefficients` are factors of
   their squares in the terms c, s and cs of the covariance. */
EXPORT void combine_orientations(const float *maps, const float *coefficients, float epsilon, int64_t n,
                                 float *restrict out)
{
    for (int64_t i = 0; i < n; i++) {
        float c = 0.0f, s = 0.0f, cs = 0.0f;
        for (int k = 0; k < ORIENTATIONS; k++) {
            float square = maps[k * n + i] * maps[k * n + i];
            c += coefficients[k] * square;
            s += coefficients[ORIENTATIONS + k] * square;
            cs += coefficients[2 * ORIENTATIONS + k] * square;
        }
        float root = __builtin_sqrtf(cs * cs + (c - s) * (c - s));
        out[i] = 0.5f * (c + s + root + epsilon);
    }
}
