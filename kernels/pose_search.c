/* The loops of the search for a pose. */

#include "kernels.h"

#define LAYER 4   /* planes of a layer: three harmonics, and what is usable */
#define STEP 4    /* cells a side for which an overlap counts */
#define BLOCK 256 /* numbers whose sums stay in the cache; Windows has no more than 4 kB of stack for them at once */

typedef float Pixel __attribute__((vector_size(4 * LAYER), aligned(4), may_alias));
typedef int32_t Lanes __attribute__((vector_size(4 * LAYER)));

/* Sum the cross spectra of an image, (harmonics, 2, n), and of `count` fixed ones over their harmonics: conj(moving) *
   fixed, or of a fixed image turned by half, whose spectrum is the conjugate. The second axis is the real and the
   imaginary part; in `out`, (count, n, 2), it is the last one. */
EXPORT void cross_spectra(const float *moving, const float *fixed, int64_t count, int64_t harmonics, int64_t n,
                          int64_t opposite, float *restrict out)
{
    float real[BLOCK], imaginary[BLOCK], sign = opposite ? -1.0f : 1.0f;
    for (int64_t image = 0; image < count; image++, fixed += harmonics * 2 * n, out += 2 * n) {
        for (int64_t start = 0; start < n; start += BLOCK) {
            int64_t length = smaller(BLOCK, n - start);
            for (int64_t i = 0; i < length; i++) real[i] = imaginary[i] = 0.0f;
            for (int64_t k = 0; k < harmonics; k++) {
                const float *a = moving + k * 2 * n + start, *b = fixed + k * 2 * n + start;
                for (int64_t i = 0; i < length; i++) {
                    float across = sign * a[i];
                    real[i] += a[i] * b[i] + sign * a[n + i] * b[n + i];
                    imaginary[i] += across * b[n + i] - a[n + i] * b[i];
                }
            }
            for (int64_t i = 0; i < length; i++) {
                out[2 * (start + i)] = real[i];
                out[2 * (start + i) + 1] = imaginary[i];
            }
        }
    }
}

static inline Pixel higher(Pixel a, Pixel b)
{
    Lanes more = (Lanes)(b > a);
    return (Pixel)(((Lanes)b & more) | ((Lanes)a & ~more));
}

/* Divide each of `count` correlations, (side, side), by the root of the overlap, cells, which is known on every fourth row
   and column and counts where it is at least `least`; tell where the highest is. */
EXPORT void weigh_by_overlap(float *scores, const float *overlaps, int64_t count, int64_t side, float least,
                             int64_t *highest)
{
    int64_t blocks = side / STEP;
    for (int64_t image = 0; image < count; image++, scores += side * side, overlaps += blocks * blocks) {
        float best = -1e30f;
        highest[image] = 0;
        for (int64_t row = 0; row < side; row++) {
            Pixel top = {best, best, best, best}, *cells = (Pixel *)(scores + row * side);
            for (int64_t block = 0; block < blocks; block++) {
                float overlap = overlaps[row / STEP * blocks + block];
                float weight = overlap < least ? 0.0f : 1.0f / __builtin_sqrtf(overlap > 1.0f ? overlap : 1.0f);
                cells[block] *= weight;
                top = higher(top, cells[block]);
            }
            float first = top[0] > top[1] ? top[0] : top[1], second = top[2] > top[3] ? top[2] : top[3];
            if (first <= best && second <= best) continue;
            best = first > second ? first : second;
            for (int64_t i = row * side; i < (row + 1) * side; i++)
                if (scores[i] == best) highest[image] = i;
        }
    }
}

/* The layer at a place (col, row) = (x, y), linear between its pixels, and 0 beyond them. */
static inline Pixel between_pixels(const float *layer, int64_t rows, int64_t cols, double x, double y)
{
    const Pixel nothing = {0.0f, 0.0f, 0.0f, 0.0f};
    if (!(x > -1.0 && y > -1.0 && x < (double)cols && y < (double)rows)) return nothing;
    int64_t left = (int64_t)(x + 1.0) - 1, top = (int64_t)(y + 1.0) - 1;
    float right = (float)(x - (double)left), down = (float)(y - (double)top);
    const Pixel *first = (const Pixel *)layer + top * cols + left;
    int above = top >= 0, below = top + 1 < rows, before = left >= 0, after = left + 1 < cols;
    Pixel a = above && before ? first[0] : nothing, b = above && after ? first[1] : nothing;
    Pixel c = below && before ? first[cols] : nothing, d = below && after ? first[cols + 1] : nothing;
    Pixel upper = a + right * (b - a), lower = c + right * (d - c);
    return upper + down * (lower - upper);
}

/* Place a layer (image_rows, image_cols, 4) on the cells of a reference, (rows, cols): at the cell (col, row) is what
   the image has at matrix * (col, row, 1); its second and third harmonic are turned. `usable` says which cells of the
   reference are; `known` is 1 at those where the layer is usable too, and elsewhere it and the planes, (3, rows, cols),
   are 0. */
EXPORT void place_layer(const float *layer, int64_t image_rows, int64_t image_cols, const double *matrix, double cosine,
                        double sine, const float *usable, int64_t rows, int64_t cols, float *restrict known,
                        float *restrict planes)
{
    int64_t cells = rows * cols;
    float turn = (float)cosine, cross = (float)sine;
    for (int64_t row = 0; row < rows; row++) {
        for (int64_t col = 0; col < cols; col++) {
            int64_t at = row * cols + col;
            double x = matrix[0] * (double)col + matrix[1] * (double)row + matrix[2];
            double y = matrix[3] * (double)col + matrix[4] * (double)row + matrix[5];
            Pixel value = between_pixels(layer, image_rows, image_cols, x, y);
            known[at] = value[LAYER - 1] > 0.5f ? usable[at] : 0.0f;
            value *= known[at];
            planes[at] = value[0];
            planes[cells + at] = turn * value[1] - cross * value[2];
            planes[2 * cells + at] = cross * value[1] + turn * value[2];
        }
    }
}
