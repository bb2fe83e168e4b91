// Back-to-front order of Gaussians by the depth of their centres.
//
// The depth of centre x of a cloud is row . (x, 1). What is transparent or outside (near_plane, far_plane) is left out. The bits
// of depths sort like the numbers because they are positive. Exact order takes three passes over as many bits as nearest and
// farthest differ in; coarse order takes one pass over the highest COARSE_BITS of these. Equal keys keep the order of the
// compositing rule: seen from the front, the smaller index comes first. The result is the same for every number of threads.

#include <cmath>
#include <cstdint>
#include <cstring>
#include <exception>
#include <vector>

#include "lanes.hpp"
#include "radix.hpp"

// Mirrored field by field in scene/depth_order.py.
struct DepthOrder {
    int64_t count, clouds;
    int32_t threads, coarse;
    float near_plane, far_plane, alpha_min;
    const int64_t* starts;    // (clouds + 1,) first Gaussian of every cloud, then N
    const float* rows;        // (clouds, 4) of the matrix that gives depth
    const float* means;       // (N, 3)
    const float* opacities;   // (N,)
    float* order;             // (N,) indices, the farthest first; whole numbers, because textures hold floats
};

using namespace f4x;

namespace {

constexpr int COARSE_BITS = 12;

// The depths of the Gaussians that are seen, as (bits, index) in `items`; returns their number.
int64_t collect(const DepthOrder& d, const Team& team, Item* items) {
    std::vector<int64_t> found(team.threads);
    team.each_part([&](int64_t part, int64_t begin, int64_t end) {
        Item* out = items + begin;
        for (int64_t cloud = 0; cloud < d.clouds; ++cloud) {
            const float* row = d.rows + 4 * cloud;
            const float a = row[0], b = row[1], c = row[2], t = row[3];
            const int64_t last = std::min(end, d.starts[cloud + 1]);
            for (int64_t i = std::max(begin, d.starts[cloud]); i < last; ++i) {
                const float* x = d.means + 3 * i;
                const float z = a * x[0] + b * x[1] + c * x[2] + t;
                std::memcpy(&out->key, &z, sizeof z);
                out->index = uint32_t(i);
                // a NaN fails every comparison
                out += (z > d.near_plane) & (z < d.far_plane) & (d.opacities[i] >= d.alpha_min);
            }
        }
        found[part] = out - (items + begin);
    });
    int64_t total = found[0];
    for (int64_t part = 1; part < team.threads; ++part) {
        std::memmove(items + total, items + team.count * part / team.threads, found[part] * sizeof(Item));
        total += found[part];
    }
    return total;
}

int64_t sort(const DepthOrder& d) {
    // Kept by the calling thread: fresh pages cost more than the sort.
    static thread_local Buffer<Item> first, second;
    Team team = Team::of(d.threads, d.count);
    Item* items = first.resize(d.count);
    team.count = collect(d, team, items);
    const auto finish = [&](uint32_t place, const Item& item) { d.order[team.count - 1 - place] = float(item.index); };
    if (d.coarse) {
        const KeyRange range = KeyRange::of(team, items);
        radix_pass(team, items, range.low, std::max(0, range.bits - COARSE_BITS), COARSE_BITS, finish);
    } else {
        radix_sort(team, items, second.resize(d.count), finish);
    }
    return team.count;
}

}  // namespace

// Returns how many Gaussians are in the order, -1 when memory ran out.
F4X_API int64_t f4x_depth_order(const DepthOrder* d) {
    try {
        return sort(*d);
    } catch (const std::exception&) {
        return -1;
    }
}
