/* Which levels this CPU, and its operating system, can run. Compiled once. */

#include "lanes.h"

#if defined(__x86_64__)
#include <cpuid.h>

static uint64_t enabled(void) {
    uint32_t low, high;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return ((uint64_t)high << 32) | low;
}

/* 0: the least that the architecture has; 1: AVX2; 2: AVX-512 (F and DQ). */
EXPORTED int32_t dynident_best(void) {
    uint32_t a, b, c, d;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & (1u << 27)) || (enabled() & 0x6) != 0x6) return 0;
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || !(b & (1u << 5))) return 0;
    return (b & (1u << 16)) && (b & (1u << 17)) && (enabled() & 0xe6) == 0xe6 ? 2 : 1;
}
#else
EXPORTED int32_t dynident_best(void) { return 0; }
#endif

/* What the library was compiled from: the loader refuses one of other sources. */
EXPORTED const char *dynident_sources(void) { return SOURCES; }
EXPORTED const char *dynident_compiler(void) { return __VERSION__; }
