/* The filter of the mutual structure (Shen et al. 2015), in double precision. */

#include "kernels.h"

#define SUMS 8
#define PRODUCTS 5

typedef struct {
    int64_t rows, cols, radius, count; /* count: pixels of a window */
    double lambda_g, lambda_i, epsilon_g, epsilon_i;
    double *area, *sums[SUMS], *products[PRODUCTS], *column;
} Filter;

/* Sum over the (2 * radius + 1)² neighbourhood of each pixel, cut off at the border. */
static void box_sums(const Filter *filter, const double *restrict values, double *restrict out)
{
    int64_t rows = filter->rows, cols = filter->cols, radius = filter->radius;
    double *restrict column = filter->column;
    for (int64_t c = 0; c < cols; c++) column[c] = 0.0;
    for (int64_t r = 0; r < smaller(radius, rows); r++)
        for (int64_t c = 0; c < cols; c++) column[c] += values[r * cols + c];
    for (int64_t r = 0; r < rows; r++) {
        double *restrict line = out + r * cols;
        if (r + radius < rows)
            for (int64_t c = 0; c < cols; c++) column[c] += values[(r + radius) * cols + c];
        if (r - radius > 0)
            for (int64_t c = 0; c < cols; c++) column[c] -= values[(r - radius - 1) * cols + c];
        for (int64_t c = 0; c < cols; c++) line[c] = column[c];
        for (int64_t step = 1; step <= radius; step++) {
            for (int64_t c = step; c < cols; c++) line[c] += column[c - step];
            for (int64_t c = 0; c < cols - step; c++) line[c] += column[c + step];
        }
    }
}

/* Fill the first five sums with those of g, i, g², i² and gi over the neighbourhoods. */
static void moments(const Filter *filter, const double *restrict g, const double *restrict i)
{
    double *restrict square_g = filter->products[2], *restrict square_i = filter->products[3];
    double *restrict product = filter->products[4];
    for (int64_t k = 0; k < filter->count; k++) {
        square_g[k] = g[k] * g[k];
        square_i[k] = i[k] * i[k];
        product[k] = g[k] * i[k];
    }
    const double *values[PRODUCTS] = {g, i, square_g, square_i, product};
    for (int n = 0; n < PRODUCTS; n++) box_sums(filter, values[n], filter->sums[n]);
}

/* Fill the sums over the neighbourhoods of a1, a0, b1, b0, a1², a1 * a0, b1², b1 * b0. */
static void local_lines(const Filter *filter, const double *g, const double *i)
{
    moments(filter, g, i);
    for (int64_t k = 0; k < filter->count; k++) {
        double n = 1.0 / filter->area[k], mean_g = filter->sums[0][k] * n, mean_i = filter->sums[1][k] * n;
        double covariance = filter->sums[4][k] * n - mean_g * mean_i;
        double a1 = covariance / (most(filter->sums[3][k] * n - mean_i * mean_i, 0.0) + filter->epsilon_i);
        double b1 = covariance / (most(filter->sums[2][k] * n - mean_g * mean_g, 0.0) + filter->epsilon_g);
        double a0 = mean_g - a1 * mean_i, b0 = mean_i - b1 * mean_g;
        double terms[SUMS] = {a1, a0, b1, b0, a1 * a1, a1 * a0, b1 * b1, b1 * b0};
        for (int m = 0; m < SUMS; m++) filter->sums[m][k] = terms[m];
    }
    for (int n = 0; n < SUMS; n++) {
        for (int64_t k = 0; k < filter->count; k++) filter->products[0][k] = filter->sums[n][k];
        box_sums(filter, filter->products[0], filter->sums[n]);
    }
}

/* Solve the 2 x 2 system of each pixel for g and i, the local lines given by their sums. */
static void update_images(const Filter *filter, const double *g0, const double *i0, double *g, double *i)
{
    for (int64_t k = 0; k < filter->count; k++) {
        double s[SUMS];
        for (int m = 0; m < SUMS; m++) s[m] = filter->sums[m][k];
        double a11 = s[4] + filter->area[k] + filter->lambda_i, a22 = s[6] + filter->area[k] + filter->lambda_g;
        double a12 = -(s[0] + s[2]);
        double r1 = filter->lambda_i * i0[k] + s[3] - s[5], r2 = filter->lambda_g * g0[k] + s[1] - s[7];
        double determinant = a11 * a22 - a12 * a12;
        i[k] = (r1 * a22 - a12 * r2) / determinant;
        g[k] = (a11 * r2 - a12 * r1) / determinant;
    }
}

/* Multiply the weights by |rho| of the neighbourhoods. */
static void weigh(const Filter *filter, const double *g, const double *i, double *weight)
{
    moments(filter, g, i);
    for (int64_t k = 0; k < filter->count; k++) {
        double n = 1.0 / filter->area[k], mean_g = filter->sums[0][k] * n, mean_i = filter->sums[1][k] * n;
        double covariance = filter->sums[4][k] * n - mean_g * mean_i;
        double variance_g = most(filter->sums[2][k] * n - mean_g * mean_g, 0.0) + filter->epsilon_g;
        double variance_i = most(filter->sums[3][k] * n - mean_i * mean_i, 0.0) + filter->epsilon_i;
        weight[k] *= least(__builtin_fabs(covariance) / __builtin_sqrt(variance_g * variance_i), 1.0);
    }
}

/* Filter every one of `windows` windows in place, and weight its pixels. The numbers are radius; lambda and epsilon
   of g and of i. `memory` holds 14 windows and a row. See the Python function that calls it. */
EXPORT void filter_windows(const double *g0, const double *i0, double *g, double *i, double *weight, int64_t windows,
                           int64_t rows, int64_t cols, int64_t iterations, int64_t radius, double lambda_g,
                           double lambda_i, double epsilon_g, double epsilon_i, double *memory)
{
    int64_t count = rows * cols;
    Filter filter = {rows, cols, radius, count, lambda_g, lambda_i, epsilon_g, epsilon_i, memory, {0}, {0}, 0};
    for (int m = 0; m < SUMS; m++) filter.sums[m] = memory + (1 + m) * count;
    for (int m = 0; m < PRODUCTS; m++) filter.products[m] = memory + (1 + SUMS + m) * count;
    filter.column = memory + (1 + SUMS + PRODUCTS) * count;
    for (int64_t k = 0; k < count; k++) filter.products[0][k] = 1.0;
    box_sums(&filter, filter.products[0], filter.area);
    for (int64_t window = 0; window < windows; window++) {
        int64_t at = window * count;
        for (int64_t n = 0; n < iterations; n++) {
            local_lines(&filter, g + at, i + at);
            update_images(&filter, g0 + at, i0 + at, g + at, i + at);
        }
        for (int64_t k = 0; k < count; k++) weight[at + k] = 1.0;
        weigh(&filter, g + at, i0 + at, weight + at);
        weigh(&filter, g0 + at, i + at, weight + at);
    }
}
