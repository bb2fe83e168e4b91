// Gaussians composited along the ray of each pixel, as path tracers draw them: alpha is the largest response on the ray, the order
// is that of the places where it is largest, pixel by pixel. See raster/rays.py for the formulas.

#ifndef F4X_ISA

#include <cstdint>
#include <vector>

#include "lanes.hpp"
#include "threads.hpp"

// Mirrored field by field in native/rays.py. Camera axes: x right, y down, z forward, the camera at 0.
struct Rays {
    int32_t count, width, height, threads;
    float fx, fy, cx, cy, near_plane, alpha_min;
    const float* means;        // (N, 3)
    const float* whiten;       // (N, 3, 3) turns offsets from the centre into standard deviations
    const float* opacities;    // (N,)
    const float* radii;        // (N,) of the ball outside of which nothing is drawn
    const float* boxes;        // (N, 4) left, top, right, bottom in pixels
    const float* colors;       // (N, 3)
    float* image;              // (H, W, 4) colours and alpha; written by f4x_rays
    const float* d_image;      // (H, W, 4)
    float *d_whiten, *d_opacities, *d_colors;  // as the above; written by f4x_rays_backward
};

using namespace f4x;

namespace {

constexpr int SIDE = 8, PIXELS = SIDE * SIDE;
constexpr float ALPHA_MAX = 0.9999f, TRANSMITTANCE_MIN = 1e-4f;
constexpr int SLOPES = 13;  // of whiten, opacity and colour

struct Hit {
    float depth, alpha;
    int32_t entry;
};

// Which Gaussians may be seen in which tile. Pair p belongs to one Gaussian and one tile; those of a Gaussian follow one another.
struct Tiles {
    int across, down;
    std::vector<int64_t> first_pair;   // (N + 1,)
    std::vector<int64_t> first_entry;  // (tiles + 1,)
    std::vector<int32_t> gaussian;     // of an entry
    std::vector<int64_t> pair;         // of an entry
};

struct TileBox {
    int left, top, right, bottom;
};

TileBox tile_box(const Rays& r, const Tiles& tiles, int i) {
    const float* b = r.boxes + 4 * int64_t(i);
    if (!(r.opacities[i] >= r.alpha_min) || !(r.means[3 * int64_t(i) + 2] > r.near_plane) || !(b[2] >= 0 && b[3] >= 0) ||
        !(b[0] < r.width && b[1] < r.height))
        return {0, 0, 0, 0};
    const auto tile = [](float x, int end) { return std::min(end, int(std::max(0.0f, x)) / SIDE); };
    return {tile(b[0], tiles.across - 1), tile(b[1], tiles.down - 1), tile(std::min(b[2], 1e6f), tiles.across - 1) + 1,
            tile(std::min(b[3], 1e6f), tiles.down - 1) + 1};
}

Tiles bin(const Rays& r) {
    Tiles tiles{(r.width + SIDE - 1) / SIDE, (r.height + SIDE - 1) / SIDE, {}, {}, {}, {}};
    tiles.first_pair.assign(r.count + 1, 0);
    tiles.first_entry.assign(int64_t(tiles.across) * tiles.down + 1, 0);
    for (int i = 0; i < r.count; ++i) {
        const TileBox box = tile_box(r, tiles, i);
        tiles.first_pair[i + 1] = tiles.first_pair[i] + int64_t(box.right - box.left) * (box.bottom - box.top);
        for (int y = box.top; y < box.bottom; ++y)
            for (int x = box.left; x < box.right; ++x) ++tiles.first_entry[y * tiles.across + x + 1];
    }
    for (size_t k = 1; k < tiles.first_entry.size(); ++k) tiles.first_entry[k] += tiles.first_entry[k - 1];
    tiles.gaussian.resize(tiles.first_pair.back());
    tiles.pair.resize(tiles.first_pair.back());
    std::vector<int64_t> next(tiles.first_entry.begin(), tiles.first_entry.end() - 1);
    for (int i = 0; i < r.count; ++i) {
        const TileBox box = tile_box(r, tiles, i);
        int64_t pair = tiles.first_pair[i];
        for (int y = box.top; y < box.bottom; ++y)
            for (int x = box.left; x < box.right; ++x, ++pair) {
                const int64_t entry = next[y * tiles.across + x]++;
                tiles.gaussian[entry] = i;
                tiles.pair[entry] = pair;
            }
    }
    return tiles;
}

struct RayKernels {
    // Appends the hits of the pixels of a tile.
    void (*hit)(const Rays&, const Tiles&, int tile, std::vector<Hit>* hits);
};

}  // namespace

#define F4X_FILE "rays.cpp"
#include "each_isa.hpp"

