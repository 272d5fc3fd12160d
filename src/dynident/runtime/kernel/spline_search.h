/* The fit of one series of equal weights in one call: what motion/splines/search.py does for several side by side, by
   functions of the same names, with the same bits. What is not ordinary is left to that: data that cannot be smoothed,
   straight lines, p at which the system breaks down, S that rounding keeps from being reached. */

#include <math.h>

#define MAX_VALUE 1e100
#define MIN_RESIDUAL_SHARE 1e-4
#define REFINEMENT_ERROR 1e-4
#define MAX_CORRECTABLE_ERROR 3e-4
#define MAX_CUBIC_ERROR 0.05
#define MAX_SLOPE_SHIFT 0.01
#define NOISE_SHARE 0.44194173824159216 /* 5 / 2^3.5 */
#define GRID_POINTS 12
#define MAX_STEPS 20
#define TOLERANCE 1e-5
#define START (0.5 / (20.0 * 20.0 * 20.0 * 20.0))

typedef struct {
    double x, error, slope; /* log p, log (rss / target), and its slope by log p */
} place;

typedef struct {
    int64_t n;
    const double *step, *r, *z;
    double *rd, *l, *g, *u;
} series;

static double clipped(double x, double low, double high) {
    x = low > x ? low : x;
    return high < x ? high : x;
}

/* x(0) of the cubic x(error) through two points. */
static double hermite_root(place a, place b) {
    const double h = b.error - a.error, s = -a.error / h, other = 1.0 - s;
    return a.x * (1.0 + 2.0 * s) * (other * other) + b.x * s * s * (3.0 - 2.0 * s)
           + h * (s * (other * other) / a.slope - s * s * other / b.slope);
}

/* log p by a model of rss: noise, noise_ratio (1 - NOISE_SHARE p^(1/4)), and signal, b p^-power. */
static double step_by_model(place at, double noise_ratio) {
    const double rss = exp(at.error), lost_share = NOISE_SHARE * exp(0.25 * at.x), rate = at.slope * rss;
    double signal = rss - noise_ratio * (1.0 - lost_share), power = 0.0, shift = 0.0;
    if (signal > 0.0) power = -(rate + 0.25 * noise_ratio * lost_share) / signal;
    if (!(0.8 < power && power < 2.2)) {
        noise_ratio = (2.0 * rss + rate) / (2.0 - 2.25 * lost_share), power = 2.0;
        signal = rss - noise_ratio * (1.0 - lost_share);
    }
    if (!(signal > 0.0 && lost_share < 0.5)) return at.x - at.error / at.slope;
    for (int k = 0; k < 20; k++) {
        const double remaining = signal * exp(-power * shift), lost = noise_ratio * lost_share * exp(0.25 * shift);
        const double change = (noise_ratio - lost + remaining - 1.0) / (0.25 * lost + power * remaining);
        shift = clipped(shift + clipped(change, -1.0, 1.0), -7.0, 7.0);
        if (fabs(change) < 1e-3) break;
    }
    return at.x + shift;
}

static double next_log_p(place at, const place *previous, double low, double high, double noise_ratio) {
    if (at.slope < 0.0) {
        double next = at.x - at.error / at.slope;
        if (previous && previous->slope < 0.0 && fabs(previous->error) < MAX_CUBIC_ERROR
            && (previous->error * at.error < 0.0 || fabs(at.error) < 0.3 * fabs(previous->error)))
            next = hermite_root(at, *previous);
        else if (fabs(at.error) > REFINEMENT_ERROR && at.slope > -2.0) next = step_by_model(at, noise_ratio);
        next = clipped(next, at.x - 7.0, at.x + 7.0);
        if (low < next && next < high) return next;
    }
    return isfinite(low + high) ? 0.5 * (low + high) : at.x + copysign(3.0, at.error);
}

/* rss at p, and its logarithm's slope by log p; whether they are numbers. */
static int figures_at(const series *s, double p, double *rss, double *slope) {
    double out[8];
    API(spline_figures_one)(s->n - 2, s->step, s->r, &s->z, 0, &p, 0, out);
    *rss = out[0] + out[1];
    *slope = *rss != 0.0 ? (out[1] + out[2]) / *rss : NAN;
    return out[5] == 0.0 && isfinite(*rss);
}

