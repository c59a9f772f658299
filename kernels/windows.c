/* The loops of the refinement over the pixels of a window. Sums are written as those of vectors, so that compilers
   need not reorder them: the same numbers come from all. */

#include "kernels.h"

#define EXTRA_TAPS 3 /* spline coefficients that a window needs beyond its side */
#define VARIANCE_FLOOR 1e-5f

/* The four weights of the cubic B-spline at fractions t, and of its derivative. */
static inline void spline(Vector t, Vector w[4], Vector d[4])
{
    Vector s = 1.0f - t, s_half = s * 0.5f, t_half = t * 0.5f;
    w[0] = s * s * s * (1.0f / 6.0f);
    w[1] = 2.0f / 3.0f - t * t_half * (2.0f - t);
    w[2] = 2.0f / 3.0f - s * s_half * (2.0f - s);
    w[3] = t * t * t * (1.0f / 6.0f);
    d[0] = -s * s_half;
    d[1] = t_half * (3.0f * t - 4.0f);
    d[2] = -s_half * (3.0f * s - 4.0f);
    d[3] = t * t_half;
}

static inline Vector weighted(const Vector w[4], Vector a, Vector b, Vector c, Vector d)
{
    return w[0] * a + w[1] * b + w[2] * c + w[3] * d;
}

/* By how many numbers a vector that begins at an offset goes beyond the end of a plane: it is read that much earlier,
   and only the rest of it is kept. */
static inline int64_t overhang(Plane plane, int64_t offset)
{
    return larger(0, offset + LANES - plane.rows * plane.cols);
}

static inline void keep(float *to, Vector v, int64_t over)
{
    if (over == 0) {
        store(to, v);
        return;
    }
    for (int64_t k = over; k < LANES; k++) to[k - over] = v[k];
}

/* Where a column lies in a row of a plane: with a step of 2 the even ones come first. */
static inline int64_t place_of(int64_t col, int64_t step, int64_t cols)
{
    return step == 1 ? col : (col >> 1) + (col & 1) * (cols >> 1);
}

void copy_window(Plane plane, int64_t row, int64_t col, Shape shape, float *out)
{
    int64_t rows = shape.rows + 2 * shape.correlation_half, cols = shape.cols + 2 * shape.correlation_half;
    const float *first = plane.values + row * plane.cols + place_of(col, shape.step, plane.cols);
    for (int64_t r = 0; r < rows; r++) {
        const float *from = first + r * shape.step * plane.cols;
        float *to = out + r * shape.width;
        int64_t c = 0;
        for (; c + LANES <= cols; c += LANES) store(to + c, load(from + c));
        for (; c < cols; c++) to[c] = from[c];
    }
}

/* Interpolate a row of coefficients: values and derivatives along it. */
static inline void across(Plane plane, int64_t row, const int64_t places[4], const Vector w[4], const Vector d[4],
                          int64_t cols, float *value, float *slope)
{
    for (int64_t i = 0; i < cols; i += LANES) {
        int64_t at = row * plane.cols + i, over = overhang(plane, at + larger(places[1], places[3]));
        const float *from = plane.values + at - over;
        Vector a = load(from + places[0]), b = load(from + places[1]);
        Vector c = load(from + places[2]), e = load(from + places[3]);
        keep(value + i, weighted(w, a, b, c, e), over);
        keep(slope + i, weighted(d, a, b, c, e), over);
    }
}

/* Interpolate four rows of values and of slopes along the columns. */
static inline void down(float *const rows[4], int64_t width, const Vector w[4], const Vector d[4], int64_t cols,
                        float *out, float *by_col, float *by_row)
{
    for (int64_t i = 0; i < cols; i += LANES) {
        const float *first = rows[0] + i, *second = rows[1] + i, *third = rows[2] + i, *fourth = rows[3] + i;
        Vector a = load(first), b = load(second), c = load(third), e = load(fourth);
        store(out + i, weighted(w, a, b, c, e));
        store(by_row + i, weighted(d, a, b, c, e));
        a = load(first + width), b = load(second + width), c = load(third + width), e = load(fourth + width);
        store(by_col + i, weighted(w, a, b, c, e));
    }
}

/* Sample a spline and its gradient on a window whose first pixel is at row, col; 0 if it leaves the plane.
   The rows of coefficients that four rows of the window share are interpolated once, in `scratch`, which holds
   eight rows and so stays in the first cache. */
