/* Recursive filters of second-order sections, over many series at a time.

   A section is recursive in time, so that one series is as slow as a chain of additions; LANES series are filtered side
   by side. A tile of samples is turned so that the series are the lanes, filtered, and turned back. */

#include "lanes.h"

enum { TILE = 64, MOST = 8 };

static inline int64_t least(int64_t a, int64_t b) { return a < b ? a : b; }

/* Filter the rows of x (series, n) in place by up to MOST sections, b0 b1 b2 1 a1 a2 each, in the direct form II
   transposed; from the last sample to the first where `back` is not 0. state (series, sections, 2) is what the filter
   remembers at the start. */
EXPORTED void API(sections)(int64_t series, int64_t n, double *x, int64_t sections, const double *sos,
                            const double *state, int64_t back) {
    _Alignas(64) double tile[TILE * LANES] = {0};
    for (int64_t first = 0; first < series; first += LANES) {
        const int64_t width = least(LANES, series - first);
        double *rows = x + first * n;
        lanes z[MOST][2];
        for (int64_t s = 0; s < sections; s++)
            for (int64_t l = 0; l < LANES; l++)
                for (int64_t k = 0; k < 2; k++)
                    z[s][k][l] = l < width ? state[((first + l) * sections + s) * 2 + k] : 0.0;
        for (int64_t start = 0; start < n; start += TILE) {
            const int64_t m = least(TILE, n - start);
            const int64_t origin = back ? n - 1 - start : start, step = back ? -1 : 1;
            for (int64_t l = 0; l < width; l++)
                for (int64_t i = 0; i < m; i++)
                    tile[i * LANES + l] = rows[l * n + origin + step * i];
            for (int64_t i = 0; i < m; i++) {
                lanes u = load(tile + i * LANES);
                for (int64_t s = 0; s < sections; s++) {
                    const double *c = sos + 6 * s;
                    const lanes y = all(c[0]) * u + z[s][0];
                    z[s][0] = all(c[1]) * u - all(c[4]) * y + z[s][1];
                    z[s][1] = all(c[2]) * u - all(c[5]) * y;
                    u = y;
                }
                store(tile + i * LANES, u);
            }
            for (int64_t l = 0; l < width; l++)
                for (int64_t i = 0; i < m; i++)
                    rows[l * n + origin + step * i] = tile[i * LANES + l];
        }
    }
}