/* Find rss(p) = target; whether that is done, then with u and the figures (6) of spline_refined. */
static int newton(const series *s, double target, double noise_ratio, double *out) {
    double low = -INFINITY, high = INFINITY, x = log(START), slope = -1.0, slope_at = INFINITY, best = -1.0;
    place previous = {0};
    int refine = 0, begun = 0;
    for (int k = 0; k < 200; k++) {
        double p = exp(x), rss, rate;
        if (refine) {
            const double aim[2] = {target, slope};
            API(spline_refined_one)(s->n - 2, s->step, s->r, &s->z, 0, &p, s->rd, s->l, s->g, s->u, aim, out);
            if (out[3] != 0.0 || !isfinite(out[0])) return 0;
            rss = out[0], x = log(out[4]);
        } else {
            if (!figures_at(s, p, &rss, &rate)) return 0;
            x = log(p), slope = rate, slope_at = x;
        }
        const double error = log((rss > TINY ? rss : TINY) / target);
        if (refine) {
            if (fabs(error) <= 1e-10) return 1;
            if (best < 0.0) low = -INFINITY, high = INFINITY;
            else if (fabs(error) >= best) return 0;
            best = fabs(error);
            if (fabs(x - slope_at) > MAX_SLOPE_SHIFT) {
                if (!figures_at(s, exp(x), &rss, &slope)) return 0;
                slope_at = x;
            }
        }
        if (error > 0.0) low = x > low ? x : low;
        else high = x < high ? x : high;
        const place at = {x, error, slope};
        const double next = next_log_p(at, refine || !begun ? 0 : &previous, low, high, noise_ratio);
        if (!refine && (fabs(error) < MAX_CORRECTABLE_ERROR || fabs(next - x) < REFINEMENT_ERROR)) {
            refine = 1;
            if (begun && slope < 0.0) { /* the slope at the next p, by those of the last two */
                const double there = slope + (next - x) * (slope - previous.slope) / (x - previous.x);
                slope_at = next, slope = clipped(there, 1.1 * slope, 0.9 * slope);
            }
        }
        previous = at, begun = 1, x = next;
    }
    return 0;
}

/* The criterion of cross-validation, log (rss / (m - rise)^2), at log p = x: at the same time for LANES of them. */
typedef struct {
    double x, value, slope;
} criterion;

static int criteria_at(const series *s, int64_t count, criterion *at) {
    const double *z[LANES];
    double p[LANES], out[8 * LANES];
    for (int64_t k = 0; k < LANES; k++) z[k] = s->z, p[k] = exp(at[k < count ? k : 0].x);
    if (count > 1) API(spline_figures_many)(s->n - 2, s->step, s->r, z, 0, p, 0, out);
    else API(spline_figures_one)(s->n - 2, s->step, s->r, z, 0, p, 0, out);
    int usable = 1;
    for (int64_t k = 0, wide = count > 1 ? LANES : 1; k < count; k++) {
        const double rate = out[wide + k], rss = out[k] + rate, free = (double)(s->n - 2) - out[3 * wide + k];
        const double degrees = free > 1e-3 ? free : 1e-3;
        at[k].value = log(rss > TINY ? rss : TINY) - 2.0 * log(degrees);
        at[k].slope = (rate + out[2 * wide + k]) / rss + 2.0 * out[4 * wide + k] / degrees;
        usable &= out[5 * wide + k] == 0.0 && isfinite(at[k].value) && isfinite(at[k].slope);
    }
    return usable;
}

/* The least value, and its place, of the cubic with the values and slopes of two points. */
static criterion cubic_minimum(criterion a, criterion b) {
    const double h = b.x - a.x;
    criterion best = {a.x, INFINITY, 0.0};
    for (int k = 0; k <= 64; k++) {
        const double s = k / 64.0, other = 1.0 - s;
        const double value = a.value * (1.0 + 2.0 * s) * (other * other) + b.value * s * s * (3.0 - 2.0 * s)
                             + h * s * other * (a.slope * other - b.slope * s);
        if (value < best.value) best.value = value, best.x = a.x + s * h;
    }
    return best;
}