int sample_shift(Plane plane, double row, double col, Shape shape, float *scratch, Window out)
{
    int64_t window_rows = shape.rows + 2 * shape.correlation_half, step = shape.step;
    int64_t window_cols = shape.cols + 2 * shape.correlation_half, beyond = EXTRA_TAPS / step;
    int64_t top = (int64_t)__builtin_floor(row) - 1, left = (int64_t)__builtin_floor(col) - 1;
    if (top < 0 || left < 0) return 0;
    if (top + step * (window_rows + beyond) > plane.rows || left + step * (window_cols + beyond) > plane.cols) return 0;
    Vector none = {0}, w[4], d[4], w_row[4], d_row[4];
    spline(none + (float)(col - __builtin_floor(col)), w, d);
    spline(none + (float)(row - __builtin_floor(row)), w_row, d_row);
    int64_t places[4];
    for (int k = 0; k < 4; k++) places[k] = place_of(left + k, step, plane.cols);
    for (int64_t r = 0, done = 0; r < window_rows; r++) {
        float *rows[4];
        for (; done < r * step + 4; done++) {
            float *memory = scratch + (done & 3) * 2 * shape.width;
            across(plane, top + done, places, w, d, window_cols, memory, memory + shape.width);
        }
        for (int k = 0; k < 4; k++) rows[k] = scratch + ((r * step + k) & 3) * 2 * shape.width;
        int64_t at = r * shape.width;
        down(rows, shape.width, w_row, d_row, window_cols, out.value + at, out.slope_x + at, out.slope_y + at);
    }
    return 1;
}

/* How many fractions t, t + pace, t + 2 * pace, ... lie within 0 to 1. */
static inline int64_t run_length(double t, double pace)
{
    double edge = pace < 0.0 ? 0.0 : 1.0;
    return (int64_t)least((edge - t) / (pace == 0.0 ? 1e-300 : pace), 1e6) + 1;
}

/* Sample pixels whose coefficients begin at an offset and at four places, and advance by one number a pixel. */
static inline __attribute__((always_inline)) void sample_run(Plane plane, int64_t offset, const int64_t places[4],
                                                             float tx, float ty, float pace_x, float pace_y,
                                                             int64_t run, Window out, int64_t at, int slopes)
{
    const Vector count = {0.0f, 1.0f, 2.0f, 3.0f, 4.0f, 5.0f, 6.0f, 7.0f};
    for (int64_t i = 0; i < run; i += LANES) {
        int64_t over = overhang(plane, offset + 3 * plane.cols + i + larger(places[1], places[3]));
        const float *from = plane.values + offset + i - over;
        Vector pixel = count + (float)(i - over), w[4], d[4], w_row[4], d_row[4];
        Vector value = {0}, by_col = {0}, by_row = {0};
        spline(tx + pixel * pace_x, w, d);
        spline(ty + pixel * pace_y, w_row, d_row);
        for (int k = 0; k < 4; k++, from += plane.cols) {
            Vector a = load(from + places[0]), b = load(from + places[1]);
            Vector c = load(from + places[2]), e = load(from + places[3]);
            Vector along = weighted(w, a, b, c, e);
            value += w_row[k] * along;
            if (!slopes) continue;
            by_col += w_row[k] * weighted(d, a, b, c, e);
            by_row += d_row[k] * along;
        }
        keep(out.value + at + i, value, over);
        if (!slopes) continue;
        keep(out.slope_x + at + i, by_col, over);
        keep(out.slope_y + at + i, by_row, over);
    }
}

/* Sample a spline, and its gradient if `slopes`, on a deformed window whose centre is at row, col; 0 if it leaves the
   plane. Along a row the four by four coefficients advance by `step` columns a pixel, except in a few places: each run
   between two of them is one loop. */
