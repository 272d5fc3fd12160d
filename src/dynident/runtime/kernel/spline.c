/* The banded system of the smoothing spline: factorise, solve, refine. README.md explains the method.

   The sweeps are written once (spline_sweeps.h), for one series and for LANES of them side by side. */

#include "lanes.h"

#define FORCED static inline __attribute__((always_inline))
#define EPS 2.220446049250313e-16
#define TINY 2.2250738585072014e-308
#define MISSED 5e-11 /* relative error of an aim from which p is corrected, */
#define NEAR 1e-5     /* and below which one step of Newton's method does it */
#define LARGE 1e-8 /* the relative correction at which refinement has failed */

#define V double
#define MASK int64_t
#define COUNT 1
#define NAME(x) x##_one
#include "spline_sweeps.h"
#undef V
#undef MASK
#undef COUNT
#undef NAME

typedef int64_t mask __attribute__((vector_size(8 * LANES)));
#define V lanes
#define MASK mask
#define COUNT LANES
#define NAME(x) x##_many
#include "spline_sweeps.h"

/* Doubles side by side in the work arrays of `many`. */
EXPORTED int32_t API(spline_lanes)(void) { return LANES; }

#define BLOCK 256 /* rows that stay in the first cache while each column is worked on */

#define ABREAST 16 /* rows that are looked at side by side */

/* Of each of k columns (n, k): least value, largest, and their sum with zero times each value, not finite where one
   is not, in the first k of each row of out (3, 16 k). The order of comparisons does not matter. */
EXPORTED void API(spline_survey)(int64_t n, int64_t k, const double *restrict y, double *restrict out) {
    const int64_t wide = ABREAST * k;
    double *restrict low = out, *restrict high = out + wide, *restrict bad = out + 2 * wide;
    for (int64_t j = 0; j < wide; j++) low[j] = high[j] = y[j % k], bad[j] = 0.0;
    for (int64_t i = 0; i < n * k; i += wide) {
        const int64_t last = n * k - i < wide ? n * k - i : wide;
        for (int64_t j = 0; j < last; j++) {
            double x = y[i + j];
            low[j] = x < low[j] ? x : low[j];
            high[j] = x > high[j] ? x : high[j];
            bad[j] += 0.0 * x;
        }
    }
    for (int64_t j = k; j < wide; j++) {
        low[j % k] = low[j] < low[j % k] ? low[j] : low[j % k];
        high[j % k] = high[j] > high[j % k] ? high[j] : high[j % k];
        bad[j % k] += bad[j];
    }
}

typedef double four __attribute__((vector_size(32), aligned(8), may_alias)); /* on every level */
#define FOUR(x, i) (*(four *)((x) + (i)))
#define SUM(x) (((x)[0] + (x)[1]) + ((x)[2] + (x)[3]))

/* Second differences z (k, n - 2) of columns (n, k) times `inverse` (k), by the reciprocal steps r (n - 1); and
   of y = (column less its first value) times `inverse` in out (3, k) the sums of squares of its slopes, of itself, and
   of what a straight line leaves of it, over the times x = (t - middle) * rate. work (2, k). */
