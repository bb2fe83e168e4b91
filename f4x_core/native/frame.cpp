// The losses of one frame that compare pixel with pixel: inverse depth with the prior's, its bends, the alpha of what moves with
// the motion score. Also what the picture loss (picture.cpp) needs of the frame. Plain forms: fit/losses.py, fit/loss_terms.py.

#ifndef F4X_ISA

#include <cfloat>
#include <cstdint>

#include "lanes.hpp"
#include "threads.hpp"

// Mirrored field by field in frame.py.
struct Frame {
    int32_t width, height, channels, threads;
    int32_t step;                        // pixels between two that a bend compares; 0 for no bends
    float moving;                        // weight of a moving pixel in the picture loss; a static one has 1
    float depth_factor, bend_factor, alpha_factor;  // weights of the three losses
    float plain, min_depth;
    const float *image, *depth, *alpha;  // (H, W, C), where channel 3 is the alpha of what moves; (H, W)
    const uint8_t* frame;                // (H, W, 3)
    const float* prior;                  // (H, W)
    const uint16_t *confidence, *motion;  // (H, W) float16
    float *target, *attention;           // (H, W, 3) and (H, W) for the picture loss, written
    float *d_image, *d_depth, *d_alpha;  // gradients; the first three channels of d_image are left as they are
};

using namespace f4x;

namespace {

// Rows of maps, each with `margin` zeros before and enough after to read whole vectors.
struct Plan {
    const Frame& p;
    int margin, pitch;
    double certain;                         // sum of the confidences of known depths, at least 1
    float *inverse, *known;                 // per pixel: inverse depth; confidence of the prior's, 0 where it has none
    float *grey, *unsure;                   // of the frame; how little is known of the background's depth
    float *down, *across;                   // gradients of the bends, by their middle pixel
    float* terms;                           // to be summed
    float* row(float* map, int y) const { return map + size_t(y) * pitch + margin; }
};

struct Sums {
    double first, second, third;
};

struct FrameKernels {
    Sums (*prepare_row)(const Plan&, int row);   // of the attention, of the confidences, of the alpha errors
    double (*bend_row)(const Plan&, int row);    // of the bends
    double (*gradient_row)(const Plan&, int row);  // of the depth errors
};

// Finite halves alone: scores and confidences are.
F4X_INLINE float number(uint16_t half) {
    const uint32_t bits = uint32_t(half & 0x7fff) << 13;
    float value;
    std::memcpy(&value, &bits, 4);
    value *= 5.192296858534828e33f;  // 2^112
    return half & 0x8000 ? -value : value;
}

}  // namespace

#define F4X_FILE "frame.cpp"
#include "each_isa.hpp"

namespace {
template <class Work>
void each_row(const Plan& plan, const Work& work) {
    parallel(plan.p.threads, plan.p.height, [&](std::atomic<int64_t>& cursor) {
        for (int64_t row; (row = cursor++) < plan.p.height;) work(int(row));
    });
}
}  // namespace

// The weighted sum of the three losses in `losses[0]`, that of the attention in `losses[1]`. Returns 1 when memory ran out.
F4X_API int32_t f4x_frame_losses(const Frame* problem, double* losses) {
    try {
        // Kept by the calling thread, so that a training loop does not fault in fresh pages at every step.
        static thread_local Buffer<float> maps;
        const Frame& p = *problem;
        const int margin = (p.step + 7) / 8 * 8, pitch = (p.width + 7) / 8 * 8 + 2 * margin;
        const size_t size = size_t(p.height) * pitch;
        float* from = maps.resize(size * 7);
        Plan plan{p, margin, pitch, 1};
        for (float** map : {&plan.inverse, &plan.known, &plan.grey, &plan.unsure, &plan.down, &plan.across, &plan.terms}) {
            *map = from;
            from += size;
        }
        std::vector<Sums> sums(p.height);  // summed in a fixed order: the same for every number of threads
        std::vector<double> bends(p.height, 0.0), depths(p.height);
        each_row(plan, [&](int row) { sums[row] = kernels().prepare_row(plan, row); });
        Sums total{};
        for (const Sums& each : sums) {
            total.first += each.first;
            total.second += each.second;
            total.third += each.third;
        }
        plan.certain = std::max(total.second, 1.0);
        if (p.step) each_row(plan, [&](int row) { bends[row] = kernels().bend_row(plan, row); });
        each_row(plan, [&](int row) { depths[row] = kernels().gradient_row(plan, row); });
        losses[0] = total.third;
        for (int row = 0; row < p.height; ++row) losses[0] += depths[row] + bends[row];
        losses[1] = total.first;
        return 0;
    } catch (const std::exception&) {
        return 1;
    }
}