int sample_deformed(Plane plane, double row, double col, const double linear[2][2], Shape shape, int slopes, Window out)
{
    int64_t rows = shape.rows + 2 * shape.correlation_half, cols = shape.cols + 2 * shape.correlation_half;
    int64_t step = shape.step, half_rows = rows / 2, half_cols = cols / 2;
    double x_by_x = (double)step * linear[0][0], y_by_x = (double)step * linear[1][0];
    for (int64_t r = 0; r < rows; r++) {
        double down_by = (double)((r - half_rows) * step);
        double x0 = col - (double)half_cols * ((double)step + x_by_x) + down_by * linear[0][1];
        double y0 = row - (double)half_cols * y_by_x + down_by * (1.0 + linear[1][1]);
        for (int64_t c = 0; c < cols;) {
            double x = x0 + (double)c * ((double)step + x_by_x), y = y0 + (double)c * y_by_x;
            int64_t top = (int64_t)__builtin_floor(y), left = (int64_t)__builtin_floor(x);
            double tx = x - (double)left, ty = y - (double)top;
            int64_t run = smaller(cols - c, smaller(run_length(tx, x_by_x), run_length(ty, y_by_x)));
            if (top < 1 || left < 1 || top + 3 > plane.rows) return 0;
            if (left + step * (run - 1) + 3 > plane.cols) return 0;
            int64_t places[4];
            for (int k = 0; k < 4; k++) places[k] = place_of(left - 1 + k, step, plane.cols);
            /* whole vectors: what goes beyond the run is overwritten by the next one */
            int64_t offset = (top - 1) * plane.cols, at = r * shape.width + c;
            float paces[2] = {(float)x_by_x, (float)y_by_x};
            if (slopes)
                sample_run(plane, offset, places, (float)tx, (float)ty, paces[0], paces[1], run, out, at, 1);
            else
                sample_run(plane, offset, places, (float)tx, (float)ty, paces[0], paces[1], run, out, at, 0);
            c += run;
        }
    }
    return 1;
}

/* Add a row of first, first² and first * second to the sums of columns, or, with a sign of -1, take it away. */
static inline void add_row(const float *first, const float *second, float sign, int64_t n, int64_t stride,
                           float *columns)
{
    for (int64_t c = 0; c < n; c += LANES, columns += LANES) {
        Vector a = load(first + c), signed_a = sign * a;
        store(columns, load(columns) + signed_a);
        store(columns + stride, load(columns + stride) + signed_a * a);
        store(columns + 2 * stride, load(columns + 2 * stride) + signed_a * load(second + c));
    }
}

/* From sums of columns to the mutual structure, or, for the reference, to its mean and precision. */
static inline __attribute__((always_inline)) void row_means(const float *columns, int64_t stride, int64_t size,
                                                            int64_t cols, float *mean, float *precision,
                                                            const float *valid, float *structure)
{
    float scale = 1.0f / (float)(size * size);
    for (int64_t c = 0; c < cols; c += LANES) {
        const float *ones = columns + c, *squares = ones + stride, *products = squares + stride;
        Vector sum = load(ones), square = load(squares), product = load(products);
        for (int64_t k = 1; k < size; k++) {
            sum += load(ones + k);
            square += load(squares + k);
            product += load(products + k);
        }
        Vector m = sum * scale, variance = positive(square * scale - m * m) + VARIANCE_FLOOR;
        if (structure) {
            Vector covariance = positive(product * scale - m * load(mean + c));
            store(structure + c, load(valid + c) * (covariance * covariance * load(precision + c) / variance));
        } else {
            store(mean + c, m);
            store(precision + c, 1.0f / variance);
        }
    }
}

/* A sum of a constant number of terms is unrolled. */
static void row_means_of(const float *columns, int64_t stride, int64_t size, int64_t cols, float *mean,
                         float *precision, const float *valid, float *structure)
{
    switch (size) {
    case 3: row_means(columns, stride, 3, cols, mean, precision, valid, structure); break;
    case 5: row_means(columns, stride, 5, cols, mean, precision, valid, structure); break;
    case 7: row_means(columns, stride, 7, cols, mean, precision, valid, structure); break;
    case 9: row_means(columns, stride, 9, cols, mean, precision, valid, structure); break;
    case 11: row_means(columns, stride, 11, cols, mean, precision, valid, structure); break;
    default: row_means(columns, stride, size, cols, mean, precision, valid, structure);
    }
}

