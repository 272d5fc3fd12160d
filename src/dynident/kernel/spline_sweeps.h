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
    double *restrict rd, *restrict l, *restrict g; /* (m, COUNT): 1 / d; first off-diagonal of L; see each sweep */
    double *restrict u;              /* (m, COUNT), with a zero row before and after it */
} NAME(job);

/* What one sweep inwards hands on: the next diagonal entry, the entry beside it and the next but one diagonal entry,
   as the rows so far leave them; their derivatives by log p; the right-hand side of both rows. */
typedef struct {
    V d, e, d1, f, f1;
    V dx, ex, d1x, dxx, exx, d1xx;
} NAME(front);

typedef struct {
    V rise, bend, product; /* of log det: the derivatives by log p; product of the diagonal of the last rows */
    MASK bad;
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
}

/* Eliminate row i of a side: g becomes 1 / d times the right-hand side that the rows before have left. */
FORCED void NAME(inwards)(const NAME(job) *q, int side, int weighted, int criterion, int64_t i, NAME(front) *s,
                          NAME(total) *sum) {
    V rd = NAME(all)(1.0) / s->d, b2 = NAME(beyond)(q, side, weighted, i), l = s->e * rd, l2 = b2 * rd;
    V mass = NAME(mass)(q, side, i + 2), mass1 = NAME(mass_beside)(q, side, i + 1);
    V b0 = NAME(diagonal)(q, side, weighted, i + 2) + mass, b1 = NAME(beside)(q, side, weighted, i + 1) + mass1;
    NAME(write)(q->rd, ROW(i), rd);
    NAME(write)(q->l, ROW(i), l);
    NAME(write)(q->g, ROW(i), s->f * rd);
    sum->bad |= (MASK)(s->d <= NAME(all)(0.0));
    V f = s->f1 - l * s->f;
    s->f1 = NAME(gather)(q->z, ROW(i + 2)) - l2 * s->f;
    s->f = f;
    if (criterion) {
        V rate = s->dx * rd, rate2 = s->dxx * rd;
        V lx = s->ex * rd - l * rate, l2x = -l2 * rate;
        V lxx = s->exx * rd - NAME(all)(2.0) * lx * rate - l * rate2;
        V l2xx = -NAME(all)(2.0) * l2x * rate - l2 * rate2;
        sum->rise += rate;
        sum->bend += rate2 - rate * rate;
        sum->product *= s->d;
        V dx = s->d1x - lx * s->e - l * s->ex;
        V dxx = s->d1xx - lxx * s->e - NAME(all)(2.0) * lx * s->ex - l * s->exx;
        s->dx = dx, s->dxx = dxx;
        s->ex = mass1 - lx * b2, s->exx = mass1 - lxx * b2;
        s->d1x = mass - l2x * b2, s->d1xx = mass - l2xx * b2;
    }
    s->d = s->d1 - l * s->e;
    s->e = b1 - l * b2;
    s->d1 = b0 - l2 * b2;
}

/* What one sweep outwards hands on: u of the two rows before, and the slope between them. */
typedef struct {
    V u1, u2, slope, rss, energy;
} NAME(back);

FORCED void NAME(count)(const NAME(job) *q, int side, int weighted, int64_t i, V u, NAME(back) *s) {
    V slope = (s->u1 - u) * NAME(all)(R(i + 1)), bend = s->slope - slope, square = bend * bend;
    s->rss += weighted ? D(i + 2) * square : square;
    s->energy += NAME(all)(H(i + 1)) * (s->u1 * s->u1 + s->u1 * u + u * u);
    s->u2 = s->u1, s->u1 = u, s->slope = slope;
}
FORCED V NAME(solved)(const NAME(job) *q, int side, int weighted, int64_t i, const NAME(back) *s) {
    V rd = NAME(read)(q->rd, ROW(i)), l2 = NAME(beyond)(q, side, weighted, i) * rd;
    return NAME(read)(q->g, ROW(i)) - l2 * s->u2 - NAME(read)(q->l, ROW(i)) * s->u1;
}

/* N u times 3, row i of a side. */
FORCED V NAME(massive)(const NAME(job) *q, int side, int64_t i) {
    double h0 = H(i), h1 = H(i + 1);
    const double *u = q->u;
    V before = NAME(read)(u, ROW(i - 1)), here = NAME(read)(u, ROW(i)), after = NAME(read)(u, ROW(i + 1));
    return NAME(all)(h0) * before + NAME(all)(2.0 * (h0 + h1)) * here + NAME(all)(h1) * after;
}

