// The fastest this processor multiplies and adds: what the share of the peak in benchmarks refers to.

#ifndef F4X_ISA

#include <chrono>

#include "lanes.hpp"

namespace {
struct PeakKernels {
    float (*multiply_add)(int64_t rounds);
};
}  // namespace

#define F4X_FILE "peak.cpp"
#include "each_isa.hpp"

// Float operations per second of a loop of independent multiply-adds, on the calling thread, over about `seconds`.
F4X_API double f4x_peak(double seconds) {
    constexpr int64_t ROUNDS = 1 << 16;
    using clock = std::chrono::steady_clock;
    volatile float sink = 0;  // keeps the loop
    double operations = 0, elapsed = 0;
    for (const auto start = clock::now(); elapsed < seconds; operations += double(ROUNDS) * f4x::PEAK_OPERATIONS) {
        sink = kernels().multiply_add(ROUNDS);
        elapsed = std::chrono::duration<double>(clock::now() - start).count();
    }
    (void)sink;
    return operations / elapsed;
}

#else  // ------------------------------------------------------------------------------- compiled once per instruction set

#ifndef F4X_PEAK_OPERATIONS
#define F4X_PEAK_OPERATIONS
namespace f4x {
constexpr int PEAK_CHAINS = 12;  // enough to hide the latency of a multiply-add
constexpr double PEAK_OPERATIONS = 2 * 8 * PEAK_CHAINS;
}  // namespace f4x
#endif

namespace {
namespace F4X_ISA {

#include "lanes_isa.hpp"

F4X_TARGET float multiply_add(int64_t rounds) {
    const f8 factor = broadcast(0.999f), term = broadcast(0.001f);
    f8 chain[f4x::PEAK_CHAINS];
    F4X_UNROLL
    for (int k = 0; k < f4x::PEAK_CHAINS; ++k) chain[k] = broadcast(float(k));
    for (int64_t i = 0; i < rounds; ++i)
        F4X_UNROLL
        for (int k = 0; k < f4x::PEAK_CHAINS; ++k) chain[k] = chain[k] * factor + term;
    float sum = 0;
    for (int k = 0; k < f4x::PEAK_CHAINS; ++k) sum += chain[k][k % 8];
    return sum;
}

const PeakKernels kernels = {multiply_add};

#undef F4X_HOT

}  // namespace F4X_ISA
}  // namespace

#endif
