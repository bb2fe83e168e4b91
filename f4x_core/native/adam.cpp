// One step of Adam (Kingma and Ba 2015) on one tensor, rows of it moving further than others; see gaussians/optimiser.py.

#ifndef F4X_ISA

#include <cstdint>

#include "lanes.hpp"
#include "threads.hpp"

// Mirrored field by field in adam.py.
struct Adam {
    int64_t rows;
    int32_t width, threads;
    float rate;                 // learning rate over the bias correction of `mean`
    float root_correction;      // square root of the bias correction of `square`
    float keep_mean, keep_square;  // the betas
    float epsilon;
    const float* gradient;      // (rows, width)
    const float* reach;         // (rows,) by which a row's step is multiplied; null for 1
    float *mean, *square;       // (rows, width) the moments, changed
    float* value;               // (rows, width) changed
};

using namespace f4x;

namespace {
struct AdamKernels {
    void (*step)(const Adam&, int64_t begin, int64_t end);
};
}  // namespace

#define F4X_FILE "adam.cpp"
#include "each_isa.hpp"

F4X_API void f4x_adam(const Adam* problem) {
    const Adam& p = *problem;
    parallel_ranges(p.threads, p.rows, [&](int64_t begin, int64_t end) { kernels().step(p, begin, end); });
}

#else  // ------------------------------------------------------------------------------- compiled once per instruction set

namespace {
namespace F4X_ISA {

F4X_TARGET void step(const Adam& p, int64_t begin, int64_t end) {
    constexpr int CHUNK = 64;  // rows at a time
    constexpr int WIDEST = 16;
    float rates[CHUNK * WIDEST];
    const float fresh_mean = 1 - p.keep_mean, fresh_square = 1 - p.keep_square;
    const int columns = p.width < WIDEST ? p.width : WIDEST;
    for (int i = 0; i < CHUNK * columns; ++i) rates[i] = p.rate;
    // What is wider has no reach, and is walked as rows of fewer columns.
    const int64_t from = begin * p.width, to = end * p.width;
    for (int64_t first = from; first < to; first += CHUNK * columns) {
        const int count = int(std::min<int64_t>(CHUNK * columns, to - first));
        if (p.reach)
            for (int row = 0; row < count / columns; ++row)
                for (int c = 0; c < columns; ++c) rates[row * columns + c] = p.rate * p.reach[first / columns + row];
        const float* gradient = p.gradient + first;
        float *mean = p.mean + first, *square = p.square + first, *value = p.value + first;
        for (int i = 0; i < count; ++i) {
            const float g = gradient[i];
            mean[i] = p.keep_mean * mean[i] + fresh_mean * g;
            square[i] = p.keep_square * square[i] + fresh_square * g * g;
            value[i] -= rates[i] * mean[i] / (std::sqrt(square[i]) / p.root_correction + p.epsilon);
        }
    }
}

const AdamKernels kernels = {step};

}  // namespace F4X_ISA
}  // namespace

#endif