/* Add row i of a side to w' A^-1 w for w = 3 N u, without a change of the arrays. */
FORCED void NAME(weigh)(const NAME(job) *q, int side, int weighted, int64_t i, V *f, V *f1, V *sum) {
    V rd = NAME(read)(q->rd, ROW(i)), g = *f * rd;
    *sum += *f * g;
    V next = *f1 - NAME(read)(q->l, ROW(i)) * *f;
    *f1 = NAME(massive)(q, side, i + 2) - NAME(beyond)(q, side, weighted, i) * g;
    *f = next;
}

/* out (8, COUNT): rss, u'Nu, (Nu)' A^-1 Nu, whether the factorisation broke down, the derivatives of log det by log p,
   the determinant of the middle, number of products; and `products` (m / 8 + 1, COUNT) of the diagonal of at most nine
   rows each, whose logarithms add up to log det */
FORCED void NAME(evaluate)(const NAME(job) *q, int weighted, int criterion, double *out, double *products) {
    const int64_t m = q->m, a = q->a, b = m - 2 - a; /* rows of the other side */
    const V zero = NAME(all)(0.0);
    NAME(front) s, t;
    NAME(total) sum = {zero, zero, NAME(all)(1.0), (MASK){0}};
    NAME(begin)(q, 1, weighted, &s);
    NAME(begin)(q, -1, weighted, &t);
    int64_t written = 0;
    for (int64_t i = 0; i < b; i++) {
        NAME(inwards)(q, 1, weighted, criterion, i, &s, &sum);
        NAME(inwards)(q, -1, weighted, criterion, i, &t, &sum);
        if (criterion && (i & 3) == 3) NAME(write)(products, written++, sum.product), sum.product = NAME(all)(1.0);
    }
    if (a > b) NAME(inwards)(q, 1, weighted, criterion, b, &s, &sum);
    NAME(write)(products, written, sum.product);

    /* The two rows in the middle: what both sides leave of them, counted once. */
    V mass = NAME(mass)(q, 1, a), mass1 = NAME(mass)(q, 1, a + 1), off = NAME(mass_beside)(q, 1, a);
    V x = s.d + (t.d1 - (NAME(diagonal)(q, 1, weighted, a) + mass));
    V y = t.d + (s.d1 - (NAME(diagonal)(q, 1, weighted, a + 1) + mass1));
    V w = s.e + (t.e - (NAME(beside)(q, 1, weighted, a) + off));
    V det = x * y - w * w, over = NAME(all)(1.0) / det;
    sum.bad |= (MASK)(det <= zero) | (MASK)(x <= zero);
    V ix = y * over, iy = x * over, iw = -w * over;
    NAME(write)(q->rd, a, ix);
    NAME(write)(q->rd, a + 1, iy);
    NAME(write)(q->l, a, iw);
    if (criterion) {
        V xx = s.dx + (t.d1x - mass), yx = t.dx + (s.d1x - mass1), wx = s.ex + (t.ex - off);
        V xxx = s.dxx + (t.d1xx - mass), yxx = t.dxx + (s.d1xx - mass1), wxx = s.exx + (t.exx - off);
        const V two = NAME(all)(2.0);
        V rise = (xx * y + x * yx - two * w * wx) * over;
        V bend = (xxx * y + two * xx * yx + x * yxx - two * (wx * wx + w * wxx)) * over;
        sum.rise += rise;
        sum.bend += bend - rise * rise;
    }

    V f = s.f + (t.f1 - NAME(gather)(q->z, a)), f1 = t.f + (s.f1 - NAME(gather)(q->z, a + 1));
    V u = ix * f + iw * f1, u1 = iw * f + iy * f1, slope = (u1 - u) * NAME(all)(q->r[a + 1]);
    NAME(write)(q->u, -1, zero);
    NAME(write)(q->u, m, zero);
    NAME(write)(q->u, a, u);
    NAME(write)(q->u, a + 1, u1);
    V energy = NAME(all)(q->step[a + 1]) * (u * u + u * u1 + u1 * u1);
    NAME(back) up = {u, u1, slope, zero, energy}, down = {u1, u, -slope, zero, zero};
    if (a > b) {
        V next = NAME(solved)(q, 1, weighted, a - 1, &up);
        NAME(write)(q->u, a - 1, next);
        NAME(count)(q, 1, weighted, a - 1, next, &up);
    }
    for (int64_t i = b - 1; i >= 0; i--) {
        V high = NAME(solved)(q, 1, weighted, i, &up), low = NAME(solved)(q, -1, weighted, i, &down);
        NAME(write)(q->u, i, high);
        NAME(write)(q->u, m - 1 - i, low);
        NAME(count)(q, 1, weighted, i, high, &up);
        NAME(count)(q, -1, weighted, i, low, &down);
    }
    NAME(count)(q, 1, weighted, -1, zero, &up);
    NAME(count)(q, -1, weighted, -1, zero, &down);
    V first = up.slope * up.slope, last = down.slope * down.slope;
    if (weighted) first *= NAME(gather)(q->variance, 0), last *= NAME(gather)(q->variance, m + 1);

    V square = zero, square2 = zero;
    f = NAME(massive)(q, 1, 0), f1 = NAME(massive)(q, 1, 1);
    V h = NAME(massive)(q, -1, 0), h1 = NAME(massive)(q, -1, 1);
    for (int64_t i = 0; i < b; i++) {
        NAME(weigh)(q, 1, weighted, i, &f, &f1, &square);
        NAME(weigh)(q, -1, weighted, i, &h, &h1, &square2);
    }
    if (a > b) NAME(weigh)(q, 1, weighted, b, &f, &f1, &square);
    f = f + (h1 - NAME(massive)(q, 1, a)), f1 = h + (f1 - NAME(massive)(q, 1, a + 1));
    square = square + square2 + (ix * f * f + NAME(all)(2.0) * iw * f * f1 + iy * f1 * f1);

    NAME(write)(out, 0, (up.rss + down.rss) + (first + last));
    NAME(write)(out, 1, (up.energy + down.energy) * NAME(all)(2.0 / 3.0));
    NAME(write)(out, 2, square * NAME(all)(1.0 / 9.0));
    for (int k = 0; k < COUNT; k++) out[3 * COUNT + k] = (double)(((int64_t *)&sum.bad)[k] != 0);
    NAME(write)(out, 4, sum.rise);
    NAME(write)(out, 5, sum.bend);
    NAME(write)(out, 6, det);
    out[7 * COUNT] = (double)(written + 1);
}

