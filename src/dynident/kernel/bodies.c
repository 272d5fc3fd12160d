/* Rigid bodies: a tree of revolute and prismatic joints, LANES samples at a time.

   All vectors have the axes of the base; those of a body are about the origin of its joint frame. README.md has the
   formulas, models/recursion.py the same in NumPy. The caller describes the tree:

   tree (B, 3)    parent (-1: the base), 1 where the joint is prismatic, column of q that drives it
   fixed (B, 34)  in the parent's frame: axes A0 + sin A1 + cos A2 (each 9, by rows), origin, axis of the joint (each 3);
                  gain of the drive
   q, dq, ddq (N, B) are of the bodies, and work has room for them (models/recursion_kernel.py). */

#include "lanes.h"
#include <string.h>

#define FIXED 34

typedef struct { lanes x, y, z; } vec;
typedef struct { vec x, y, z; } mat; /* by columns */
typedef struct { lanes xx, xy, yy, xz, yz, zz; } sym;

static inline vec plus(vec a, vec b) { return (vec){a.x + b.x, a.y + b.y, a.z + b.z}; }
static inline vec minus(vec a, vec b) { return (vec){a.x - b.x, a.y - b.y, a.z - b.z}; }
static inline vec times(lanes s, vec a) { return (vec){s * a.x, s * a.y, s * a.z}; }
static inline lanes dot(vec a, vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline vec cross(vec a, vec b) {
    return (vec){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
static inline vec turn(mat R, vec a) { return plus(plus(times(a.x, R.x), times(a.y, R.y)), times(a.z, R.z)); }
static inline vec back(mat R, vec a) { return (vec){dot(R.x, a), dot(R.y, a), dot(R.z, a)}; }
static inline vec act(sym J, vec a) {
    return (vec){J.xx * a.x + J.xy * a.y + J.xz * a.z, J.xy * a.x + J.yy * a.y + J.yz * a.z,
                 J.xz * a.x + J.yz * a.y + J.zz * a.z};
}
static inline vec given(const double *a) { return (vec){all(a[0]), all(a[1]), all(a[2])}; }
static const vec none;

/* Sine and cosine to an ulp for |x| < 5e5, by the reductions and polynomials of fdlibm (Sun Microsystems, 1993). */
typedef int64_t whole __attribute__((vector_size(8 * LANES)));
static inline lanes where(whole mask, lanes yes, lanes no) { return (lanes)((mask & (whole)yes) | (~mask & (whole)no)); }

static inline void sincos_(lanes x, lanes *sine, lanes *cosine) {
    const double magic = 6755399441055744.0; /* 1.5 * 2^52: adding it rounds to an integer */
    lanes rounded = x * 6.36619772367581382433e-01 + magic, k = rounded - magic;
    whole quarter = (whole)rounded;
    lanes t = x - k * 1.57079632673412561417e+00, w = k * 6.07710050630396597660e-11, r = t - w;
    w = k * 2.02226624879595063154e-21 - ((t - r) - w);
    lanes y = r - w, tail = (r - y) - w, z = y * y, v = z * y;
    lanes odd = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * (2.75573137070700676789e-06
                + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)));
    lanes s = y - ((z * (0.5 * tail - v * odd) - tail) + v * 1.66666666666666324348e-01);
    lanes even = z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * (2.48015872894767294178e-05
                 + z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)))));
    lanes half = 0.5 * z, one = 1.0 - half, c = one + (((1.0 - one) - half) + (z * even - y * tail));
    whole swapped = -(quarter & 1);
    *sine = (lanes)((whole)where(swapped, c, s) ^ ((quarter & 2) << 62));
    *cosine = (lanes)((whole)where(swapped, s, c) ^ (((quarter + 1) & 2) << 62));
}

/* The motion of a body: axes R, axis z of its joint, origin p and d from its parent's, velocities and accelerations of
   rotation and origin, the latter less gravity. */
typedef struct { mat R; vec z, p, d, v, w, dw, a; } motion;