/* Go down a window with the sums of its columns over the height of the correlation. */
static void go_down(Shape shape, const float *first, const float *second, float *columns, float *mean,
                    float *precision, const float *valid, float *structure)
{
    int64_t size = 2 * shape.correlation_half + 1, width = shape.width, stride = 2 * width;
    int64_t extended = shape.cols + size - 1;
    for (int64_t i = 0; i < 3 * stride; i++) columns[i] = 0.0f;
    for (int64_t r = 0; r < size - 1; r++)
        add_row(first + r * width, second + r * width, 1.0f, extended, stride, columns);
    for (int64_t r = 0; r < shape.rows; r++) {
        int64_t top = r * width, bottom = (r + size - 1) * width;
        add_row(first + bottom, second + bottom, 1.0f, extended, stride, columns);
        row_means_of(columns, stride, size, shape.cols, mean + top, precision + top, valid ? valid + top : 0,
                     structure ? structure + top : 0);
        add_row(first + top, second + top, -1.0f, extended, stride, columns);
    }
}

/* Fill the local mean and the inverse variance of the reference. */
void reference_moments(Shape shape, const float *reference, float *columns, float *mean, float *precision)
{
    go_down(shape, reference, reference, columns, mean, precision, 0, 0);
}

/* Fill the mutual structure: validity times the squared positive local correlation of both windows. */
void mutual_structure(Shape shape, Window window, float *columns, float *mean, float *precision,
                      const float *valid, float *structure)
{
    go_down(shape, window.value, window.reference, columns, mean, precision, valid, structure);
}

static inline double total(Vector v)
{
    float sum = 0.0f;
    for (int k = 0; k < LANES; k++) sum += v[k];
    return (double)sum;
}

/* The inner part of a window that has the sides of the correlation: where row r begins. */
static inline int64_t inner(Shape shape, int64_t r)
{
    return (r + shape.correlation_half) * shape.width + shape.correlation_half;
}

/* Fit reference = offset + gain * sampled by weighted least squares; return the sum of the weights, 0 where they
   do not determine it. */
double fit_gain(Shape shape, const float *weight, Window window, double *offset, double *gain)
{
    Vector sw = {0}, sx = {0}, sy = {0}, sxx = {0}, sxy = {0};
    for (int64_t r = 0; r < shape.rows; r++) {
        const float *weights = weight + r * shape.width;
        const float *value = window.value + inner(shape, r), *reference = window.reference + inner(shape, r);
        for (int64_t c = 0; c < shape.cols; c += LANES) {
            Vector w = load(weights + c), x = load(value + c), y = load(reference + c), wx = w * x;
            sw += w;
            sx += wx;
            sy += w * y;
            sxx += wx * x;
            sxy += wx * y;
        }
    }
    double known = total(sw);
    *offset = *gain = 0.0;
    if (known <= 1e-6) return 0.0;
    double mean_x = total(sx) / known, mean_y = total(sy) / known;
    double variance = total(sxx) - total(sx) * mean_x;
    if (variance <= MIN_CONTRAST * total(sxx)) return 0.0;
    *gain = (total(sxy) - total(sx) * mean_y) / variance;
    *offset = mean_y - *gain * mean_x;
    return known;
}

/* Return the sum of weight * |reference - offset - gain * sampled|. */
double sum_of_deviations(Shape shape, const float *weight, Window window, Gain gain)
{
    Vector sum = {0}, second = {0};
    for (int64_t r = 0; r < shape.rows; r++) {
        const float *weights = weight + r * shape.width;
        const float *value = window.value + inner(shape, r), *reference = window.reference + inner(shape, r);
        int64_t c = 0;
        for (; c + LANES < shape.cols; c += 2 * LANES) {
            Vector left = load(reference + c) - gain.offset - gain.gain * load(value + c);
            Vector next = load(reference + c + LANES) - gain.offset - gain.gain * load(value + c + LANES);
            sum += load(weights + c) * magnitude(left);
            second += load(weights + c + LANES) * magnitude(next);
        }
        for (; c < shape.cols; c += LANES)
            sum += load(weights + c) * magnitude(load(reference + c) - gain.offset - gain.gain * load(value + c));
    }
    return total(sum + second);
}

/* Fill the sums of all products of two of 1, x, r, p, q with weights w / (1 + |r| / sigma) (eq. 9 of the paper).
   Here x is the sampled value, r the residual, p and q the derivatives of x by column and row; where a `monomial`
   is given, the weights are multiplied by it. The order is that of the rows of the triangle. A row is gone along
   twice, as fifteen sums and what they need have no room in sixteen registers. */
