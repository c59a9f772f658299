/* The refinement of many points: Gauss-Newton with robust and structure weights, one point at a time, all channels. What is
   summed over pixels is in windows.c. */

#include "kernels.h"

enum { STRUCTURE_NONE, STRUCTURE_FOLLOWS, STRUCTURE_FIXED, STRUCTURE_GIVEN };
enum { CONVERGED, NOT_CONVERGED, INVALID, DIVERGED, UNDETERMINED };

#define FARTHEST_PX 1e9 /* no image is as wide */

/* The numbers below have their names in Python, which gives them, and their reasons. */
typedef struct {
    int64_t half_rows, half_cols, step, correlation_half, width, structure_mode, robust, affine, iterations, blocks;
    double reached_by_px, tolerance_px, relaxation, least_valid, largest_move_px;
} Options;

typedef struct {
    double longest_step_px, largest_relaxation, min_slope, near_px, settling_px, sigma_per_mean_deviation;
    int64_t settled_after, patience;
} Limits;

/* Maps of both images, those of the target as spline coefficients. A channel has `rows` * `cols` numbers; the
   validity may have a column more. */
typedef struct {
    const float *reference, *coefficients;
    const uint8_t *reference_valid, *target_valid;
    int64_t channels, rows, cols, valid_cols, target_rows, target_cols, target_valid_cols;
} Images;

typedef struct {
    const int64_t (*corners_rc)[2];
    const double (*shift_xy)[2];
    const double (*linear)[2][2];
    const double (*structure_xy)[2];
    const float *structure; /* (n, rows, cols) of the window */
    int64_t count;
} Starts;

typedef struct {
    double (*shift_xy)[2], (*linear)[2][2], (*covariance)[2][2];
    int64_t *status;
} Results;

/* Memory of one point: flat windows of one channel or, where named so, of all. */
typedef struct {
    float *value, *slope_x, *slope_y, *references, *means, *precisions, *structures, *valid, *monomials, *rows;
    double (*scores)[2];
} Workspace;

typedef struct {
    const Images *images;
    const Starts *starts;
    const Options *options;
    const Limits *limits;
    Workspace work;
    Shape shape;
    int64_t extended, plain; /* numbers of a window, see below */
} Job;

/* What the channels of a window add up to: the parameters are (dx, a1, a2, dy, b1, b2), or (dx, dy), px. */
typedef struct {
    double matrix[2 * LARGEST_TERMS][2 * LARGEST_TERMS], right[2 * LARGEST_TERMS];
    int64_t terms; /* of a component: 1 or 3 */
} Equations;

/* Numbers of a window, with the sides of the correlation and without; vectors go beyond its last row. */
static int64_t extended_numbers(Shape shape)
{
    return (shape.rows + 2 * shape.correlation_half + 2) * shape.width;
}
static int64_t plain_numbers(Shape shape) { return (shape.rows + 2) * shape.width; }

/* Divide the memory of a point; with none, only count. */
static int64_t divide(const Images *images, const Options *options, Shape shape, float *memory, Workspace *work)
{
    int64_t plain = plain_numbers(shape), extended = extended_numbers(shape), used = 0;
    float **const parts[] = {&work->value, &work->slope_x, &work->slope_y, &work->references, &work->means,
                             &work->precisions, &work->structures, &work->valid, &work->monomials,
                             &work->rows};
    const int64_t sizes[] = {extended, extended, extended, images->channels * extended, images->channels * plain,
                             images->channels * plain, images->channels * plain, plain,
                             options->affine ? 5 * plain : 0, 8 * shape.width};
    for (int k = 0; k < 10; k++) {
        *parts[k] = memory ? memory + used : 0;
        used += sizes[k];
    }
    return used;
}

static Shape shape_of(const Options *options)
{
    return (Shape){2 * options->half_rows + 1, 2 * options->half_cols + 1, options->step, options->correlation_half,
                   options->width};
}

/* Return how many float32 numbers of memory, all 0, `refine_points` needs. */
EXPORT int64_t refinement_memory(const Images *images, const Options *options)
{
    Workspace work;
    return divide(images, options, shape_of(options), 0, &work);
}

/* Invert a positive definite matrix in place (Gauss-Jordan); return 0 if it is not. */
int invert(double *matrix, int64_t n, int64_t stride)
{
    for (int64_t k = 0; k < n; k++) {
        double pivot = matrix[k * stride + k];
        if (!(pivot > 0.0)) return 0;
        matrix[k * stride + k] = 1.0;
        for (int64_t j = 0; j < n; j++) matrix[k * stride + j] /= pivot;
        for (int64_t i = 0; i < n; i++) {
            if (i == k) continue;
            double factor = matrix[i * stride + k];
            matrix[i * stride + k] = 0.0;
            for (int64_t j = 0; j < n; j++) matrix[i * stride + j] -= factor * matrix[k * stride + j];
        }
    }
    return 1;
}

