/* The sums of the coarse match: those of a template and of the windows of a search area, at every offset.

   Rows are correlated by their Fourier transforms, columns as they stand: few offsets are asked for. All rows are
   transformed at once, so that vectors hold rows, and one transform of complex numbers does those of two windows. */

#include "kernels.h"

#define AT_ONCE 4 /* offsets, at least two of the vectors' latency */

enum { VALUES, SQUARES, MASK, KINDS };

typedef struct {
    const float *values, *valid;
    int64_t cols;
} Map;

typedef struct {
    int64_t template, area;  /* sides of the template and of the search area, px */
    int64_t length, width;   /* of a transform; rows of a window and zeros beyond */
    int64_t offsets, lanes;  /* offsets an axis, and the next multiple of LANES */
    const float (*roots)[2]; /* of unity, clockwise */
} Search;

typedef struct {
    Planes one, other;       /* a transform goes from one to the other and back */
    Planes areas[KINDS], templates[KINDS];
    Planes cross;            /* (offsets, frequencies) */
    Planes waves;            /* (frequencies, lanes) */
} Memory;

static int64_t frequencies(Search search) { return search.length / 2 + 1; }

/* Divide memory; count the numbers that are used. */
static Memory divided(float *begin, int64_t *used, Search search)
{
    int64_t count = frequencies(search) * search.width;
    Memory memory = {.one = planes_of(begin, used, search.length * search.width),
                     .other = planes_of(begin, used, search.length * search.width)};
    for (int kind = 0; kind < KINDS; kind++) {
        memory.areas[kind] = planes_of(begin, used, count);
        memory.templates[kind] = planes_of(begin, used, count);
    }
    memory.cross = planes_of(begin, used, frequencies(search) * (search.offsets + AT_ONCE));
    memory.waves = planes_of(begin, used, frequencies(search) * search.lanes);
    return memory;
}

/* Copy a kind of a window, of which the first pixel is at row, col, with its rows along those of memory. */
static void copy(Map map, int kind, int64_t row, int64_t col, int64_t side, Search search, float *out)
{
    const float *from = (kind == MASK ? map.valid : map.values) + row * map.cols + col;
    for (int64_t c = 0; c < search.length; c++) {
        float *to = out + c * search.width;
        int64_t rows = c < side ? side : 0;
        for (int64_t r = 0; r < rows; r++) {
            float value = from[r * map.cols + c];
            to[r] = kind == SQUARES ? value * value : value;
        }
        for (int64_t r = rows; r < search.width; r++) to[r] = 0.0f;
    }
}

/* The spectra of a kind of the search area and of one of the template, whose middle is at row, col. */
static void transform_both(Map reference, Map target, int64_t row, int64_t col, int of_area, int of_template,
                           Search search, Memory memory)
{
    int64_t half = search.template / 2, reach = search.area / 2;
    copy(target, of_area, row - reach, col - reach, search.area, search, memory.one.real);
    copy(reference, of_template, row - half, col - half, search.template, search, memory.one.imaginary);
    Planes both = transform(memory.one, memory.other, search.length, search.width, search.roots);
    Planes area = memory.areas[of_area], template = memory.templates[of_template];
    for (int64_t k = 0; k < frequencies(search); k++) {
        int64_t to = k * search.width, opposite = (search.length - k) % search.length * search.width;
        for (int64_t i = 0; i < search.width; i += LANES) {
            Vector a = load(both.real + to + i), b = load(both.imaginary + to + i);
            Vector c = load(both.real + opposite + i), d = load(both.imaginary + opposite + i);
            store(area.real + to + i, 0.5f * (a + c)), store(area.imaginary + to + i, 0.5f * (b - d));
            store(template.real + to + i, 0.5f * (b + d)), store(template.imaginary + to + i, 0.5f * (c - a));
        }
    }
}

static inline float total(Vector v)
{
    float sum = 0.0f;
    for (int i = 0; i < LANES; i++) sum += v[i];
    return sum;
}

/* Correlate two spectra: the sums of the products at every offset. Some offsets at a time, as each sum has to wait for
   itself; the last ones may be those before again. */