/* Add to u the correction in g where `used` (COUNT) is one, not zero, unless it is null. Then v = D^2 Q u
   (m + 2, COUNT), and g the residual z - Q' v - p N u; out (3, COUNT): squares of v over D, of the residual and of u. */
FORCED void NAME(remainder)(const NAME(job) *q, int weighted, const double *used, double *restrict v, double *out) {
    const int64_t m = q->m;
    double *restrict u = q->u, *restrict g = q->g;
    const double *r = q->r;
    if (used) {
        V part;
        for (int k = 0; k < COUNT; k++) ((double *)&part)[k] = used[k];
        for (int64_t j = 0; j < m; j++) NAME(write)(u, j, NAME(read)(u, j) + part * NAME(read)(g, j));
    }
    const int side = 1;
    NAME(write)(v, 0, NAME(read)(u, 0) * NAME(all)(r[0]));
    for (int64_t j = 1; j <= m; j++) {
        V before = NAME(read)(u, j - 2), here = NAME(read)(u, j - 1), after = NAME(read)(u, j);
        NAME(write)(v, j, (after - here) * NAME(all)(r[j]) - (here - before) * NAME(all)(r[j - 1]));
    }
    NAME(write)(v, m + 1, NAME(read)(u, m - 1) * NAME(all)(r[m]));
    V sum[4], rest[4], size[4];
    for (int k = 0; k < 4; k++) sum[k] = rest[k] = size[k] = NAME(all)(0.0);
    for (int64_t j = 0; j < m + 2; j++) {
        V x = NAME(read)(v, j), away = x;
        if (weighted) x *= D(j), NAME(write)(v, j, x);
        sum[j & 3] += x * away;
    }
    for (int64_t j = 0; j < m; j++) {
        V here = NAME(read)(v, j + 1);
        V bend = (NAME(read)(v, j + 2) - here) * NAME(all)(r[j + 1]) - (here - NAME(read)(v, j)) * NAME(all)(r[j]);
        NAME(write)(q->g, j, NAME(gather)(q->z, j) - bend - q->third * NAME(massive)(q, 1, j));
    }
    for (int64_t j = 0; j < m; j++) {
        V x = NAME(read)(g, j), y = NAME(read)(u, j);
        rest[j & 3] += x * x;
        size[j & 3] += y * y;
    }
    NAME(write)(out, 0, (sum[0] + sum[1]) + (sum[2] + sum[3]));
    NAME(write)(out, 1, (rest[0] + rest[1]) + (rest[2] + rest[3]));
    NAME(write)(out, 2, (size[0] + size[1]) + (size[2] + size[3]));
}

