// Arithmetic on eight lanes, and on sixteen where those are wanted, for one instruction set: included inside the namespace F4X_ISA,
// so it has no include guard.

#define F4X_HOT F4X_TARGET static F4X_INLINE

// As many lanes as the file is compiled for.
#if defined(F4X_WIDE)
typedef f16 fp;
typedef i16 ip;
#else
typedef f8 fp;
typedef i8 ip;
#endif
constexpr int LANES = sizeof(fp) / sizeof(float);

template <class V = f8>
F4X_HOT V load(const float* from) {
    V v;
    std::memcpy(&v, from, sizeof v);
    return v;
}
template <class V>
F4X_HOT void store(float* to, const V& v) {
    std::memcpy(to, &v, sizeof v);
}
template <class V = f8, class T>
F4X_HOT V broadcast(T x) {
#if defined(__GNUC__) && !defined(F4X_PLAIN)
    return x - V{};  // -0 stays -0
#else
    return V(x);
#endif
}
template <class M, class V>
F4X_HOT V select(const M& mask, const V& yes, const V& no) {
#if defined(__GNUC__) && !defined(F4X_PLAIN)
    return mask ? yes : no;
#else
    V r;
    for (int i = 0; i < 8; ++i) r[i] = mask[i] ? yes[i] : no[i];
    return r;
#endif
}
template <class M, class V>
F4X_HOT V keep_where(const M& mask, const V& v) {
#if defined(F4X_AVX512)
    return mask ? v : V{};  // a mask register, no vector
#else
    return (V)(mask & (M)v);
#endif
}
template <class V>
F4X_HOT V minimum(const V& a, const V& b) {
    return select(a < b, a, b);
}
template <class V>
F4X_HOT V maximum(const V& a, const V& b) {
    return select(a > b, a, b);
}
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
F4X_HOT uint32_t mask_bits(const i16& mask) { return uint32_t(_mm512_movepi32_mask((__m512i)mask)); }
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

#if defined(F4X_WIDE)
F4X_HOT f16 join(const f8& low, const f8& high) {
    return (f16)_mm512_insertf32x8(_mm512_castps256_ps512((__m256)low), (__m256)high, 1);
}
F4X_HOT f8 lower(const f16& v) { return (f8)_mm512_castps512_ps256((__m512)v); }
F4X_HOT f8 upper(const f16& v) { return (f8)_mm512_extractf32x8_ps((__m512)v, 1); }
// Eight rows of eight in the lower halves become their columns, in place, and as many in the upper halves.
F4X_HOT void transpose(f16* rows) {
    const __m512i low = (__m512i)i16{0, 1, 2, 3, 16, 17, 18, 19, 8, 9, 10, 11, 24, 25, 26, 27};
    const __m512i high = (__m512i)((i16)low + 4);
    __m512 pairs[8], fours[8];
    F4X_UNROLL
    for (int i = 0; i < 8; i += 2) {
        pairs[i] = _mm512_unpacklo_ps((__m512)rows[i], (__m512)rows[i + 1]);
        pairs[i + 1] = _mm512_unpackhi_ps((__m512)rows[i], (__m512)rows[i + 1]);
    }
    F4X_UNROLL
    for (int i = 0; i < 8; i += 4) {
        fours[i] = _mm512_shuffle_ps(pairs[i], pairs[i + 2], 0x44);
        fours[i + 1] = _mm512_shuffle_ps(pairs[i], pairs[i + 2], 0xee);
        fours[i + 2] = _mm512_shuffle_ps(pairs[i + 1], pairs[i + 3], 0x44);
        fours[i + 3] = _mm512_shuffle_ps(pairs[i + 1], pairs[i + 3], 0xee);
    }
    F4X_UNROLL
    for (int i = 0; i < 4; ++i) {
        rows[i] = (f16)_mm512_permutex2var_ps(fours[i], low, fours[i + 4]);
        rows[i + 4] = (f16)_mm512_permutex2var_ps(fours[i], high, fours[i + 4]);
    }
}
// Lanes of `low` (numbers 0 to 15) and `high` (16 to 31).
F4X_HOT f16 pick(const f16& low, const i16& from, const f16& high) {
    return (f16)_mm512_permutex2var_ps((__m512)low, (__m512i)from, (__m512)high);
}
// Eight floats in both halves.
F4X_HOT f16 twice(const float* from) { return (f16)_mm512_broadcast_f32x8(_mm256_loadu_ps(from)); }
#endif

template <class V>
struct BitsOf;
template <>
struct BitsOf<f8> {
    typedef u8 type;
};
#if defined(F4X_AVX512)
template <>
struct BitsOf<f16> {
    typedef u16 type;
};
#endif

// 2^x for -126 < x < 126 (degree-5 fit, relative error below 2.5e-7); any value outside. Of N vectors step by step.
template <int N, class V>
F4X_HOT void exp2_fast(const V* x, V* y) {
    typedef typename BitsOf<V>::type U;
    const V shifter = broadcast<V>(12582912.0f);  // 1.5 * 2^23: adding it rounds to the nearest integer
    V shifted[N], f[N];
    F4X_UNROLL
    for (int k = 0; k < N; ++k) shifted[k] = x[k] + shifter;
    F4X_UNROLL
    for (int k = 0; k < N; ++k) f[k] = x[k] - (shifted[k] - shifter);  // [-0.5, 0.5]
    F4X_UNROLL
    for (int k = 0; k < N; ++k) y[k] = broadcast<V>(1.327647178e-3f) * f[k] + broadcast<V>(9.675541333e-3f);
    F4X_UNROLL
    for (int k = 0; k < N; ++k) y[k] = y[k] * f[k] + broadcast<V>(5.550713274e-2f);
    F4X_UNROLL
    for (int k = 0; k < N; ++k) y[k] = y[k] * f[k] + broadcast<V>(2.402211972e-1f);
    F4X_UNROLL
    for (int k = 0; k < N; ++k) y[k] = y[k] * f[k] + broadcast<V>(6.931469671e-1f);
    F4X_UNROLL
    for (int k = 0; k < N; ++k) y[k] = y[k] * f[k] + broadcast<V>(1.0f);
    // The integer stands in the low bits of `shifted`, below nine zeros of the shifter.
    F4X_UNROLL
    for (int k = 0; k < N; ++k) y[k] = (V)((U)y[k] + ((U)shifted[k] << broadcast<U>(23u)));
}
F4X_HOT f8 exp2_fast(const f8& x) {
    f8 y;
    exp2_fast<1>(&x, &y);
    return y;
}
