/* The torque of rigid bodies, their mass matrix, the derivatives of the torque and those of sums of the regressor, and
   steps of a free simulation. */

#include "bodies.h"
#include <math.h>

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

/* What the sums of one sample change by with the motion of a body: by unit changes a, g and e as in `change`, and by the
   screws of the joints before it, as its own moves. */
typedef struct { vec a, g, e; lanes crossed; } pulled;

/* Derivatives (3, N, n) by q, dq, ddq of the sums <G_i, Y_i> for weights G (N, n, width); the parameters of body k begin
   at place[k] of a row, or it has none (-1). models/recursion.py has the same by NumPy. */
EXPORTED void API(bodies_weighted)(const int64_t *tree, const double *fixed, int64_t bodies, const double *gravity,
                                   const double *q, const double *dq, const double *ddq, int64_t count, const int64_t *place, const double *weights,
                                   int64_t width, double *slopes, int64_t n, double *work) {
    const arm t = {tree, fixed, bodies};
    const states x = {q, dq, ddq, count};
    motion *m = aligned(work);
    pulled *b = (pulled *)(m + bodies + 1);
    int64_t *path = (int64_t *)(b + bodies);
    memset(slopes, 0, (size_t)(3 * count * n) * sizeof(double));
    for (int64_t i = 0; i < count; i += LANES) {
        int64_t rows = count - i < LANES ? count - i : LANES;
        move(&t, &x, gravity, i, m);
        memset(b, 0, (size_t)bodies * sizeof(pulled));
        for (int64_t k = 0; k < bodies; k++) {
            if (place[k] < 0) continue;
            const motion *M = &m[k + 1];
            int64_t depth = 0;
            for (int64_t j = k; j >= 0; j = tree[3 * j]) path[depth++] = j;
            vec w = back(M->R, M->w), dw = back(M->R, M->dw), acc = back(M->R, M->a);
            vec a = none, g = none, e = none, N_ = none, F_ = none; /* the last: what the screws of joints before take */
            while (depth--) {
                int64_t j = path[depth];
                lanes y[10];
                const double *from = weights + tree[3 * j + 2] * width + place[k];
                for (int r = 0; r < LANES; r++) {
                    const double *row = from + (i + r < count ? i + r : count - 1) * n * width;
                    for (int c = 0; c < 10; c++) y[c][r] = row[c];
                }
                for (int c = 0; c < 10; c++) y[c] *= gain(&t, j);
                const vec z = m[j + 1].z, h = {y[1], y[2], y[3]};
                const sym J = {y[4], y[5], y[6], y[7], y[8], y[9]};
                vec W = none, U = z;
                if (!prismatic(&t, j)) {
                    W = back(M->R, z);
                    U = j == k ? none : cross(z, minus(M->p, m[j + 1].p));
                }
                U = back(M->R, U);
                vec wh = cross(w, h), Jw = act(J, w);
                vec F = plus(times(y[0], acc), plus(cross(dw, h), cross(w, wh)));
                vec N = plus(plus(cross(h, acc), act(J, dw)), cross(w, Jw));
                b[j].crossed += dot(W, N_) + dot(U, F_);
                N_ = plus(N_, plus(cross(W, N), cross(U, F)));
                F_ = plus(F_, cross(W, F));
                e = plus(e, plus(times(y[0], U), cross(W, h)));
                g = plus(g, plus(cross(h, U), act(J, W)));
                a = plus(a, plus(plus(cross(wh, U), cross(h, cross(U, w))), plus(cross(Jw, W), act(J, cross(W, w)))));
            }
            e = b[k].e = turn(M->R, e);
            g = b[k].g = turn(M->R, g);
            vec lost = cross(M->v, e);
            b[k].a = plus(turn(M->R, a), plus(cross(M->w, g), plus(lost, lost)));
        }
        for (int64_t k = bodies - 1; k >= 0; k--) {
            const motion *M = &m[k + 1];
            change by[3];
            changes(&t, k, &m[tree[3 * k] + 1], M, by);
            for (int c = 0; c < 3; c++) {
                lanes value = dot(b[k].a, by[c].a) + dot(b[k].g, by[c].g) + dot(b[k].e, by[c].e);
                if (c == 0) value -= b[k].crossed;
                put(slopes + (c * count + i) * n + tree[3 * k + 2], n, rows, gain(&t, k) * value);
            }
            if (tree[3 * k] < 0) continue;
            pulled *P = &b[tree[3 * k]];
            P->a = plus(P->a, b[k].a);
            P->e = plus(P->e, b[k].e);
            P->g = plus(P->g, plus(b[k].g, cross(M->d, b[k].e)));
        }
    }
}

