// Semi-global matching: the plane of every pixel from the costs of all planes; see priors/sweep.py, whose plain form computes the
// same. In 16-bit integers, in loops that compilers turn into vectors.

#include <algorithm>
#include <cstdint>
#include <vector>

#include "lanes.hpp"

// Mirrored field by field in sweep.py.
struct Planes {
    int32_t width, height, planes;
    int32_t step;          // penalty of one plane more or less than the pixel before
    const int16_t* costs;  // (height, width, planes)
    const int16_t* right;  // (height, width) penalty of any other plane than at the pixel to the left,
    const int16_t* below;  // and than at the pixel above
    float* place;          // (height, width) plane of least cost, with a fraction
};

namespace {

// Costs of one pixel's planes along a path, with a wall at both ends that no minimum passes.
struct Path {
    static constexpr int16_t WALL = 16000;
    std::vector<int16_t> cost;
    int16_t least = 0;

    explicit Path(int32_t planes) : cost(size_t(planes) + 2, WALL) {}

    void start(const int16_t* costs, int16_t* sums, int32_t planes) {
        std::copy(costs, costs + planes, cost.begin() + 1);
        finish(sums, planes);
    }

    // From the pixel `before`, whose arrays are not this one's.
    void go_on(const Path& before, const int16_t* costs, int16_t step, int16_t jump, int16_t* sums, int32_t planes) {
        const int16_t* from = before.cost.data() + 1;
        int16_t* to = cost.data() + 1;
        const int16_t low = before.least, far = int16_t(low + jump);
        for (int32_t k = 0; k < planes; ++k) {
            const int16_t beside = int16_t(std::min(from[k - 1], from[k + 1]) + step);
            to[k] = int16_t(costs[k] + std::min(std::min(from[k], beside), far) - low);
        }
        finish(sums, planes);
    }

private:
    void finish(int16_t* sums, int32_t planes) {
        const int16_t* own = cost.data() + 1;
        int16_t low = own[0];
        for (int32_t k = 0; k < planes; ++k) low = std::min(low, own[k]);
        for (int32_t k = 0; k < planes; ++k) sums[k] = int16_t(sums[k] + own[k]);
        least = low;
    }
};

// Along one line of `count` pixels, `stride` apart, beginning at `first`; `jump` of a pixel is that between it and the one before
// it in the picture, so on the way back that of the pixel before.
void line(const Planes& p, const int16_t* jump, int64_t first, int64_t stride, int64_t count, bool back, Path* two, int16_t* sums) {
    const int64_t planes = p.planes;
    for (int64_t i = 0; i < count; ++i) {
        const int64_t pixel = first + (back ? count - 1 - i : i) * stride;
        const int16_t* costs = p.costs + pixel * planes;
        Path& own = two[i & 1];
        if (i == 0)
            own.start(costs, sums + pixel * planes, p.planes);
        else
            own.go_on(two[(i & 1) ^ 1], costs, int16_t(p.step), jump[back ? pixel + stride : pixel], sums + pixel * planes,
                      p.planes);
    }
}

// The least sum and where the parabola through it and its neighbours is lowest.
float lowest(const int16_t* sums, int32_t planes) {
    int32_t best = 0;
    for (int32_t k = 1; k < planes; ++k)
        if (sums[k] < sums[best]) best = k;
    if (best == 0 || best == planes - 1) return float(best);
    const float before = sums[best - 1], own = sums[best], after = sums[best + 1], bend = before - 2 * own + after;
    return bend > 0 ? float(best) + 0.5f * (before - after) / bend : float(best);
}

}  // namespace

F4X_API void f4x_best_planes(const Planes* p) {
    const int64_t width = p->width, height = p->height, planes = p->planes;
    std::vector<int16_t> sums(size_t(width * height * planes), 0);
    Path two[2] = {Path(p->planes), Path(p->planes)};
    for (const bool back : {false, true}) {
        for (int64_t row = 0; row < height; ++row) line(*p, p->right, row * width, 1, width, back, two, sums.data());
        for (int64_t column = 0; column < width; ++column) line(*p, p->below, column, width, height, back, two, sums.data());
    }
    for (int64_t i = 0; i < width * height; ++i) p->place[i] = lowest(sums.data() + i * planes, p->planes);
}