static double length_of(double x, double y) { return __builtin_sqrt(x * x + y * y); }

/* Fill the plain Gauss-Newton step of the shift, and add that of the deformation. */
static void plain_step(const Equations *inverse, const Options *options, double step[2], double linear[2][2])
{
    int64_t terms = inverse->terms, half[2] = {options->half_cols, options->half_rows};
    for (int axis = 0; axis < 2; axis++) {
        for (int64_t k = 0; k < terms; k++) {
            double sum = 0.0;
            for (int64_t j = 0; j < 2 * terms; j++) sum += inverse->matrix[axis * terms + k][j] * inverse->right[j];
            if (k == 0)
                step[axis] = sum;
            else
                linear[axis][k - 1] += sum / (double)half[k - 1];
        }
    }
}

/* Update the slopes of the plain step, minus its derivative by the shift, from the last move (Broyden's update). The
   first move gives one slope for all directions, later ones their own. */
static void learn_slopes(const Limits *limits, const double step[2], const double before[2], const double moved[2],
                         int first, double slopes[2][2])
{
    double length2 = moved[0] * moved[0] + moved[1] * moved[1];
    if (length2 == 0.0) return;
    if (first) {
        double slope = ((before[0] - step[0]) * moved[0] + (before[1] - step[1]) * moved[1]) / length2;
        slopes[0][0] = slopes[1][1] = least(most(slope, 1.0 / limits->largest_relaxation), 1.0);
    }
    for (int axis = 0; axis < 2; axis++) {
        double error = before[axis] - step[axis] - slopes[axis][0] * moved[0] - slopes[axis][1] * moved[1];
        slopes[axis][0] += error * moved[0] / length2;
        slopes[axis][1] += error * moved[1] / length2;
    }
}

/* Move the shift to where the plain step is expected to vanish; return how long the move would be, px. */
static double move(const Limits *limits, const double step[2], double slopes[2][2], double moved[2], double shift[2])
{
    double determinant = slopes[0][0] * slopes[1][1] - slopes[0][1] * slopes[1][0];
    double x = step[0], y = step[1];
    if (determinant > 0.0) {
        x = (slopes[1][1] * step[0] - slopes[0][1] * step[1]) / determinant;
        y = (slopes[0][0] * step[1] - slopes[1][0] * step[0]) / determinant;
    }
    if (x * step[0] + y * step[1] <= 0.0) x = step[0], y = step[1];
    double length = length_of(x, y), longest = limits->largest_relaxation * length_of(step[0], step[1]);
    if (length > longest) x = x * longest / length, y = y * longest / length, length = longest;
    double limit = most(length / limits->longest_step_px, 1.0);
    moved[0] = x / limit, moved[1] = y / limit;
    shift[0] += moved[0];
    shift[1] += moved[1];
    return length;
}

/* Whether the symmetric part of the slopes has no eigenvalue below `slope`. */
static int is_determined(double slopes[2][2], double slope)
{
    double mean = (slopes[0][0] + slopes[1][1]) / 2.0, half_difference = (slopes[0][0] - slopes[1][1]) / 2.0;
    return mean - length_of(half_difference, (slopes[0][1] + slopes[1][0]) / 2.0) >= slope;
}

/* The scatter of the blocks' scores between two inverses of the normal matrix. */
static void sandwich(const Equations *inverse, double (*scores)[2], int64_t blocks, double covariance[2][2])
{
    int64_t other = inverse->terms;
    covariance[0][0] = covariance[0][1] = covariance[1][1] = 0.0;
    for (int64_t block = 0; block < blocks * blocks; block++) {
        double x = inverse->matrix[0][0] * scores[block][0] + inverse->matrix[0][other] * scores[block][1];
        double y = inverse->matrix[other][0] * scores[block][0] + inverse->matrix[other][other] * scores[block][1];
        covariance[0][0] += x * x;
        covariance[0][1] += x * y;
        covariance[1][1] += y * y;
    }
    covariance[1][0] = covariance[0][1];
}

/* The order of the moments, as `weighted_moments` fills them. */
enum { W, WX, WR, WP, WQ, XX, XR, XP, XQ, RR, RP, RQ, PP, PQ, QQ };