/* Solve n equations, the rows of a (n, width) with their right sides behind, in place; 0 where they are singular. */
static int solve(double *a, int64_t n, int64_t width) {
    for (int64_t k = 0; k < n; k++) {
        int64_t pivot = k;
        for (int64_t i = k + 1; i < n; i++)
            if (fabs(a[i * width + k]) > fabs(a[pivot * width + k])) pivot = i;
        double *row = a + k * width, *best = a + pivot * width, top = best[k];
        if (top == 0.0) return 0;
        for (int64_t j = k; j < width; j++) {
            double value = best[j] / top;
            best[j] = row[j];
            row[j] = value;
        }
        for (int64_t i = 0; i < n; i++)
            for (int64_t j = k + 1; i != k && j < width; j++) a[i * width + j] -= a[i * width + k] * row[j];
    }
    return 1;
}

/* Impulses p (m), each at most h F, that stop sliding velocities v (m), which W (m, m) times p slows. */
static void brake(const double *v, const double *W, double h, const double *F, double *p, int64_t m) {
    for (int64_t i = 0; i < m; i++) p[i] = h * (v[i] > 0 ? F[i] : v[i] < 0 ? -F[i] : 0.0);
    for (int round = 0, done = 0; round < 51 && !done; round++) { /* a look whether all keep sliding, then projected Gauss-Seidel */
        done = 1;
        for (int64_t i = 0; i < m; i++) {
            double rest = v[i], limit = h * F[i];
            for (int64_t j = 0; j < m; j++) rest -= W[i * m + j] * p[j];
            double next = fmin(fmax(p[i] + rest / W[i * m + i], -limit), limit);
            done &= round ? fabs(next - p[i]) <= 1e-9 * limit : rest * p[i] >= 0;
            if (round) p[i] = next;
        }
    }
}

/* From the first of the states q, dq (steps + 1, P, n) and ddq (P, n) take steps of h s with the torque tau (P, n), as
   models/simulation/trace.py does, and return how many succeeded. set: the offset of each body, mass and bias of other
   terms, V, J (m, n) and F (m); work begins with zeros. */
EXPORTED int64_t API(bodies_steps)(const int64_t *tree, const double *fixed, int64_t bodies, const double *gravity,
                                   const double *theta, const double *set, int64_t n, int64_t m, double *q, double *dq,
                                   double *ddq, const double *tau, int64_t pieces, const double *h, int64_t steps, double *work) {
    const int64_t size = pieces * n, all_bodies = pieces * bodies, width = n + 1 + m;
    const double *offset = set, *mass0 = offset + bodies, *bias0 = mass0 + n * n, *V = bias0 + n, *J = V + n * n, *F = J + m * n;
    double *middle = work, *rate = middle + size, *bias = rate + size, *mass = bias + size, *body_q = mass + size * n;
    double *body_dq = body_q + all_bodies, *still = body_dq + all_bodies, *a = still + all_bodies, *p = a + n * width;
    double *slide = p + m, *W = slide + m, *rest = W + m * m;
    for (int64_t s = 0; s < steps; s++, q += size, dq += size) {
        for (int64_t i = 0; i < size; i++) middle[i] = q[i] + 0.5 * h[s] * dq[i], rate[i] = dq[i] + 0.5 * h[s] * ddq[i];
        for (int64_t i = 0; i < all_bodies; i++) {
            int64_t k = i % bodies, from = i / bodies * n + tree[3 * k + 2];
            body_q[i] = middle[from] * fixed[FIXED * k + 33] + offset[k];
            body_dq[i] = rate[from] * fixed[FIXED * k + 33];
        }
        API(bodies_mass)(tree, fixed, bodies, gravity, body_q, body_dq, still, pieces, theta, mass, bias, n, rest);
        for (int64_t at = 0; at < size; at += n) {
            /* the new velocity without dry friction, and how it answers to impulses along the rows of J */
            for (int64_t i = 0; i < n; i++) {
                double *row = a + i * width;
                row[n] = tau[at + i] - bias[at + i] - bias0[i];
                for (int64_t j = 0; j < n; j++) {
                    row[j] = mass[(at + i) * n + j] + mass0[i * n + j] + 0.5 * h[s] * V[i * n + j];
                    row[n] -= V[i * n + j] * dq[at + j];
                }
                for (int64_t c = 0; c < m; c++) row[n + 1 + c] = J[c * n + i];
            }
            if (!solve(a, n, width)) return s;
            double *v = dq + size + at;
            for (int64_t i = 0; i < n; i++) v[i] = dq[at + i] + h[s] * a[i * width + n];
            memset(slide, 0, (size_t)(m + m * m) * sizeof(double));
            for (int64_t c = 0; c < m; c++)
                for (int64_t i = 0; i < n; i++) {
                    slide[c] += J[c * n + i] * v[i];
                    for (int64_t e = 0; e < m; e++) W[c * m + e] += J[c * n + i] * a[i * width + n + 1 + e];
                }
            brake(slide, W, h[s], F, p, m);
            for (int64_t i = 0; i < n; i++) {
                for (int64_t c = 0; c < m; c++) v[i] -= a[i * width + n + 1 + c] * p[c];
                ddq[at + i] = (v[i] - dq[at + i]) / h[s];
                q[size + at + i] = middle[at + i] + 0.5 * h[s] * v[i];
            }
        }
    }
    return steps;
}
