/* Functions compiled twice for x86-64: also for vectors of four doubles, where the processor has
 * them. Both give the same bits, since no multiplication is fused with an addition. */
#ifndef WIDE_H
#define WIDE_H

/* A loop of few rounds, and one of long rounds that do not wait for each other. */
#ifdef __clang__
#define UNROLLED _Pragma("clang loop unroll(full)")
#define INTERLEAVED _Pragma("clang loop interleave_count(2)")
#pragma clang diagnostic ignored "-Wpass-failed"
#define PAIRED _Pragma("clang loop vectorize_width(2) interleave_count(2)")
#else
#define UNROLLED
#define INTERLEAVED
#define PAIRED
#endif

/* Spare lanes count as read: otherwise a compiler may leave out their constants, among them those
 * that keep divisors from 0. */
#ifdef __GNUC__
#define KEEP_LANES(lanes) __asm__ volatile("" : : "r"(lanes) : "memory")
#else
#define KEEP_LANES(lanes)
#endif

#if defined(__GNUC__) && defined(__x86_64__)
#include <cpuid.h>

/* Whether processor and operating system support AVX2; asking them is slow. */
static inline int has_wide_vectors(void) {
    static volatile int known = -1;
    unsigned a;
    unsigned b;
    unsigned c;
    unsigned d;
    unsigned saved = 0;
    if (known < 0) {
        const bool saves = __get_cpuid(1, &a, &b, &c, &d) && (c & bit_OSXSAVE);
        if (saves) {
            __asm__("xgetbv" : "=a"(saved), "=d"(d) : "c"(0));
        }
        known = (saved & 6) == 6 && __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & bit_AVX2);
    }
    return known;
}

#define INLINED static inline __attribute__((always_inline))
#define IN_WIDTHS(name, signature, arguments)                                                      \
    __attribute__((target("avx2"))) static bool name##_wide signature {                            \
        return name##_inlined arguments;                                                           \
    }                                                                                              \
    static bool name signature {                                                                   \
        return has_wide_vectors() ? name##_wide arguments : name##_inlined arguments;              \
    }
#else
#define INLINED static
#define IN_WIDTHS(name, signature, arguments)                                                      \
    static bool name signature {                                                                   \
        return name##_inlined arguments;                                                           \
    }
#endif

/* The same for a loop that is PAIRED: GCC does not interleave, so it needs the wide form. */
#ifdef __clang__
#define IN_PAIRS(name, signature, arguments)                                                       \
    static bool name signature {                                                                   \
        return name##_inlined arguments;                                                           \
    }
#else
#define IN_PAIRS IN_WIDTHS
#endif

#endif