/* Add the normal equations of a channel over its residual variance; offset and gain are eliminated. The moments have
   each of 1, x, y, x², xy, y² as a further weight, x and y in half windows; the first alone for a shift. Return the
   refitted gain over the variance of the residual, 0 where nothing was added: singular, or inverted. */
static double add_equations(double moments[LARGEST_TERMS][MOMENTS], double known_gain, int inverted_too, Equations *all,
                            double fit[3][2])
{
    const double *plain = moments[0];
    double determinant = plain[W] * plain[XX] - plain[WX] * plain[WX];
    if (determinant <= MIN_CONTRAST * plain[W] * plain[XX]) return 0.0;
    for (int k = 0; k < 3; k++) {
        double with_one = plain[WR + k], with_x = plain[XR + k];
        fit[k][0] = (with_one * plain[XX] - with_x * plain[WX]) / determinant;
        fit[k][1] = (with_x * plain[W] - with_one * plain[WX]) / determinant;
    }
    double gain = known_gain + fit[0][1];
    double variance = (plain[RR] - fit[0][0] * plain[WR] - fit[0][1] * plain[XR]) / plain[W];
    if (variance <= 0.0 || (gain <= 0.0 && !inverted_too)) return 0.0;
    int64_t terms = all->terms;
    double scale = gain / variance;
    for (int64_t first = 0; first < 2 * terms; first++) {
        int64_t axis = first / terms, k = first % terms;
        double one = moments[k][WP + axis], x = moments[k][XP + axis];
        double e0 = (one * plain[XX] - x * plain[WX]) / determinant;
        double e1 = (x * plain[W] - one * plain[WX]) / determinant;
        all->right[first] += scale * (moments[k][RP + axis] - fit[0][0] * one - fit[0][1] * x);
        for (int64_t second = 0; second < 2 * terms; second++) {
            int64_t other = second / terms, m = second % terms;
            int64_t product = k + m + (smaller(k, m) > 0 ? 1 : 0);
            double projected = e0 * moments[m][WP + other] + e1 * moments[m][XP + other];
            all->matrix[first][second] += gain * scale * (moments[product][PP + axis + other] - projected);
        }
    }
    return scale;
}

static Window window_of(const Job *job, int64_t channel)
{
    const Workspace *work = &job->work;
    return (Window){work->references + channel * job->extended, work->value, work->slope_x, work->slope_y};
}

/* How far a window reaches above its centre, and before it along a row, px. */
static void reach_of(const Options *options, int64_t *above, int64_t *before)
{
    *above = options->step * (options->half_rows + options->correlation_half);
    *before = options->step * (options->half_cols + options->correlation_half);
}

/* Sample the window of a channel, its reference at the first call only; return 0 if it leaves the image. */
static int load_channel(const Job *job, int64_t k, const int64_t corner[2], const double place[2],
                        const double linear[2][2], int deformed, int first, int slopes)
{
    const Images *images = job->images;
    Window window = window_of(job, k);
    int64_t above, before;
    reach_of(job->options, &above, &before);
    if (first) {
        Plane plane = {images->reference + k * images->rows * images->cols, images->rows, images->cols};
        copy_window(plane, corner[0] - above, corner[1] - before, job->shape, window.reference);
    }
    int64_t numbers = images->target_rows * images->target_cols;
    Plane plane = {images->coefficients + k * numbers, images->target_rows, images->target_cols};
    double row = (double)corner[0] + place[1], col = (double)corner[1] + place[0];
    if (deformed) return sample_deformed(plane, row, col, linear, job->shape, slopes, window);
    return sample_shift(plane, row - (double)above, col - (double)before, job->shape, job->work.rows, window);
}

/* Add the equations of a channel, and its scores if they are wanted, unless its window is flat. */
static void add_channel(const Job *job, int64_t k, int scored, Equations *all)
{
    const Workspace *work = &job->work;
    const float *structure = work->structures + k * job->plain;
    Window window = window_of(job, k);
    double offset, factor, known = fit_gain(job->shape, structure, window, &offset, &factor);
    if (known <= 0.0) return;
    Gain gain = {(float)offset, (float)factor, 0.0f};
    if (job->options->robust) {
        double deviation = sum_of_deviations(job->shape, structure, window, gain) / known;
        gain.per_sigma = (float)(1.0 / most(job->limits->sigma_per_mean_deviation * deviation, 1e-9));
    }
    double moments[LARGEST_TERMS][MOMENTS], fit[3][2];
    for (int64_t m = 0; m < (job->options->affine ? LARGEST_TERMS : 1); m++)
        weighted_moments(job->shape, structure, m ? work->monomials + (m - 1) * job->plain : 0, window, gain,
                         work->rows, moments[m]);
    /* a single map may be inverted as a whole; an inverted channel of several shows other structure */
    int inverted_too = job->images->channels == 1;
    double scale = add_equations(moments, (double)gain.gain, inverted_too, all, fit);
    if (scored && scale != 0.0)
        add_block_scores(job->shape, structure, window, gain, fit, scale, job->options->blocks, work->rows, work->scores);
}