namespace {

// Calls work(x, y, hits sorted front to back) for every pixel of a tile.
template <class Work>
void each_pixel(const Rays& r, const Tiles& tiles, int tile, std::vector<Hit>* hits, const Work& work) {
    for (int k = 0; k < PIXELS; ++k) hits[k].clear();
    kernels().hit(r, tiles, tile, hits);
    const int left = tile % tiles.across * SIDE, top = tile / tiles.across * SIDE;
    for (int k = 0; k < PIXELS; ++k) {
        const int x = left + k % SIDE, y = top + k / SIDE;
        if (x >= r.width || y >= r.height) continue;
        std::sort(hits[k].begin(), hits[k].end(), [](const Hit& a, const Hit& b) {
            return a.depth < b.depth || (a.depth == b.depth && a.entry < b.entry);
        });
        work(x, y, hits[k]);
    }
}

template <class Work>
void each_tile(const Rays& r, const Tiles& tiles, const Work& work) {
    parallel(r.threads, int64_t(tiles.across) * tiles.down, [&](std::atomic<int64_t>& cursor) {
        std::vector<std::vector<Hit>> hits(PIXELS);
        for (int64_t tile; (tile = cursor++) < int64_t(tiles.across) * tiles.down;) work(int(tile), hits.data());
    });
}

void composite(const Rays& r, const Tiles& tiles, int tile, std::vector<Hit>* hits) {
    each_pixel(r, tiles, tile, hits, [&](int x, int y, const std::vector<Hit>& sorted) {
        float sum[4] = {}, left = 1;
        for (const Hit& hit : sorted) {
            const float* color = r.colors + 3 * int64_t(tiles.gaussian[hit.entry]);
            const float weight = hit.alpha * left;
            for (int c = 0; c < 3; ++c) sum[c] += weight * color[c];
            sum[3] += weight;
            left *= 1 - hit.alpha;
            if (left < TRANSMITTANCE_MIN) break;
        }
        std::copy(sum, sum + 4, r.image + 4 * (int64_t(y) * r.width + x));
    });
}

// The derivatives of one hit: `by_log` is that of the loss by the logarithm of alpha. The place where the response is largest
// moves with `whiten`, but to first order the response does not change with it.
void add_shape(const Rays& r, int i, float x, float y, float by_log, float* slopes) {
    const float* w = r.whiten + 9 * int64_t(i);
    const float* m = r.means + 3 * int64_t(i);
    float from[3], along[3];
    for (int k = 0; k < 3; ++k) {
        from[k] = -(w[3 * k] * m[0] + w[3 * k + 1] * m[1] + w[3 * k + 2] * m[2]);
        along[k] = w[3 * k] * x + w[3 * k + 1] * y + w[3 * k + 2];
    }
    const float t = -(from[0] * along[0] + from[1] * along[1] + from[2] * along[2]) /
                    (along[0] * along[0] + along[1] * along[1] + along[2] * along[2]);
    const float offset[3] = {t * x - m[0], t * y - m[1], t - m[2]};
    for (int k = 0; k < 3; ++k) {
        const float place = from[k] + t * along[k];
        for (int j = 0; j < 3; ++j) slopes[3 * k + j] -= by_log * place * offset[j];
    }
    slopes[9] += by_log / r.opacities[i];
}

void differentiate(const Rays& r, const Tiles& tiles, int tile, std::vector<Hit>* hits, float* pairs) {
    each_pixel(r, tiles, tile, hits, [&](int px, int py, const std::vector<Hit>& sorted) {
        const float* g = r.d_image + 4 * (int64_t(py) * r.width + px);
        const float x = (px + 0.5f - r.cx) / r.fx, y = (py + 0.5f - r.cy) / r.fy;
        const auto value = [&](const Hit& hit) {
            const float* color = r.colors + 3 * int64_t(tiles.gaussian[hit.entry]);
            return color[0] * g[0] + color[1] * g[1] + color[2] * g[2] + g[3];
        };
        size_t end = 0;
        float left = 1, behind = 0;
        for (; end < sorted.size() && left >= TRANSMITTANCE_MIN; ++end) {
            behind += sorted[end].alpha * left * value(sorted[end]);
            left *= 1 - sorted[end].alpha;
        }
        left = 1;
        for (size_t k = 0; k < end; ++k) {
            const Hit& hit = sorted[k];
            const int i = tiles.gaussian[hit.entry];
            float* slopes = pairs + SLOPES * tiles.pair[hit.entry];
            const float weight = hit.alpha * left, own = value(hit);
            behind -= weight * own;
            for (int c = 0; c < 3; ++c) slopes[10 + c] += weight * g[c];
            const float by_alpha = left * own - behind / (1 - hit.alpha);
            if (hit.alpha < ALPHA_MAX) add_shape(r, i, x, y, by_alpha * hit.alpha, slopes);
            left *= 1 - hit.alpha;
        }
    });
}

// Sums the parts of every Gaussian in the order of its tiles: the same for every number of threads.
void gather(const Rays& r, const Tiles& tiles, const float* pairs) {
    parallel_ranges(r.threads, r.count, [&](int64_t begin, int64_t end) {
        for (int64_t i = begin; i < end; ++i) {
            double sum[SLOPES] = {};
            for (int64_t p = tiles.first_pair[i]; p < tiles.first_pair[i + 1]; ++p)
                for (int k = 0; k < SLOPES; ++k) sum[k] += pairs[SLOPES * p + k];
            std::copy(sum, sum + 9, r.d_whiten + 9 * i);
            r.d_opacities[i] = float(sum[9]);
            std::copy(sum + 10, sum + 13, r.d_colors + 3 * i);
        }
    });
}

}  // namespace