EXPORTED void API(spline_scale)(int64_t n, int64_t k, const double *restrict from, const double *restrict r,
                                const double *restrict inverse, const double *restrict t, double middle, double rate,
                                double *restrict z, double *restrict moments, double *restrict out) {
    double time = 0.0, square = 0.0, x[BLOCK], a[BLOCK], y[BLOCK + 2], slope[BLOCK + 1];
    for (int64_t j = 0; j < k; j++) {
        double last = (from[(n - 1) * k + j] - from[(n - 2) * k + j]) * r[n - 2] * inverse[j];
        moments[j] = moments[k + j] = out[k + j] = 0.0;
        out[j] = last * last;
    }
    for (int64_t start = 0; start < n; start += BLOCK) {
        const int64_t count = n - start < BLOCK ? n - start : BLOCK; /* rows beyond the last are zero */
        const int64_t bends = n - 2 - start < BLOCK ? n - 2 - start : BLOCK;
        four sum_x = {0}, sum_xx = {0};
        for (int64_t i = 0; i < BLOCK; i++) x[i] = i < count ? (t[start + i] - middle) * rate : 0.0;
        for (int64_t i = 0; i < count; i += 4) sum_x += FOUR(x, i), sum_xx += FOUR(x, i) * FOUR(x, i);
        time += SUM(sum_x), square += SUM(sum_xx);
        for (int64_t j = 0; j < k; j++) {
            const double *column = from + start * k + j, first = from[j], unit = inverse[j];
            double *bend = z + j * (n - 2) + start;
            four sum_a = {0}, sum_ax = {0}, sum_aa = {0}, sum_ss = {0};
            for (int64_t i = 0; i < count; i++) y[i] = column[i * k];
            for (int64_t i = count; i < bends + 2; i++) y[i] = column[i * k];
            for (int64_t i = 0; i < bends + 1; i++) slope[i] = (y[i + 1] - y[i]) * r[start + i] * unit;
            for (int64_t i = 0; i < bends; i++) bend[i] = slope[i + 1] - slope[i];
            for (int64_t i = 0; i < count; i++) a[i] = (y[i] - first) * unit;
            for (int64_t i = count; i & 3; i++) a[i] = 0.0;
            for (int64_t i = bends > 0 ? bends : 0; i & 3; i++) slope[i] = 0.0;
            for (int64_t i = 0; i < count; i += 4) {
                const four here = FOUR(a, i);
                sum_a += here, sum_ax += here * FOUR(x, i), sum_aa += here * here;
            }
            for (int64_t i = 0; i < bends; i += 4) sum_ss += FOUR(slope, i) * FOUR(slope, i);
            moments[j] += SUM(sum_a), moments[k + j] += SUM(sum_ax), out[k + j] += SUM(sum_aa), out[j] += SUM(sum_ss);
        }
    }
    square -= time * time / (double)n;
    for (int64_t j = 0; j < k; j++) {
        double tilt = moments[k + j] - time * moments[j] / (double)n;
        out[2 * k + j] = out[k + j] - moments[j] * moments[j] / (double)n - tilt * tilt / square;
    }
}

/* Rows start to end of values and c (below) of columns j to j + LANES, whose u are side by side. What is written beyond
   `count` columns is written again later: by rows further on, and by columns to the left. */
static void finish_rows(int64_t start, int64_t end, int64_t n, int64_t k, int64_t j, int64_t count, const double *from,
                        const double *r, const double *const *u, int64_t apart, const double *const *variance,
                        const double *size, const double *bend, double *values, double *c) {
    const double *x = u[j] - apart; /* row by row; zero at both ends */
    lanes none = {0}, sizes = {0}, bends = {0}, weight;
    for (int64_t l = 0; l < count; l++) sizes[l] = size[j + l], bends[l] = bend[j + l];
    lanes here = start > 0 && start < n - 1 ? load(x + start * apart) : none;
    lanes before = start > 1 ? load(x + (start - 1) * apart) : none;
    lanes down = start ? (here - before) * all(r[start - 1]) : none;
    for (int64_t i = start; i < end; i++) {
        lanes after = i + 1 < n - 1 ? load(x + (i + 1) * apart) : none;
        lanes up = i + 1 < n ? (after - here) * all(r[i]) : none, v = up - down, bent = bends * here;
        const int64_t at = i * k + j;
        if (variance) {
            for (int64_t l = 0; l < LANES; l++) weight[l] = l < count ? variance[j + l][i] : 0.0;
            v *= weight;
        }
        if (at + LANES <= n * k) {
            store(values + at, load(from + at) - sizes * v);
            store(c + at, bent);
        } else
            for (int64_t l = 0; l < count; l++) values[at + l] = from[at + l] - sizes[l] * v[l], c[at + l] = bent[l];
        here = after, down = up;
    }
}

/* The same of one column j. */
static void finish_column(int64_t start, int64_t end, int64_t n, int64_t k, int64_t j, const double *restrict from,
                          const double *restrict r, const double *restrict u, int64_t apart, const double *restrict d,
                          double size, double bend, double *restrict values, double *restrict c) {
    double x[BLOCK + 2], slope[BLOCK + 1]; /* from the row before the block on; zero at both ends and beyond */
    const int64_t count = end - start, first = start ? 0 : 2, last = end < n - 1 ? count + 2 : n - start;
    const int64_t steps = end < n ? count : count - 1;
    for (int64_t i = 0; i < first; i++) x[i] = 0.0;
    for (int64_t i = first; i < last; i++) x[i] = u[(start - 2 + i) * apart];
    for (int64_t i = last; i < count + 2; i++) x[i] = 0.0;
    slope[0] = start ? (x[1] - x[0]) * r[start - 1] : 0.0;
    for (int64_t i = 1; i <= steps; i++) slope[i] = (x[i + 1] - x[i]) * r[start + i - 1];
    if (steps < count) slope[count] = 0.0;
    for (int64_t i = 0; i < count; i++) {
        const double v = slope[i + 1] - slope[i];
        const int64_t at = (start + i) * k + j;
        values[at] = from[at] - size * (d ? d[start + i] * v : v);
        c[at] = bend * x[i + 1];
    }
}

