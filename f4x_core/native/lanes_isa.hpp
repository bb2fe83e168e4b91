// Arithmetic on eight lanes for one instruction set: included inside the namespace F4X_ISA, so it has no include guard.

#define F4X_HOT F4X_TARGET static F4X_INLINE

F4X_HOT f8 load(const float* from) {
    f8 v;
    std::memcpy(&v, from, sizeof v);
    return v;
}
F4X_HOT void store(float* to, const f8& v) { std::memcpy(to, &v, sizeof v); }
F4X_HOT f8 broadcast(float x) { return f8{x, x, x, x, x, x, x, x}; }
#if defined(F4X_AVX512)
F4X_HOT f8 keep_where(const i8& mask, const f8& v) { return mask ? v : f8{}; }  // a mask register, no vector
#else
F4X_HOT f8 keep_where(const i8& mask, const f8& v) { return (f8)(mask & (i8)v); }
#endif
F4X_HOT f8 select(const i8& mask, const f8& yes, const f8& no) {
#if defined(__GNUC__) && !defined(F4X_PLAIN)
    return mask ? yes : no;
#else
    f8 r;
    for (int i = 0; i < 8; ++i) r[i] = mask[i] ? yes[i] : no[i];
    return r;
#endif
}
F4X_HOT f8 minimum(const f8& a, const f8& b) { return select(a < b, a, b); }
F4X_HOT f8 maximum(const f8& a, const f8& b) { return select(a > b, a, b); }
F4X_HOT float minimum(float a, float b) { return a < b ? a : b; }
F4X_HOT float maximum(float a, float b) { return a > b ? a : b; }
F4X_HOT float root(float x) { return std::sqrt(x); }

// Eight rows of eight become their columns, in place.
F4X_HOT void transpose(f8* rows) {
#if defined(F4X_AVX2)
    __m256 pairs[8], fours[8];
    F4X_UNROLL
    for (int i = 0; i < 8; i += 2) {
        pairs[i] = _mm256_unpacklo_ps((__m256)rows[i], (__m256)rows[i + 1]);
        pairs[i + 1] = _mm256_unpackhi_ps((__m256)rows[i], (__m256)rows[i + 1]);
    }
    F4X_UNROLL
    for (int i = 0; i < 8; i += 4) {
        fours[i] = _mm256_shuffle_ps(pairs[i], pairs[i + 2], 0x44);
        fours[i + 1] = _mm256_shuffle_ps(pairs[i], pairs[i + 2], 0xee);
        fours[i + 2] = _mm256_shuffle_ps(pairs[i + 1], pairs[i + 3], 0x44);
        fours[i + 3] = _mm256_shuffle_ps(pairs[i + 1], pairs[i + 3], 0xee);
    }
    F4X_UNROLL
    for (int i = 0; i < 4; ++i) {
        rows[i] = (f8)_mm256_permute2f128_ps(fours[i], fours[i + 4], 0x20);
        rows[i + 4] = (f8)_mm256_permute2f128_ps(fours[i], fours[i + 4], 0x31);
    }
#else
    for (int i = 0; i < 8; ++i)
        for (int j = 0; j < i; ++j) {
            const float swapped = rows[i][j];
            rows[i][j] = rows[j][i];
            rows[j][i] = swapped;
        }
#endif
}

#if defined(F4X_AVX2)
F4X_HOT f8 root(const f8& x) { return (f8)_mm256_sqrt_ps((__m256)x); }
#if defined(F4X_AVX512)
F4X_HOT uint32_t mask_bits(const i8& mask) { return uint32_t(_mm256_movepi32_mask((__m256i)mask)); }
#else
F4X_HOT uint32_t mask_bits(const i8& mask) { return uint32_t(_mm256_movemask_ps((__m256)mask)); }
#endif
#else
F4X_HOT f8 root(const f8& x) {
    f8 r;
    for (int i = 0; i < 8; ++i) r[i] = std::sqrt(x[i]);
    return r;
}
F4X_HOT uint32_t mask_bits(const i8& mask) {
    const i8 bits = mask & i8{1, 2, 4, 8, 16, 32, 64, 128};
    return uint32_t(bits[0] + bits[1] + bits[2] + bits[3] + bits[4] + bits[5] + bits[6] + bits[7]);
}
#endif

// 2^x for -126 < x < 126 (degree-5 fit, relative error below 2.5e-7); any value outside. Of N vectors step by step.
template <int N>
F4X_HOT void exp2_fast(const f8* x, f8* y) {
    const f8 shifter = broadcast(12582912.0f);  // 1.5 * 2^23: adding it rounds to the nearest integer
    f8 shifted[N], f[N];
    F4X_UNROLL
    for (int k = 0; k < N; ++k) shifted[k] = x[k] + shifter;
    F4X_UNROLL
    for (int k = 0; k < N; ++k) f[k] = x[k] - (shifted[k] - shifter);  // [-0.5, 0.5]
    F4X_UNROLL
    for (int k = 0; k < N; ++k) y[k] = broadcast(1.327647178e-3f) * f[k] + broadcast(9.675541333e-3f);
    F4X_UNROLL
    for (int k = 0; k < N; ++k) y[k] = y[k] * f[k] + broadcast(5.550713274e-2f);
    F4X_UNROLL
    for (int k = 0; k < N; ++k) y[k] = y[k] * f[k] + broadcast(2.402211972e-1f);
    F4X_UNROLL
    for (int k = 0; k < N; ++k) y[k] = y[k] * f[k] + broadcast(6.931469671e-1f);
    F4X_UNROLL
    for (int k = 0; k < N; ++k) y[k] = y[k] * f[k] + broadcast(1.0f);
    // The integer stands in the low bits of `shifted`, below nine zeros of the shifter.
    F4X_UNROLL
    for (int k = 0; k < N; ++k) y[k] = (f8)((u8)y[k] + ((u8)shifted[k] << u8{23, 23, 23, 23, 23, 23, 23, 23}));
}
F4X_HOT f8 exp2_fast(const f8& x) {
    f8 y;
    exp2_fast<1>(&x, &y);
    return y;
}
