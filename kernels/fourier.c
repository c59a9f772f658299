/* Fourier transforms of many rows at once (Stockham's: no number is moved to its place afterwards). Vectors hold
   numbers of neighbouring rows, so that none has to be shuffled. */

#include "kernels.h"

/* Transform `radix` complex numbers. */
static inline __attribute__((always_inline)) void short_transform(int radix, const Vector *a, const Vector *b,
                                                                  Vector *real, Vector *imaginary)
{
    if (radix == 2) {
        real[0] = a[0] + a[1], imaginary[0] = b[0] + b[1];
        real[1] = a[0] - a[1], imaginary[1] = b[0] - b[1];
    } else if (radix == 3) {
        Vector sum_a = a[1] + a[2], sum_b = b[1] + b[2];
        Vector mean_a = a[0] - 0.5f * sum_a, mean_b = b[0] - 0.5f * sum_b;
        Vector apart_a = 0.8660254037844386f * (a[1] - a[2]), apart_b = 0.8660254037844386f * (b[1] - b[2]);
        real[0] = a[0] + sum_a, imaginary[0] = b[0] + sum_b;
        real[1] = mean_a + apart_b, imaginary[1] = mean_b - apart_a;
        real[2] = mean_a - apart_b, imaginary[2] = mean_b + apart_a;
    } else if (radix == 4) {
        Vector even_a = a[0] + a[2], even_b = b[0] + b[2], odd_a = a[1] + a[3], odd_b = b[1] + b[3];
        Vector apart_a = a[0] - a[2], apart_b = b[0] - b[2], turned_a = b[1] - b[3], turned_b = a[3] - a[1];
        real[0] = even_a + odd_a, imaginary[0] = even_b + odd_b;
        real[1] = apart_a + turned_a, imaginary[1] = apart_b + turned_b;
        real[2] = even_a - odd_a, imaginary[2] = even_b - odd_b;
        real[3] = apart_a - turned_a, imaginary[3] = apart_b - turned_b;
    } else {
        const float c1 = 0.30901699437494745f, c2 = -0.8090169943749473f;
        const float s1 = 0.9510565162951535f, s2 = 0.5877852522924731f;
        Vector sum_a = a[1] + a[4], sum_b = b[1] + b[4], next_a = a[2] + a[3], next_b = b[2] + b[3];
        Vector apart_a = a[1] - a[4], apart_b = b[1] - b[4], wide_a = a[2] - a[3], wide_b = b[2] - b[3];
        Vector one_a = a[0] + c1 * sum_a + c2 * next_a, one_b = b[0] + c1 * sum_b + c2 * next_b;
        Vector two_a = a[0] + c2 * sum_a + c1 * next_a, two_b = b[0] + c2 * sum_b + c1 * next_b;
        Vector turn_a = s1 * apart_b + s2 * wide_b, turn_b = s1 * apart_a + s2 * wide_a;
        Vector back_a = s2 * apart_b - s1 * wide_b, back_b = s2 * apart_a - s1 * wide_a;
        real[0] = a[0] + sum_a + next_a, imaginary[0] = b[0] + sum_b + next_b;
        real[1] = one_a + turn_a, imaginary[1] = one_b - turn_b;
        real[2] = two_a + back_a, imaginary[2] = two_b - back_b;
        real[3] = two_a - back_a, imaginary[3] = two_b + back_b;
        real[4] = one_a - turn_a, imaginary[4] = one_b + turn_b;
    }
}

/* What is left of the transform are `length / stride` numbers, `stride` of them side by side: combine `radix` each. */
static inline __attribute__((always_inline)) void pass(int radix, Planes from, Planes to, int64_t stride,
                                                       int64_t length, int64_t width, const float (*roots)[2])
{
    int64_t left = length / stride / radix, count = stride * width;
    for (int64_t j = 0; j < left; j++)
        for (int64_t i = 0; i < count; i += LANES) {
            Vector a[5], b[5], real[5], imaginary[5];
            for (int r = 0; r < radix; r++) {
                int64_t at = (j + left * r) * count + i;
                a[r] = load(from.real + at), b[r] = load(from.imaginary + at);
            }
            short_transform(radix, a, b, real, imaginary);
            for (int k = 0; k < radix; k++) {
                const float *root = roots[j * k * stride];
                int64_t at = (radix * j + k) * count + i;
                store(to.real + at, real[k] * root[0] - imaginary[k] * root[1]);
                store(to.imaginary + at, real[k] * root[1] + imaginary[k] * root[0]);
            }
        }
}

/* The same for any `radix`, sum by sum. */
static void long_pass(int64_t radix, Planes from, Planes to, int64_t stride, int64_t length, int64_t width,
                      const float (*roots)[2])
{
    int64_t left = length / stride / radix, count = stride * width;
    for (int64_t j = 0; j < left; j++)
        for (int64_t k = 0; k < radix; k++)
            for (int64_t i = 0; i < count; i += LANES) {
                Vector real = {0}, imaginary = {0};
                for (int64_t r = 0; r < radix; r++) {
                    /* of the short transform, and of the turn that follows */
                    const float *root = roots[(k * r % radix * (length / radix) + j * k * stride) % length];
                    int64_t at = (j + left * r) * count + i;
                    Vector a = load(from.real + at), b = load(from.imaginary + at);
                    real += a * root[0] - b * root[1], imaginary += a * root[1] + b * root[0];
                }
                store(to.real + (radix * j + k) * count + i, real);
                store(to.imaginary + (radix * j + k) * count + i, imaginary);
            }
}

/* Transform the (length, width) planes `from` along their first axis; return where the result is, `from` or `to`. The
   `roots` of unity are clockwise. With real and imaginary parts exchanged it is the inverse, times the length. */
Planes transform(Planes from, Planes to, int64_t length, int64_t width, const float (*roots)[2])
{
    for (int64_t stride = 1, radix; stride < length; stride *= radix) {
        int64_t left = length / stride;
        radix = left % 4 == 0 ? 4 : 2;
        while (left % radix != 0) radix++;
        if (radix == 2) pass(2, from, to, stride, length, width, roots);
        else if (radix == 3) pass(3, from, to, stride, length, width, roots);
        else if (radix == 4) pass(4, from, to, stride, length, width, roots);
        else if (radix == 5) pass(5, from, to, stride, length, width, roots);
        else long_pass(radix, from, to, stride, length, width, roots);
        Planes swap = from;
        from = to, to = swap;
    }
    return from;
}