/* Sample all channels at a place, and add their equations unless it is only for the structure. */
static int measure(const Job *job, const int64_t corner[2], const double place[2], const double linear[2][2],
                   int deformed, int first, int structure_only, int scored, Equations *all)
{
    const Workspace *work = &job->work;
    int64_t mode = job->options->structure_mode;
    for (int64_t i = 0; i < 2 * all->terms; i++) {
        all->right[i] = 0.0;
        for (int64_t j = 0; j < 2 * all->terms; j++) all->matrix[i][j] = 0.0;
    }
    for (int64_t i = 0; i < job->options->blocks * job->options->blocks; i++)
        work->scores[i][0] = work->scores[i][1] = 0.0;
    for (int64_t k = 0; k < job->images->channels; k++) {
        if (!load_channel(job, k, corner, place, linear, deformed, first, !structure_only)) return 0;
        if (mode == STRUCTURE_FOLLOWS || (mode == STRUCTURE_FIXED && first)) {
            Window window = window_of(job, k);
            float *mean = work->means + k * job->plain, *precision = work->precisions + k * job->plain;
            if (first) reference_moments(job->shape, window.reference, work->rows, mean, precision);
            mutual_structure(job->shape, window, work->rows, mean, precision, work->valid,
                             work->structures + k * job->plain);
        }
        if (!structure_only) add_channel(job, k, scored, all);
    }
    return 1;
}

/* Iterate until the shift converges; the last equations give the covariance. Return the status. */
static int64_t refine_point(const Job *job, int64_t p, double shift[2], double linear[2][2], double covariance[2][2])
{
    const Options *options = job->options;
    const Limits *limits = job->limits;
    const int64_t *corner = job->starts->corners_rc[p];
    const double *start = job->starts->shift_xy[p], *wanted = job->starts->structure_xy[p];
    int deformed = options->affine != 0;
    for (int axis = 0; axis < 2; axis++) {
        shift[axis] = start[axis];
        for (int other = 0; other < 2; other++) {
            linear[axis][other] = job->starts->linear[p][axis][other];
            deformed |= linear[axis][other] != 0.0;
        }
    }
    double step[2], before[2] = {0.0, 0.0}, moved[2] = {0.0, 0.0};
    double slopes[2][2] = {{1.0 / options->relaxation, 0.0}, {0.0, 1.0 / options->relaxation}};
    double length = options->reached_by_px;
    Equations all = {.terms = options->affine ? 3 : 1};
    /* structure that is fixed is computed at its own place first, unless that is where the shift starts */
    int elsewhere = options->structure_mode == STRUCTURE_FIXED && (wanted[0] != shift[0] || wanted[1] != shift[1]);
    if (elsewhere && !measure(job, corner, wanted, linear, deformed, 1, 1, 0, &all)) return DIVERGED;
    for (int64_t iteration = 0; iteration < options->iterations; iteration++) {
        double before_px = length;
        int near = before_px < limits->near_px, first = iteration == 0 && !elsewhere;
        if (!measure(job, corner, shift, linear, deformed, first, 0, near, &all)) return DIVERGED;
        if (!invert(&all.matrix[0][0], 2 * all.terms, 2 * LARGEST_TERMS)) return DIVERGED;
        plain_step(&all, options, step, linear);
        if (iteration > 0 && !options->affine) /* a deformation that moves too hides what the shift did */
            learn_slopes(limits, step, before, moved, iteration == 1, slopes);
        length = move(limits, step, slopes, moved, shift);
        before[0] = step[0], before[1] = step[1];
        if (!(length_of(shift[0] - start[0], shift[1] - start[1]) <= options->largest_move_px)) return DIVERGED;
        /* moves shrink faster and faster: the next one, which is left out, by the same ratio at least */
        if (near && length * least(length / before_px, 1.0) < options->tolerance_px) {
            sandwich(&all, job->work.scores, options->blocks, covariance);
            return is_determined(slopes, limits->min_slope) ? CONVERGED : UNDETERMINED;
        }
        if (iteration >= limits->settled_after && length > limits->settling_px && !options->affine) return NOT_CONVERGED;
        if (iteration >= limits->patience && !is_determined(slopes, limits->min_slope / 2.0)) return UNDETERMINED;
    }
    return NOT_CONVERGED;
}

