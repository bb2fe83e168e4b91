// What density control keeps of a step: how strongly the loss pulls at each Gaussian in the picture; see gaussians/density.py.

#include <cmath>
#include <cstdint>

#include "lanes.hpp"
#include "threads.hpp"

// Mirrored field by field in density.py.
struct Pulls {
    int64_t count;
    int32_t threads;
    float across, down;        // pixels of half a picture
    const float* gradient;     // (N, 2) of the loss by the projected means, per pixel
    const uint8_t* visible;    // (N,)
    float *gradient_sum, *seen;  // (N,), added to
};

F4X_API void f4x_record_pulls(const Pulls* problem) {
    const Pulls& p = *problem;
    f4x::parallel_ranges(p.threads, p.count, [&](int64_t begin, int64_t end) {
        for (int64_t i = begin; i < end; ++i) {
            const float x = p.gradient[2 * i] * p.across, y = p.gradient[2 * i + 1] * p.down;
            p.gradient_sum[i] += std::sqrt(x * x + y * y);
            p.seen[i] += float(p.visible[i]);
        }
    });
}