typedef struct {
    const int64_t *tree;
    const double *fixed;
    int64_t bodies;
} arm;

typedef struct {
    const double *q, *dq, *ddq;
    int64_t count;
} states;

static inline int prismatic(const arm *t, int64_t k) { return (int)t->tree[3 * k + 1]; }

/* Values of body k at LANES samples from i; the last is repeated where there are no more. */
static inline lanes at(const double *from, int64_t bodies, int64_t k, int64_t i, int64_t count) {
    lanes out;
    for (int t = 0; t < LANES; t++) out[t] = from[(i + t < count ? i + t : count - 1) * bodies + k];
    return out;
}

static inline vec spun(const double *A, lanes s, lanes c) { /* a column of A0 + s A1 + c A2 */
    return (vec){all(A[0]) + s * A[9] + c * A[18], all(A[3]) + s * A[12] + c * A[21], all(A[6]) + s * A[15] + c * A[24]};
}

/* Motions of the base, m[0], and of body k, m[k + 1]. */
static void move(const arm *t, const states *x, const double *gravity, int64_t i, motion *m) {
    const lanes zero = {0}, one = all(1.0);
    m[0] = (motion){.R = {{one, zero, zero}, {zero, one, zero}, {zero, zero, one}}, .a = times(all(-1.0), given(gravity))};
    for (int64_t k = 0; k < t->bodies; k++) {
        const double *A = t->fixed + FIXED * k;
        const motion *P = &m[t->tree[3 * k] + 1];
        motion *M = &m[k + 1];
        lanes dq = at(x->dq, t->bodies, k, i, x->count), ddq = at(x->ddq, t->bodies, k, i, x->count);
        lanes q = at(x->q, t->bodies, k, i, x->count), s = zero, c = zero;
        vec origin = given(A + 27);
        if (prismatic(t, k)) origin = plus(origin, times(q, given(A + 30)));
        else sincos_(q, &s, &c);
        M->R = (mat){turn(P->R, spun(A, s, c)), turn(P->R, spun(A + 1, s, c)), turn(P->R, spun(A + 2, s, c))};
        M->d = turn(P->R, origin);
        M->p = plus(P->p, M->d);
        M->z = turn(P->R, given(A + 30));
        vec swept = cross(P->w, M->d), rate = times(dq, M->z), gain = plus(times(ddq, M->z), cross(P->w, rate));
        M->v = plus(P->v, swept);
        M->a = plus(P->a, plus(cross(P->dw, M->d), cross(P->w, swept)));
        M->w = P->w;
        M->dw = P->dw;
        if (prismatic(t, k)) {
            M->v = plus(M->v, rate);
            M->a = plus(M->a, plus(gain, cross(P->w, rate)));
        } else {
            M->w = plus(M->w, rate);
            M->dw = plus(M->dw, gain);
        }
    }
}

static motion *aligned(double *work) { return (motion *)(((uintptr_t)work + 63) & ~(uintptr_t)63); }

/* ---- regressor ---- */

/* What the wrench of one body is made of, in its own axes: force a m + L h, moment h x a + sum of G I. */
typedef struct { vec a; mat L; vec G[6]; } body;

static inline body unit(const motion *M) {
    vec a = back(M->R, M->a), w = back(M->R, M->w), d = back(M->R, M->dw);
    lanes xx = w.x * w.x, yy = w.y * w.y, zz = w.z * w.z, xy = w.x * w.y, xz = w.x * w.z, yz = w.y * w.z;
    return (body){
        a,
        {{-(yy + zz), xy + d.z, xz - d.y}, {xy - d.z, -(xx + zz), yz + d.x}, {xz + d.y, yz - d.x, -(xx + yy)}},
        {{d.x, xz, -xy}, {d.y - xz, d.x + yz, xx - yy}, {-yz, d.y, xy},
         {d.z + xy, zz - xx, d.x - yz}, {yy - zz, d.z - xy, d.y + xz}, {yz, -xz, d.z}},
    };
}

