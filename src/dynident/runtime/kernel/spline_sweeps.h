/* The sweeps of spline.c, for V = double or V = lanes: COUNT series at a time, their numbers side by side.

   A = Q' D^2 Q + p N (m rows, pentadiagonal) is factorised from both ends at once, which meet at the rows a, a + 1
   (burn at both ends): two recurrences that do not wait for each other. `side` is +1 for the end at row 0 and -1 for
   the other, for which all arrays are read backwards: the same formulas. r are the reciprocal steps (m + 1), `third`
   is p / 3, `variance` the diagonal of D^2 (m + 2), which is null where it is one. */

typedef struct {
    int64_t m, a;                    /* rows; the first of the two in the middle, which the sweep from the top leaves */
    const double *step, *r;          /* (m + 1) */
    const double *const *z;          /* COUNT pointers to (m) */
    const double *const *variance;   /* COUNT pointers to (m + 2), or null */
    V third;
    double *restrict rd, *restrict l, *g; /* (m, COUNT): 1 / d; first off-diagonal of L; see each sweep */
    double *u;                       /* (m, COUNT), with a zero row before and after it */
} NAME(job);

/* What one sweep inwards hands on: the next diagonal entry, the entry beside it and the next but one diagonal entry,
   as the rows so far leave them, and the right-hand side of the first two; their derivatives by log p (x, xx). */
typedef struct {
    V d, e, d1, f, f1;
    V dx, ex, d1x, fx, f1x;
    V dxx, exx, d1xx, fxx, f1xx;
} NAME(front);

typedef struct {
    V rise, bend;           /* derivatives by log p of log det */
    V work, rate, rate2;    /* z' A^-1 z and its derivatives by log p */
    V product;              /* of the diagonal, of the last rows */
    MASK bad;               /* whether the factorisation broke down */
} NAME(total);

#if COUNT == 1
FORCED double all_one(double x) { return x; }
FORCED double read_one(const double *from, int64_t row) { return from[row]; }
FORCED void write_one(double *to, int64_t row, double x) { to[row] = x; }
FORCED double gather_one(const double *const *from, int64_t i) { return from[0][i]; }
#else
FORCED lanes all_many(double x) { return all(x); }
FORCED lanes read_many(const double *from, int64_t row) { return load(from + row * LANES); }
FORCED void write_many(double *to, int64_t row, lanes x) { store(to + row * LANES, x); }
FORCED lanes gather_many(const double *const *from, int64_t i) {
    lanes out;
    for (int k = 0; k < LANES; k++) out[k] = from[k][i];
    return out;
}
#endif

#define ROW(i) (side > 0 ? (i) : q->m - 1 - (i))
#define R(i) (side > 0 ? q->r[i] : q->r[q->m - (i)])
#define H(i) (side > 0 ? q->step[i] : q->step[q->m - (i)])
#define D(i) NAME(gather)(q->variance, side > 0 ? (i) : q->m + 1 - (i))

/* Entries of Q' D^2 Q: the diagonal of row i, what is beside it to the right, and what is two to the right. */
FORCED V NAME(diagonal)(const NAME(job) *q, int side, int weighted, int64_t i) {
    double r0 = R(i), r1 = R(i + 1), sum = r0 + r1;
    if (weighted)
        return D(i) * NAME(all)(r0 * r0) + D(i + 1) * NAME(all)(sum * sum) + D(i + 2) * NAME(all)(r1 * r1);
    return NAME(all)(sum * sum + r0 * r0 + r1 * r1);
}
FORCED V NAME(beside)(const NAME(job) *q, int side, int weighted, int64_t i) {
    double r0 = R(i), r1 = R(i + 1), r2 = R(i + 2);
    if (weighted)
        return NAME(all)(-r1) * (D(i + 1) * NAME(all)(r0 + r1) + D(i + 2) * NAME(all)(r1 + r2));
    return NAME(all)(-r1 * ((r0 + r1) + (r1 + r2)));
}
FORCED V NAME(beyond)(const NAME(job) *q, int side, int weighted, int64_t i) {
    V out = NAME(all)(R(i + 1) * R(i + 2));
    return weighted ? out * D(i + 2) : out;
}
/* The same of p N. */
FORCED V NAME(mass)(const NAME(job) *q, int side, int64_t i) { return q->third * NAME(all)(2.0 * (H(i) + H(i + 1))); }
FORCED V NAME(mass_beside)(const NAME(job) *q, int side, int64_t i) { return q->third * NAME(all)(H(i + 1)); }

