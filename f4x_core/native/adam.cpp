// One step of Adam (Kingma and Ba 2015) on tensors, rows of which move further than others; see scaffold/adam.py.

#ifndef F4X_ISA

#include <cstdint>
#include <exception>
#include <vector>

#include "lanes.hpp"
#include "threads.hpp"

// One tensor. Mirrored field by field in adam.py.
struct Adam {
    int64_t rows;
    int32_t width;
    float rate;                 // learning rate over the bias correction of `mean`
    float root_correction;      // square root of the bias correction of `square`
    float keep_mean, keep_square;  // the betas
    float epsilon;
    const float* gradient;      // (rows, width)
    const float* reach;         // (rows,) by which a row's step is multiplied; null for 1
    const float* cap;           // (rows,) that no value of a row exceeds after the step; null for none
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

// Steps of `count` tensors. Returns 1 when memory ran out, else 0.
F4X_API int32_t f4x_adam(const Adam* const* problems, int64_t count, int32_t threads) {
    try {
        std::vector<int64_t> ends(count);  // units of GRAIN rows of the tensors up to this one
        int64_t units = 0;
        for (int64_t k = 0; k < count; ++k) ends[k] = units += (problems[k]->rows + GRAIN - 1) / GRAIN;
        parallel(threads, units, [&](std::atomic<int64_t>& cursor) {
            for (int64_t unit, k = 0; (unit = cursor++) < units;) {
                while (unit >= ends[k]) ++k;
                const Adam& p = *problems[k];
                const int64_t begin = (unit - (k ? ends[k - 1] : 0)) * GRAIN;
                kernels().step(p, begin, std::min<int64_t>(p.rows, begin + GRAIN));
            }
        });
        return 0;
    } catch (const std::exception&) {
        return 1;
    }
}

#else  // ------------------------------------------------------------------------------- compiled once per instruction set

namespace {
namespace F4X_ISA {

#include "lanes_isa.hpp"

F4X_TARGET void step(const Adam& p, int64_t begin, int64_t end) {
    constexpr int CHUNK = 64;  // rows at a time
    constexpr int WIDEST = 16;
    float rates[CHUNK * WIDEST];
    const float fresh_mean = 1 - p.keep_mean, fresh_square = 1 - p.keep_square;
    const int columns = p.width < WIDEST ? p.width : WIDEST;
    for (int i = 0; i < CHUNK * columns; ++i) rates[i] = p.rate;
    // What is wider has neither reach nor cap, and is walked as rows of fewer columns.
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
        if (p.cap)
            for (int row = 0; row < count / columns; ++row)
                for (int c = 0; c < columns; ++c)
                    value[row * columns + c] = minimum(value[row * columns + c], p.cap[first / columns + row]);
    }
}

const AdamKernels kernels = {step};

#undef F4X_HOT

}  // namespace F4X_ISA
}  // namespace

#endif