/* The ten columns of body k for a joint that moves the bodies via[0..many - 1] above it, or itself. */
static inline void columns(const arm *t, const motion *m, const body *b, int64_t k, const int64_t *via, int64_t many,
                           lanes y[10]) {
    const motion *M = &m[k + 1];
    vec w = none, u = none;
    for (int64_t one = 0; one < many; one++) {
        int64_t j = via[one];
        lanes gain = all(t->fixed[FIXED * j + 33]);
        vec z = times(gain, m[j + 1].z);
        if (prismatic(t, j)) {
            u = plus(u, z);
        } else {
            w = plus(w, z);
            u = plus(u, cross(z, minus(M->p, m[j + 1].p)));
        }
    }
    w = back(M->R, w);
    u = back(M->R, u);
    vec h = plus(back(b->L, u), cross(b->a, w));
    y[0] = dot(u, b->a);
    y[1] = h.x;
    y[2] = h.y;
    y[3] = h.z;
    for (int c = 0; c < 6; c++) y[4 + c] = dot(w, b->G[c]);
}

/* Y (N, n, width): pairs (P, 4) of a body, the entry of its first parameter in a row, the first of its via and their
   number, in the order of the bodies. */
EXPORTED void API(bodies_regressor)(const int64_t *tree, const double *fixed, int64_t bodies, const double *gravity,
                                    const double *q, const double *dq, const double *ddq, int64_t count, const int64_t *pairs, int64_t many,
                                    const int64_t *via, double *Y, int64_t size, double *work) {
    const arm t = {tree, fixed, bodies};
    const states x = {q, dq, ddq, count};
    motion *m = aligned(work);
    for (int64_t i = 0; i < count; i += LANES) {
        int64_t rows = count - i < LANES ? count - i : LANES;
        double *out = Y + i * size;
        memset(out, 0, (size_t)(rows * size) * sizeof(double));
        move(&t, &x, gravity, i, m);
        body b;
        int64_t last = -1;
        for (const int64_t *pair = pairs; pair < pairs + 4 * many; pair += 4) {
            if (pair[0] != last) b = unit(&m[pair[0] + 1]);
            last = pair[0];
            lanes y[10];
            columns(&t, m, &b, last, via + pair[2], pair[3], y);
            for (int r = 0; r < rows; r++)
                for (int c = 0; c < 10; c++) out[r * size + pair[1] + c] = y[c][r];
        }
    }
}

/* Chosen entries (M, N): to (P, 10) has the row of each parameter of a pair, -1 where not wanted. Samples are gathered
   in the work array, M by TILE, because writing to M distant places at once is slow. */
#define TILE 128

EXPORTED void API(bodies_entries)(const int64_t *tree, const double *fixed, int64_t bodies, const double *gravity,
                                  const double *q, const double *dq, const double *ddq, int64_t count,
                                  const int64_t *pairs, int64_t many, const int64_t *via, const int64_t *to, double *Y,
                                  int64_t M, double *work) {
    const arm t = {tree, fixed, bodies};
    const states x = {q, dq, ddq, count};
    motion *m = aligned(work);
    double *tile = (double *)(m + bodies + 1);
    for (int64_t first = 0; first < count; first += TILE) {
        int64_t rows = count - first < TILE ? count - first : TILE;
        for (int64_t i = 0; i < rows; i += LANES) {
            move(&t, &x, gravity, first + i, m);
            body b;
            int64_t last = -1;
            for (int64_t one = 0; one < many; one++) {
                const int64_t *pair = pairs + 4 * one, *row = to + 10 * one;
                if (pair[0] != last) b = unit(&m[pair[0] + 1]);
                last = pair[0];
                lanes y[10];
                columns(&t, m, &b, last, via + pair[2], pair[3], y);
                for (int c = 0; c < 10; c++)
                    if (row[c] >= 0) store(tile + row[c] * TILE + i, y[c]);
            }
        }
        for (int64_t r = 0; r < M; r++) memcpy(Y + r * count + first, tile + r * TILE, (size_t)rows * sizeof(double));
    }
}

/* ---- torque and its derivatives ---- */