FORCED void NAME(eliminate)(const NAME(job) *q, int side, int weighted, int64_t i, V *f, V *f1) {
    V g = *f * NAME(read)(q->rd, ROW(i)), next = *f1 - NAME(read)(q->l, ROW(i)) * *f;
    NAME(write)(q->g, ROW(i), g);
    *f1 = NAME(read)(q->g, ROW(i + 2)) - NAME(beyond)(q, side, weighted, i) * g;
    *f = next;
}

FORCED void NAME(keep)(const NAME(job) *q, int64_t row, V x, V *change) {
    NAME(write)(q->g, row, x);
    *change += x * x;
}

/* Solve A x = g by the factor, into g. out (COUNT): squares of x. */
FORCED void NAME(correct)(const NAME(job) *q, int weighted, double *out) {
    const int64_t m = q->m, a = q->a, b = m - 2 - a;
    V middle = NAME(read)(q->g, a), middle1 = NAME(read)(q->g, a + 1);
    V f = NAME(read)(q->g, 0), f1 = NAME(read)(q->g, 1), h = NAME(read)(q->g, m - 1), h1 = NAME(read)(q->g, m - 2);
    for (int64_t i = 0; i < b; i++) {
        NAME(eliminate)(q, 1, weighted, i, &f, &f1);
        NAME(eliminate)(q, -1, weighted, i, &h, &h1);
    }
    if (a > b) NAME(eliminate)(q, 1, weighted, b, &f, &f1);
    f = f + (h1 - middle), f1 = h + (f1 - middle1);
    V ix = NAME(read)(q->rd, a), iy = NAME(read)(q->rd, a + 1), iw = NAME(read)(q->l, a);
    V x = ix * f + iw * f1, x1 = iw * f + iy * f1, change = NAME(all)(0.0), change2 = change;
    NAME(keep)(q, a, x, &change);
    NAME(keep)(q, a + 1, x1, &change2);
    NAME(back) up = {x, x1}, down = {x1, x};
    if (a > b) {
        x = NAME(solved)(q, 1, weighted, a - 1, &up);
        NAME(keep)(q, a - 1, x, &change);
        up.u2 = up.u1, up.u1 = x;
    }
    for (int64_t i = b - 1; i >= 0; i--) {
        x = NAME(solved)(q, 1, weighted, i, &up), x1 = NAME(solved)(q, -1, weighted, i, &down);
        NAME(keep)(q, i, x, &change);
        NAME(keep)(q, m - 1 - i, x1, &change2);
        up.u2 = up.u1, up.u1 = x;
        down.u2 = down.u1, down.u1 = x1;
    }
    NAME(write)(out, 0, change + change2);
}

FORCED NAME(job) NAME(made)(int64_t m, const double *step, const double *r, const double *const *z,
                            const double *const *variance, const double *p, double *rd, double *l, double *g, double *u) {
    V third;
    for (int k = 0; k < COUNT; k++) ((double *)&third)[k] = p[k] / 3.0;
    NAME(job) out = {m, m - 2 - (m - 2) / 2, step, r, z, variance, third, rd, l, g, u + COUNT};
    return out;
}

#define ARGUMENTS                                                                                                      \
    int64_t m, const double *step, const double *r, const double *const *z, const double *const *variance,             \
        const double *p, double *rd, double *l, double *g, double *u

EXPORTED void API(NAME(spline_evaluate))(ARGUMENTS, int32_t criterion, double *out, double *products) {
    NAME(job) q = NAME(made)(m, step, r, z, variance, p, rd, l, g, u);
    if (variance && criterion) NAME(evaluate)(&q, 1, 1, out, products);
    else if (variance) NAME(evaluate)(&q, 1, 0, out, products);
    else if (criterion) NAME(evaluate)(&q, 0, 1, out, products);
    else NAME(evaluate)(&q, 0, 0, out, products);
}

EXPORTED void API(NAME(spline_remainder))(ARGUMENTS, const double *used, double *v, double *out) {
    NAME(job) q = NAME(made)(m, step, r, z, variance, p, rd, l, g, u);
    if (variance) NAME(remainder)(&q, 1, used, v, out);
    else NAME(remainder)(&q, 0, used, v, out);
}

EXPORTED void API(NAME(spline_correct))(ARGUMENTS, double *out) {
    NAME(job) q = NAME(made)(m, step, r, z, variance, p, rd, l, g, u);
    if (variance) NAME(correct)(&q, 1, out);
    else NAME(correct)(&q, 0, out);
}

#undef ROW
#undef R
#undef H
#undef D
#undef ARGUMENTS