// Returns 1 when memory ran out.
F4X_API int32_t f4x_rays(const Rays* r) {
    try {
        const Tiles tiles = bin(*r);
        each_tile(*r, tiles, [&](int tile, std::vector<Hit>* hits) { composite(*r, tiles, tile, hits); });
        return 0;
    } catch (const std::exception&) {
        return 1;
    }
}

F4X_API int32_t f4x_rays_backward(const Rays* r) {
    try {
        const Tiles tiles = bin(*r);
        std::vector<float> pairs(SLOPES * tiles.first_pair.back());
        each_tile(*r, tiles, [&](int tile, std::vector<Hit>* hits) { differentiate(*r, tiles, tile, hits, pairs.data()); });
        gather(*r, tiles, pairs.data());
        return 0;
    } catch (const std::exception&) {
        return 1;
    }
}

#else  // ------------------------------------------------------------------------------- compiled once per instruction set

namespace {
namespace F4X_ISA {

#include "lanes_isa.hpp"

F4X_TARGET void hit(const Rays& r, const Tiles& tiles, int tile, std::vector<Hit>* hits) {
    const int left = tile % tiles.across * SIDE, top = tile / tiles.across * SIDE;
    const f8 lanes = {0, 1, 2, 3, 4, 5, 6, 7};
    const f8 dx = (lanes + broadcast(left + 0.5f - r.cx)) / broadcast(r.fx);
    const float log_min = std::log2(r.alpha_min), half = -0.5f * 1.44269504f;
    for (int64_t e = tiles.first_entry[tile]; e < tiles.first_entry[tile + 1]; ++e) {
        const int64_t i = tiles.gaussian[e];
        const float *w = r.whiten + 9 * i, *m = r.means + 3 * i;
        float from[3];
        for (int k = 0; k < 3; ++k) from[k] = -(w[3 * k] * m[0] + w[3 * k + 1] * m[1] + w[3 * k + 2] * m[2]);
        const float log_opacity = std::log2(r.opacities[i]), ball = r.radii[i] * r.radii[i];
        for (int row = 0; row < SIDE; ++row) {
            const float dy = (top + row + 0.5f - r.cy) / r.fy;
            f8 along[3];
            for (int k = 0; k < 3; ++k) along[k] = broadcast(w[3 * k]) * dx + broadcast(w[3 * k + 1] * dy + w[3 * k + 2]);
            const f8 square = along[0] * along[0] + along[1] * along[1] + along[2] * along[2];
            const f8 a = broadcast(from[1]) * along[2] - broadcast(from[2]) * along[1];
            const f8 b = broadcast(from[2]) * along[0] - broadcast(from[0]) * along[2];
            const f8 c = broadcast(from[0]) * along[1] - broadcast(from[1]) * along[0];
            const f8 exponent = broadcast(log_opacity) + broadcast(half) * ((a * a + b * b + c * c) / square);
            // the distance of the centre from the ray
            const f8 p = broadcast(m[1]) - broadcast(m[2] * dy), q = broadcast(m[2]) * dx - broadcast(m[0]);
            const f8 s = broadcast(m[0] * dy) - broadcast(m[1]) * dx;
            const f8 away = p * p + q * q + s * s, reach = broadcast(ball) * (dx * dx + broadcast(dy * dy + 1));
            const f8 depth = (broadcast(-from[0]) * along[0] - broadcast(from[1]) * along[1] - broadcast(from[2]) * along[2]) / square;
            uint32_t bits = mask_bits((exponent >= broadcast(log_min)) & (away <= reach) & (depth > broadcast(r.near_plane)));
            if (!bits) continue;
            const f8 alpha = minimum(exp2_fast(exponent), broadcast(ALPHA_MAX));
            for (int lane = 0; lane < SIDE; ++lane)
                if (bits >> lane & 1) hits[row * SIDE + lane].push_back({depth[lane], alpha[lane], int32_t(e)});
        }
    }
}

const RayKernels kernels = {hit};

#undef F4X_HOT

}  // namespace F4X_ISA
}  // namespace

#endif
