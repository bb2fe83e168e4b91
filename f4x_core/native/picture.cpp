// The picture loss and its gradient to the picture: the weighted sum over pixels of the L1 over channels and of 1 - SSIM
// (structural similarity, Wang et al. 2004). Gaussian window of 11 pixels, zero padding, as in fit/losses.py.

#ifndef F4X_ISA

#include <cstdint>

#include "lanes.hpp"
#include "threads.hpp"

// Mirrored field by field in picture.py.
struct Picture {
    int32_t width, height, channels, threads;
    int64_t stride;                 // floats between two pixels of the picture
    const float *image, *target;    // (H, W, stride) of which the first C are read, (H, W, C)
    const float* weight;            // (H, W)
    const float* window;            // (11,)
    float c1, c2;
    float structure;                // weight of 1 - SSIM (mean over channels) beside the L1
    float factor;                   // of the gradient
    int64_t gradient_stride;        // floats between two pixels of the gradient
    float* gradient;                // (H, W, gradient_stride) of which the first C are written; may be null
};

using namespace f4x;

namespace {

constexpr int HALF = 5, MAPS = 4, SLOPES = 3;

// Rows are planar, one after another per channel, with HALF zeros before and enough after to read whole vectors.
struct Plan {
    const Picture& p;
    int pitch;       // floats of a row
    float* across;   // rows of MAPS maps blurred across
    float* slopes;   // rows of SLOPES derivatives, also blurred across
};

struct PictureKernels {
    double (*apart_row)(Plan&, int y, float* scratch);
    void (*blur_row)(Plan&, int row, float* scratch);
    double (*compare_row)(Plan&, int row, float* scratch);
    void (*gradient_row)(Plan&, int row, float* scratch);
};

}  // namespace

#define F4X_FILE "picture.cpp"
#define F4X_WIDE_TOO
#include "each_isa.hpp"

namespace {
template <class Work>
void each_row(const Plan& plan, int rows, const Work& work) {
    parallel(plan.p.threads, rows, [&](std::atomic<int64_t>& cursor) {
        Buffer<float> scratch;
        scratch.resize(size_t(MAPS) * plan.pitch);
        for (int64_t row; (row = cursor++) < rows;) work(int(row), scratch);
    });
}
}  // namespace

// The loss in `*total`. Returns 1 when memory ran out.
F4X_API int32_t f4x_picture_loss(const Picture* problem, double* total) {
    try {
        // Kept by the calling thread, so that a training loop does not fault in fresh pages at every step.
        static thread_local Buffer<float> across, slopes;
        const int height = problem->height, rows = height * problem->channels, pitch = (problem->width + 15) / 16 * 16 + 16;
        across.resize(size_t(rows) * MAPS * pitch);
        if (problem->gradient) slopes.resize(size_t(rows) * SLOPES * pitch);
        Plan plan{*problem, pitch, across, slopes};
        std::vector<double> apart(height), unlike(rows);  // summed in a fixed order: the same for every number of threads
        each_row(plan, height, [&](int y, float* scratch) { apart[y] = kernels().apart_row(plan, y, scratch); });
        each_row(plan, rows, [&](int row, float* scratch) { kernels().blur_row(plan, row, scratch); });
        each_row(plan, rows, [&](int row, float* scratch) { unlike[row] = kernels().compare_row(plan, row, scratch); });
        if (plan.p.gradient)
            each_row(plan, rows, [&](int row, float* scratch) { kernels().gradient_row(plan, row, scratch); });
        *total = 0;
        for (const double each : unlike) *total += each;
        *total *= double(problem->structure) / problem->channels;
        for (const double each : apart) *total += each;
        return 0;
    } catch (const std::exception&) {
        return 1;
    }
}

#else  // ------------------------------------------------------------------------------- compiled once per instruction set