static void correlate(Planes area, Planes template, Search search, Memory memory, double *out)
{
    int64_t width = search.width, count = frequencies(search);
    for (int64_t k = 0; k < count; k++)
        for (int64_t next = 0; next < search.offsets; next += AT_ONCE) {
            int64_t first = larger(0, smaller(next, search.offsets - AT_ONCE));
            Vector real[AT_ONCE] = {{0}}, imaginary[AT_ONCE] = {{0}};
            for (int64_t i = k * width; i < k * width + search.template; i += LANES) {
                Vector c = load(template.real + i), d = load(template.imaginary + i);
                for (int m = 0; m < AT_ONCE; m++) {
                    Vector a = load(area.real + i + first + m), b = load(area.imaginary + i + first + m);
                    real[m] += a * c, imaginary[m] += b * c;
                    real[m] += b * d, imaginary[m] -= a * d;
                }
            }
            for (int m = 0; m < AT_ONCE; m++) {
                memory.cross.real[(first + m) * count + k] = total(real[m]);
                memory.cross.imaginary[(first + m) * count + k] = total(imaginary[m]);
            }
        }
    for (int64_t next = 0; next < search.offsets; next += AT_ONCE)
        for (int64_t across = 0; across < search.lanes; across += LANES) {
            int64_t first = larger(0, smaller(next, search.offsets - AT_ONCE));
            Vector sums[AT_ONCE] = {{0}};
            for (int64_t k = 0; k < count; k++) {
                int64_t at = k * search.lanes + across;
                Vector cosine = load(memory.waves.real + at), sine = load(memory.waves.imaginary + at);
                for (int m = 0; m < AT_ONCE; m++) {
                    sums[m] += memory.cross.real[(first + m) * count + k] * cosine;
                    sums[m] += memory.cross.imaginary[(first + m) * count + k] * sine;
                }
            }
            for (int64_t m = 0; m < smaller(AT_ONCE, search.offsets - first); m++)
                for (int64_t i = across; i < smaller(across + LANES, search.offsets); i++)
                    out[(first + m) * search.offsets + i] = (double)sums[m][i - across];
        }
}

/* What a frequency adds to the correlation at each offset along a row; all but two stand for their opposites too. */
static void fill_waves(Search search, Memory memory)
{
    for (int64_t k = 0; k < frequencies(search); k++)
        for (int64_t i = 0; i < search.lanes; i++) {
            float share = (k == 0 || 2 * k == search.length ? 1.0f : 2.0f) / (float)search.length;
            const float *root = search.roots[k * i % search.length];
            memory.waves.real[k * search.lanes + i] = share * root[0];
            memory.waves.imaginary[k * search.lanes + i] = share * root[1];
        }
}

/* The sums of a kind of the target over the windows of the template's side. `columns` holds those of its columns. */
static void box_sums(Map target, int kind, int64_t row, int64_t col, Search search, double *columns, double *out)
{
    const float *first = (kind == MASK ? target.valid : target.values) + row * target.cols + col;
    for (int64_t c = 0; c < search.area; c++) columns[c] = 0.0;
    for (int64_t r = 0; r < search.area; r++) {
        const float *enters = first + r * target.cols, *leaves = enters - search.template * target.cols;
        for (int64_t c = 0; c < search.area; c++) {
            double in = (double)enters[c], gone = r < search.template ? 0.0 : (double)leaves[c];
            columns[c] += kind == SQUARES ? in * in - gone * gone : in - gone;
        }
        if (r < search.template - 1) continue;
        double sum = 0.0, *to = out + (r - search.template + 1) * search.offsets;
        for (int64_t c = 0; c < search.area; c++) {
            sum += columns[c] - (c < search.template ? 0.0 : columns[c - search.template]);
            if (c >= search.template - 1) to[c - search.template + 1] = sum;
        }
    }
}

/* The sum of a kind over a window. */
static double window_sum(Map map, int kind, int64_t row, int64_t col, int64_t side)
{
    double sums[LANES] = {0}, sum = 0.0;
    for (int64_t r = row; r < row + side; r++) {
        const float *from = (kind == MASK ? map.valid : map.values) + r * map.cols + col;
        for (int64_t c = 0; c < side; c += LANES)
            for (int64_t i = 0; i < smaller(LANES, side - c); i++) {
                double value = (double)from[c + i];
                sums[i] += kind == SQUARES ? value * value : value;
            }
    }
    for (int i = 0; i < LANES; i++) sum += sums[i];
    return sum;
}