FORCED void NAME(begin)(const NAME(job) *q, int side, int weighted, NAME(front) *s) {
    s->dx = s->dxx = NAME(mass)(q, side, 0);
    s->ex = s->exx = NAME(mass_beside)(q, side, 0);
    s->d1x = s->d1xx = NAME(mass)(q, side, 1);
    s->d = NAME(diagonal)(q, side, weighted, 0) + s->dx;
    s->e = NAME(beside)(q, side, weighted, 0) + s->ex;
    s->d1 = NAME(diagonal)(q, side, weighted, 1) + s->d1x;
    s->f = NAME(gather)(q->z, ROW(0));
    s->f1 = NAME(gather)(q->z, ROW(1));
    s->fx = s->f1x = s->fxx = s->f1xx = NAME(all)(0.0);
}

/* Eliminate row i of a side. Without `figures` l and 1 / d are kept, and g = 1 / d times the right-hand side that the
   rows before have left; with them nothing is kept but sums. */
FORCED void NAME(inwards)(const NAME(job) *q, int side, int weighted, int figures, int64_t i, NAME(front) *s,
                          NAME(total) *sum) {
    V rd = NAME(all)(1.0) / s->d, b2 = NAME(beyond)(q, side, weighted, i), l = s->e * rd, l2 = b2 * rd, g = s->f * rd;
    V mass = NAME(mass)(q, side, i + 2), mass1 = NAME(mass_beside)(q, side, i + 1);
    V b0 = NAME(diagonal)(q, side, weighted, i + 2) + mass, b1 = NAME(beside)(q, side, weighted, i + 1) + mass1;
    V f = s->f1 - l * s->f, f1 = NAME(gather)(q->z, ROW(i + 2)) - b2 * g;
    V d = s->d1 - l * s->e, e = b1 - l * b2, d1 = b0 - l2 * b2;
    sum->bad |= (MASK)(s->d <= NAME(all)(0.0));
    if (figures) {
        const V two = NAME(all)(2.0);
        V rate = s->dx * rd, rate2 = s->dxx * rd, tilt = s->fx - s->f * rate;
        V lx = s->ex * rd - l * rate, lxx = s->exx * rd - two * lx * rate - l * rate2;
        V l2x = -l2 * rate, l2xx = -two * l2x * rate - l2 * rate2;
        sum->rise += rate;
        sum->bend += rate2 - rate * rate;
        sum->work += s->f * g;
        sum->rate += g * (s->fx + tilt);
        sum->rate2 += two * (rd * tilt * tilt + g * s->fxx) - s->f * g * rate2;
        sum->product *= s->d;
        V fx = s->f1x - lx * s->f - l * s->fx, fxx = s->f1xx - lxx * s->f - two * lx * s->fx - l * s->fxx;
        V dx = s->d1x - lx * s->e - l * s->ex, dxx = s->d1xx - lxx * s->e - two * lx * s->ex - l * s->exx;
        s->f1x = -l2x * s->f - l2 * s->fx, s->f1xx = -l2xx * s->f - two * l2x * s->fx - l2 * s->fxx;
        s->fx = fx, s->fxx = fxx, s->dx = dx, s->dxx = dxx;
        s->ex = mass1 - lx * b2, s->exx = mass1 - lxx * b2;
        s->d1x = mass - l2x * b2, s->d1xx = mass - l2xx * b2;
    } else {
        NAME(write)(q->rd, ROW(i), rd);
        NAME(write)(q->l, ROW(i), l);
        NAME(write)(q->g, ROW(i), g);
    }
    s->f = f, s->f1 = f1, s->d = d, s->e = e, s->d1 = d1;
}

/* The two rows in the middle: what both sides leave of them, counted once. The entries of the matrix are x w; w y. */
typedef struct {
    V x, w, y, det, ix, iw, iy; /* and those of its inverse */
    V mass, mass1, off;
} NAME(middle);

FORCED NAME(middle) NAME(met)(const NAME(job) *q, int weighted, const NAME(front) *s, const NAME(front) *t) {
    NAME(middle) o;
    const int64_t a = q->a;
    o.mass = NAME(mass)(q, 1, a), o.mass1 = NAME(mass)(q, 1, a + 1), o.off = NAME(mass_beside)(q, 1, a);
    o.x = s->d + (t->d1 - (NAME(diagonal)(q, 1, weighted, a) + o.mass));
    o.y = t->d + (s->d1 - (NAME(diagonal)(q, 1, weighted, a + 1) + o.mass1));
    o.w = s->e + (t->e - (NAME(beside)(q, 1, weighted, a) + o.off));
    o.det = o.x * o.y - o.w * o.w;
    V over = NAME(all)(1.0) / o.det;
    o.ix = o.y * over, o.iy = o.x * over, o.iw = -o.w * over;
    return o;
}

