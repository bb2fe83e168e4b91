// The fastest this processor multiplies and adds: what the share of the peak in benchmarks refers to, and whether sixteen lanes
// at once pay.

#ifndef F4X_ISA

#include <chrono>

#include "lanes.hpp"
#include "threads.hpp"

namespace {
struct PeakKernels {
    float (*multiply_add)(int64_t rounds);
    double operations;  // per round
};

// Fewest seconds of some short runs.
double shortest(const PeakKernels& kernels, double least) {
    constexpr int64_t ROUNDS = 1 << 11;  // microseconds
    using clock = std::chrono::steady_clock;
    const auto start = clock::now();
    volatile float sink = kernels.multiply_add(ROUNDS);  // keeps the loop
    (void)sink;
    return std::min(least, std::chrono::duration<double>(clock::now() - start).count());
}
}  // namespace

#define F4X_FILE "peak.cpp"
#define F4X_WIDE_TOO
#include "each_isa.hpp"

#if defined(F4X_HAS_AVX512)
bool f4x::wide_pays() {
#if defined(F4X_WIDE_LANES)  // given, for tests
    return has_avx512() && F4X_WIDE_LANES;
#else
    static const bool found = [] {
        if (!has_avx512()) return false;
        double narrow = 1, wide = 1;
        for (int run = 0; run < 40; ++run) {  // a fifth of a millisecond
            narrow = shortest(avx512::kernels, narrow);
            wide = shortest(avx512_wide::kernels, wide);
        }
        // A processor that does halves in turn has 1, a whole vector at once 2: noise decides nothing.
        return narrow / avx512::kernels.operations > 1.5 * wide / avx512_wide::kernels.operations;
    }();
    return found;
#endif
}
#endif

// Float operations per second of a loop of independent multiply-adds, on the calling thread, over about `seconds`.
F4X_API double f4x_peak(double seconds) {
    constexpr int64_t ROUNDS = 1 << 16;
    using clock = std::chrono::steady_clock;
    volatile float sink = 0;  // keeps the loop
    double operations = 0, elapsed = 0;
    for (const auto start = clock::now(); elapsed < seconds; operations += double(ROUNDS) * kernels().operations) {
        sink = kernels().multiply_add(ROUNDS);
        elapsed = std::chrono::duration<double>(clock::now() - start).count();
    }
    (void)sink;
    return operations / elapsed;
}

// Seconds of processor time that callers of all kernels have spent so far on work that threads can share.
F4X_API double f4x_shareable_seconds() { return 1e-9 * double(f4x::shareable_nanoseconds); }

#else  // ------------------------------------------------------------------------------- compiled once per instruction set

namespace {
namespace F4X_ISA {

#include "lanes_isa.hpp"

constexpr int CHAINS = 12;  // enough to hide the latency of a multiply-add

F4X_TARGET float multiply_add(int64_t rounds) {
    const fp factor = broadcast<fp>(0.999f), term = broadcast<fp>(0.001f);
    fp chain[CHAINS];
    F4X_UNROLL
    for (int k = 0; k < CHAINS; ++k) chain[k] = broadcast<fp>(float(k));
    for (int64_t i = 0; i < rounds; ++i)
        F4X_UNROLL
        for (int k = 0; k < CHAINS; ++k) chain[k] = chain[k] * factor + term;
    float sum = 0;
    for (int k = 0; k < CHAINS; ++k) sum += chain[k][k % 8];
    return sum;
}

const PeakKernels kernels = {multiply_add, 2.0 * CHAINS * LANES};

#undef F4X_HOT

}  // namespace F4X_ISA
}  // namespace

#endif
