// Compiles the second half of F4X_FILE once per instruction set, into the namespaces `plain`, `avx2`, `avx512` and, where the file
// asks for it by F4X_WIDE_TOO, `avx512_wide`, each with its own constant `kernels`; kernels() is the one for this processor.
// Included once per kernel file, so it has no include guard.

#define F4X_ISA plain
#define F4X_TARGET
#include F4X_FILE
#undef F4X_ISA
#undef F4X_TARGET
#if defined(F4X_HAS_AVX2)
#define F4X_ISA avx2
#define F4X_AVX2 1
#define F4X_TARGET __attribute__((target("avx2,fma")))
#include F4X_FILE
#undef F4X_ISA
#undef F4X_TARGET
#endif
#if defined(F4X_HAS_AVX512)
#define F4X_ISA avx512
#define F4X_AVX512 1
#define F4X_TARGET __attribute__((target("avx2,fma,avx512f,avx512vl,avx512dq,avx512bw" F4X_NARROW)))
#include F4X_FILE
#undef F4X_ISA
#if defined(F4X_WIDE_TOO)
#define F4X_ISA avx512_wide
#define F4X_WIDE 1
#include F4X_FILE
#undef F4X_ISA
#undef F4X_WIDE
#endif
#undef F4X_AVX512
#undef F4X_TARGET
#endif
#undef F4X_AVX2

namespace {
inline const decltype(plain::kernels)& kernels() {
#if defined(F4X_HAS_AVX512)
#if defined(F4X_WIDE_TOO)
    if (f4x::wide_pays()) return avx512_wide::kernels;
#endif
    if (f4x::has_avx512()) return avx512::kernels;
#endif
#if defined(F4X_HAS_AVX2)
    if (f4x::has_avx2()) return avx2::kernels;
#endif
    return plain::kernels;
}
}  // namespace