/* What a body, and all that it carries, holds about its origin: mass, first and second moment, momentum p, the moments
   U of velocity (columns), force and moment. */
typedef struct { lanes m; vec h; sym J; vec p; mat U; vec F, N; } bulk;

static inline sym tensor(mat R, const double *I) { /* R I R' for xx, xy, yy, xz, yz, zz */
    mat S = {turn(R, (vec){all(I[0]), all(I[1]), all(I[3])}), turn(R, (vec){all(I[1]), all(I[2]), all(I[4])}),
             turn(R, (vec){all(I[3]), all(I[4]), all(I[5])})};
    vec x = {R.x.x, R.y.x, R.z.x}, y = {R.x.y, R.y.y, R.z.y}, z = {R.x.z, R.y.z, R.z.z};
    vec sx = {S.x.x, S.y.x, S.z.x}, sy = {S.x.y, S.y.y, S.z.y}, sz = {S.x.z, S.y.z, S.z.z};
    return (sym){dot(sx, x), dot(sx, y), dot(sy, y), dot(sx, z), dot(sy, z), dot(sz, z)};
}

static inline bulk alone(const motion *M, const double *theta, int flow) {
    bulk b = {.m = all(theta[0]), .h = turn(M->R, given(theta + 1)), .J = tensor(M->R, theta + 4)};
    vec w = M->w, wh = cross(w, b.h);
    b.F = plus(times(b.m, M->a), plus(cross(M->dw, b.h), cross(w, wh)));
    b.N = plus(plus(cross(b.h, M->a), act(b.J, M->dw)), cross(w, act(b.J, w)));
    if (!flow) return b;
    b.p = plus(times(b.m, M->v), wh);
    lanes half = all(0.5) * (b.J.xx + b.J.yy + b.J.zz);
    vec x = {half - b.J.xx, -b.J.xy, -b.J.xz}, y = {-b.J.xy, half - b.J.yy, -b.J.yz}, z = {-b.J.xz, -b.J.yz, half - b.J.zz};
    b.U = (mat){plus(times(b.h.x, M->v), cross(w, x)), plus(times(b.h.y, M->v), cross(w, y)),
                plus(times(b.h.z, M->v), cross(w, z))};
    return b;
}

/* Add what body b carries to that of its parent, whose origin lies at -d. */
static inline void carry(bulk *P, const bulk *b, vec d, int inertia, int flow) {
    P->F = plus(P->F, b->F);
    P->N = plus(P->N, plus(b->N, cross(d, b->F)));
    if (!inertia) return;
    vec md = times(b->m, d), s = plus(b->h, md), h = b->h;
    lanes both = dot(h, d) + dot(s, d);
    P->m += b->m;
    P->h = plus(P->h, s);
    P->J.xx += b->J.xx + (both - (h.x * d.x + s.x * d.x));
    P->J.yy += b->J.yy + (both - (h.y * d.y + s.y * d.y));
    P->J.zz += b->J.zz + (both - (h.z * d.z + s.z * d.z));
    P->J.xy += b->J.xy - (h.x * d.y + s.y * d.x);
    P->J.xz += b->J.xz - (h.x * d.z + s.z * d.x);
    P->J.yz += b->J.yz - (h.y * d.z + s.z * d.y);
    if (!flow) return;
    P->p = plus(P->p, b->p);
    P->U = (mat){plus(P->U.x, plus(b->U.x, times(d.x, b->p))), plus(P->U.y, plus(b->U.y, times(d.y, b->p))),
                 plus(P->U.z, plus(b->U.z, times(d.z, b->p)))};
}

/* Add a value, by the gains of its bodies, to an entry of samples i to i + rows. */
static inline void put(double *out, int64_t size, int64_t rows, lanes value) {
    for (int r = 0; r < rows; r++) out[r * size] += value[r];
}

static inline double gain(const arm *t, int64_t k) { return t->fixed[FIXED * k + 33]; }

