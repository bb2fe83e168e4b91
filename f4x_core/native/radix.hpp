// Sorting by whole numbers on several threads: stable least-significant-digit radix sort (Satish et al. 2009). The result is the
// same for every number of threads.

#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "threads.hpp"

namespace f4x {

constexpr int RADIX_PASSES = 3;
constexpr int64_t WORTH_A_THREAD = 1 << 14;  // items that take longer to sort than a thread takes to wake

struct Item {
    uint32_t key, index;
};

// `count` items cut into one part for each thread.
struct Team {
    int threads;
    int64_t count;

    // As many of `threads` as there is work for.
    static Team of(int threads, int64_t count) {
        return {int(std::max<int64_t>(1, std::min<int64_t>(threads, 1 + count / WORTH_A_THREAD))), count};
    }

    // work(part, begin, end) for every part of the items; parts are in order.
    template <class Work>
    void each_part(const Work& work) const {
        parallel(threads, threads, [&](std::atomic<int64_t>& cursor) {
            for (int64_t part; (part = cursor++) < threads;)
                work(part, count * part / threads, count * (part + 1) / threads);
        });
    }
};

// Counts of a part for each of `bins` -> where that part writes its first item of the bin; bin_start (bins + 1,) may be null.
inline void start_places(std::vector<uint32_t>& counts, int parts, size_t bins, int64_t* bin_start = nullptr) {
    uint32_t place = 0;
    for (size_t bin = 0; bin < bins; ++bin) {
        if (bin_start) bin_start[bin] = place;
        for (int part = 0; part < parts; ++part) place += std::exchange(counts[part * bins + bin], place);
    }
    if (bin_start) bin_start[bins] = place;
}

// The range of keys: the lowest, and how many bits the rest above it takes, at least 1.
struct KeyRange {
    uint32_t low;
    int bits;

    static KeyRange of(const Team& team, const Item* items) {
        std::vector<uint32_t> lows(team.threads, UINT32_MAX), highs(team.threads, 0);
        team.each_part([&](int64_t part, int64_t begin, int64_t end) {
            uint32_t low = UINT32_MAX, high = 0;
            for (int64_t i = begin; i < end; ++i) {
                low = std::min(low, items[i].key);
                high = std::max(high, items[i].key);
            }
            lows[part] = low;
            highs[part] = high;
        });
        const uint32_t low = *std::min_element(lows.begin(), lows.end());
        const uint32_t high = *std::max_element(highs.begin(), highs.end());
        int bits = 1;
        while (bits < 32 && low <= high && (high - low) >> bits) ++bits;
        return {low, bits};
    }
};

// One stable pass over the digit of `bits` bits above `shift`, of keys counted from `low`: put(place, item) for every item.
template <class Put>
void radix_pass(const Team& team, const Item* items, uint32_t low, int shift, int bits, const Put& put) {
    const size_t digits = size_t(1) << bits;
    const auto digit = [=](const Item& item) { return (item.key - low) >> shift & uint32_t(digits - 1); };
    std::vector<uint32_t> counts(team.threads * digits);
    team.each_part([&](int64_t part, int64_t begin, int64_t end) {
        uint32_t* mine = &counts[part * digits];
        for (int64_t i = begin; i < end; ++i) ++mine[digit(items[i])];
    });
    start_places(counts, team.threads, digits);
    team.each_part([&](int64_t part, int64_t begin, int64_t end) {
        uint32_t* mine = &counts[part * digits];
        for (int64_t i = begin; i < end; ++i) put(mine[digit(items[i])]++, items[i]);
    });
}

// put(rank, item) for every item, the lowest key at rank 0; equal keys keep their order. `other` is as long as `items`, and
// both are overwritten.
template <class Put>
void radix_sort(const Team& team, Item* items, Item* other, const Put& put) {
    const KeyRange range = KeyRange::of(team, items);
    const int digit = (range.bits + RADIX_PASSES - 1) / RADIX_PASSES;
    for (int turn = 0; turn < RADIX_PASSES - 1; ++turn) {
        radix_pass(team, items, range.low, turn * digit, digit, [&](uint32_t at, const Item& item) { other[at] = item; });
        std::swap(items, other);
    }
    radix_pass(team, items, range.low, (RADIX_PASSES - 1) * digit, digit, put);
}

}  // namespace f4x