namespace {
namespace F4X_ISA {

#include "lanes_isa.hpp"

// A sum over a row's pixels as sixteen lanes, so that eight at a time round as sixteen do.
struct RowSum {
    static constexpr int PARTS = 16 / LANES;
    fp part[PARTS] = {};
    F4X_TARGET fp& at(int x) { return part[x / LANES % PARTS]; }
    F4X_TARGET double all() const {
        double sum = 0;
        for (int lane = 0; lane < 16; ++lane) sum += part[lane / LANES][lane % LANES];
        return sum;
    }
};

// out[x] = sum_k window[k] in[x + k] for a padded row.
F4X_HOT void blur_across(const float* window, const float* in, float* out, int width) {
    for (int x = 0; x < width; x += LANES) {
        fp sum = broadcast<fp>(window[0]) * load<fp>(in + x);
        F4X_UNROLL
        for (int k = 1; k <= 2 * HALF; ++k) sum += broadcast<fp>(window[k]) * load<fp>(in + x + k);
        store(out + x, sum);
    }
}

// LANES pixels from `x` on of N maps blurred down, for the row of `channel` at `y`. All maps step by step: one map's chain of
// dependent additions is too long for a processor to look past.
template <int N>
F4X_HOT void blur_down(const float* window, const float* maps, int pitch, int channel, int y, int height, int x, fp* out) {
    const int first = std::max(0, HALF - y), last = std::min(2 * HALF, height - 1 + HALF - y);
    const float* row = maps + size_t(channel * height + y + first - HALF) * N * pitch + x;
    F4X_UNROLL
    for (int m = 0; m < N; ++m) out[m] = broadcast<fp>(0.0f);
    for (int k = first; k <= last; ++k, row += size_t(N) * pitch) {
        const fp share = broadcast<fp>(window[k]);
        F4X_UNROLL
        for (int m = 0; m < N; ++m) out[m] += share * load<fp>(row + m * pitch);
    }
}

// Weighted L1 over channels of a row of pixels; writes its gradient. CHANNELS = 0 for any number.
template <int CHANNELS>
F4X_HOT void apart(const Picture& p, int y, float* terms) {
    const int channels = CHANNELS ? CHANNELS : p.channels;
    const float* image = p.image + int64_t(y) * p.width * p.stride;
    const float* target = p.target + int64_t(y) * p.width * p.channels;
    const float* weight = p.weight + int64_t(y) * p.width;
    float* out = p.gradient ? p.gradient + int64_t(y) * p.width * p.gradient_stride : nullptr;
    const int64_t stride = p.stride, out_stride = p.gradient_stride;
    const int width = p.width;
    const float factor = p.factor;
    for (int x = 0; x < width; ++x) {
        const float by = factor * weight[x];
        float sum = 0;
        for (int c = 0; c < channels; ++c) {
            const float difference = image[x * stride + c] - target[x * channels + c];
            sum += std::abs(difference);
            if (out) out[x * out_stride + c] = by * float((difference > 0) - (difference < 0));  // without a branch
        }
        terms[x] = weight[x] * sum;
    }
}

F4X_TARGET double apart_row(Plan& plan, int y, float* scratch) {
    const Picture& p = plan.p;
    p.channels == 3 ? apart<3>(p, y, scratch) : apart<0>(p, y, scratch);
    std::fill(scratch + p.width, scratch + (p.width + LANES - 1) / LANES * LANES, 0.0f);
    RowSum total;
    for (int x = 0; x < p.width; x += LANES) total.at(x) += load<fp>(scratch + x);
    return total.all();
}

// Blurs the row's maps across.
F4X_TARGET void blur_row(Plan& plan, int row, float* scratch) {
    const Picture& p = plan.p;
    const int channel = row / p.height, y = row % p.height, pitch = plan.pitch;
    std::memset(scratch, 0, sizeof(float) * MAPS * pitch);
    const float* image = p.image + int64_t(y) * p.width * p.stride + channel;
    const float* target = p.target + int64_t(y) * p.width * p.channels + channel;
    float *a = scratch + HALF, *b = a + pitch, *squares = b + pitch, *product = squares + pitch;
    for (int x = 0; x < p.width; ++x) {
        a[x] = image[x * p.stride];
        b[x] = target[x * p.channels];
    }
    for (int x = 0; x < p.width; ++x) {
        squares[x] = a[x] * a[x] + b[x] * b[x];
        product[x] = a[x] * b[x];
    }
    float* out = plan.across + size_t(row) * MAPS * pitch;
    for (int map = 0; map < MAPS; ++map) blur_across(p.window, scratch + map * pitch, out + map * pitch, p.width);
}

// Compares the row's blurred maps and blurs the slopes across; returns its weighted 1 - SSIM.
F4X_TARGET double compare_row(Plan& plan, int row, float* scratch) {
    const Picture& p = plan.p;
    const int channel = row / p.height, y = row % p.height, pitch = plan.pitch;
    const fp one = broadcast<fp>(1.0f), two = broadcast<fp>(2.0f), c1 = broadcast<fp>(p.c1), c2 = broadcast<fp>(p.c2);
    std::memset(scratch, 0, sizeof(float) * MAPS * pitch);
    alignas(64) float weight[LANES] = {};
    RowSum total;
    for (int x = 0; x < p.width; x += LANES) {
        fp map[MAPS];
        blur_down<MAPS>(p.window, plan.across, pitch, channel, y, p.height, x, map);
        const fp mean_a = map[0], mean_b = map[1], means = mean_a * mean_a + mean_b * mean_b;
        const fp b1 = means + c1, b2 = map[2] - means + c2;
        const fp luminance = (two * mean_a * mean_b + c1) / b1;
        const fp structure = (two * (map[3] - mean_a * mean_b) + c2) / b2;
        const float* from = p.weight + int64_t(y) * p.width + x;
        for (int lane = 0; x + LANES > p.width && lane < LANES; ++lane) weight[lane] = x + lane < p.width ? from[lane] : 0;
        const fp w = load<fp>(x + LANES > p.width ? weight : from);
        total.at(x) += w * (one - luminance * structure);
        if (!p.gradient) continue;
        // Derivatives of -w SSIM by the blurred picture, the blurred squares and the blurred product.
        const fp by_product = two * luminance / b2, by_squares = luminance * structure / b2;
        const fp by_mean = structure * two * (mean_b - luminance * mean_a) / b1 + two * mean_a * by_squares - mean_b * by_product;
        const fp minus = broadcast<fp>(0.0f) - w;
        store(scratch + HALF + x, minus * by_mean);
        store(scratch + pitch + HALF + x, w * by_squares);
        store(scratch + 2 * pitch + HALF + x, minus * by_product);
    }
    if (p.gradient) {
        float* out = plan.slopes + size_t(row) * SLOPES * pitch;
        for (int m = 0; m < SLOPES; ++m) blur_across(p.window, scratch + m * pitch, out + m * pitch, p.width);
    }
    return total.all();
}

// Adds the gradient of 1 - SSIM to that of the L1.
F4X_TARGET void gradient_row(Plan& plan, int row, float* scratch) {
    const Picture& p = plan.p;
    const int channel = row / p.height, y = row % p.height, pitch = plan.pitch;
    for (int x = 0; x < p.width; x += LANES) {
        fp slope[SLOPES];
        blur_down<SLOPES>(p.window, plan.slopes, pitch, channel, y, p.height, x, slope);
        for (int m = 0; m < SLOPES; ++m) store(scratch + m * pitch + x, slope[m]);
    }
    const float* image = p.image + int64_t(y) * p.width * p.stride + channel;
    const float* target = p.target + int64_t(y) * p.width * p.channels + channel;
    float* out = p.gradient + int64_t(y) * p.width * p.gradient_stride + channel;
    const float share = p.factor * p.structure / p.channels;
    for (int x = 0; x < p.width; ++x) {
        const float a = image[x * p.stride], b = target[x * p.channels];
        out[x * p.gradient_stride] += share * (scratch[x] + 2 * a * scratch[pitch + x] + b * scratch[2 * pitch + x]);
    }
}

const PictureKernels kernels = {apart_row, blur_row, compare_row, gradient_row};

#undef F4X_HOT

}  // namespace F4X_ISA
}  // namespace

#endif
