// Back-to-front order of Gaussians by the depth of their centres: stable least-significant-digit radix sort (Satish et al. 2009).
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
#include "threads.hpp"

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

constexpr int PASSES = 3, COARSE_BITS = 12;
constexpr int64_t WORTH_A_THREAD = 1 << 16;  // Gaussians that take longer to sort than a thread takes to start

struct Item {
    uint32_t key, index;
};

struct Team {
    int threads;
    int64_t count;

    // work(part, begin, end) for every part of the items; parts are in order.
    template <class Work>
    void each_part(const Work& work) const {
        parallel(threads, threads, [&](std::atomic<int64_t>& cursor) {
            for (int64_t part; (part = cursor++) < threads;)
                work(part, count * part / threads, count * (part + 1) / threads);
        });
    }
};

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

// One stable pass over the digit of `bits` bits above `shift`: put(place, item) for every item.
template <class Put>
void pass(const Team& team, const Item* from, int shift, int bits, std::vector<uint32_t>& counts, const Put& put) {
    const size_t digits = size_t(1) << bits;
    const uint32_t mask = uint32_t(digits - 1);
    counts.assign(team.threads * digits, 0);
    team.each_part([&](int64_t part, int64_t begin, int64_t end) {
        uint32_t* mine = &counts[part * digits];
        for (int64_t i = begin; i < end; ++i) ++mine[(from[i].key >> shift) & mask];
    });
    uint32_t place = 0;
    for (size_t digit = 0; digit < digits; ++digit)
        for (int part = 0; part < team.threads; ++part) {
            uint32_t& mine = counts[part * digits + digit];
            const uint32_t number = mine;
            mine = place;
            place += number;
        }
    team.each_part([&](int64_t part, int64_t begin, int64_t end) {
        uint32_t* mine = &counts[part * digits];
        for (int64_t i = begin; i < end; ++i) put(mine[(from[i].key >> shift) & mask]++, from[i]);
    });
}

// Counts keys from the nearest one on; returns how many bits they have, at least 1.
int rebase(const Team& team, Item* items) {
    uint32_t low = UINT32_MAX, high = 0;
    for (int64_t i = 0; i < team.count; ++i) {
        low = std::min(low, items[i].key);
        high = std::max(high, items[i].key);
    }
    for (int64_t i = 0; i < team.count; ++i) items[i].key -= low;
    int bits = 1;
    while (bits < 32 && (high - low) >> bits) ++bits;
    return bits;
}

int64_t sort(const DepthOrder& d) {
    // Kept by the calling thread: fresh pages cost more than the sort.
    static thread_local Buffer<Item> first, second;
    const int64_t wanted = std::min<int64_t>(d.threads, 1 + d.count / WORTH_A_THREAD);
    Team team{int(std::max<int64_t>(1, wanted)), d.count};
    Item *items = first.resize(d.count), *other = second.resize(d.count);
    team.count = collect(d, team, items);
    if (!team.count) return 0;
    std::vector<uint32_t> counts;
    const int bits = rebase(team, items), last = int(team.count - 1);
    const auto finish = [&](uint32_t place, const Item& item) { d.order[last - place] = float(item.index); };
    if (d.coarse) {
        pass(team, items, std::max(0, bits - COARSE_BITS), COARSE_BITS, counts, finish);
        return team.count;
    }
    const int digit = (bits + PASSES - 1) / PASSES;
    for (int turn = 0; turn < PASSES - 1; ++turn) {
        pass(team, items, turn * digit, digit, counts, [&](uint32_t place, const Item& item) { other[place] = item; });
        std::swap(items, other);
    }
    pass(team, items, (PASSES - 1) * digit, digit, counts, finish);
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
