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

/* Of each of k columns (n, k): least value, largest, and their sum with zero times each value, not finite where one
   is not. out (3, k). */
EXPORTED void API(spline_survey)(int64_t n, int64_t k, const double *restrict y, double *restrict out) {
    if (k == 1) { /* eight at a time: the order of comparisons does not matter */
        double low[8], high[8], bad[8] = {0};
        for (int j = 0; j < 8; j++) low[j] = high[j] = y[0];
        int64_t i = 0;
        for (; i + 8 <= n; i += 8)
            for (int j = 0; j < 8; j++) {
                double x = y[i + j];
                low[j] = x < low[j] ? x : low[j];
                high[j] = x > high[j] ? x : high[j];
                bad[j] += 0.0 * x;
            }
        for (; i < n; i++) {
            low[0] = y[i] < low[0] ? y[i] : low[0];
            high[0] = y[i] > high[0] ? y[i] : high[0];
            bad[0] += 0.0 * y[i];
        }
        for (int j = 1; j < 8; j++) {
            low[0] = low[j] < low[0] ? low[j] : low[0];
            high[0] = high[j] > high[0] ? high[j] : high[0];
            bad[0] += bad[j];
        }
        out[0] = low[0], out[1] = high[0], out[2] = bad[0];
        return;
    }
    double *low = out, *high = out + k, *bad = out + 2 * k;
    for (int64_t j = 0; j < k; j++) low[j] = high[j] = y[j], bad[j] = 0.0;
    for (int64_t i = 0; i < n; i++)
        for (int64_t j = 0; j < k; j++) {
            double x = y[i * k + j];
            low[j] = x < low[j] ? x : low[j];
            high[j] = x > high[j] ? x : high[j];
            bad[j] += 0.0 * x;
        }
}

/* Second differences z (k, n - 2) of columns (n, k) times `inverse` (k), by the reciprocal steps r (n - 1); and
   of y = (column less its first value) times `inverse` in out (3, k) the sums of squares of its slopes, of itself, and
   of what a straight line leaves of it, over the times x = (t - middle) * rate. work (5, k). */
EXPORTED void API(spline_scale)(int64_t n, int64_t k, const double *restrict from, const double *restrict r,
                                const double *restrict inverse, const double *restrict t, double middle, double rate,
                                double *restrict z, double *restrict moments, double *restrict out) {
    for (int64_t j = 0; j < k; j++) {
        double last = (from[(n - 1) * k + j] - from[(n - 2) * k + j]) * r[n - 2] * inverse[j];
        for (int c = 0; c < 5; c++) moments[c * k + j] = 0.0;
        out[j] = last * last;
    }
    for (int64_t start = 0; start < n; start += BLOCK) {
        int64_t end = start + BLOCK < n ? start + BLOCK : n, last = end < n - 2 ? end : n - 2;
        for (int64_t j = 0; j < k; j++) {
            const double *y = from + j;
            const double first = y[0], unit = inverse[j];
            double *bend = z + j * (n - 2), sum[6][4] = {{0}};
            for (int64_t i = start; i < last; i++) {
                double a = y[i * k], b = y[(i + 1) * k], c = y[(i + 2) * k];
                double slope = (b - a) * r[i] * unit;
                bend[i] = (c - b) * r[i + 1] * unit - slope;
                sum[5][i & 3] += slope * slope;
            }
            for (int64_t i = start; i < end; i++) {
                double a = (y[i * k] - first) * unit, x = (t[i] - middle) * rate;
                sum[0][i & 3] += a, sum[1][i & 3] += x * a, sum[2][i & 3] += a * a, sum[3][i & 3] += x, sum[4][i & 3] += x * x;
            }
            for (int c = 0; c < 5; c++) moments[c * k + j] += (sum[c][0] + sum[c][1]) + (sum[c][2] + sum[c][3]);
            out[j] += (sum[5][0] + sum[5][1]) + (sum[5][2] + sum[5][3]);
        }
    }
    for (int64_t j = 0; j < k; j++) {
        double y = moments[j], xy = moments[k + j], yy = moments[2 * k + j], x = moments[3 * k + j];
        double slope = xy - x * y / (double)n, square = moments[4 * k + j] - x * x / (double)n;
        out[k + j] = yy;
        out[2 * k + j] = yy - y * y / (double)n - slope * slope / square;
    }
}

/* Back to the data's units: values (n, k) = from - size D^2 Q u, and c (n, k) = bend u. u is k pointers to (n - 2);
   variance k pointers to (n), or null. */
EXPORTED void API(spline_finish)(int64_t n, int64_t k, const double *restrict from, const double *restrict r,
                                 const double *const *u, const double *const *variance, const double *restrict size,
                                 const double *restrict bend, double *restrict values, double *restrict c) {
    for (int64_t start = 0; start < n; start += BLOCK) {
        int64_t end = start + BLOCK < n ? start + BLOCK : n;
        for (int64_t j = 0; j < k; j++) {
            const double *x = u[j], *d = variance ? variance[j] : 0;
            for (int64_t i = start; i < end; i++) {
                double before = i >= 2 ? x[i - 2] : 0.0, here = i >= 1 && i <= n - 2 ? x[i - 1] : 0.0;
                double after = i < n - 2 ? x[i] : 0.0;
                double up = i < n - 1 ? (after - here) * r[i] : 0.0, down = i ? (here - before) * r[i - 1] : 0.0;
                double v = d ? d[i] * (up - down) : up - down;
                values[i * k + j] = from[i * k + j] - size[j] * v;
                c[i * k + j] = bend[j] * here;
            }
        }
    }
}

/* First derivative (n, k) at the samples, eq. (35), of values and c (n, k) at times t (n). */
EXPORTED void API(spline_slope)(int64_t n, int64_t k, const double *restrict t, const double *restrict a,
                                const double *restrict c, double *restrict out) {
    if (k == 1)
        for (int64_t i = 0; i < n - 1; i++) {
            double h = t[i + 1] - t[i];
            out[i] = (a[i + 1] - a[i]) / h - h * (2.0 * c[i] + c[i + 1]) / 3.0;
        }
    else
        for (int64_t i = 0; i < n - 1; i++) {
            double h = t[i + 1] - t[i];
            for (int64_t j = i * k; j < (i + 1) * k; j++)
                out[j] = (a[j + k] - a[j]) / h - h * (2.0 * c[j] + c[j + k]) / 3.0;
        }
    double h = t[n - 1] - t[n - 2];
    for (int64_t j = (n - 1) * k; j < n * k; j++) out[j] = out[j - k] + h * (c[j - k] + c[j]);
}