/* Eliminate from both ends, and return the middle. */
FORCED NAME(middle) NAME(eliminated)(const NAME(job) *q, int weighted, int figures, NAME(front) *s, NAME(front) *t,
                                     NAME(total) *up, NAME(total) *down, double *products, int64_t *written) {
    const int64_t b = q->m - 2 - q->a; /* rows of the other side */
    NAME(total) none = {0};
    *up = *down = none;
    up->product = down->product = NAME(all)(1.0);
    NAME(begin)(q, 1, weighted, s);
    NAME(begin)(q, -1, weighted, t);
    for (int64_t i = 0; i < b; i++) {
        NAME(inwards)(q, 1, weighted, figures, i, s, up);
        NAME(inwards)(q, -1, weighted, figures, i, t, down);
        if (products && (i & 3) == 3) {
            NAME(write)(products, (*written)++, up->product * down->product);
            up->product = down->product = NAME(all)(1.0);
        }
    }
    if (q->a > b) NAME(inwards)(q, 1, weighted, figures, b, s, up);
    NAME(middle) o = NAME(met)(q, weighted, s, t);
    up->bad |= down->bad | (MASK)(o.det <= NAME(all)(0.0)) | (MASK)(o.x <= NAME(all)(0.0));
    return o;
}

/* out (8, COUNT): z' A^-1 z with its first and second derivative by log p, the first two derivatives of log det,
   whether the factorisation broke down, the determinant of the middle, the number of products; and `products`
   (m / 8 + 1, COUNT) of the diagonal, at most nine rows each: with the determinant, the logarithms add up to log det.
   `products` may be null. */
FORCED void NAME(figures)(const NAME(job) *q, int weighted, double *products, double *out) {
    NAME(front) s, t;
    NAME(total) up, down;
    int64_t written = 0;
    NAME(middle) o = NAME(eliminated)(q, weighted, 1, &s, &t, &up, &down, products, &written);
    if (products) NAME(write)(products, written, up.product * down.product);
    const V two = NAME(all)(2.0), over = NAME(all)(1.0) / o.det;
    V xx = s.dx + (t.d1x - o.mass), yx = t.dx + (s.d1x - o.mass1), wx = s.ex + (t.ex - o.off);
    V xxx = s.dxx + (t.d1xx - o.mass), yxx = t.dxx + (s.d1xx - o.mass1), wxx = s.exx + (t.exx - o.off);
    V rise = (xx * o.y + o.x * yx - two * o.w * wx) * over;
    V bend = (xxx * o.y + two * xx * yx + o.x * yxx - two * (wx * wx + o.w * wxx)) * over;
    /* u = M^-1 f of the middle: f' u, and its derivatives with those of u */
    V f = s.f + (t.f1 - NAME(gather)(q->z, q->a)), f1 = t.f + (s.f1 - NAME(gather)(q->z, q->a + 1));
    V fx = s.fx + t.f1x, f1x = t.fx + s.f1x, fxx = s.fxx + t.f1xx, f1xx = t.fxx + s.f1xx;
    V u = o.ix * f + o.iw * f1, u1 = o.iw * f + o.iy * f1;
    V g = fx - xx * u - wx * u1, g1 = f1x - wx * u - yx * u1;
    V ux = o.ix * g + o.iw * g1, u1x = o.iw * g + o.iy * g1;
    V rate = two * (u * fx + u1 * f1x) - (u * u * xx + two * u * u1 * wx + u1 * u1 * yx);
    V rate2 = two * (g * ux + g1 * u1x) + two * (u * fxx + u1 * f1xx) - (u * u * xxx + two * u * u1 * wxx + u1 * u1 * yxx);
    NAME(write)(out, 0, up.work + down.work + (u * f + u1 * f1));
    NAME(write)(out, 1, up.rate + down.rate + rate);
    NAME(write)(out, 2, up.rate2 + down.rate2 + rate2);
    NAME(write)(out, 3, up.rise + down.rise + rise);
    NAME(write)(out, 4, up.bend + down.bend + (bend - rise * rise));
    for (int k = 0; k < COUNT; k++) out[5 * COUNT + k] = (double)(((int64_t *)&up.bad)[k] != 0);
    NAME(write)(out, 6, o.det);
    for (int k = 0; k < COUNT; k++) out[7 * COUNT + k] = (double)(written + 1);
}