/* Fill the window of validity in both images and return the share of valid pixels. */
static double valid_share(const Job *job, const double shift_xy[2], int64_t row, int64_t col, float *valid)
{
    const Images *images = job->images;
    int64_t rows = job->shape.rows, cols = job->shape.cols, step = job->shape.step, good = 0;
    int64_t top = row - step * job->options->half_rows, left = col - step * job->options->half_cols;
    int64_t down = (int64_t)__builtin_rint(shift_xy[1]), right = (int64_t)__builtin_rint(shift_xy[0]);
    for (int64_t i = 0; i < job->plain; i++) valid[i] = 0.0f;
    for (int64_t r = 0; r < rows; r++) {
        int64_t y = top + step * r, there = y + down, c = 0;
        if (there < 0 || there >= images->target_rows) continue;
        const uint8_t *here = images->reference_valid + y * images->valid_cols + left;
        const uint8_t *target = images->target_valid + there * images->target_valid_cols + left + right;
        while (c < cols && left + right + step * c < 0) c++;
        for (int32_t both; c < cols && left + right + step * c < images->target_valid_cols; c++, good += both) {
            both = here[step * c] & target[step * c];
            valid[r * job->shape.width + c] = (float)both;
        }
    }
    return (double)good / (double)(rows * cols);
}

/* Fill weights that are not computed from the images: 1, or the given structure; 0 where not valid. */
static void set_structure(const Job *job, int64_t p)
{
    int64_t rows = job->shape.rows, cols = job->shape.cols, width = job->shape.width;
    const float *given = job->starts->structure + p * rows * cols;
    for (int64_t k = 0; k < job->images->channels; k++) {
        float *structure = job->work.structures + k * job->plain;
        for (int64_t i = 0; i < job->plain; i++) structure[i] = job->work.valid[i];
        if (job->options->structure_mode != STRUCTURE_GIVEN) continue;
        for (int64_t r = 0; r < rows; r++)
            for (int64_t c = 0; c < cols; c++) structure[r * width + c] *= given[r * cols + c];
    }
}

/* x, y, x², xy, y² of the pixels of a window, in half windows. */
static void fill_monomials(const Job *job)
{
    double half_cols = (double)job->options->half_cols, half_rows = (double)job->options->half_rows;
    for (int64_t r = 0; r < job->shape.rows; r++)
        for (int64_t c = 0; c < job->shape.cols; c++) {
            double x = (double)c / half_cols - 1.0, y = (double)r / half_rows - 1.0;
            double values[5] = {x, y, x * x, x * y, y * y};
            for (int k = 0; k < 5; k++)
                job->work.monomials[k * job->plain + r * job->shape.width + c] = (float)values[k];
        }
}

/* Refine every corner of `starts` on the maps of `images` and fill `results`. `memory` is what `refinement_memory`
   asks for, `scores` two numbers for each of the blocks. Points whose window is not usable keep zeros and the
   status INVALID. */
EXPORT void refine_points(const Images *images, const Starts *starts, const Options *options, const Limits *limits,
                          float *memory, double (*scores)[2], const Results *results)
{
    Shape shape = shape_of(options);
    Job job = {images, starts, options, limits, {.scores = scores}, shape, extended_numbers(shape), plain_numbers(shape)};
    divide(images, options, shape, memory, &job.work);
    if (options->affine) fill_monomials(&job);
    int64_t above, before;
    reach_of(options, &above, &before);
    for (int64_t p = 0; p < starts->count; p++) {
        int64_t row = starts->corners_rc[p][0], col = starts->corners_rc[p][1];
        results->status[p] = INVALID;
        if (row < above || col < before) continue;
        if (row + above >= images->rows || col + before >= images->cols) continue;
        /* a vector that is read earlier at the end of a plane still begins within it */
        if (smaller(images->target_rows, images->target_cols) < LANES) continue;
        const double *shift = starts->shift_xy[p];
        if (!(length_of(shift[0], shift[1]) <= FARTHEST_PX)) continue; /* or not a number */
        if (valid_share(&job, shift, row, col, job.work.valid) < options->least_valid) continue;
        if (options->structure_mode == STRUCTURE_NONE || options->structure_mode == STRUCTURE_GIVEN) set_structure(&job, p);
        results->status[p] = refine_point(&job, p, results->shift_xy[p], results->linear[p], results->covariance[p]);
    }
}