/* Return log p of the least criterion: on a grid, then by the zero of its slope; nan where it is not found. */
static double search_minimum(const series *s) {
    const double widest = s->n < 2000 ? (double)s->n : 2000.0, narrowest = 0.3;
    const double low = log(0.5 / pow(widest, 4.0)), high = log(0.5 / pow(narrowest, 4.0));
    criterion at[GRID_POINTS], best = {NAN, INFINITY, 0.0};
    int pair = -1;
    for (int k = 0; k < GRID_POINTS; k++) at[k].x = low + (high - low) * k / (GRID_POINTS - 1);
    for (int k = 0; k < GRID_POINTS; k += LANES)
        if (!criteria_at(s, GRID_POINTS - k < LANES ? GRID_POINTS - k : LANES, at + k)) return NAN;
    if (at[0].slope >= 0.0) best = at[0];
    if (at[GRID_POINTS - 1].slope <= 0.0 && at[GRID_POINTS - 1].value < best.value) best = at[GRID_POINTS - 1];
    for (int k = 0; k < GRID_POINTS - 1; k++) {
        if (!(at[k].slope < 0.0 && at[k + 1].slope >= 0.0)) continue;
        const criterion between = cubic_minimum(at[k], at[k + 1]);
        if (between.value < best.value) best = between, pair = k;
    }
    if (pair < 0) return best.x;
    criterion a = at[pair], b = at[pair + 1], history[3] = {a, a, b}, now = {best.x, 0.0, 0.0};
    for (int k = 0; k < MAX_STEPS; k++) {
        if (!criteria_at(s, 1, &now)) return NAN;
        history[0] = history[1], history[1] = history[2], history[2] = now;
        if (now.slope < 0.0) a = now;
        else b = now;
        /* the zero of the parabola x(slope) through the last three points */
        const criterion *o = history;
        const double f = o[0].slope, g = o[1].slope, h = o[2].slope;
        double next = o[0].x * g * h / ((f - g) * (f - h)) + o[1].x * h * f / ((g - h) * (g - f))
                      + o[2].x * f * g / ((h - f) * (h - g));
        if (f == g || g == h || h == f || !(a.x < next && next < b.x)) next = 0.5 * (a.x + b.x);
        const double step = fabs(next - now.x), others = fabs(next - history[1].x);
        now.x = next;
        if (step * (others < 1.0 ? others : 1.0) < TOLERANCE) break;
    }
    return now.x;
}

/* Sum of squares that a straight line leaves of (y - its first value) / size. */
static double line_rss(int64_t n, const double *step, const double *y, double size) {
    double x = 0.0, x_sum = 0.0, y_sum = 0.0, xx = 0.0, xy = 0.0, rss = 0.0;
    for (int64_t i = 0; i < n; i++) x_sum += x, y_sum += (y[i] - y[0]) / size, x += i < n - 1 ? step[i] : 0.0;
    const double middle = x_sum / (double)n, mean = y_sum / (double)n;
    x = -middle;
    for (int64_t i = 0; i < n; i++) xx += x * x, xy += x * ((y[i] - y[0]) / size - mean), x += i < n - 1 ? step[i] : 0.0;
    x = -middle;
    for (int64_t i = 0; i < n; i++) {
        const double away = (y[i] - y[0]) / size - mean - xy / xx * x;
        rss += away * away, x += i < n - 1 ? step[i] : 0.0;
    }
    return rss;
}

/* Least and largest value; whether they are of a size that can be smoothed. */
static int range_of(int64_t n, const double *x, double *low, double *high) {
    double out[3 * ABREAST];
    API(spline_survey)(n, 1, x, out);
    *low = out[0], *high = out[ABREAST];
    const double extent = *high - *low;
    return out[2 * ABREAST] == 0.0 && extent <= MAX_VALUE && extent >= 1.0 / MAX_VALUE && -*low <= MAX_VALUE
           && *high <= MAX_VALUE;
}