/* Row i of a side of the solution, from the two rows before on the way outwards. */
FORCED V NAME(solved)(const NAME(job) *q, int side, int weighted, int64_t i, V before, V before2) {
    V l2 = NAME(beyond)(q, side, weighted, i) * NAME(read)(q->rd, ROW(i));
    return NAME(read)(q->g, ROW(i)) - l2 * before2 - NAME(read)(q->l, ROW(i)) * before;
}

/* From g to the solution in `to`, outwards from the rows x, y in the middle; returns the sum of squares. */
FORCED V NAME(outwards)(const NAME(job) *q, int weighted, V x, V y, double *to) {
    const int64_t m = q->m, a = q->a, b = m - 2 - a;
    V x1 = y, y1 = x, sum = x * x, sum1 = y * y;
    NAME(write)(to, a, x);
    NAME(write)(to, a + 1, y);
    if (a > b) {
        V next = NAME(solved)(q, 1, weighted, b, x, x1);
        NAME(write)(to, b, next);
        sum += next * next;
        x1 = x, x = next;
    }
    for (int64_t i = b - 1; i >= 0; i--) {
        V up = NAME(solved)(q, 1, weighted, i, x, x1), down = NAME(solved)(q, -1, weighted, i, y, y1);
        NAME(write)(to, i, up);
        NAME(write)(to, m - 1 - i, down);
        sum += up * up;
        sum1 += down * down;
        x1 = x, x = up;
        y1 = y, y = down;
    }
    return sum + sum1;
}

/* Factorise and solve A u = z. out (COUNT): whether the factorisation broke down. */
FORCED void NAME(solve)(const NAME(job) *q, int weighted, double *out) {
    const int64_t a = q->a;
    NAME(front) s, t;
    NAME(total) up, down;
    NAME(middle) o = NAME(eliminated)(q, weighted, 0, &s, &t, &up, &down, 0, 0);
    NAME(write)(q->rd, a, o.ix);
    NAME(write)(q->rd, a + 1, o.iy);
    NAME(write)(q->l, a, o.iw);
    NAME(write)(q->g, a, NAME(all)(0.0)); /* what memory held, even times zero, could be nan */
    NAME(write)(q->g, a + 1, NAME(all)(0.0));
    V f = s.f + (t.f1 - NAME(gather)(q->z, a)), f1 = t.f + (s.f1 - NAME(gather)(q->z, a + 1));
    NAME(write)(q->u, -1, NAME(all)(0.0));
    NAME(write)(q->u, q->m, NAME(all)(0.0));
    NAME(outwards)(q, weighted, o.ix * f + o.iw * f1, o.iw * f + o.iy * f1, q->u);
    for (int k = 0; k < COUNT; k++) out[k] = (double)(((int64_t *)&up.bad)[k] != 0);
}

/* Add to u the correction in g where `used` (COUNT) is one, not zero, and let g be the residual z - Q' v - p N u with
   v = D^2 Q u. out (4, COUNT): squares of v over D, of the residual, of u and of z. */
