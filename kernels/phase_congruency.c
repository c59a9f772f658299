/* The loops of the phase congruency (Kovesi 1999). */

#include "kernels.h"

#define SCALES 4
#define ORIENTATIONS 6

typedef struct {
    float real, imaginary;
} Complex;

/* Copy the values at positive frequencies to the negative ones. */
static void mirror(const float *half, int64_t count, int64_t n, float *full)
{
    for (int64_t i = 0; i < count; i++) full[i] = half[i];
    for (int64_t i = 1; i < n - count + 1; i++) full[n - i] = half[i];
}

/* Multiply `rows` rows of half a spectrum of m columns, from `start` on, by one angular filter and by the radial ones
   of the first `scales` scales. `memory` holds 2 * m numbers. See the Python function of this name. */
EXPORT void filter_rows(const Complex *spectrum, const float *radial, const float *inverse_radius, const float *across,
                        const float *along, int64_t start, int64_t scales, int64_t rows, int64_t m, int64_t quadrant_rows,
                        int64_t quadrant_cols, float *memory, Complex *out)
{
    float *restrict angular = memory, *restrict mirrored = memory + m;
    for (int64_t row = 0; row < rows; row++) {
        mirror(inverse_radius + (start + row) * quadrant_cols, quadrant_cols, m, mirrored);
        for (int64_t col = 0; col < m; col++) {
            float cosine = (across[start + row] + along[col]) * mirrored[col];
            /* (1 + cos 3 angle) / 2 up to 60 degrees, as a polynomial in the cosine */
            float part = 2.0f * cosine - 1.0f;
            part = part > 0.0f ? part : 0.0f;
            angular[col] = 0.5f * (1.0f + cosine) * part * part;
        }
        for (int64_t scale = 0; scale < scales; scale++) {
            mirror(radial + (scale * quadrant_rows + start + row) * quadrant_cols, quadrant_cols, m, mirrored);
            const Complex *restrict source = spectrum + (start + row) * m;
            Complex *restrict target = out + (scale * rows + row) * m;
            for (int64_t col = 0; col < m; col++) {
                float factor = angular[col] * mirrored[col];
                target[col].real = source[col].real * factor;
                target[col].imaginary = source[col].imaginary * factor;
            }
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

/* Combine the responses of one orientation, (4, n), into its phase congruency, (n,). */
EXPORT void combine_scales(const Complex *responses, float epsilon, float cut_off, float gain, int64_t n,
                           float *restrict out)
{
    for (int64_t i = 0; i < n; i++) {
        float even = 0.0f, odd = 0.0f, sum = 0.0f, largest = 0.0f, across = 0.0f;
        for (int scale = 0; scale < SCALES; scale++) {
            Complex response = responses[scale * n + i];
            float amplitude =
                __builtin_sqrtf(response.real * response.real + response.imaginary * response.imaginary);
            even += response.real;
            odd += response.imaginary;
            sum += amplitude;
            largest = largest > amplitude ? largest : amplitude;
        }
        for (int scale = 0; scale < SCALES; scale++) {
            Complex response = responses[scale * n + i];
            across += __builtin_fabsf(response.real * odd - response.imaginary * even);
        }
        float square = even * even + odd * odd;
        float energy = (square - across) / (__builtin_sqrtf(square) + epsilon);
        energy = energy > 0.0f ? energy : 0.0f;
        float width = (sum / (largest + epsilon) - 1.0f) / (float)(SCALES - 1);
        out[i] = sigmoid(width, cut_off, gain) * energy / (sum + epsilon);
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
