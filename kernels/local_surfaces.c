/* The fit of robust local surfaces through neighbours. Sums may be reordered (-ffast-math). */

#include "kernels.h"

typedef struct {
    int64_t terms, count; /* of a surface; of the neighbours that take part */
    double *design[LARGEST_TERMS], *moved[2];
    double solution[LARGEST_TERMS][2], normal[LARGEST_TERMS][LARGEST_TERMS], right[LARGEST_TERMS][2];
} Fit;

/* Return the value of a rank and reorder: smaller ones precede it afterwards (Hoare's selection). */
static double select_rank(double *values, int64_t count, int64_t rank)
{
    for (int64_t low = 0, high = count - 1; low < high;) {
        double pivot = values[rank];
        int64_t i = low, j = high;
        while (i <= j) {
            while (values[i] < pivot) i++;
            while (values[j] > pivot) j--;
            if (i <= j) {
                double other = values[i];
                values[i++] = values[j];
                values[j--] = other;
            }
        }
        if (j < rank) low = i;
        if (i > rank) high = j;
    }
    return values[rank];
}

/* Return the median; the values are reordered. */
static double median(double *values, int64_t count)
{
    int64_t middle = count / 2;
    double upper = select_rank(values, count, middle);
    if (count % 2) return upper;
    double lower = values[0];
    for (int64_t j = 1; j < middle; j++) lower = most(lower, values[j]);
    return 0.5 * (lower + upper);
}

/* Fill the terms of the surface; the second and third hold the offsets, px, on input. */
static void fill_design(Fit *fit, double reach)
{
    for (int64_t j = 0; j < fit->count; j++) {
        double x = fit->design[1][j] / reach, y = fit->design[2][j] / reach;
        double terms[LARGEST_TERMS] = {1.0, x, y, x * x, x * y, y * y};
        for (int64_t a = 0; a < fit->terms; a++) fit->design[a][j] = terms[a];
    }
}

static void distances(const Fit *fit, double *restrict out)
{
    for (int64_t j = 0; j < fit->count; j++) {
        double x = fit->moved[0][j], y = fit->moved[1][j];
        for (int64_t a = 0; a < fit->terms; a++) {
            x -= fit->design[a][j] * fit->solution[a][0];
            y -= fit->design[a][j] * fit->solution[a][1];
        }
        out[j] = __builtin_sqrt(x * x + y * y);
    }
}

/* Fill the weighted normal equations; the ridge is relative on all terms but the constant. */
static void normal_equations(Fit *fit, const double *weight, double ridge, double tiny)
{
    for (int64_t a = 0; a < fit->terms; a++) {
        for (int64_t b = a; b < fit->terms; b++) {
            double sum = 0.0;
            for (int64_t j = 0; j < fit->count; j++) sum += weight[j] * fit->design[a][j] * fit->design[b][j];
            fit->normal[a][b] = fit->normal[b][a] = sum;
        }
        for (int axis = 0; axis < 2; axis++) {
            double sum = 0.0;
            for (int64_t j = 0; j < fit->count; j++) sum += weight[j] * fit->design[a][j] * fit->moved[axis][j];
            fit->right[a][axis] = sum;
        }
    }
    ridge = ridge * fit->normal[0][0] + tiny;
    fit->normal[0][0] += tiny;
    for (int64_t a = 1; a < fit->terms; a++) fit->normal[a][a] += ridge;
}

static void solve(Fit *fit)
{
    invert(&fit->normal[0][0], fit->terms, LARGEST_TERMS);
    for (int64_t a = 0; a < fit->terms; a++)
        for (int axis = 0; axis < 2; axis++) {
            double sum = 0.0;
            for (int64_t b = 0; b < fit->terms; b++) sum += fit->normal[a][b] * fit->right[b][axis];
            fit->solution[a][axis] = sum;
        }
}

typedef struct {
    int64_t rounds; /* of reweighting */
    double ridge, tiny, min_scale_px;
} SurfaceLimits;

/* Fit a surface to the displacements of the usable ones of `most_neighbours` neighbours of each of n places. `memory`
   holds ten times as many numbers. See the Python function of this name. */
EXPORT void fit_surfaces(const double (*xy_px)[2], const double (*displacement_px)[2], const double (*at_xy_px)[2],
                         const int64_t *neighbours, const uint8_t *usable, int64_t n, int64_t most_neighbours,
                         int64_t order, const SurfaceLimits *limits, double *memory, double (*value)[2],
                         double (*slope)[2][2], double *scale, double *leverage)
{
    Fit fit = {.terms = order == 1 ? 3 : 6};
    for (int a = 0; a < LARGEST_TERMS; a++) fit.design[a] = memory + a * most_neighbours;
    for (int axis = 0; axis < 2; axis++) fit.moved[axis] = memory + (6 + axis) * most_neighbours;
    double *residual = memory + 8 * most_neighbours, *work = memory + 9 * most_neighbours;
    for (int64_t p = 0; p < n; p++) {
        double reach = 0.0;
        fit.count = 0;
        for (int64_t j = 0; j < most_neighbours; j++) {
            int64_t k = neighbours[p * most_neighbours + j];
            double x = xy_px[k][0] - at_xy_px[p][0], y = xy_px[k][1] - at_xy_px[p][1];
            reach = most(reach, x * x + y * y);
            if (!usable[p * most_neighbours + j]) continue;
            fit.design[1][fit.count] = x, fit.design[2][fit.count] = y;
            for (int axis = 0; axis < 2; axis++) fit.moved[axis][fit.count] = displacement_px[k][axis];
            fit.count++;
        }
        if (fit.count < 2 * fit.terms) continue;
        double extent = most(__builtin_sqrt(reach), 1e-9);
        fill_design(&fit, extent);
        for (int axis = 0; axis < 2; axis++) {
            for (int64_t a = 0; a < LARGEST_TERMS; a++) fit.solution[a][axis] = 0.0;
            for (int64_t j = 0; j < fit.count; j++) work[j] = fit.moved[axis][j];
            fit.solution[0][axis] = median(work, fit.count);
        }
        for (int64_t round = 0; round < limits->rounds; round++) {
            distances(&fit, residual);
            for (int64_t j = 0; j < fit.count; j++) work[j] = residual[j];
            scale[p] = most(median(work, fit.count), limits->min_scale_px);
            for (int64_t j = 0; j < fit.count; j++) {
                double ratio = residual[j] / (2.0 * scale[p]);
                work[j] = 1.0 / (1.0 + ratio * ratio);
            }
            normal_equations(&fit, work, limits->ridge, limits->tiny);
            solve(&fit);
        }
        for (int64_t j = 0; j < fit.count; j++) work[j] = 1.0; /* all alike */
        normal_equations(&fit, work, limits->ridge, limits->tiny);
        invert(&fit.normal[0][0], fit.terms, LARGEST_TERMS);
        leverage[p] = fit.normal[0][0];
        for (int axis = 0; axis < 2; axis++) {
            value[p][axis] = fit.solution[0][axis];
            slope[p][axis][0] = fit.solution[1][axis] / extent;
            slope[p][axis][1] = fit.solution[2][axis] / extent;
        }
    }
}