FORCED void NAME(remainder)(const NAME(job) *q, int weighted, const double *used, double *out) {
    const int64_t m = q->m;
    const double *r = q->r, *h = q->step;
    double *u = q->u, *g = q->g;
    V part, sum = NAME(all)(0.0), rest = sum, size = sum, whole = sum, before = sum;
    for (int k = 0; k < COUNT; k++) ((double *)&part)[k] = used[k];
    V here = NAME(read)(u, 0) + part * NAME(read)(g, 0), after = NAME(read)(u, 1) + part * NAME(read)(g, 1);
    NAME(write)(u, 0, here);
    NAME(write)(u, 1, after);
    V slope = (after - here) * NAME(all)(r[1]), v = here * NAME(all)(r[0]), v1 = slope - v;
    sum = weighted ? NAME(gather)(q->variance, 0) * v * v + NAME(gather)(q->variance, 1) * v1 * v1 : v * v + v1 * v1;
    if (weighted) v *= NAME(gather)(q->variance, 0), v1 *= NAME(gather)(q->variance, 1);
    for (int64_t j = 0; j < m; j++) {
        V next = NAME(all)(0.0), slope1 = next;
        if (j + 2 < m) {
            next = NAME(read)(u, j + 2) + part * NAME(read)(g, j + 2);
            NAME(write)(u, j + 2, next);
        }
        if (j + 2 <= m) slope1 = (next - after) * NAME(all)(r[j + 2]);
        V v2 = slope1 - slope, away = v2;
        if (weighted) v2 *= NAME(gather)(q->variance, j + 2);
        V bend = (v2 - v1) * NAME(all)(r[j + 1]) - (v1 - v) * NAME(all)(r[j]), z = NAME(gather)(q->z, j);
        V mass = NAME(all)(h[j]) * before + NAME(all)(2.0 * (h[j] + h[j + 1])) * here + NAME(all)(h[j + 1]) * after;
        V left = z - bend - q->third * mass;
        NAME(write)(g, j, left);
        sum += v2 * away;
        rest += left * left;
        size += here * here;
        whole += z * z;
        before = here, here = after, after = next, slope = slope1, v = v1, v1 = v2;
    }
    NAME(write)(out, 0, sum);
    NAME(write)(out, 1, rest);
    NAME(write)(out, 2, size);
    NAME(write)(out, 3, whole);
}

/* Row i of the right-hand side of a correction: of g less `change` / 3 N u, where p is to change by `change`. */
FORCED V NAME(wanted)(const NAME(job) *q, int shifted, V change, int64_t i) {
    V out = NAME(read)(q->g, i);
    if (!shifted) return out;
    const double h = q->step[i], h1 = q->step[i + 1];
    V mass = NAME(all)(h) * NAME(read)(q->u, i - 1) + NAME(all)(2.0 * (h + h1)) * NAME(read)(q->u, i)
             + NAME(all)(h1) * NAME(read)(q->u, i + 1);
    return out - change * mass;
}

FORCED void NAME(eliminate)(const NAME(job) *q, int side, int weighted, int shifted, V change, int64_t i, V *f, V *f1) {
    V g = *f * NAME(read)(q->rd, ROW(i)), next = *f1 - NAME(read)(q->l, ROW(i)) * *f;
    NAME(write)(q->g, ROW(i), g);
    *f1 = NAME(wanted)(q, shifted, change, ROW(i + 2)) - NAME(beyond)(q, side, weighted, i) * g;
    *f = next;
}

/* Solve A x = g by the factor, into g; `shifted`: with N u times a third of `change` (COUNT) taken from g. out
   (COUNT): squares of x. */
FORCED void NAME(correct)(const NAME(job) *q, int weighted, int shifted, const double *changes, double *out) {
    const int64_t m = q->m, a = q->a, b = m - 2 - a;
    V change;
    for (int k = 0; k < COUNT; k++) ((double *)&change)[k] = changes[k];
    V middle = NAME(wanted)(q, shifted, change, a), middle1 = NAME(wanted)(q, shifted, change, a + 1);
    V f = NAME(wanted)(q, shifted, change, 0), f1 = NAME(wanted)(q, shifted, change, 1);
    V h = NAME(wanted)(q, shifted, change, m - 1), h1 = NAME(wanted)(q, shifted, change, m - 2);
    for (int64_t i = 0; i < b; i++) {
        NAME(eliminate)(q, 1, weighted, shifted, change, i, &f, &f1);
        NAME(eliminate)(q, -1, weighted, shifted, change, i, &h, &h1);
    }
    if (a > b) NAME(eliminate)(q, 1, weighted, shifted, change, b, &f, &f1);
    f = f + (h1 - middle), f1 = h + (f1 - middle1);
    V ix = NAME(read)(q->rd, a), iy = NAME(read)(q->rd, a + 1), iw = NAME(read)(q->l, a);
    NAME(write)(out, 0, NAME(outwards)(q, weighted, ix * f + iw * f1, iw * f + iy * f1, q->g));
}

/* Solve, then refine until the error left is EPS or no correction is half the one before, which is then not made.
   Where that misses the aim (2, COUNT), a value of |D^-1 v|^2 and its logarithm's slope by log p, by little, p is
   corrected, and u with it, by the factor there is. out (6, COUNT): |D^-1 v|^2; squares of the residual over z and of
   the error estimated over u; 0 solved, 1 the factorisation broke down, 2 the corrections stay large; p; |u|^2. */
