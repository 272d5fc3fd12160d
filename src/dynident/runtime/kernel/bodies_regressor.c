/* The regressor of rigid bodies. */

#include "bodies.h"

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
