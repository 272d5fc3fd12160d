/* Which levels this CPU, and its operating system, can run, and which compiler made this. Compiled once. */

#include "lanes.h"

#if defined(_WIN32) && !defined(__clang__)
/* GCC for Windows does not align wider vectors on the stack (its bug 54412): only the least level is safe. */
EXPORTED int32_t dynident_best(void) { return 0; }
#elif defined(__x86_64__)
#include <cpuid.h>

static uint64_t enabled(void) {
    uint32_t low, high;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return ((uint64_t)high << 32) | low;
}

/* 0: the least that the architecture has; 1: AVX2 and FMA; 2: AVX-512 (F and DQ). */
EXPORTED int32_t dynident_best(void) {
    uint32_t a, b, c, d, fma_and_xgetbv = 1u << 12 | 1u << 27;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & fma_and_xgetbv) != fma_and_xgetbv || (enabled() & 0x6) != 0x6) return 0;
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || !(b & (1u << 5))) return 0;
    return (b & (1u << 16)) && (b & (1u << 17)) && (enabled() & 0xe6) == 0xe6 ? 2 : 1;
}
#else
EXPORTED int32_t dynident_best(void) { return 0; }
#endif

#define TEXT_(value) #value
#define TEXT(value) TEXT_(value)
#if defined(__clang__)
#define COMPILER "Clang " TEXT(__clang_major__) "." TEXT(__clang_minor__) "." TEXT(__clang_patchlevel__)
#elif defined(__GNUC__)
#define COMPILER "GCC " TEXT(__GNUC__) "." TEXT(__GNUC_MINOR__) "." TEXT(__GNUC_PATCHLEVEL__)
#else
#define COMPILER "a C compiler"
#endif

EXPORTED const char *dynident_compiler(void) { return COMPILER; }