FORCED void NAME(refined)(NAME(job) *q, int weighted, const double *p, const double *aim, double *out) {
    double used[COUNT], last[COUNT], left[COUNT], sums[4 * COUNT], change[COUNT], *state = out + 3 * COUNT;
    double shift[COUNT], step[COUNT], floor[COUNT]; /* of the corrections where they do not fall any more, else EPS^2 */
    int active = 0, begun = 0, tries[COUNT];
    NAME(solve)(q, weighted, state);
    for (int k = 0; k < COUNT; k++) {
        used[k] = 0.0, last[k] = left[k] = 1.0, floor[k] = EPS * EPS, tries[k] = 0;
        out[2 * COUNT + k] = -1.0; /* not known yet */
        out[4 * COUNT + k] = p[k];
        active += state[k] == 0.0;
    }
    while (active) {
        int wanted = 0, shifted = 0;
        NAME(remainder)(q, weighted, used, sums);
        for (int k = 0; k < COUNT; k++) {
            shift[k] = step[k] = 0.0;
            if (state[k] || out[2 * COUNT + k] >= 0.0) continue;
            out[k] = sums[k], out[5 * COUNT + k] = sums[2 * COUNT + k];
            out[COUNT + k] = sums[COUNT + k] / (sums[3 * COUNT + k] > TINY ? sums[3 * COUNT + k] : TINY);
            int done = left[k] <= EPS * EPS;
            if (done || !begun) {
                double error = aim[k] > 0.0 ? sums[k] / aim[k] - 1.0 : 0.0, size = error < 0.0 ? -error : error;
                if (size > MISSED && size < NEAR && aim[COUNT + k] < 0.0 && tries[k]++ < 4) {
                    double *third = (double *)&q->third + k, before = *third;
                    step[k] = error / aim[COUNT + k];
                    out[4 * COUNT + k] *= 1.0 - step[k];
                    *third *= 1.0 - step[k];
                    shift[k] = *third - before;
                    last[k] = 1.0, shifted = 1;
                } else if (done) out[2 * COUNT + k] = floor[k], active--;
            }
            wanted += out[2 * COUNT + k] < 0.0;
        }
        begun = 1;
        if (wanted && shifted) NAME(correct)(q, weighted, 1, shift, change);
        else if (wanted) NAME(correct)(q, weighted, 0, shift, change);
        for (int k = 0; k < COUNT; k++) {
            used[k] = 0.0;
            if (state[k] || out[2 * COUNT + k] >= 0.0) continue;
            double now = change[k] / (sums[2 * COUNT + k] > TINY ? sums[2 * COUNT + k] : TINY);
            double rate = step[k] * step[k] > now ? step[k] * step[k] : now / last[k]; /* of the errors, by a correction */
            if (now < 0.25 * last[k]) used[k] = 1.0, left[k] = now * rate, last[k] = now;
            else if (now < LARGE * LARGE && aim[k] > 0.0) floor[k] = now, left[k] = 0.0; /* p may be wrong yet */
            else out[2 * COUNT + k] = now, state[k] = now < LARGE * LARGE ? 0.0 : 2.0, active--;
        }
    }
}

FORCED NAME(job) NAME(made)(int64_t m, const double *step, const double *r, const double *const *z,
                            const double *const *variance, const double *p, double *rd, double *l, double *g, double *u) {
    V third;
    for (int k = 0; k < COUNT; k++) ((double *)&third)[k] = p[k] / 3.0;
    NAME(job) out = {m, m - 2 - (m - 2) / 2, step, r, z, variance, third, rd, l, g, u ? u + COUNT : 0};
    return out;
}

EXPORTED void API(NAME(spline_figures))(int64_t m, const double *step, const double *r, const double *const *z,
                                        const double *const *variance, const double *p, double *products, double *out) {
    NAME(job) q = NAME(made)(m, step, r, z, variance, p, 0, 0, 0, 0);
    if (variance) NAME(figures)(&q, 1, products, out);
    else NAME(figures)(&q, 0, products, out);
}

EXPORTED void API(NAME(spline_refined))(int64_t m, const double *step, const double *r, const double *const *z,
                                       const double *const *variance, const double *p, double *rd, double *l, double *g,
                                       double *u, const double *aim, double *out) {
    NAME(job) q = NAME(made)(m, step, r, z, variance, p, rd, l, g, u);
    if (variance) NAME(refined)(&q, 1, p, aim, out);
    else NAME(refined)(&q, 0, p, aim, out);
}

#undef ROW
#undef R
#undef H
#undef D
