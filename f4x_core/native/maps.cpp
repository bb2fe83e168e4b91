// Bilinear samples of a map, and the smooth map through uncertain samples; see priors/flow.py and priors/depth.py, whose plain
// forms compute the same. In doubles, without vectors: numpy and scipy write every step of it for all pixels.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#include "lanes.hpp"

// Mirrored field by field in maps.py.
struct Samples {
    int64_t count;
    int32_t width, height, channels;
    const uint16_t* halves;  // (height, width, channels) float16, or null
    const float* floats;     // the same in float32 where `halves` is null
    const double* points;    // (count, 2) pixels, centres at + 0.5
    double* values;          // (count, channels)
};

// Mirrored field by field in maps.py.
struct Smoothing {
    int32_t width, height, iterations;
    double tolerance;         // of the residual, as a fraction of the right-hand side's length
    const double* itself;     // (height, width) the matrix: of a pixel with itself,
    const double* right;      // with its neighbour to the right,
    const double* right_two;  // with the one after that,
    const double* below;
    const double* below_two;
    const double* weight;  // (height, width) added to the diagonal: precision of the samples
    const double* sample;  // (height, width)
    double* solution;      // (height, width) where it begins, and what it comes to
};

namespace {

// Finite halves alone: a flow is.
double number(uint16_t half) {
    const uint32_t bits = uint32_t(half & 0x7fff) << 13, power = 0x77800000;  // 2^112
    float value, scale;
    std::memcpy(&value, &bits, 4);
    std::memcpy(&scale, &power, 4);
    return double(half & 0x8000 ? -value * scale : value * scale);
}

double number(float value) { return double(value); }

template <class T>
void bilinear(const Samples& s, const T* image) {
    const int64_t width = s.width, height = s.height, channels = s.channels;
    for (int64_t i = 0; i < s.count; ++i) {
        const double x = std::min(std::max(s.points[2 * i] - 0.5, 0.0), double(width - 1));
        const double y = std::min(std::max(s.points[2 * i + 1] - 0.5, 0.0), double(height - 1));
        double* out = s.values + i * channels;
        if (std::isnan(x) || std::isnan(y)) {
            std::fill(out, out + channels, std::nan(""));
            continue;
        }
        const int64_t column = std::min(int64_t(x), std::max<int64_t>(width - 2, 0));
        const int64_t row = std::min(int64_t(y), std::max<int64_t>(height - 2, 0));
        const double u = x - double(column), v = y - double(row);
        const int64_t next = std::min(column + 1, width - 1), under = std::min(row + 1, height - 1);
        const T *a = image + (row * width + column) * channels, *b = image + (row * width + next) * channels;
        const T *c = image + (under * width + column) * channels, *d = image + (under * width + next) * channels;
        for (int64_t k = 0; k < channels; ++k) {
            const double top = number(a[k]) * (1 - u) + number(b[k]) * u;
            const double bottom = number(c[k]) * (1 - u) + number(d[k]) * u;
            out[k] = top * (1 - v) + bottom * v;
        }
    }
}

double dot(const std::vector<double>& a, const std::vector<double>& b) {
    double sum[4] = {0, 0, 0, 0};
    size_t i = 0;
    for (; i + 4 <= a.size(); i += 4)
        for (int k = 0; k < 4; ++k) sum[k] += a[i + k] * b[i + k];
    for (; i < a.size(); ++i) sum[0] += a[i] * b[i];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

// out = (matrix + weight) v. A link of a pixel counts for both of its ends.
void apply(const Smoothing& s, const std::vector<double>& v, std::vector<double>& out) {
    const int64_t width = s.width, height = s.height, count = width * height;
    for (int64_t i = 0; i < count; ++i) out[i] = (s.itself[i] + s.weight[i]) * v[i];
    const auto link = [&](const double* band, int64_t step, int64_t rows, int64_t columns) {
        for (int64_t row = 0; row < rows; ++row) {
            const int64_t first = row * width;
            for (int64_t i = first; i < first + columns; ++i) out[i] += band[i] * v[i + step];
            for (int64_t i = first; i < first + columns; ++i) out[i + step] += band[i] * v[i];
        }
    };
    link(s.right, 1, height, width - 1);
    link(s.right_two, 2, height, width - 2);
    link(s.below, width, height - 1, width);
    link(s.below_two, 2 * width, height - 2, width);
}

}  // namespace

F4X_API void f4x_sample_map(const Samples* s) {
    if (s->halves)
        bilinear(*s, s->halves);
    else
        bilinear(*s, s->floats);
}

// Conjugate gradients, each unknown divided by its entry on the diagonal.
F4X_API void f4x_smooth_map(const Smoothing* s) {
    const size_t count = size_t(s->width) * size_t(s->height);
    std::vector<double> x(s->solution, s->solution + count), r(count), z(count), p(count), q(count);
    apply(*s, x, q);
    double length = 0;
    for (size_t i = 0; i < count; ++i) {
        const double wanted = s->weight[i] * s->sample[i];
        r[i] = wanted - q[i];
        length += wanted * wanted;
    }
    const double enough = s->tolerance * std::sqrt(length);
    double before = 1;
    for (int32_t step = 0; step < s->iterations && !(std::sqrt(dot(r, r)) <= enough); ++step) {
        for (size_t i = 0; i < count; ++i) z[i] = r[i] / (s->itself[i] + s->weight[i]);
        const double now = dot(r, z), kept = step ? now / before : 0.0;
        for (size_t i = 0; i < count; ++i) p[i] = z[i] + (step ? kept * p[i] : 0.0);
        apply(*s, p, q);
        const double bent = dot(p, q);
        if (!(bent > 0)) break;
        const double part = now / bent;
        for (size_t i = 0; i < count; ++i) x[i] += part * p[i];
        for (size_t i = 0; i < count; ++i) r[i] -= part * q[i];
        before = now;
    }
    std::copy(x.begin(), x.end(), s->solution);
}
