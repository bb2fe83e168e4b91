// Eight lanes at once, and the processor's choice of instruction set. Shared by all kernels of this folder.
//
// A kernel file includes itself: its second half, between F4X_ISA and its end, is compiled once for the plain target and,
// on x86 with GCC or clang, once more for AVX2 + FMA and for AVX-512 (each_isa.hpp). Vectors stay eight lanes wide: AVX-512 gives
// them twice as many registers and masks, and rounds as AVX2 does. A file that defines F4X_WIDE_TOO is compiled once more with
// F4X_WIDE, for sixteen lanes. Many processors with AVX-512 do half of such a vector at a time, so the choice is measured.
// That half begins by including lanes_isa.hpp.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

#if defined(__GNUC__) && (defined(__x86_64__) || defined(__i386__))
#define F4X_X86 1
#include <cpuid.h>
#include <immintrin.h>
#if !defined(F4X_PLAIN) && !defined(F4X_NO_AVX2)
#define F4X_HAS_AVX2 1
#if !defined(F4X_NO_AVX512)
#define F4X_HAS_AVX512 1
#endif
#endif
#endif
#if defined(__clang__)
#define F4X_NARROW  // of itself
#else
#define F4X_NARROW ",prefer-vector-width=256"
#endif

#if defined(_WIN32)
#define F4X_API extern "C" __declspec(dllexport)
#else
#define F4X_API extern "C" __attribute__((visibility("default")))
#endif

#if defined(__GNUC__)
#define F4X_INLINE inline __attribute__((always_inline))
#else
#define F4X_INLINE inline
#endif

// Loops over small arrays of vectors must be unrolled completely, or the arrays live in memory instead of registers.
#if defined(__clang__)
#define F4X_UNROLL _Pragma("unroll")
#elif defined(__GNUC__)
#define F4X_UNROLL _Pragma("GCC unroll 16")
#else
#define F4X_UNROLL
#endif

// ------------------------------------------------------------------------------------------------- eight lanes at once

#if defined(__GNUC__) && !defined(F4X_PLAIN)
typedef float f8 __attribute__((vector_size(32)));
typedef int32_t i8 __attribute__((vector_size(32)));
typedef uint32_t u8 __attribute__((vector_size(32)));  // wraps around where i8 must not overflow
typedef float f16 __attribute__((vector_size(64)));
typedef int32_t i16 __attribute__((vector_size(64)));
typedef uint32_t u16 __attribute__((vector_size(64)));
#else
// The same arithmetic for compilers without vector extensions.
template <class T>
struct Eight {
    T lane[8];
    Eight() = default;
    Eight(T x) { std::fill(lane, lane + 8, x); }
    Eight(T a, T b, T c, T d, T e, T f, T g, T h) : lane{a, b, c, d, e, f, g, h} {}
    T& operator[](int i) { return lane[i]; }
    const T& operator[](int i) const { return lane[i]; }
    template <class U>
    explicit operator Eight<U>() const {
        Eight<U> bits;
        std::memcpy(&bits, this, sizeof bits);
        return bits;
    }
};
typedef Eight<float> f8;
typedef Eight<int32_t> i8;
typedef Eight<uint32_t> u8;
#define F4X_LANES(V, R, OP, EXPRESSION)                                                      \
    inline R operator OP(const V& a, const V& b) {                                           \
        R r;                                                                                 \
        for (int i = 0; i < 8; ++i) r[i] = EXPRESSION;                                       \
        return r;                                                                            \
    }
F4X_LANES(f8, f8, +, a[i] + b[i])
F4X_LANES(f8, f8, -, a[i] - b[i])
F4X_LANES(f8, f8, *, a[i] * b[i])
F4X_LANES(f8, f8, /, a[i] / b[i])
F4X_LANES(f8, i8, <, -(a[i] < b[i]))
F4X_LANES(f8, i8, <=, -(a[i] <= b[i]))
F4X_LANES(f8, i8, >=, -(a[i] >= b[i]))
F4X_LANES(f8, i8, >, -(a[i] > b[i]))
F4X_LANES(i8, i8, &, a[i] & b[i])
F4X_LANES(u8, u8, +, a[i] + b[i])
F4X_LANES(u8, u8, -, a[i] - b[i])
F4X_LANES(u8, u8, <<, a[i] << b[i])
inline f8& operator+=(f8& a, const f8& b) { return a = a + b; }
#endif

namespace f4x {

#if defined(F4X_HAS_AVX2)
// Bits of the register files that survive a task switch; a processor with OSXSAVE tells them.
inline unsigned kept_registers() {
    unsigned kept, high;
    __asm__("xgetbv" : "=a"(kept), "=d"(high) : "c"(0));
    return kept;
}
#endif

// Whether the AVX2 half of a kernel file exists and may run here.
inline bool has_avx2() {
#if defined(F4X_HAS_AVX2)
    static const bool found = [] {
        unsigned a, b, c, d;
        if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & bit_FMA) || !(c & bit_OSXSAVE)) return false;
        if ((kept_registers() & 6) != 6) return false;  // the upper halves of the registers
        return __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & bit_AVX2);
    }();
    return found;
#else
    return false;
#endif
}

// Whether the AVX-512 half of a kernel file exists and may run here.
inline bool has_avx512() {
#if defined(F4X_HAS_AVX512)
    static const bool found = [] {
        const unsigned wanted = bit_AVX512F | bit_AVX512VL | bit_AVX512DQ | bit_AVX512BW;
        unsigned a, b, c, d;
        if (!has_avx2() || (kept_registers() & 0xe6) != 0xe6) return false;  // masks, and registers 16 to 31
        return __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & wanted) == wanted;
    }();
    return found;
#else
    return false;
#endif
}

// Whether sixteen lanes at once are faster here than eight, on a processor with AVX-512: measured at the first call (peak.cpp).
bool wide_pays();

}  // namespace f4x