void weighted_moments(Shape shape, const float *weight, const float *monomial, Window window, Gain gain,
                      float *row_memory, double moments[MOMENTS])
{
    Vector sw = {0}, swx = {0}, swr = {0}, swp = {0}, swq = {0}, sxx = {0}, sxr = {0}, sxp = {0}, sxq = {0};
    Vector srr = {0}, srp = {0}, srq = {0}, spp = {0}, spq = {0}, sqq = {0};
    for (int64_t r = 0; r < shape.rows; r++) {
        const float *weights = weight + r * shape.width, *factors = monomial ? monomial + r * shape.width : 0;
        const float *value = window.value + inner(shape, r), *reference = window.reference + inner(shape, r);
        const float *slope_x = window.slope_x + inner(shape, r), *slope_y = window.slope_y + inner(shape, r);
        float *residuals = row_memory, *products = row_memory + shape.width;
        for (int64_t c = 0; c < shape.cols; c += LANES) {
            Vector x = load(value + c), p = load(slope_x + c);
            Vector left = load(reference + c) - gain.offset - gain.gain * x;
            Vector w = load(weights + c) / (1.0f + magnitude(left) * gain.per_sigma);
            if (factors) w *= load(factors + c);
            Vector wx = w * x, wr = w * left;
            store(residuals + c, left);
            store(products + c, w);
            sw += w;
            swx += wx;
            swr += wr;
            sxx += wx * x;
            sxr += wx * left;
            sxp += wx * p;
            srr += wr * left;
            srp += wr * p;
        }
        for (int64_t c = 0; c < shape.cols; c += LANES) {
            Vector w = load(products + c), p = load(slope_x + c), q = load(slope_y + c), wp = w * p, wq = w * q;
            swp += wp;
            swq += wq;
            sxq += wq * load(value + c);
            srq += wq * load(residuals + c);
            spp += wp * p;
            spq += wp * q;
            sqq += wq * q;
        }
    }
    Vector sums[MOMENTS] = {sw, swx, swr, swp, swq, sxx, sxr, sxp, sxq, srr, srp, srq, spp, spq, sqq};
    for (int k = 0; k < MOMENTS; k++) moments[k] = total(sums[k]);
}

/* Add the scores w * residual * gradient * scale, gain and offset projected out, to the sums of blocks, row by
   row. The rows of `fit` are the (offset, gain) that correct the residual and that are projected out of p and q. */
void add_block_scores(Shape shape, const float *weight, Window window, Gain gain, double fit[3][2], double scale,
                      int64_t blocks, float *row_memory, double (*scores)[2])
{
    float *sum_x = row_memory, *sum_y = row_memory + shape.width;
    float r0 = (float)fit[0][0], r1 = (float)fit[0][1], p0 = (float)fit[1][0], p1 = (float)fit[1][1];
    float q0 = (float)fit[2][0], q1 = (float)fit[2][1];
    for (int64_t i = 0; i < 2 * shape.width; i++) row_memory[i] = 0.0f;
    for (int64_t r = 0; r < shape.rows; r++) {
        const float *weights = weight + r * shape.width;
        const float *value = window.value + inner(shape, r), *reference = window.reference + inner(shape, r);
        const float *slope_x = window.slope_x + inner(shape, r), *slope_y = window.slope_y + inner(shape, r);
        for (int64_t c = 0; c < shape.cols; c += LANES) {
            Vector x = load(value + c), left = load(reference + c) - gain.offset - gain.gain * x;
            Vector pull = load(weights + c) / (1.0f + magnitude(left) * gain.per_sigma) * (left - r0 - r1 * x);
            store(sum_x + c, load(sum_x + c) + pull * (load(slope_x + c) - p0 - p1 * x));
            store(sum_y + c, load(sum_y + c) + pull * (load(slope_y + c) - q0 - q1 * x));
        }
        int64_t block = r * blocks / shape.rows;
        if (r + 1 < shape.rows && (r + 1) * blocks / shape.rows == block) continue;
        for (int64_t b = 0, c = 0; b < blocks; b++) {
            double *score = scores[block * blocks + b];
            for (; c * blocks < (b + 1) * shape.cols; c++) {
                score[0] += scale * (double)sum_x[c];
                score[1] += scale * (double)sum_y[c];
            }
        }
        for (int64_t i = 0; i < 2 * shape.width; i++) row_memory[i] = 0.0f;
    }
}