/* Back to the data's units: values (n, k) = from - size D^2 Q u, and c (n, k) = bend u. u is k pointers to (n - 2)
   numbers that are `apart` (k) from each other; variance k pointers to (n), or null. */
EXPORTED void API(spline_finish)(int64_t n, int64_t k, const double *from, const double *r, const double *const *u,
                                 const int64_t *apart, const double *const *variance, const double *size,
                                 const double *bend, double *values, double *c) {
    for (int64_t start = 0; start < n; start += BLOCK) {
        const int64_t end = start + BLOCK < n ? start + BLOCK : n;
        for (int64_t j = k - 1; j >= 0; j--) {
            int64_t last = j;
            while (j > 0 && last - j < LANES - 1 && apart[j] >= LANES && apart[j - 1] == apart[j] && u[j - 1] + 1 == u[j]) j--;
            const int64_t count = last - j + 1;
            if (apart[j] >= LANES && (count == LANES || last == k - 1))
                finish_rows(start, end, n, k, j, count, from, r, u, apart[j], variance, size, bend, values, c);
            else
                for (int64_t l = j; l <= last; l++)
                    finish_column(start, end, n, k, l, from, r, u[l], apart[l], variance ? variance[l] : 0, size[l],
                                  bend[l], values, c);
        }
    }
}

/* First derivative (n, k) at the samples, eq. (35), of values and c (n, k) at times t (n). */
EXPORTED void API(spline_slope)(int64_t n, int64_t k, const double *restrict t, const double *restrict a,
                                const double *restrict c, double *restrict out) {
    const int64_t end = (n - 1) * k;
    if (k == 1)
        for (int64_t i = 0; i < end; i++) {
            double h = t[i + 1] - t[i];
            out[i] = (a[i + 1] - a[i]) * (1.0 / h) - (h / 3.0) * (2.0 * c[i] + c[i + 1]);
        }
    else
        for (int64_t i = 0; i < n - 1; i++) {
            double h = t[i + 1] - t[i], r = 1.0 / h, third = h / 3.0;
            int64_t j = i * k;
            for (; j < (i + 1) * k && j + LANES <= end; j += LANES) /* what is beyond the row is written again */
                store(out + j, (load(a + j + k) - load(a + j)) * all(r)
                                   - all(third) * (all(2.0) * load(c + j) + load(c + j + k)));
            for (; j < (i + 1) * k; j++) out[j] = (a[j + k] - a[j]) * r - third * (2.0 * c[j] + c[j + k]);
        }
    double h = t[n - 1] - t[n - 2];
    for (int64_t j = (n - 1) * k; j < n * k; j++) out[j] = out[j - k] + h * (c[j - k] + c[j]);
}

/* Sums (k) of the squares of fourth divided differences of columns y (n, k) at times t (n), over their variances, where
   that of a sample is 1 / weight; weight (n, own) has one column or k. */
EXPORTED void API(spline_noise)(int64_t n, int64_t k, const double *restrict t, const double *restrict y,
                                const double *restrict weight, int64_t own, double *restrict sum) {
    for (int64_t j = 0; j < k; j++) sum[j] = 0.0;
    for (int64_t i = 0; i + 4 < n; i++) {
        const double rate = 1.0 / (t[i + 4] - t[i]);
        double c[5], square[5], variance = 0.0;
        for (int a = 0; a < 5; a++) {
            double product = 1.0;
            for (int b = 0; b < 5; b++) product *= a == b ? 1.0 : (t[i + a] - t[i + b]) * rate;
            c[a] = 1.0 / product, square[a] = c[a] * c[a];
        }
        if (own == 1) {
            const double *w = weight + i;
            variance = square[0] / w[0] + square[1] / w[1] + square[2] / w[2] + square[3] / w[3] + square[4] / w[4];
        }
        const double *x = y + i * k, reciprocal = 1.0 / variance;
        for (int64_t j = 0; j < k; j++) {
            double found = c[0] * x[j] + c[1] * x[j + k] + c[2] * x[j + 2 * k] + c[3] * x[j + 3 * k] + c[4] * x[j + 4 * k];
            double over = reciprocal;
            if (own > 1) {
                const double *w = weight + i * k + j;
                over = 1.0 / (square[0] / w[0] + square[1] / w[k] + square[2] / w[2 * k] + square[3] / w[3 * k] + square[4] / w[4 * k]);
            }
            sum[j] += found * found * over;
        }
    }
}

#include "spline_search.h"