#else  // ------------------------------------------------------------------------------- compiled once per instruction set

namespace {
namespace F4X_ISA {

#include "lanes_isa.hpp"

F4X_HOT float sign(float x) { return float((x > 0) - (x < 0)); }

// Sum of a row, in eight lanes.
F4X_HOT double sum_of(const float* row, int width) {
    f8 lanes = broadcast(0.0f);
    int x = 0;
    for (; x + 8 <= width; x += 8) lanes += load(row + x);
    double sum = 0;
    for (int lane = 0; lane < 8; ++lane) sum += lanes[lane];
    for (; x < width; ++x) sum += row[x];
    return sum;
}

F4X_TARGET Sums prepare_row(const Plan& plan, int row) {
    const Frame& p = plan.p;
    const int64_t first = int64_t(row) * p.width;
    const float *depth = p.depth + first, *alpha = p.alpha + first, *prior = p.prior + first;
    const uint16_t *confidence = p.confidence + first, *motion = p.motion + first;
    const uint8_t* frame = p.frame + 3 * first;
    float *inverse = plan.row(plan.inverse, row), *known = plan.row(plan.known, row), *terms = plan.row(plan.terms, row);
    float *attention = p.attention + first, *target = p.target + 3 * first;
    for (int x = 0; x < 3 * p.width; ++x) target[x] = frame[x] / 255.0f;
    float* score = plan.row(plan.across, row);  // until the bends are worked out
    for (int x = 0; x < p.width; ++x) score[x] = number(motion[x]);
    for (int x = 0; x < p.width; ++x) attention[x] = 1 + (p.moving - 1) * score[x];
    for (int x = 0; x < p.width; ++x) inverse[x] = alpha[x] / maximum(depth[x], p.min_depth);
    for (int x = 0; x < p.width; ++x) known[x] = (prior[x] > 0) & (prior[x] <= FLT_MAX) ? number(confidence[x]) : 0.0f;
    if (p.step) {
        float *grey = plan.row(plan.grey, row), *unsure = plan.row(plan.unsure, row);
        for (int x = 0; x < p.width; ++x) grey[x] = (target[3 * x] + target[3 * x + 1] + target[3 * x + 2]) / 3;
        for (int x = 0; x < p.width; ++x) unsure[x] = (1 - number(confidence[x])) * (1 - score[x]);
    }
    const float factor = p.alpha_factor / (float(p.height) * float(p.width));
    float* d_image = p.d_image + first * p.channels;
    const float* image = p.image + first * p.channels;
    const bool parted = p.channels > 3 && factor != 0;
    for (int c = parted ? 4 : 3; c < p.channels; ++c)
        for (int x = 0; x < p.width; ++x) d_image[x * p.channels + c] = 0;
    for (int x = 0; parted && x < p.width; ++x) {
        const float error = image[x * p.channels + 3] - float(score[x] > 0.5f);
        const float weight = factor * std::abs(2 * score[x] - 1);
        terms[x] = weight * std::abs(error);
        d_image[x * p.channels + 3] = weight * sign(error);
    }
    return {sum_of(attention, p.width), sum_of(known, p.width), parted ? sum_of(terms, p.width) : 0.0};
}

// How much a bend of the depth counts: where grey does not bend and nothing is known of the three depths.
F4X_HOT f8 weight_of(const float* grey, const float* unsure, int step, const f8& fall) {
    const f8 texture = load(grey - step) - broadcast(2.0f) * load(grey) + load(grey + step);
    const f8 least = minimum(minimum(load(unsure - step), load(unsure)), load(unsure + step));
    return exp2_fast(maximum(texture, broadcast(0.0f) - texture) * fall) * least;
}

// Bends along one axis, `step` floats between two pixels that are compared; their sum, lane by lane.
F4X_HOT f8 bends(const float* inverse, const float* grey, const float* unsure, int step, const f8& fall, const f8& factor,
                 f8& gradient) {
    const f8 zero = broadcast(0.0f);
    const f8 bend = load(inverse - step) - broadcast(2.0f) * load(inverse) + load(inverse + step);
    const f8 weight = weight_of(grey, unsure, step, fall) * factor;
    gradient = select(bend > zero, weight, keep_where(bend < zero, zero - weight));
    return maximum(bend, zero - bend) * weight;
}

F4X_TARGET double bend_row(const Plan& plan, int y) {
    const Frame& p = plan.p;
    const int step = p.step, down = p.height - 2 * step, across = p.width - 2 * step;
    const float *inverse = plan.row(plan.inverse, y), *grey = plan.row(plan.grey, y), *unsure = plan.row(plan.unsure, y);
    float *d_down = plan.row(plan.down, y), *d_across = plan.row(plan.across, y);
    const f8 fall = broadcast(-1.44269504088896340736f / p.plain), zero = broadcast(0.0f);
    const f8 column = f8{0, 1, 2, 3, 4, 5, 6, 7};
    std::memset(d_across - plan.margin, 0, sizeof(float) * plan.pitch);
    const bool inside = y >= step && y < p.height - step;
    f8 sum = zero, gradient;
    for (int x = 0; x < p.width; x += 8) {
        const f8 at = column + broadcast(float(x));
        if (inside) {
            const i8 there = at < broadcast(float(p.width));
            const f8 factor = broadcast(p.bend_factor / (float(down) * float(p.width)));
            sum += keep_where(there, bends(inverse + x, grey + x, unsure + x, step * plan.pitch, fall, factor, gradient));
            store(d_down + x, gradient);
        } else {
            store(d_down + x, zero);
        }
        if (across <= 0) continue;
        const i8 there = (at >= broadcast(float(step))) & (at < broadcast(float(p.width - step)));
        const f8 factor = broadcast(p.bend_factor / (float(p.height) * float(across)));
        sum += keep_where(there, bends(inverse + x, grey + x, unsure + x, step, fall, factor, gradient));
        store(d_across + x, keep_where(there, gradient));
    }
    alignas(32) float lanes[8];
    store(lanes, sum);
    return sum_of(lanes, 8);
}

F4X_TARGET double gradient_row(const Plan& plan, int y) {
    const Frame& p = plan.p;
    const int64_t first = int64_t(y) * p.width;
    const float *depth = p.depth + first, *prior = p.prior + first, *inverse = plan.row(plan.inverse, y);
    const float* known = plan.row(plan.known, y);
    float *d_depth = p.d_depth + first, *d_alpha = p.d_alpha + first, *terms = plan.row(plan.terms, y);
    const float factor = float(p.depth_factor / plan.certain);
    for (int x = 0; x < p.width; ++x) {
        const float weight = factor * known[x], error = inverse[x] - 1 / (weight > 0 ? prior[x] : 1.0f);
        terms[x] = weight * std::abs(error);
        d_alpha[x] = weight * sign(error);
    }
    if (p.step) {
        const int step = p.step, far = p.height - 1 - step;
        const float *middle = plan.row(plan.down, y), *across = plan.row(plan.across, y);
        for (int x = 0; x < p.width; ++x) d_alpha[x] += across[x - step] - 2 * across[x] + across[x + step] - 2 * middle[x];
        for (const int other : {y >= step ? y - step : -1, y <= far ? y + step : -1})
            if (other >= 0) {
                const float* bend = plan.row(plan.down, other);
                for (int x = 0; x < p.width; ++x) d_alpha[x] += bend[x];
            }
    }
    // So far d_alpha holds the gradient of the inverse depth, alpha / max(depth, min_depth).
    for (int x = 0; x < p.width; ++x) {
        const float by_alpha = d_alpha[x] / maximum(depth[x], p.min_depth);
        d_alpha[x] = by_alpha;
        d_depth[x] = depth[x] >= p.min_depth ? -by_alpha * inverse[x] : 0.0f;
    }
    return sum_of(terms, p.width);
}

const FrameKernels kernels = {prepare_row, bend_row, gradient_row};

#undef F4X_HOT

}  // namespace F4X_ISA
}  // namespace

#endif