/* Fit y (n) at times t (n). rule 0: so that the sum of ((y - g) / sigma)^2 is `setting`; 1: with p = setting; 2: by
   cross-validation. A sigma of 0 is estimated. values, c (n); out (6): p, lam, S, sigma, residual, accuracy; work (7 n).
   Returns whether that is done. */
EXPORTED int32_t API(spline_fit)(int64_t n, const double *t, const double *y, int32_t rule, double setting, double sigma,
                                 double *work, double *values, double *c, double *out) {
    double low, high, first, last, moments[2], squares[3], answer[6], largest = 0.0, *step = work, *r = work + n;
    double *z = work + 2 * n, *u = work + 6 * n;
    if (!range_of(n, t, &first, &last) || !range_of(n, y, &low, &high)) return 0;
    const double h = (t[n - 1] - t[0]) / (double)(n - 1), above = high - y[0], below = y[0] - low;
    const double size = ldexp(1.0, (int)rint(log2(below > above ? below : above))), inverse = 1.0 / size;
    int increases = 1;
    for (int64_t i = 0; i < n - 1; i++) step[i] = t[i + 1] - t[i], increases &= step[i] > 0.0;
    if (!increases) return 0;
    if (sigma == 0.0 && n > 5) { /* noise_sigma */
        const double rounding = 4.0 * EPS * (-low > high ? -low : high);
        for (int64_t i = 0; i < n; i++) z[i] = 1.0;
        API(spline_noise)(n, 1, t, y, z, 1, &sigma);
        sigma = sqrt(sigma / (double)(n - 4));
        sigma = sigma > rounding ? sigma : rounding;
    }
    if (!(1.0 / MAX_VALUE <= sigma && sigma < MAX_VALUE && (rule == 2 || (setting > 0.0 && setting < INFINITY)))) return 0;
    for (int64_t i = 0; i < n - 1; i++) step[i] /= h, r[i] = 1.0 / step[i], largest = step[i] > largest ? step[i] : largest;
    API(spline_scale)(n, 1, y, r, &inverse, t, t[n / 2], (double)(n - 1) / (t[n - 1] - t[0]), z, moments, squares);
    const double noise = sigma / size, target = setting * (noise * noise), unit = noise * size;
    const double p_scale = unit * unit / (h * h * h);
    const double rounding = EPS * (-low > high ? -low : high) / size, tolerance = 4.0 * rounding + EPS * (double)(64 + n);
    const double straight = squares[2] > MIN_RESIDUAL_SHARE * squares[1] ? squares[2] : line_rss(n, step, y, size);
    if (!(p_scale > 0.0 && p_scale < INFINITY && noise * noise > 0.0)) return 0;
    if (rule != 1 && !(straight > (double)n * (tolerance * tolerance) && (rule == 2 || straight > target))) return 0;
    const series s = {n, step, r, z, work + 3 * n, work + 4 * n, work + 5 * n, u};
    if (rule) {
        const double aim[2] = {0.0, 0.0}, at = rule == 1 ? setting / p_scale : exp(search_minimum(&s));
        if (!(at > 0.0 && at < INFINITY)) return 0;
        API(spline_refined_one)(n - 2, step, r, &s.z, 0, &at, s.rd, s.l, s.g, s.u, aim, answer);
        if (answer[3] != 0.0) return 0;
    } else if (!newton(&s, target, (double)n * (noise * noise) / target, answer)) return 0;
    const double p = answer[4], bend = size * (1.0 / (h * h)) * p, *solution = u + 1;
    const int64_t apart = 1;
    API(spline_finish)(n, 1, y, r, &solution, &apart, 0, &size, &bend, values, c);
    /* ScaledSeries.accuracy */
    const double gain = pow(p, -0.75), longest = pow((double)(n - 1) / 4.73, 3.0);
    const double total_gain = 0.57 * (longest < gain ? longest : gain) * sqrt(largest), accuracy = sqrt(answer[2]);
    const double least = EPS * (4.0 + 6.0 * total_gain * sqrt(squares[0]) / sqrt(answer[5]));
    out[0] = p * p_scale, out[1] = 0.5 / out[0], out[2] = answer[0] / (noise * noise), out[3] = sigma;
    out[4] = sqrt(answer[1]), out[5] = least > accuracy ? least : accuracy;
    return 1;
}
