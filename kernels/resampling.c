/* The resampling of a frame by a cubic B-spline. */

#include "kernels.h"

static void spline(double t, double w[4])
{
    double s = 1.0 - t;
    w[0] = s * s * s / 6.0;
    w[1] = 2.0 / 3.0 - t * t * (2.0 - t) / 2.0;
    w[2] = 2.0 / 3.0 - s * s * (2.0 - s) / 2.0;
    w[3] = t * t * t / 6.0;
}

/* An index beyond the border, mirrored about the outermost pixel. */
static int64_t mirrored(int64_t index, int64_t count)
{
    index = index < 0 ? -index : index;
    return index > count - 1 ? 2 * (count - 1) - index : index;
}

/* Evaluate the spline of `plane` at the places (col, row) of `grid`, linear between its nodes, which are `step` pixels
   of the output apart; not a number where the plane does not reach. */
EXPORT void resample(const float *plane, int64_t rows, int64_t cols, const double (*grid)[2], int64_t grid_cols,
                     int64_t step, int64_t out_rows, int64_t out_cols, float *out)
{
    for (int64_t r = 0; r < out_rows; r++) {
        const double (*upper)[2] = grid + r / step * grid_cols, (*lower)[2] = upper + grid_cols;
        double v = (double)(r % step) / (double)step;
        for (int64_t c = 0; c < out_cols; c++) {
            int64_t j = c / step;
            double u = (double)(c % step) / (double)step, at[2];
            for (int axis = 0; axis < 2; axis++)
                at[axis] = (1 - v) * ((1 - u) * upper[j][axis] + u * upper[j + 1][axis]) +
                           v * ((1 - u) * lower[j][axis] + u * lower[j + 1][axis]);
            if (!(at[0] >= 0.0 && at[1] >= 0.0 && at[0] <= (double)cols && at[1] <= (double)rows)) {
                out[r * out_cols + c] = __builtin_nanf("");
                continue;
            }
            double x = at[0] - 0.5, y = at[1] - 0.5, weights_x[4], weights_y[4], sum = 0.0;
            int64_t left = (int64_t)__builtin_floor(x), top = (int64_t)__builtin_floor(y);
            spline(x - (double)left, weights_x);
            spline(y - (double)top, weights_y);
            for (int k = 0; k < 4; k++) {
                const float *line = plane + mirrored(top - 1 + k, rows) * cols;
                double along = 0.0;
                for (int m = 0; m < 4; m++) along += weights_x[m] * (double)line[mirrored(left - 1 + m, cols)];
                sum += weights_y[k] * along;
            }
            out[r * out_cols + c] = (float)sum;
        }
    }
}