static void fill(double *out, int64_t count, double value)
{
    for (int64_t i = 0; i < count; i++) out[i] = value;
}

static Search searched(int64_t template, int64_t radius, int64_t length, const float (*roots)[2])
{
    int64_t offsets = 2 * radius + 1, width = rounded_up(template) + rounded_up(larger(2 * radius, AT_ONCE));
    Search search = {template, template + 2 * radius, length, width, offsets, rounded_up(offsets), roots};
    return search;
}

/* Numbers of float64 that `correlation_sums` needs as its memory. */
EXPORT int64_t coarse_memory(int64_t template, int64_t radius, int64_t length)
{
    Search search = searched(template, radius, length, 0);
    int64_t used = 0;
    divided(0, &used, search);
    return search.area + (used + 1) / 2;
}

/* For each of the n `corners` (row, col): the number of pixels valid in both and their sums of t, t², s, s², t s at
   every offset, (n, 6, offsets, offsets), where t is the template and s the window of the search area; all 0 where
   fewer than `least` pixels of the template are valid. Values that are not valid are 0. */
EXPORT void correlation_sums(const float *reference_values, const float *reference_valid, const float *target_values,
                             const float *target_valid, int64_t cols, const int64_t (*corners)[2], int64_t n,
                             int64_t template, int64_t radius, int64_t length, const float (*roots)[2], double least,
                             double *memory_begin, double *sums)
{
    Search search = searched(template, radius, length, roots);
    int64_t area = search.area, count = search.offsets * search.offsets;
    Map reference = {reference_values, reference_valid, cols}, target = {target_values, target_valid, cols};
    double *columns = memory_begin;
    int64_t used = 0;
    Memory memory = divided((float *)(memory_begin + area), &used, search);
    fill_waves(search, memory);
    for (int64_t point = 0; point < n; point++) {
        int64_t row = corners[point][0], col = corners[point][1], top = row - area / 2, left = col - area / 2;
        double *out = sums + 6 * count * point;
        int64_t first_row = row - template / 2, first_col = col - template / 2;
        double valid = window_sum(reference, MASK, first_row, first_col, template);
        if (valid < least) {
            fill(out, 6 * count, 0.0);
            continue;
        }
        int whole_template = valid == (double)(template * template);
        int whole_area = window_sum(target, MASK, top, left, area) == (double)(area * area);
        transform_both(reference, target, row, col, VALUES, VALUES, search, memory);
        correlate(memory.areas[VALUES], memory.templates[VALUES], search, memory, out + 5 * count);
        if (whole_template && !whole_area) transform_both(reference, target, row, col, MASK, SQUARES, search, memory);
        if (!whole_template && whole_area) transform_both(reference, target, row, col, SQUARES, MASK, search, memory);
        if (!whole_template && !whole_area) {
            transform_both(reference, target, row, col, SQUARES, SQUARES, search, memory);
            transform_both(reference, target, row, col, MASK, MASK, search, memory);
        }
        for (int kind = VALUES; kind <= SQUARES; kind++) {
            double *of_t = out + (1 + kind) * count, *of_s = out + (3 + kind) * count;
            if (whole_area) fill(of_t, count, window_sum(reference, kind, first_row, first_col, template));
            else correlate(memory.areas[MASK], memory.templates[kind], search, memory, of_t);
            if (whole_template) box_sums(target, kind, top, left, search, columns, of_s);
            else correlate(memory.areas[kind], memory.templates[MASK], search, memory, of_s);
        }
        if (whole_area) fill(out, count, valid);
        else if (whole_template) box_sums(target, MASK, top, left, search, columns, out);
        else {
            correlate(memory.areas[MASK], memory.templates[MASK], search, memory, out);
            for (int64_t i = 0; i < count; i++) out[i] = (double)(int64_t)(out[i] + 0.5);
        }
    }
}
