/* What the sources of the kernel share: this level's vector of doubles, and how its functions are called.

   Each source is compiled once for every level of CPU (build.py), with LANES and LEVEL set: solve of a source becomes
   dynident_solve_avx2, and the loader (__init__.py) takes those of the best level that the CPU has. A vector is used
   with the operators of C alone (an extension that GCC and Clang share), so that one source serves all levels.
   Multiplication and addition are never contracted (-ffp-contract=off): every level gives the same bits. */

#ifndef DYNIDENT_LANES_H
#define DYNIDENT_LANES_H

#include <stdint.h>

#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif

#define JOIN_(name, level) dynident_##name##_##level
#define JOIN(name, level) JOIN_(name, level)
#define API(name) JOIN(name, LEVEL)

typedef double lanes __attribute__((vector_size(8 * LANES)));
typedef double loose __attribute__((vector_size(8 * LANES), aligned(8), may_alias));

static inline lanes load(const double *from) { return *(const loose *)from; }
static inline void store(double *to, lanes value) { *(loose *)to = value; }
static inline lanes all(double value) { return value - (lanes){0}; }

#endif