/* The torque of the joint of body j by a wrench at the origin of body k, which it carries. */
static inline lanes taken(const arm *t, const motion *m, int64_t j, int64_t k, vec N, vec F) {
    const motion *J = &m[j + 1];
    if (prismatic(t, j)) return dot(J->z, F);
    return j == k ? dot(J->z, N) : dot(J->z, N) + dot(cross(J->z, minus(m[k + 1].p, J->p)), F);
}

/* The torque (N, n) of bodies theta (B, 10). */
EXPORTED void API(bodies_torque)(const int64_t *tree, const double *fixed, int64_t bodies, const double *gravity,
                                 const double *q, const double *dq, const double *ddq, int64_t count, const double *theta, double *tau, int64_t n,
                                 double *work) {
    const arm t = {tree, fixed, bodies};
    const states x = {q, dq, ddq, count};
    motion *m = aligned(work);
    bulk *b = (bulk *)(m + bodies + 1);
    for (int64_t i = 0; i < count; i += LANES) {
        int64_t rows = count - i < LANES ? count - i : LANES;
        double *out = tau + i * n;
        memset(out, 0, (size_t)(rows * n) * sizeof(double));
        move(&t, &x, gravity, i, m);
        for (int64_t k = 0; k < bodies; k++) b[k] = alone(&m[k + 1], theta + 10 * k, 0);
        for (int64_t k = bodies - 1; k >= 0; k--) {
            put(out + tree[3 * k + 2], n, rows, gain(&t, k) * taken(&t, m, k, k, b[k].N, b[k].F));
            if (tree[3 * k] >= 0) carry(&b[tree[3 * k]], &b[k], m[k + 1].d, 0, 0);
        }
    }
}

/* The mass matrix (N, n, n), and the torque (N, n) at the accelerations ddq. */
EXPORTED void API(bodies_mass)(const int64_t *tree, const double *fixed, int64_t bodies, const double *gravity,
                               const double *q, const double *dq, const double *ddq, int64_t count, const double *theta, double *mass, double *tau,
                               int64_t n, double *work) {
    const arm t = {tree, fixed, bodies};
    const states x = {q, dq, ddq, count};
    motion *m = aligned(work);
    bulk *b = (bulk *)(m + bodies + 1);
    memset(mass, 0, (size_t)(count * n * n) * sizeof(double));
    memset(tau, 0, (size_t)(count * n) * sizeof(double));
    for (int64_t i = 0; i < count; i += LANES) {
        int64_t rows = count - i < LANES ? count - i : LANES;
        double *D = mass + i * n * n;
        move(&t, &x, gravity, i, m);
        for (int64_t k = 0; k < bodies; k++) b[k] = alone(&m[k + 1], theta + 10 * k, 0);
        for (int64_t k = bodies - 1; k >= 0; k--) {
            const motion *M = &m[k + 1];
            int64_t own = tree[3 * k + 2];
            put(tau + i * n + own, n, rows, gain(&t, k) * taken(&t, m, k, k, b[k].N, b[k].F));
            vec F = prismatic(&t, k) ? times(b[k].m, M->z) : cross(M->z, b[k].h);
            vec N = prismatic(&t, k) ? cross(b[k].h, M->z) : act(b[k].J, M->z);
            for (int64_t j = k; j >= 0; j = tree[3 * j]) {
                lanes value = gain(&t, k) * gain(&t, j) * taken(&t, m, j, k, N, F);
                int64_t other = tree[3 * j + 2];
                put(D + other * n + own, n * n, rows, value);
                if (j != k) put(D + own * n + other, n * n, rows, value);
            }
            if (tree[3 * k] >= 0) carry(&b[tree[3 * k]], &b[k], M->d, 1, 0);
        }
    }
}

/* How a change of a joint changes the accelerations below it: by e + g x r + 2 a x (velocity), r from its origin. */
typedef struct { vec a, g, e; } change;

