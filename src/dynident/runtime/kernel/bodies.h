/* What the sources on rigid bodies share: a tree of revolute and prismatic joints, and the motion of its bodies, for
   LANES samples at a time.

   All vectors have the axes of the base; those of a body are about the origin of its joint frame. README.md has the
   formulas, models/recursion.py the same in NumPy. The caller describes the tree:

   tree (B, 3)    parent (-1: the base), 1 where the joint is prismatic, column of q that drives it
   fixed (B, 34)  in the parent's frame: axes A0 + sin A1 + cos A2 (each 9, by rows), origin, axis of the joint (each 3);
                  gain of the drive
   q, dq, ddq (N, B) are of the bodies, and work has room for them (models/recursion_kernel.py). */

#ifndef DYNIDENT_BODIES_H
#define DYNIDENT_BODIES_H

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

static inline void sine_cosine(lanes x, lanes *sine, lanes *cosine) {
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
static inline void move(const arm *t, const states *x, const double *gravity, int64_t i, motion *m) {
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
        else sine_cosine(q, &s, &c);
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

#endif