static void changes(const arm *t, int64_t k, const motion *P, const motion *M, change by[3]) {
    vec z = M->z, wz = cross(P->w, z), bent = plus(cross(P->dw, z), cross(P->w, wz)), wz2 = plus(wz, wz);
    if (prismatic(t, k)) {
        by[0] = (change){none, none, bent};
        by[1] = (change){none, none, wz2};
        by[2] = (change){none, none, z};
    } else {
        vec lost = cross(wz, M->v), turned = cross(z, M->v);
        by[0] = (change){wz, bent, minus(cross(M->a, z), plus(lost, lost))};
        by[1] = (change){z, wz2, times(all(-2.0), turned)};
        by[2] = (change){none, z, none};
    }
}

/* Derivatives (3, N, n, n) of the torque by q, dq, ddq. */
EXPORTED void API(bodies_partials)(const int64_t *tree, const double *fixed, int64_t bodies, const double *gravity,
                                   const double *q, const double *dq, const double *ddq, int64_t count, const double *theta, double *slopes, int64_t n,
                                   double *work) {
    const arm t = {tree, fixed, bodies};
    const states x = {q, dq, ddq, count};
    motion *m = aligned(work);
    bulk *b = (bulk *)(m + bodies + 1);
    change(*by)[3] = (change(*)[3])(b + bodies);
    int64_t size = n * n;
    memset(slopes, 0, (size_t)(3 * count * size) * sizeof(double));
    for (int64_t i = 0; i < count; i += LANES) {
        int64_t rows = count - i < LANES ? count - i : LANES;
        double *out[3] = {slopes + i * size, slopes + (count + i) * size, slopes + (2 * count + i) * size};
        move(&t, &x, gravity, i, m);
        for (int64_t k = 0; k < bodies; k++) {
            b[k] = alone(&m[k + 1], theta + 10 * k, 1);
            changes(&t, k, &m[tree[3 * k] + 1], &m[k + 1], by[k]);
        }
        for (int64_t k = bodies - 1; k >= 0; k--) {
            const motion *M = &m[k + 1];
            const bulk *own_ = &b[k];
            int64_t own = tree[3 * k + 2];
            lanes trace = own_->U.x.x + own_->U.y.y + own_->U.z.z;
            vec N[3], F[3], z = M->z;
            for (int c = 0; c < 3; c++) {
                change s = by[k][c];
                vec a2 = plus(s.a, s.a);
                F[c] = plus(plus(times(own_->m, s.e), cross(s.g, own_->h)), cross(a2, own_->p));
                N[c] = plus(plus(cross(own_->h, s.e), act(own_->J, s.g)), minus(times(trace, a2), turn(own_->U, a2)));
            }
            vec e, g, a; /* the torque of this joint is e.e + g.g + a.a of a change at its origin */
            if (prismatic(&t, k)) {
                N[0] = plus(N[0], cross(z, own_->F));
                e = times(own_->m, z);
                g = cross(own_->h, z);
                a = cross(plus(own_->p, own_->p), z);
            } else {
                N[0] = plus(N[0], cross(z, own_->N));
                F[0] = plus(F[0], cross(z, own_->F));
                vec Uz = back(own_->U, z);
                e = cross(z, own_->h);
                g = act(own_->J, z);
                a = minus(times(trace + trace, z), plus(Uz, Uz));
            }
            for (int64_t j = k; j >= 0; j = tree[3 * j]) {
                lanes both = all(gain(&t, k) * gain(&t, j));
                int64_t other = tree[3 * j + 2], upper = other * n + own, lower = own * n + other;
                for (int c = 0; c < 3; c++) {
                    lanes value = both * taken(&t, m, j, k, N[c], F[c]);
                    put(out[c] + upper, size, rows, value);
                    if (c == 2 && j != k) put(out[c] + lower, size, rows, value);
                }
                if (j == k) continue;
                vec g_ = plus(g, cross(minus(M->p, m[j + 1].p), e));
                for (int c = 0; c < 2; c++) {
                    change s = by[j][c];
                    put(out[c] + lower, size, rows, both * (dot(e, s.e) + dot(g_, s.g) + dot(a, s.a)));
                }
            }
            if (tree[3 * k] >= 0) carry(&b[tree[3 * k]], &b[k], M->d, 1, 1);
        }
    }
}
