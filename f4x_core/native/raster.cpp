// Feature4X rasteriser, CPU: EWA projection, tile lists and front-to-back compositing of any number of channels, with a
// hand-written backward pass. Float32, C++17, plain C functions at the end; no Python, no OpenMP.
//
//   project       one Splat per Gaussian                                          (parallel over Gaussians)
//   bind          depth order, exact ellipse/tile lists in that order             (radix and counting sort, parallel)
//   forward_tile  16x16 pixels: chunks of splats are binned to blocks of 4x2 pixels, 4x4 where vectors are wide; per block
//                 first the weights w = alpha T of all its splats (one pixel a lane), then the channels are blended with them
//   backward_tile the same chunks in reverse; writes one gradient row per (splat, tile) pair
//   gather        sums each splat's rows and carries them back through the projection
//
// Sums have a fixed order, so the result is the same bit for bit for every number of threads, and for every instruction set that
// multiplies and adds with one rounding (AVX2 with FMA, AVX-512 with eight or sixteen lanes).
//
// The second half is compiled once per instruction set (lanes.hpp); the processor picks at run time.

#ifndef F4X_ISA

#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "lanes.hpp"
#include "radix.hpp"
#include "threads.hpp"

// ------------------------------------------------------------------------------------------------ what C callers hand in

// Mirrored field by field in raster/native/library.py.
struct Problem {
    int64_t count;      // N
    int32_t channels;   // C
    int32_t attached;   // channels before this one send gradient to opacity and geometry
    int32_t width, height, threads;
    int32_t first_row, last_row;  // rows of the image that are drawn, the last not; pictures and `limit` hold these alone
    float near_plane, blur, alpha_min, alpha_max, transmittance_min;
    float intrinsics[9], viewmat[16];
    const float *means, *quats, *scales, *opacities, *colors;
    const float *background, *offset;  // may be null
    const float *limit;  // (rows, W) depth from which on a pixel sees nothing; may be null
};

struct Gradients {
    const float *channels, *depth, *alpha;                                       // of the image; each may be null
    float *means, *quats, *scales, *opacities, *colors, *viewmat, *offset;  // of the inputs, all written
};

using namespace f4x;

namespace {

constexpr int TILE = 16;                       // pixels on a side; the block lists below are written for this
constexpr int TILE_PIXELS = TILE * TILE;
constexpr int BLOCK_WIDTH = 4, STRIP_HEIGHT = 2;
constexpr int STRIPS = TILE / STRIP_HEIGHT;    // 8: one lane per strip when binning
constexpr int COLUMNS = TILE / BLOCK_WIDTH;    // 4
constexpr int BLOCKS = STRIPS * COLUMNS;       // 32: one bit each; block = column * STRIPS + strip
constexpr int MOST_PIXELS = 16;                // of a block; one of 16 pixels is two strips high and bears the upper one's number
constexpr int CHUNK = 256;                     // splats binned at a time: one byte per list entry
constexpr int MOMENTS = 6;                     // sums of v (1, u, dy, u u, u dy, dy dy), v = dL/d(log alpha)
constexpr float LOG2E = 1.44269504088896340736f;
constexpr float SLACK = 0.02f;                 // px added around ellipses so that rounding never loses a pixel

// A projected Gaussian. With u = dx - slope dy, alpha = exp2(log2_opacity - (a u^2 + c dy^2)): completing the square
// avoids the cancellation that the usual three-term form suffers for needles. The rows of the ellipse alpha = alpha_min
// are |dy| <= reach, |u| <= half_width sqrt(1 - (dy/reach)^2); it is widest to the right at dy = tip.
struct alignas(32) Hot {  // what alpha needs
    float x, y, a, slope, c, log2_opacity, reach, inverse_reach;
};

struct alignas(64) Splat : Hot {
    float half_width, tip, depth;
};

// Where a splat's tiles are written down: rows row0 <= row < row1 (none where it is culled), one Span each from `span` on,
// and its pairs from `pair` on.
struct Extent {
    uint32_t span, pair;
    uint16_t row0, row1;
};

struct Entry {
    uint32_t splat, pair;
};

struct Span {
    uint16_t begin, end;  // tile columns
};

// What the backward pass needs of the forward pass.
struct State {
    int tile_columns = 0, tile_rows = 0, first_tile_row = 0;  // of the rows that are drawn; numbers of rows count from there
    Buffer<Splat> splats;
    Buffer<uint32_t> depth_bits, order;
    Buffer<Item> items, other_items;          // of the sort by depth
    Buffer<Extent> extents;                   // per Gaussian and one more
    Buffer<Span> spans;
    Buffer<int64_t> tile_start;               // per tile
    Buffer<Entry> entries;                    // tile after tile, each front to back
    Buffer<uint32_t> blocks;                  // per entry: the blocks of its tile that the splat meets, one bit each
    Buffer<int64_t> chunk_start;              // per tile
    Buffer<int32_t> chunks_done;              // per tile: chunks up to the early stop
    Buffer<float> running;                    // per chunk and pixel, block after block: transmittance before it, 0 where stopped
    Buffer<float> final;                      // per tile and pixel: transmittance left
    Buffer<f8> rows;                          // per pair: MOMENTS and padding, then depth, channels and padding
    Buffer<uint8_t> touched;                  // per pair
};

// Work memory of one thread.
struct Scratch {
    alignas(64) Hot hot[CHUNK];
    alignas(64) uint8_t met[COLUMNS][CHUNK];           // per splat and block column: the strips met, one bit each
    alignas(64) uint8_t list[BLOCKS][CHUNK + MOST_PIXELS];  // written by eights, read by as many as a block has pixels
    int length[BLOCKS];
    alignas(64) float alpha[CHUNK * MOST_PIXELS], weight[CHUNK * MOST_PIXELS], dot[CHUNK * MOST_PIXELS];
    alignas(64) float moments[CHUNK * 8];
    Buffer<float> feature, feature_gradient;  // CHUNK rows of `stride`: depth, channels, padding
    Buffer<float> image;                      // per block: 1 + C vectors
    Buffer<float> pixels, lanes;              // image gradient of a block: a row of `stride` per pixel; 1 + C vectors
    int stride = 0;

    explicit Scratch(const Problem& p, bool backward) {
        stride = (1 + p.channels + 7) / 8 * 8;
        feature.resize(size_t(CHUNK) * stride);
        if (!backward) {
            image.resize(size_t(TILE_PIXELS) * (1 + p.channels));
            return;
        }
        feature_gradient.resize(size_t(CHUNK) * stride);
        pixels.resize(size_t(MOST_PIXELS) * stride);
        lanes.resize(size_t(MOST_PIXELS) * stride);
    }
};

struct Kernels {
    const char* name;
    void (*project)(const Problem&, State&, int64_t begin, int64_t end, uint8_t* visible);
    void (*measure)(const Problem&, State&, int64_t begin, int64_t end);
    void (*forward_tile)(const Problem&, State&, Scratch&, int tile, bool keep, float* channels, float* depth, float* alpha);
    void (*backward_tile)(const Problem&, State&, Scratch&, int tile, const Gradients&);
    int64_t (*count_tile)(const Problem&, State&, Scratch&, int tile);
    void (*gather)(const Problem&, State&, int64_t begin, int64_t end, const Gradients&, double* viewmat);
};

inline int row_vectors(const Problem& p) { return 1 + (1 + p.channels + 7) / 8; }

inline bool culled(const Extent& extent) { return extent.row0 == extent.row1; }

// -------------------------------------------------------------------------------------------------- order and tile lists

inline void prefetch(const void* from, size_t bytes = 1) {
#if defined(__GNUC__)
    for (size_t i = 0; i < bytes; i += 64) __builtin_prefetch(static_cast<const char*>(from) + i);
#endif
}

// Numbers of things in units of GRAIN Gaussians -> of those in the units before; returns how many there are in all.
int64_t add_up(std::vector<int64_t>& counts) {
    int64_t sum = 0;
    for (int64_t& count : counts) sum += std::exchange(count, sum);
    return sum;
}

// A value of a Gaussian is NaN or infinite.
struct NotFinite : std::exception {};

bool all_finite(const float* values, int64_t count) {
    uint32_t found = 0;  // without a branch, so that compilers use vectors
    for (int64_t i = 0; i < count; ++i) {
        uint32_t bits;
        std::memcpy(&bits, values + i, 4);
        found |= uint32_t((bits & 0x7f800000u) == 0x7f800000u);
    }
    return !found;
}

// Whether all values of Gaussians `begin` to `end` are finite.
bool all_finite(const Problem& p, int64_t begin, int64_t end) {
    const std::pair<const float*, int> rows[] = {{p.means, 3},      {p.quats, 4},           {p.scales, 3},
                                                 {p.opacities, 1}, {p.colors, p.channels}, {p.offset, 2}};
    for (const auto& [values, width] : rows)
        if (values && !all_finite(values + begin * width, (end - begin) * width)) return false;
    return true;
}

// Projects, and finds where the tiles of every splat are written down and the order of those that are seen, front to back;
// returns their number. Gaussians of equal depth keep their input order. Depths are positive, so their bits sort like the numbers.
int64_t order_splats(const Problem& p, State& s, const Kernels& kernels, uint8_t* visible) {
    Extent* extents = s.extents.resize(p.count + 1);
    s.splats.resize(p.count + 7);  // written eight at a time
    s.depth_bits.resize(p.count);
    const size_t units = (p.count + GRAIN - 1) / GRAIN;
    std::vector<int64_t> spans(units), pairs(units), seen(units);
    std::atomic<bool> finite{true};
    parallel_ranges(p.threads, p.count, [&](int64_t begin, int64_t end) {
        if (!all_finite(p, begin, end)) {
            finite = false;
            return;
        }
        kernels.project(p, s, begin, end, visible);
        for (int64_t i = begin; i < end; ++i) {
            spans[begin / GRAIN] += extents[i].row1 - extents[i].row0;
            seen[begin / GRAIN] += !culled(extents[i]);
        }
    });
    if (!finite) throw NotFinite();
    const int64_t all_spans = add_up(spans), n = add_up(seen);
    s.spans.resize(all_spans);
    parallel_ranges(p.threads, p.count, [&](int64_t begin, int64_t end) {
        int64_t next = spans[begin / GRAIN];
        for (int64_t i = begin; i < end; ++i) {
            extents[i].span = uint32_t(next);
            next += extents[i].row1 - extents[i].row0;
        }
        kernels.measure(p, s, begin, end);
        for (int64_t i = begin; i < end; ++i) pairs[begin / GRAIN] += extents[i].pair;
    });
    const int64_t all_pairs = add_up(pairs);
    if (std::max(all_spans, all_pairs) > int64_t(std::numeric_limits<uint32_t>::max())) throw std::bad_alloc();
    extents[p.count] = {uint32_t(all_spans), uint32_t(all_pairs), 0, 0};
    Item* items = s.items.resize(n);
    parallel_ranges(p.threads, p.count, [&](int64_t begin, int64_t end) {
        int64_t next = pairs[begin / GRAIN], place = seen[begin / GRAIN];
        for (int64_t i = begin; i < end; ++i) {
            next += std::exchange(extents[i].pair, uint32_t(next));
            if (!culled(extents[i])) items[place++] = {s.depth_bits[i], uint32_t(i)};
        }
    });
    uint32_t* order = s.order.resize(n);
    const auto write = [=](uint32_t rank, const Item& item) { order[rank] = item.index; };
    radix_sort(Team::of(p.threads, n), items, s.other_items.resize(n), write);
    return n;
}

// Lists of splats per tile, front to back: counted, then written, by threads that have a part of the ranks each.
void bind(const Problem& p, State& s, const Kernels& kernels, uint8_t* visible) {
    const Team team = Team::of(p.threads, order_splats(p, s, kernels, visible));
    // Calls visit(tile, pair) for the tiles of splat i.
    const auto visit_tiles = [&](uint32_t i, const auto& visit) {
        const Extent& extent = s.extents[i];
        const Span* span = s.spans + extent.span;
        uint32_t pair = extent.pair;
        for (int row = extent.row0; row < extent.row1; ++row, ++span)
            for (int column = span->begin; column < span->end; ++column) visit(row * s.tile_columns + column, pair++);
    };
    // Calls work(splat) for ranks begin <= rank < end.
    const auto by_rank = [&](int64_t begin, int64_t end, const auto& work) {
        constexpr int64_t LATER = 32, SOON = 16;  // ranks fetched ahead: first the extent, then the spans it points to
        for (int64_t rank = begin; rank < end; ++rank) {
            if (rank + LATER < end) {
                prefetch(&s.extents[s.order[rank + LATER]]);
                prefetch(&s.spans[s.extents[s.order[rank + SOON]].span]);
            }
            work(s.order[rank]);
        }
    };
    const size_t tiles = size_t(s.tile_columns) * s.tile_rows;
    std::vector<uint32_t> places(team.threads * tiles);
    team.each_part([&](int64_t part, int64_t begin, int64_t end) {
        uint32_t* mine = &places[part * tiles];
        const auto count = [&](uint32_t i) { visit_tiles(i, [=](int tile, uint32_t) { ++mine[tile]; }); };
        if (team.threads == 1)  // all of them, in the order in which they lie in memory
            for (int64_t i = 0; i < p.count; ++i) count(uint32_t(i));
        else
            by_rank(begin, end, count);
    });
    start_places(places, team.threads, tiles, s.tile_start.resize(tiles + 1));
    const int64_t pairs = s.tile_start[tiles];
    Entry* entries = s.entries.resize(pairs);
    s.blocks.resize(pairs);
    team.each_part([&](int64_t part, int64_t begin, int64_t end) {
        uint32_t* mine = &places[part * tiles];
        by_rank(begin, end, [&](uint32_t i) {
            visit_tiles(i, [=](int tile, uint32_t pair) { entries[mine[tile]++] = {i, pair}; });
        });
    });
}

// The places of the set bits of a byte, lowest first, one byte each, and how many there are.
struct SetBits {
    uint64_t places[256] = {};
    uint8_t count[256] = {};
    constexpr SetBits() {
        for (int byte = 0; byte < 256; ++byte)
            for (int bit = 0; bit < 8; ++bit)
                if (byte >> bit & 1) places[byte] |= uint64_t(bit) << (8 * count[byte]++);
    }
};
constexpr SetBits SET_BITS;

// Rows and columns of a matrix of 8 x 8 bits exchanged; byte r is row r (Warren, Hacker's Delight, 7-3).
inline uint64_t transpose_bits(uint64_t x) {
    uint64_t t = (x ^ x >> 7) & 0x00aa00aa00aa00aa;
    x ^= t ^ t << 7;
    t = (x ^ x >> 14) & 0x0000cccc0000cccc;
    x ^= t ^ t << 14;
    t = (x ^ x >> 28) & 0x00000000f0f0f0f0;
    return x ^ t ^ t << 28;
}

}  // namespace

#define F4X_FILE "raster.cpp"
#define F4X_WIDE_TOO
#include "each_isa.hpp"

namespace {

// Finished states wait here with their memory, so that a training loop does not fault in fresh pages at every step.
constexpr size_t MAX_SPARE = 2;
std::mutex spare_mutex;
std::vector<std::unique_ptr<State>>& spare() {
    static auto* states = new std::vector<std::unique_ptr<State>>;  // never destroyed: callers may outlive statics
    return *states;
}

std::unique_ptr<State> take_state() {
    std::lock_guard<std::mutex> lock(spare_mutex);
    if (spare().empty()) return std::make_unique<State>();
    auto state = std::move(spare().back());
    spare().pop_back();
    return state;
}

void give_back_state(std::unique_ptr<State> state) {
    std::lock_guard<std::mutex> lock(spare_mutex);
    if (spare().size() < MAX_SPARE) spare().push_back(std::move(state));
}

std::unique_ptr<State> forward(const Problem& p, bool keep, float* channels, float* depth, float* alpha, uint8_t* visible) {
    const Kernels& k = kernels();
    auto state = take_state();
    State& s = *state;
    s.tile_columns = (p.width + TILE - 1) / TILE;
    s.first_tile_row = p.first_row / TILE;
    s.tile_rows = (p.last_row + TILE - 1) / TILE - s.first_tile_row;
    const int tiles = s.tile_columns * s.tile_rows;
    bind(p, s, k, visible);

    int64_t* chunk_start = s.chunk_start.resize(tiles + 1);
    int64_t chunks = 0;
    for (int tile = 0; tile < tiles; ++tile) {
        chunk_start[tile] = chunks;
        chunks += (s.tile_start[tile + 1] - s.tile_start[tile] + CHUNK - 1) / CHUNK;
    }
    chunk_start[tiles] = chunks;
    s.chunks_done.resize(tiles);
    if (keep) {
        s.running.resize(chunks * TILE_PIXELS);
        s.final.resize(size_t(tiles) * TILE_PIXELS);
    }
    parallel(p.threads, tiles, [&](std::atomic<int64_t>& cursor) {
        auto scratch = std::make_unique<Scratch>(p, false);
        for (int64_t tile; (tile = cursor++) < tiles;)
            k.forward_tile(p, s, *scratch, int(tile), keep, channels, depth, alpha);
    });
    return state;
}

void backward(State& s, const Problem& p, const Gradients& g) {
    const Kernels& k = kernels();
    const int tiles = s.tile_columns * s.tile_rows;
    const int64_t pairs = s.extents[p.count].pair;
    s.rows.resize(pairs * row_vectors(p));
    std::fill_n(s.touched.resize(pairs), pairs, uint8_t(0));
    parallel(p.threads, tiles, [&](std::atomic<int64_t>& cursor) {
        auto scratch = std::make_unique<Scratch>(p, true);
        for (int64_t tile; (tile = cursor++) < tiles;) k.backward_tile(p, s, *scratch, int(tile), g);
    });
    std::vector<double> viewmats(((p.count + GRAIN - 1) / GRAIN) * 12, 0.0);
    parallel_ranges(p.threads, p.count, [&](int64_t begin, int64_t end) {
        k.gather(p, s, begin, end, g, &viewmats[begin / GRAIN * 12]);
    });
    double viewmat[12] = {};
    for (size_t i = 0; i < viewmats.size(); ++i) viewmat[i % 12] += viewmats[i];
    for (int i = 0; i < 16; ++i) g.viewmat[i] = i < 12 ? float(viewmat[i]) : 0.0f;
}

}  // namespace

// --------------------------------------------------------------------------------------------------------- C interface

// Name of the instruction set in use.
F4X_API const char* f4x_instruction_set() { return kernels().name; }

// Renders; with `keep` the result is a state for f4x_backward, to be given back with f4x_release, and null otherwise.
// `*failed` is set to 1 when memory ran out, and to 2 when a value of a Gaussian is not finite.
F4X_API void* f4x_forward(const Problem* problem, int32_t keep, float* channels, float* depth, float* alpha,
                          uint8_t* visible, int32_t* failed) {
    try {
        *failed = 0;
        auto state = forward(*problem, keep != 0, channels, depth, alpha, visible);
        if (keep) return state.release();
        give_back_state(std::move(state));
    } catch (const NotFinite&) {
        *failed = 2;
    } catch (const std::exception&) {
        *failed = 1;
    }
    return nullptr;
}

// Gradients of the render that gave `state`, for the same problem. Returns 1 when memory ran out, else 0.
F4X_API int32_t f4x_backward(void* state, const Problem* problem, const Gradients* gradients) {
    try {
        backward(*static_cast<State*>(state), *problem, *gradients);
        return 0;
    } catch (const std::exception&) {
        return 1;
    }
}

// (pixel, splat) pairs that contributed to the render that gave `state`, for the same problem; -1 when memory ran out.
F4X_API int64_t f4x_count_pairs(void* state, const Problem* problem) {
    try {
        State& s = *static_cast<State*>(state);
        auto scratch = std::make_unique<Scratch>(*problem, false);
        int64_t pairs = 0;
        for (int tile = 0; tile < s.tile_columns * s.tile_rows; ++tile) pairs += kernels().count_tile(*problem, s, *scratch, tile);
        return pairs;
    } catch (const std::exception&) {
        return -1;
    }
}

F4X_API void f4x_release(void* state) { give_back_state(std::unique_ptr<State>(static_cast<State*>(state))); }

#else  // ------------------------------------------------------------------------------- compiled once per instruction set

namespace {
namespace F4X_ISA {

#include "lanes_isa.hpp"

// The pixels of a block are the lanes of one vector.
constexpr int PIXELS = LANES;
static_assert(PIXELS <= MOST_PIXELS);
constexpr int BLOCK_STRIPS = PIXELS / BLOCK_WIDTH / STRIP_HEIGHT;

// Left and right end, relative to the centre, of the part of the ellipse with lo <= dy <= hi. Exact: the extreme lies at
// the ellipse's own tip or, where the strip cuts that off, on the nearer edge. Returns the clipped strip in lo, hi
// (empty where lo > hi).
template <class V>
F4X_HOT void ellipse_span(const V& reach, const V& inverse_reach, const V& slope, const V& half_width, const V& tip, V& lo,
                          V& hi, V& left, V& right) {
    const V one = V(reach * 0.0f + 1.0f), zero = V(reach * 0.0f);
    lo = maximum(lo, zero - reach);
    hi = minimum(hi, reach);
    const V right_y = maximum(lo, minimum(hi, tip)), left_y = maximum(lo, minimum(hi, zero - tip));
    const V u = right_y * inverse_reach, v = left_y * inverse_reach;
    right = slope * right_y + half_width * root(maximum(zero, one - u * u));
    left = slope * left_y - half_width * root(maximum(zero, one - v * v));
}

// ---------------------------------------------------------------------------------------------------------- projection

// Columns of eight consecutive rows of W floats, starting at row i; rows from `end` on repeat the last one.
template <int W>
F4X_HOT void load_rows(const float* rows, int64_t i, int64_t end, f8* columns) {
    alignas(32) float cut[W][8];
    for (int lane = 0; lane < 8; ++lane)
        for (int c = 0; c < W; ++c) cut[c][lane] = rows[std::min(i + lane, end - 1) * W + c];
    for (int c = 0; c < W; ++c) columns[c] = load(cut[c]);
}

// The way back; rows from `end` on are not written.
template <int W>
F4X_HOT void store_rows(float* rows, int64_t i, int64_t end, const f8* columns) {
    alignas(32) float cut[W][8];
    for (int c = 0; c < W; ++c) store(cut[c], columns[c]);
    for (int lane = 0; lane < 8 && i + lane < end; ++lane)
        for (int c = 0; c < W; ++c) rows[(i + lane) * W + c] = cut[c][lane];
}

// The camera-side quantities of eight Gaussians, shared by the forward and the backward projection.
struct Projection {
    f8 mean[3], scale[3];
    f8 p[3];                 // camera frame
    f8 inverse_z;
    f8 q[4], norm;           // normalised quaternion; its length before
    f8 rotation[9];
    i8 u_free, v_free;       // x/z, y/z not clamped for the Jacobian
    f8 j00, j02, j11, j12;   // Jacobian, the other two entries are 0
    f8 world[9];             // W R: camera-from-local rotation
    f8 side[2][3];           // J W R
    f8 t[2][3];              // J W R diag(scale); covariance = t t^T + blur
    f8 sxx, sxy, syy, det;   // covariance and its determinant
};

F4X_HOT void project_eight(const Problem& p, int64_t i, int64_t end, Projection& o) {
    const float *w = p.viewmat, fx = p.intrinsics[0], cx = p.intrinsics[2], fy = p.intrinsics[4], cy = p.intrinsics[5];
    const f8 zero = broadcast(0.0f), one = broadcast(1.0f), two = broadcast(2.0f), blur = broadcast(p.blur);
    load_rows<3>(p.means, i, end, o.mean);
    load_rows<3>(p.scales, i, end, o.scale);
    load_rows<4>(p.quats, i, end, o.q);
    for (int r = 0; r < 3; ++r)
        o.p[r] = broadcast(w[4 * r]) * o.mean[0] + broadcast(w[4 * r + 1]) * o.mean[1] +
                 broadcast(w[4 * r + 2]) * o.mean[2] + broadcast(w[4 * r + 3]);

    o.norm = root(o.q[0] * o.q[0] + o.q[1] * o.q[1] + o.q[2] * o.q[2] + o.q[3] * o.q[3]);
    const i8 none = o.norm < broadcast(1e-12f);  // a zero quaternion counts as the identity
    for (int k = 0; k < 4; ++k) o.q[k] = select(none, k ? zero : one, o.q[k] / o.norm);
    const f8 a = o.q[0], b = o.q[1], c = o.q[2], d = o.q[3];
    f8* r = o.rotation;
    r[0] = one - two * (c * c + d * d);
    r[1] = two * (b * c - a * d);
    r[2] = two * (b * d + a * c);
    r[3] = two * (b * c + a * d);
    r[4] = one - two * (b * b + d * d);
    r[5] = two * (c * d - a * b);
    r[6] = two * (b * d - a * c);
    r[7] = two * (c * d + a * b);
    r[8] = one - two * (b * b + c * c);
    for (int k = 0; k < 3; ++k)
        for (int j = 0; j < 3; ++j)
            o.world[3 * k + j] =
                broadcast(w[4 * k]) * r[j] + broadcast(w[4 * k + 1]) * r[3 + j] + broadcast(w[4 * k + 2]) * r[6 + j];

    // The Jacobian is linearised no further out than 0.3 half-fields of view beyond the image (gsplat _torch_impl.py).
    const float margin_x = 0.15f * p.width / fx, margin_y = 0.15f * p.height / fy;
    const f8 left = broadcast(-cx / fx - margin_x), right = broadcast((p.width - cx) / fx + margin_x);
    const f8 top = broadcast(-cy / fy - margin_y), bottom = broadcast((p.height - cy) / fy + margin_y);
    o.inverse_z = one / o.p[2];
    const f8 x = o.p[0] * o.inverse_z, y = o.p[1] * o.inverse_z;
    o.u_free = (x >= left) & (x <= right);
    o.v_free = (y >= top) & (y <= bottom);
    o.j00 = broadcast(fx) * o.inverse_z;
    o.j11 = broadcast(fy) * o.inverse_z;
    o.j02 = zero - o.j00 * minimum(maximum(x, left), right);
    o.j12 = zero - o.j11 * minimum(maximum(y, top), bottom);
    f8 sxx = zero, syy = zero;
    o.sxy = zero;
    for (int k = 0; k < 3; ++k) {
        o.side[0][k] = o.j00 * o.world[k] + o.j02 * o.world[6 + k];
        o.side[1][k] = o.j11 * o.world[3 + k] + o.j12 * o.world[6 + k];
        o.t[0][k] = o.side[0][k] * o.scale[k];
        o.t[1][k] = o.side[1][k] * o.scale[k];
        sxx += o.t[0][k] * o.t[0][k];
        o.sxy += o.t[0][k] * o.t[1][k];
        syy += o.t[1][k] * o.t[1][k];
    }
    o.sxx = sxx + blur;
    o.syy = syy + blur;
    // det(t t^T) as a sum of squared minors (Cauchy-Binet): no cancellation for needles, unlike sxx syy - sxy^2.
    f8 minors = zero;
    for (int k = 0; k < 3; ++k) {
        const int n = (k + 1) % 3;
        const f8 minor = o.t[0][k] * o.t[1][n] - o.t[0][n] * o.t[1][k];
        minors += minor * minor;
    }
    o.det = minors + blur * (sxx + syy) + blur * blur;
}

// True if none of the eight Gaussians reaches the picture, however it is turned: its ellipse is no wider than its largest standard
// deviation makes it. Most batches lie outside of a close-up, and need no covariance.
F4X_HOT bool all_outside(const Problem& p, int64_t i, int64_t end) {
    if (!(p.alpha_min > 0)) return false;  // without a cut-off every Gaussian reaches everywhere
    const float *w = p.viewmat, fx = p.intrinsics[0], cx = p.intrinsics[2], fy = p.intrinsics[4], cy = p.intrinsics[5];
    const f8 zero = broadcast(0.0f), half = broadcast(0.5f);
    f8 mean[3], scale[3], at[3], opacity, offset[2] = {zero, zero};
    load_rows<3>(p.means, i, end, mean);
    load_rows<3>(p.scales, i, end, scale);
    load_rows<1>(p.opacities, i, end, &opacity);
    if (p.offset) load_rows<2>(p.offset, i, end, offset);
    for (int r = 0; r < 3; ++r)
        at[r] = broadcast(w[4 * r]) * mean[0] + broadcast(w[4 * r + 1]) * mean[1] + broadcast(w[4 * r + 2]) * mean[2] +
                broadcast(w[4 * r + 3]);
    // The longest row of the Jacobian, which is clamped as in `project_eight`.
    const float wide = std::max(std::abs(cx), std::abs(p.width - cx)) / fx + 0.15f * p.width / fx;
    const float high = std::max(std::abs(cy), std::abs(p.height - cy)) / fy + 0.15f * p.height / fy;
    const float slant = std::max(fx * std::sqrt(1 + wide * wide), fy * std::sqrt(1 + high * high));
    const float limit = std::sqrt(-2 / LOG2E * std::log2(p.alpha_min)) * 1.01f;  // standard deviations, of opacity 1
    const f8 inverse_z = broadcast(1.0f) / at[2], largest = maximum(maximum(scale[0], scale[1]), scale[2]);
    const f8 reach = broadcast(limit * slant) * inverse_z * largest + broadcast(limit * std::sqrt(p.blur) + 1);
    const f8 x = broadcast(fx) * inverse_z * at[0] + broadcast(cx) + offset[0];
    const f8 y = broadcast(fy) * inverse_z * at[1] + broadcast(cy) + offset[1];
    i8 near = (at[2] > broadcast(p.near_plane)) & (x + reach >= half) & (x - reach <= broadcast(p.width - 0.5f));
    near = near & (y + reach >= half) & (y - reach <= broadcast(p.height - 0.5f));
    return !(mask_bits(near) | mask_bits(opacity > broadcast(1.0f)));
}

F4X_HOT int32_t clamp_to_int(float x, int hi) { return int32_t(minimum(maximum(x, 0.0f), float(hi))); }

F4X_TARGET void project(const Problem& p, State& s, int64_t begin, int64_t end, uint8_t* visible) {
    const f8 zero = broadcast(0.0f), one = broadcast(1.0f), half = broadcast(0.5f);
    const f8 huge = broadcast(std::numeric_limits<float>::max());
    const f8 alpha_min = broadcast(p.alpha_min), log2_min = broadcast(std::log2(p.alpha_min));
    const float above = float(s.first_tile_row);
    for (int64_t i = begin; i < end; i += 8) {
        if (all_outside(p, i, end)) {
            for (int64_t each = i; each < std::min(i + 8, end); ++each) {
                s.extents[each].row0 = s.extents[each].row1 = 0;
                s.extents[each].pair = visible[each] = 0;
            }
            continue;
        }
        Projection o;
        project_eight(p, i, end, o);
        f8 opacity, offset[2] = {zero, zero};
        load_rows<1>(p.opacities, i, end, &opacity);
        if (p.offset) load_rows<2>(p.offset, i, end, offset);
        alignas(32) float log2_opacity[8];
        for (int lane = 0; lane < 8; ++lane) log2_opacity[lane] = std::log2(opacity[lane]);

        // Every comparison is false for NaN.
        i8 seen = (opacity >= alpha_min) & (o.p[2] > broadcast(p.near_plane)) & (o.p[2] <= huge);
        seen = seen & (o.det > zero) & (o.det <= huge);
        const f8 x = o.j00 * o.p[0] + broadcast(p.intrinsics[2]) + offset[0];
        const f8 y = o.j11 * o.p[1] + broadcast(p.intrinsics[5]) + offset[1];
        const f8 bits = load(log2_opacity), log2e_half = broadcast(0.5f * LOG2E);
        // Ellipse alpha >= alpha_min, a hair larger than exact.
        const f8 limit = (bits - log2_min) * broadcast(2.0f / LOG2E * 1.0001f) + broadcast(1e-5f);
        const f8 reach_x = root(limit * o.sxx), reach = root(limit * o.syy);
        seen = seen & (x + reach_x >= half) & (x - reach_x <= broadcast(p.width - 0.5f));
        seen = seen & (y + reach >= half) & (y - reach <= broadcast(p.height - 0.5f));
        const uint32_t mask = mask_bits(seen);

        const f8 inverse_syy = one / o.syy;
        const f8 a = log2e_half * o.syy / o.det, c = log2e_half * inverse_syy, slope = o.sxy * inverse_syy;
        const f8 half_width = root(limit * o.det * inverse_syy), tip = o.sxy * root(limit / o.sxx);
        f8 hot[8] = {x, y, a, slope, c, bits, reach, one / reach};
        f8 rest[8] = {half_width, tip, o.p[2], zero, zero, zero, zero, zero};
        transpose(hot);
        transpose(rest);
        const f8 last_row = y + reach, first_row = y - reach;
        for (int lane = 0; lane < 8 && i + lane < end; ++lane) {
            Splat* splat = s.splats + i + lane;
            std::memcpy(splat, &hot[lane], sizeof(f8));
            std::memcpy(reinterpret_cast<char*>(splat) + sizeof(f8), &rest[lane], sizeof(f8));
            std::memcpy(&s.depth_bits[i + lane], &splat->depth, sizeof(float));
            Extent& extent = s.extents[i + lane];
            extent.row0 = extent.row1 = 0;
            extent.pair = 0;
            visible[i + lane] = mask >> lane & 1;
            if (!visible[i + lane]) continue;
            const int row0 = clamp_to_int(std::ceil((first_row[lane] - SLACK - (TILE - 0.5f)) / TILE) - above, s.tile_rows);
            const int row1 = clamp_to_int(std::floor((last_row[lane] + SLACK - 0.5f) / TILE) + 1 - above, s.tile_rows);
            extent.row0 = uint16_t(row0);
            extent.row1 = uint16_t(std::max(row0, row1));
        }
    }
}

// Tile columns of every tile row that a splat meets, and how many (splat, tile) pairs that makes.
F4X_TARGET void measure(const Problem& p, State& s, int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
        const Splat& splat = s.splats[i];
        Extent& extent = s.extents[i];
        Span* span = s.spans + extent.span;
        uint32_t pairs = 0;
        for (int row = extent.row0; row < extent.row1; ++row, ++span) {
            const int top = (s.first_tile_row + row) * TILE;
            float lo = top + 0.5f - splat.y - SLACK;
            float hi = std::min(top + TILE, int(p.height)) - 0.5f - splat.y + SLACK;
            float left, right;
            ellipse_span<float>(splat.reach, splat.inverse_reach, splat.slope, splat.half_width, splat.tip, lo, hi, left, right);
            *span = {0, 0};
            if (!(lo <= hi)) continue;
            span->begin = uint16_t(clamp_to_int(std::ceil((splat.x + left - SLACK - (TILE - 0.5f)) / TILE), s.tile_columns));
            span->end = uint16_t(clamp_to_int(std::floor((splat.x + right + SLACK - 0.5f) / TILE) + 1, s.tile_columns));
            if (span->end < span->begin) span->end = span->begin;
            pairs += span->end - span->begin;
        }
        extent.pair = pairs;
    }
}

// ------------------------------------------------------------------------------------------------------- tiles and blocks

struct Tile {
    int x, y;             // first pixel
    int64_t begin, end;   // entries
    f8 strip;             // first pixel centre row of each strip
};

F4X_HOT Tile tile_of(const State& s, int tile) {
    Tile t;
    t.x = tile % s.tile_columns * TILE;
    t.y = (s.first_tile_row + tile / s.tile_columns) * TILE;
    t.begin = s.tile_start[tile];
    t.end = s.tile_start[tile + 1];
    t.strip = broadcast(t.y + 0.5f) + f8{0, 2, 4, 6, 8, 10, 12, 14};
    return t;
}

F4X_HOT int block_x(const Tile& t, int block) { return t.x + block / STRIPS * BLOCK_WIDTH; }
F4X_HOT int block_y(const Tile& t, int block) { return t.y + block % STRIPS * STRIP_HEIGHT; }

// Column and row of a block's pixels.
F4X_HOT fp columns_of_pixels(float first) {
    fp v;
    for (int lane = 0; lane < PIXELS; ++lane) v[lane] = float(lane % BLOCK_WIDTH);
    return v + broadcast<fp>(first);
}
F4X_HOT fp rows_of_pixels(float first) {
    fp v;
    for (int lane = 0; lane < PIXELS; ++lane) v[lane] = float(lane / BLOCK_WIDTH);
    return v + broadcast<fp>(first);
}

// Whether a pixel is drawn, and which one it is among those that are.
F4X_HOT bool is_drawn(const Problem& p, int x, int y) { return x < p.width && y >= p.first_row && y < p.last_row; }
F4X_HOT int64_t pixel_of(const Problem& p, int x, int y) { return int64_t(y - p.first_row) * p.width + x; }

// Depth limits of a block's pixels; those that are not drawn see nothing at all.
F4X_HOT fp limits_of(const Problem& p, int x, int y) {
    fp limits = broadcast<fp>(0.0f);
    for (int lane = 0; lane < PIXELS; ++lane) {
        const int column = x + lane % BLOCK_WIDTH, row = y + lane / BLOCK_WIDTH;
        if (is_drawn(p, column, row)) limits[lane] = p.limit[pixel_of(p, column, row)];
    }
    return limits;
}

// Transmittance at the start: 1 for a pixel that is drawn, else 0.
F4X_HOT fp first_running(const Problem& p, int x, int y) {
    const fp dx = columns_of_pixels(float(x)), dy = rows_of_pixels(float(y));
    const ip in_rows = (dy >= broadcast<fp>(float(p.first_row))) & (dy < broadcast<fp>(float(p.last_row)));
    return keep_where((dx < broadcast<fp>(float(p.width))) & in_rows, broadcast<fp>(1.0f));
}

// A few floats: a call of memcpy takes longer.
F4X_HOT void copy_floats(float* to, const float* from, int count) {
    for (; count >= 4; count -= 4, to += 4, from += 4) std::memcpy(to, from, 4 * sizeof(float));
    for (int c = 0; c < count; ++c) to[c] = from[c];
}

// Blocks of the tile whose pixels may lie inside the splat's ellipse, one bit each; all 8 strips of the tile at once.
F4X_HOT uint32_t blocks_met(const Tile& t, const Splat& splat) {
    f8 lo = t.strip - broadcast(splat.y + SLACK), left, right;
    f8 hi = t.strip + broadcast(STRIP_HEIGHT - 1 + SLACK - splat.y);
    ellipse_span<f8>(broadcast(splat.reach), broadcast(splat.inverse_reach), broadcast(splat.slope),
                     broadcast(splat.half_width), broadcast(splat.tip), lo, hi, left, right);
    const i8 meets = lo <= hi;
    uint32_t bits = 0;
    for (int column = 0; column < COLUMNS; ++column) {
        const float from = t.x + (column * BLOCK_WIDTH + 0.5f - SLACK) - splat.x;
        const float to = t.x + (column * BLOCK_WIDTH + BLOCK_WIDTH - 0.5f + SLACK) - splat.x;
        bits |= mask_bits(meets & (left <= broadcast(to)) & (right >= broadcast(from))) << (column * STRIPS);
    }
    if (BLOCK_STRIPS == 2) bits = (bits | bits >> 1) & 0x55555555;
    return bits;
}

// Writes down, for every block, the entries (numbers in the chunk, ascending) whose bit is set in `met`.
F4X_HOT void list_blocks(int n, Scratch& w) {
    for (int& length : w.length) length = 0;
    for (int first = 0; first < n; first += 8)
        for (int column = 0; column < COLUMNS; ++column) {
            uint64_t bytes;
            std::memcpy(&bytes, &w.met[column][first], sizeof bytes);
            bytes = transpose_bits(bytes);  // one byte per strip
            for (int strip = 0; strip < STRIPS; strip += BLOCK_STRIPS, bytes >>= 8 * BLOCK_STRIPS) {
                const int block = column * STRIPS + strip, set = bytes & 255;
                const uint64_t places = SET_BITS.places[set] + 0x0101010101010101 * uint64_t(first);
                std::memcpy(&w.list[block][w.length[block]], &places, sizeof places);
                w.length[block] += SET_BITS.count[set];
            }
        }
}

// Copies a chunk of the tile's splats into scratch and lists, for every live block, the ones that meet it. The forward
// pass finds the blocks, the backward pass reads them back.
template <bool FIND>
F4X_HOT void stage(const Problem& p, const State& s, const Tile& t, int64_t begin, int n, uint32_t live, Scratch& w) {
    constexpr int AHEAD = 12;
    const size_t bytes = p.channels * sizeof(float);
    for (int k = 0; k < n; ++k) {
        if (begin + k + AHEAD < t.end) {
            const uint32_t next = s.entries[begin + k + AHEAD].splat;
            prefetch(&s.splats[next]);
            prefetch(p.colors + int64_t(next) * p.channels, bytes);
        }
        const uint32_t i = s.entries[begin + k].splat;
        const Splat& splat = s.splats[i];
        w.hot[k] = splat;  // its Hot
        float* row = w.feature + size_t(k) * w.stride;
        const float* color = p.colors + int64_t(i) * p.channels;
        row[0] = splat.depth;
        copy_floats(row + 1, color, p.channels);
        if (FIND) s.blocks[begin + k] = blocks_met(t, splat);
        const uint32_t met = s.blocks[begin + k] & live;
        for (int column = 0; column < COLUMNS; ++column) w.met[column][k] = uint8_t(met >> (column * STRIPS));
    }
    for (int k = n; k % 8; ++k)
        for (int column = 0; column < COLUMNS; ++column) w.met[column][k] = 0;
    list_blocks(n, w);
}

// Alpha of N listed splats in the pixels of a block, 0 below the cut. Step by step for all N: one splat's chain of dependent
// operations is too long for a processor to look past.
template <int N>
F4X_HOT void alphas_of(const Hot* hot, const uint8_t* list, const fp& pixel_x, const fp& pixel_y, const fp& log2_min,
                       const fp& alpha_max, float* alphas) {
    fp x[N], y[N], exponent[N];
    F4X_UNROLL
    for (int k = 0; k < N; ++k) {
        x[k] = pixel_x - broadcast<fp>(hot[list[k]].x);
        y[k] = pixel_y - broadcast<fp>(hot[list[k]].y);
    }
    F4X_UNROLL
    for (int k = 0; k < N; ++k) x[k] = x[k] - broadcast<fp>(hot[list[k]].slope) * y[k];
    F4X_UNROLL
    for (int k = 0; k < N; ++k)
        exponent[k] = broadcast<fp>(hot[list[k]].log2_opacity) - broadcast<fp>(hot[list[k]].a) * x[k] * x[k];
    F4X_UNROLL
    for (int k = 0; k < N; ++k) exponent[k] = exponent[k] - broadcast<fp>(hot[list[k]].c) * y[k] * y[k];
    exp2_fast<N>(exponent, x);
    F4X_UNROLL
    for (int k = 0; k < N; ++k) store(alphas + PIXELS * k, keep_where(exponent[k] >= log2_min, minimum(x[k], alpha_max)));
}

// Alpha and weight (alpha T) of the listed splats in the pixels of a block. `running` is the transmittance, 0 once a
// pixel has stopped; `final` the transmittance left behind the last blended splat. Returns how many splats were looked at
// before all pixels had stopped. Not inlined: forward and backward must decide alike. With LIMITED a pixel also stops at
// its depth limit, which is sound because splats come front to back.
template <bool LIMITED>
#if defined(__GNUC__)
__attribute__((noinline))
#endif
F4X_TARGET int weigh(const Problem& p, const Scratch& w, int block, int x, int y, fp& running_, fp& final_,
                             float* alphas, float* weights) {
    const fp pixel_x = columns_of_pixels(x + 0.5f), pixel_y = rows_of_pixels(y + 0.5f);
    const fp log2_min = broadcast<fp>(std::log2(p.alpha_min)), alpha_max = broadcast<fp>(p.alpha_max);
    const fp stop = broadcast<fp>(p.transmittance_min), limits = LIMITED ? limits_of(p, x, y) : stop;
    const uint8_t* list = w.list[block];
    const int n = w.length[block];
    fp running = running_, final = final_;
    // Whoever has stopped stays stopped, as `next` never grows: `running` waits for no comparison.
    ip go = {};
    int k = 0;
    while (k < n) {  // splats behind the last are computed and not looked at
        alphas_of<4>(w.hot, list + k, pixel_x, pixel_y, log2_min, alpha_max, alphas + PIXELS * k);
        alphas_of<4>(w.hot, list + k + 4, pixel_x, pixel_y, log2_min, alpha_max, alphas + PIXELS * (k + 4));
        for (const int end = std::min(k + 8, n); k < end; ++k) {
            const fp next = running - running * load<fp>(alphas + PIXELS * k);
            go = next > stop;
            if (LIMITED) go = go & (broadcast<fp>(w.feature[size_t(list[k]) * w.stride]) < limits);  // its depth
            const fp alpha = keep_where(go, load<fp>(alphas + PIXELS * k));
            store(alphas + PIXELS * k, alpha);
            store(weights + PIXELS * k, alpha * running);
            running = next;
            final = select(go, next, final);
        }
        running = keep_where(go, running);
        if (!mask_bits(running > broadcast<fp>(0.0f))) break;
    }
    running_ = running;
    final_ = final;
    return k;
}

F4X_HOT int block_weights(const Problem& p, const Scratch& w, int block, int x, int y, fp& running, fp& final, float* alphas,
                          float* weights) {
    return p.limit ? weigh<true>(p, w, block, x, y, running, final, alphas, weights)
                   : weigh<false>(p, w, block, x, y, running, final, alphas, weights);
}

// A row of a chunk's table. Its address is made opaque because GCC otherwise computes it anew for every column.
template <class T>
F4X_HOT T* row_of(T* table, int stride, int entry) {
    T* row = table + size_t(entry) * stride;
#if defined(__GNUC__)
    __asm__("" : "+r"(row));
#endif
    return row;
}

// image[c] += sum over entries of weight * feature[c], for N channels at once.
template <int N>
F4X_HOT void blend_group(const float* feature, int stride, const uint8_t* list, int n, const float* weights, float* image) {
    fp sum[N];
    F4X_UNROLL
    for (int c = 0; c < N; ++c) sum[c] = load<fp>(image + PIXELS * c);
    for (int k = 0; k < n; ++k) {
        const float* row = row_of(feature, stride, list[k]);
        const fp weight = load<fp>(weights + PIXELS * k);
        F4X_UNROLL
        for (int c = 0; c < N; ++c) sum[c] += weight * broadcast<fp>(row[c]);
    }
    F4X_UNROLL
    for (int c = 0; c < N; ++c) store(image + PIXELS * c, sum[c]);
}

F4X_TARGET void blend(const Scratch& w, int block, int n, int columns, float* image) {
    const uint8_t* list = w.list[block];
    int c = 0;
    for (; c + 12 <= columns; c += 12) blend_group<12>(w.feature + c, w.stride, list, n, w.weight, image + PIXELS * c);
    const float* rest = w.feature + c;
    float* pixels = image + PIXELS * c;
    switch (columns - c) {  // a list is walked once for all of them
        case 1: return blend_group<1>(rest, w.stride, list, n, w.weight, pixels);
        case 2: return blend_group<2>(rest, w.stride, list, n, w.weight, pixels);
        case 3: return blend_group<3>(rest, w.stride, list, n, w.weight, pixels);
        case 4: return blend_group<4>(rest, w.stride, list, n, w.weight, pixels);
        case 5: return blend_group<5>(rest, w.stride, list, n, w.weight, pixels);
        case 6: return blend_group<6>(rest, w.stride, list, n, w.weight, pixels);
        case 7: return blend_group<7>(rest, w.stride, list, n, w.weight, pixels);
        case 8: return blend_group<8>(rest, w.stride, list, n, w.weight, pixels);
        case 9: return blend_group<9>(rest, w.stride, list, n, w.weight, pixels);
        case 10: return blend_group<10>(rest, w.stride, list, n, w.weight, pixels);
        case 11: return blend_group<11>(rest, w.stride, list, n, w.weight, pixels);
    }
}

F4X_TARGET void forward_tile(const Problem& p, State& s, Scratch& w, int tile, bool keep, float* channels, float* depth,
                             float* alpha) {
    const Tile t = tile_of(s, tile);
    const int columns = 1 + p.channels;
    alignas(64) float running[TILE_PIXELS], final[TILE_PIXELS];
    uint32_t live = 0;
    for (int block = 0; block < BLOCKS; block += BLOCK_STRIPS) {
        const int x = block_x(t, block), y = block_y(t, block);
        fp first = first_running(p, x, y);
        store(final + 8 * block, first);
        if (p.limit) first = keep_where(limits_of(p, x, y) > broadcast<fp>(p.near_plane), first);
        store(running + 8 * block, first);
        if (mask_bits(first > broadcast<fp>(0.0f))) live |= 1u << block;
    }
    std::memset(w.image, 0, size_t(TILE_PIXELS) * columns * sizeof(float));
    int64_t begin = t.begin, chunk = s.chunk_start[tile];
    for (; begin < t.end && live; begin += CHUNK, ++chunk) {
        const int n = int(std::min<int64_t>(CHUNK, t.end - begin));
        if (keep) std::memcpy(s.running + chunk * TILE_PIXELS, running, sizeof running);
        stage<true>(p, s, t, begin, n, live, w);
        for (int block = 0; block < BLOCKS; block += BLOCK_STRIPS) {
            if (!w.length[block]) continue;
            fp now = load<fp>(running + 8 * block), left = load<fp>(final + 8 * block);
            const int m = block_weights(p, w, block, block_x(t, block), block_y(t, block), now, left, w.alpha, w.weight);
            store(running + 8 * block, now);
            store(final + 8 * block, left);
            blend(w, block, m, columns, w.image + size_t(block) * columns * 8);
            if (!mask_bits(now > broadcast<fp>(0.0f))) live &= ~(1u << block);
        }
    }
    s.chunks_done[tile] = int32_t(chunk - s.chunk_start[tile]);
    if (keep) std::memcpy(s.final + size_t(tile) * TILE_PIXELS, final, sizeof final);

    for (int block = 0; block < BLOCKS; block += BLOCK_STRIPS) {
        const float* image = w.image + size_t(block) * columns * 8;
        for (int lane = 0; lane < PIXELS; ++lane) {
            const int x = block_x(t, block) + lane % BLOCK_WIDTH, y = block_y(t, block) + lane / BLOCK_WIDTH;
            if (!is_drawn(p, x, y)) continue;
            const int64_t pixel = pixel_of(p, x, y);
            const float left = final[8 * block + lane];
            alpha[pixel] = 1 - left;
            depth[pixel] = image[lane];
            float* out = channels + pixel * p.channels;
            for (int c = 0; c < p.channels; ++c) {
                const float value = image[PIXELS * (c + 1) + lane];
                out[c] = p.background ? value + left * p.background[c] : value;
            }
        }
    }
}

// ------------------------------------------------------------------------------------------------------------- backward

// Image gradient of a block, both ways round: `pixels` rows of (depth, channels), `lanes` one vector per column. Returns the
// gradient of the transmittance left behind: background minus alpha.
F4X_HOT fp load_gradient(const Problem& p, const Gradients& g, int x0, int y0, Scratch& w) {
    fp behind = broadcast<fp>(0.0f);
    std::memset(w.pixels, 0, size_t(PIXELS) * w.stride * sizeof(float));
    for (int lane = 0; lane < PIXELS; ++lane) {
        const int x = x0 + lane % BLOCK_WIDTH, y = y0 + lane / BLOCK_WIDTH;
        if (!is_drawn(p, x, y)) continue;
        const int64_t pixel = pixel_of(p, x, y);
        float* row = w.pixels + size_t(lane) * w.stride;
        if (g.depth) row[0] = g.depth[pixel];
        if (g.channels) copy_floats(row + 1, g.channels + pixel * p.channels, p.channels);
        float sum = g.alpha ? -g.alpha[pixel] : 0.0f;
        if (p.background)
            for (int c = 0; c < p.attached; ++c) sum += row[1 + c] * p.background[c];
        behind[lane] = sum;
    }
    for (int c = 0; c < 1 + p.attached; c += 8)
        for (int lane = 0; lane < PIXELS; lane += 8) {
            f8 square[8];
            for (int k = 0; k < 8; ++k) square[k] = load(w.pixels + size_t(lane + k) * w.stride + c);
            transpose(square);
            for (int k = 0; k < 8; ++k) store(w.lanes + PIXELS * (c + k) + lane, square[k]);
        }
    return behind;
}

// dot[k] = sum over columns of feature * image gradient, all pixels at once, for N entries at once.
template <int N>
F4X_HOT void dot_group(const Scratch& w, const uint8_t* list, int columns, float* dot) {
    const float* row[N];
    fp sum[N];
    F4X_UNROLL
    for (int k = 0; k < N; ++k) {
        row[k] = row_of<const float>(w.feature, w.stride, list[k]);
        sum[k] = broadcast<fp>(0.0f);
    }
    for (int c = 0; c < columns; ++c) {
        const fp gradient = load<fp>(w.lanes + PIXELS * c);
        F4X_UNROLL
        for (int k = 0; k < N; ++k) sum[k] += gradient * broadcast<fp>(row[k][c]);
    }
    F4X_UNROLL
    for (int k = 0; k < N; ++k) store(dot + PIXELS * k, sum[k]);
}

// feature_gradient[entry] += sum over pixels of weight * image gradient, N entries at once: V vectors of columns.
template <class F, int V, int N>
F4X_HOT void spread_group(const Scratch& w, const uint8_t* list, const float* weights, int first) {
    constexpr int WIDTH = sizeof(F) / sizeof(float);
    float* row[N];
    F sum[N][V];
    F4X_UNROLL
    for (int k = 0; k < N; ++k) {
        row[k] = row_of<float>(w.feature_gradient, w.stride, list[k]) + first;
        F4X_UNROLL
        for (int v = 0; v < V; ++v) sum[k][v] = load<F>(row[k] + WIDTH * v);
    }
    F4X_UNROLL
    for (int pixel = 0; pixel < PIXELS; ++pixel) {
        const float* gradient = w.pixels + size_t(pixel) * w.stride + first;
        F4X_UNROLL
        for (int k = 0; k < N; ++k) {
            const F weight = broadcast<F>(weights[PIXELS * k + pixel]);
            F4X_UNROLL
            for (int v = 0; v < V; ++v) sum[k][v] += weight * load<F>(gradient + WIDTH * v);
        }
    }
    F4X_UNROLL
    for (int k = 0; k < N; ++k)
        F4X_UNROLL
        for (int v = 0; v < V; ++v) store(row[k] + WIDTH * v, sum[k][v]);
}

template <class F, int V>
F4X_HOT void spread_columns(const Scratch& w, const uint8_t* list, int n, int first) {
    int k = 0;
    constexpr int N = V == 1 ? 6 : V == 2 ? 4 : 2;  // as many sums as registers hold
    for (; k + N <= n; k += N) spread_group<F, V, N>(w, list + k, w.weight + PIXELS * k, first);
    for (; k < n; ++k) spread_group<F, V, 1>(w, list + k, w.weight + PIXELS * k, first);
}

#if defined(F4X_WIDE)
// The same for eight columns: two entries a vector, P vectors at once. Pixels are added one after the other, as by narrow vectors.
template <int P>
F4X_HOT void spread_eight(const Scratch& w, const uint8_t* list, const float* weights, int first) {
    float* row[2 * P];
    f16 sum[P], weight[2 * P];
    F4X_UNROLL
    for (int k = 0; k < 2 * P; ++k) {
        row[k] = row_of<float>(w.feature_gradient, w.stride, list[k]) + first;
        weight[k] = load<f16>(weights + PIXELS * k);
    }
    F4X_UNROLL
    for (int k = 0; k < P; ++k) sum[k] = join(load(row[2 * k]), load(row[2 * k + 1]));
    const i16 entry = {0, 0, 0, 0, 0, 0, 0, 0, 16, 16, 16, 16, 16, 16, 16, 16};  // numbers of the first pixels of two entries
    F4X_UNROLL
    for (int pixel = 0; pixel < PIXELS; ++pixel) {
        const f16 gradient = twice(w.pixels + size_t(pixel) * w.stride + first);
        F4X_UNROLL
        for (int k = 0; k < P; ++k) sum[k] += pick(weight[2 * k], entry + pixel, weight[2 * k + 1]) * gradient;
    }
    F4X_UNROLL
    for (int k = 0; k < P; ++k) {
        store(row[2 * k], lower(sum[k]));
        store(row[2 * k + 1], upper(sum[k]));
    }
}

F4X_HOT void spread_eight_columns(const Scratch& w, const uint8_t* list, int n, int first) {
    int k = 0;
    constexpr int P = 4;  // enough sums to hide the latency of a multiply-add
    for (; k + 2 * P <= n; k += 2 * P) spread_eight<P>(w, list + k, w.weight + PIXELS * k, first);
    for (; k + 2 <= n; k += 2) spread_eight<1>(w, list + k, w.weight + PIXELS * k, first);
    if (k < n) {
        spread_group<f8, 1, 1>(w, list + k, w.weight + PIXELS * k, first);
    }
}
#endif

F4X_TARGET void spread(const Scratch& w, int block, int n) {
    const uint8_t* list = w.list[block];
    int first = 0;
#if defined(F4X_WIDE)
    for (; w.stride - first >= 48; first += 48) spread_columns<f16, 3>(w, list, n, first);
    for (; w.stride - first >= 32; first += 32) spread_columns<f16, 2>(w, list, n, first);
    for (; w.stride - first >= 16; first += 16) spread_columns<f16, 1>(w, list, n, first);
    if (first < w.stride) spread_eight_columns(w, list, n, first);
#else
    while (first < w.stride) {
        const int vectors = (w.stride - first) / 8;
        switch (vectors) {
            case 1: spread_columns<f8, 1>(w, list, n, first); break;
            case 2: spread_columns<f8, 2>(w, list, n, first); break;
            case 3: spread_columns<f8, 3>(w, list, n, first); break;
            case 4: spread_columns<f8, 4>(w, list, n, first); break;
            default: spread_columns<f8, 5>(w, list, n, first);
        }
        first += 8 * std::min(vectors, 5);
    }
#endif
}

// Eight floats; twice where vectors are wide, whose halves are the upper and the lower two rows of a block's pixels.
#if defined(F4X_WIDE)
F4X_HOT fp for_each_half(const float* from) { return twice(from); }
#else
F4X_HOT fp for_each_half(const float* from) { return load(from); }
#endif

// Sums over eight pixels, a vector each and an entry a lane, of v (1, x, y, x^2, x y, y^2) about the centre of their two rows.
struct BlockMoments {
    fp m0, mx, my, mxx, mxy, myy;
};

F4X_HOT BlockMoments block_moments(const fp* pixel) {
    const fp half = broadcast<fp>(0.5f), quarter = broadcast<fp>(0.25f);
    fp sum[4], lean[4];  // per column x = -1.5, -0.5, 0.5, 1.5: sum over rows, and twice that of v y
    BlockMoments m;
    for (int x = 0; x < 4; ++x) {
        sum[x] = pixel[4 + x] + pixel[x];
        lean[x] = pixel[4 + x] - pixel[x];
    }
    const fp outer = sum[0] + sum[3], inner = sum[1] + sum[2];
    m.m0 = outer + inner;
    m.mx = broadcast<fp>(1.5f) * (sum[3] - sum[0]) + half * (sum[2] - sum[1]);
    m.my = half * (lean[0] + lean[1] + lean[2] + lean[3]);
    m.mxx = broadcast<fp>(2.25f) * outer + quarter * inner;
    m.mxy = broadcast<fp>(0.75f) * (lean[3] - lean[0]) + quarter * (lean[2] - lean[1]);
    m.myy = quarter * m.m0;
    return m;
}

// moments[entry] += sum over pixels of v (1, u, dy, u^2, u dy, dy^2), u = dx - slope dy. Eight entries at once, two rows of pixels
// after the other, or both as the halves of wide vectors: the sums are taken about the centre of two rows, then sheared and
// moved to the mean. Those of two rows are added before those of the next, so that wide vectors give the same bits.
F4X_TARGET void add_moments(Scratch& w, int block, int n, float centre_x, float first_y, const float* v) {
    const uint8_t* list = w.list[block];
    fp centre_y = broadcast<fp>(first_y);
#if defined(F4X_WIDE)
    centre_y = join(broadcast(first_y), broadcast(first_y + STRIP_HEIGHT));
#endif
    for (int first = 0; first < n; first += 8) {
        fp pixel[8], hot[8];  // entries behind the last hold anything: nothing of them is stored
        for (int k = 0; k < 8; ++k) {
            pixel[k] = load<fp>(v + PIXELS * (first + k));
            hot[k] = for_each_half(&w.hot[list[first + k]].x);
        }
        transpose(pixel);
        transpose(hot);
        const BlockMoments m = block_moments(pixel);
        const fp slope = hot[3], y = centre_y - hot[1], u = broadcast<fp>(centre_x) - hot[0] - slope * y;
        const fp mu = m.mx - slope * m.my, muy = m.mxy - slope * m.myy, muu = m.mxx - slope * (m.mxy + muy);
        const fp sum_u = mu + u * m.m0, two_my = m.my + m.my, zero = broadcast<fp>(0.0f);
        fp row[8] = {m.m0,
                     sum_u,
                     m.my + y * m.m0,
                     muu + u * (mu + sum_u),
                     muy + u * m.my + y * sum_u,
                     m.myy + y * (two_my + y * m.m0),
                     zero,
                     zero};
        transpose(row);
        const int last = std::min(n - first, 8);
        for (int k = 0; k < last; ++k) {
            float* total = w.moments + 8 * list[first + k];
#if defined(F4X_WIDE)
            store(total, load(total) + lower(row[k]) + upper(row[k]));
#else
            store(total, load(total) + row[k]);
#endif
        }
    }
}

F4X_TARGET void backward_tile(const Problem& p, State& s, Scratch& w, int tile, const Gradients& g) {
    const Tile t = tile_of(s, tile);
    const int columns = 1 + p.attached, vectors = row_vectors(p);
    fp behind[BLOCKS];  // per pixel: gradient carried by what lies behind, sum of w S over later splats + background
    bool started[BLOCKS] = {};
    const int chunks = s.chunks_done[tile];
    for (int c = chunks - 1; c >= 0; --c) {
        const int64_t begin = t.begin + int64_t(c) * CHUNK;
        const int n = int(std::min<int64_t>(CHUNK, t.end - begin));
        const float* before = s.running + (s.chunk_start[tile] + c) * TILE_PIXELS;
        uint32_t live = 0;
        for (int block = 0; block < BLOCKS; block += BLOCK_STRIPS)
            if (mask_bits(load<fp>(before + 8 * block) > broadcast<fp>(0.0f))) live |= 1u << block;
        stage<false>(p, s, t, begin, n, live, w);
        std::memset(w.moments, 0, sizeof(float) * 8 * n);
        std::memset(w.feature_gradient, 0, sizeof(float) * w.stride * n);
        for (int block = 0; block < BLOCKS; block += BLOCK_STRIPS) {
            if (!w.length[block]) continue;
            const int x = block_x(t, block), y = block_y(t, block);
            const fp gradient_behind = load_gradient(p, g, x, y, w);
            if (!started[block]) behind[block] = gradient_behind * load<fp>(s.final + size_t(tile) * TILE_PIXELS + 8 * block);
            started[block] = true;
            fp running = load<fp>(before + 8 * block), final = running;
            const int m = block_weights(p, w, block, x, y, running, final, w.alpha, w.weight);
            int k = 0;
            constexpr int N = BLOCK_STRIPS == 2 ? 8 : 6;  // as many sums as registers hold
            for (; k + N <= m; k += N) dot_group<N>(w, w.list[block] + k, columns, w.dot + PIXELS * k);
            for (; k < m; ++k) dot_group<1>(w, w.list[block] + k, columns, w.dot + PIXELS * k);
            // With S = dot, dL/d(log alpha) = w S - alpha / (1 - alpha) * behind; no gradient where alpha is clamped.
            fp later = behind[block];
            const fp one = broadcast<fp>(1.0f), alpha_max = broadcast<fp>(p.alpha_max);
            for (k = m - 1; k >= 0; --k) {
                const fp alpha = load<fp>(w.alpha + PIXELS * k);
                const fp share = load<fp>(w.weight + PIXELS * k) * load<fp>(w.dot + PIXELS * k);
                store(w.dot + PIXELS * k, keep_where(alpha < alpha_max, share - later * (alpha / (one - alpha))));
                later += share;
            }
            behind[block] = later;
            add_moments(w, block, m, x + 0.5f * BLOCK_WIDTH, y + 0.5f * STRIP_HEIGHT, w.dot);
            spread(w, block, m);
        }
        for (int k = 0; k < n; ++k) {
            const int64_t pair = s.entries[begin + k].pair;
            f8* row = s.rows + pair * vectors;
            const float* gradient = w.feature_gradient + size_t(k) * w.stride;
            row[0] = load(w.moments + 8 * k);
            for (int v = 1; v < vectors; ++v) row[v] = load(gradient + 8 * (v - 1));
            s.touched[pair] = 1;
        }
    }
}

// How many (pixel, splat) pairs of a kept forward pass contributed: what its work is measured by.
F4X_TARGET int64_t count_tile(const Problem& p, State& s, Scratch& w, int tile) {
    const Tile t = tile_of(s, tile);
    int64_t pairs = 0;
    for (int c = 0; c < s.chunks_done[tile]; ++c) {
        const int64_t begin = t.begin + int64_t(c) * CHUNK;
        const float* before = s.running + (s.chunk_start[tile] + c) * TILE_PIXELS;
        stage<false>(p, s, t, begin, int(std::min<int64_t>(CHUNK, t.end - begin)), ~0u, w);
        for (int block = 0; block < BLOCKS; block += BLOCK_STRIPS) {
            fp running = load<fp>(before + 8 * block), final = running;
            const int m = block_weights(p, w, block, block_x(t, block), block_y(t, block), running, final, w.alpha, w.weight);
            for (int k = 0; k < m; ++k) {
                const ip adds = load<fp>(w.weight + PIXELS * k) > broadcast<fp>(0.0f);
                for (uint32_t bits = mask_bits(adds); bits; bits &= bits - 1) ++pairs;
            }
        }
    }
    return pairs;
}

// From the sums over pixels, moments and depth, back to the parameters of eight Gaussians; zeros where `any` is not set.
// Adds the camera gradient to `camera`, lane by lane.
F4X_HOT void unproject_eight(const Problem& p, int64_t i, int64_t end, const f8* sum, const f8& depth, const i8& any,
                             const Gradients& g, double (*camera)[8]) {
    Projection o;
    project_eight(p, i, end, o);
    const float *w = p.viewmat;
    const f8 zero = broadcast(0.0f), two = broadcast(2.0f);
    f8 opacity;
    load_rows<1>(p.opacities, i, end, &opacity);
    opacity = keep_where(any, sum[0] / opacity);
    store_rows<1>(g.opacities, i, end, &opacity);

    const f8 inverse_syy = broadcast(1.0f) / o.syy;
    const f8 a = o.syy / o.det, slope = o.sxy * inverse_syy, c = inverse_syy;
    const f8 mean_x = a * sum[1], mean_y = c * sum[2] - slope * mean_x;
    const f8 offset[2] = {keep_where(any, mean_x), keep_where(any, mean_y)};
    store_rows<2>(g.offset, i, end, offset);

    // With Q the conic and M the second moments, dL/dQ = -M/2 and Q = (t t^T + blur)^-1, hence dL/dt = (Q M Q) t; here in
    // the sheared frame of u, where Q = diag(a, c).
    const f8 h00 = a * a * sum[3], h01 = a * c * sum[4], h11 = c * c * sum[5];
    f8 side[2][3], scale[3];  // dL/d(J W R), dL/dscale
    for (int k = 0; k < 3; ++k) {
        const f8 tu = o.t[0][k] - slope * o.t[1][k], ty = o.t[1][k];
        const f8 d0 = h00 * tu + h01 * ty, d1 = h01 * tu + h11 * ty - slope * d0;
        scale[k] = keep_where(any, d0 * o.side[0][k] + d1 * o.side[1][k]);
        side[0][k] = d0 * o.scale[k];
        side[1][k] = d1 * o.scale[k];
    }
    store_rows<3>(g.scales, i, end, scale);
    f8 j00 = zero, j02 = zero, j11 = zero, j12 = zero, world[9];
    for (int k = 0; k < 3; ++k) {
        j00 += side[0][k] * o.world[k];
        j02 += side[0][k] * o.world[6 + k];
        j11 += side[1][k] * o.world[3 + k];
        j12 += side[1][k] * o.world[6 + k];
        world[k] = o.j00 * side[0][k];
        world[3 + k] = o.j11 * side[1][k];
        world[6 + k] = o.j02 * side[0][k] + o.j12 * side[1][k];
    }

    // Camera-frame point: through the pixel, the Jacobian and the depth channel.
    const f8 x = o.p[0] * o.inverse_z, y = o.p[1] * o.inverse_z, square = o.inverse_z * o.inverse_z;
    const f8 u = keep_where(o.u_free, zero - j02 * broadcast(p.intrinsics[0]) * square);
    const f8 v = keep_where(o.v_free, zero - j12 * broadcast(p.intrinsics[4]) * square);
    f8 point[3] = {mean_x * o.j00, mean_y * o.j11, depth};
    const f8 stretch = j00 * o.j00 + j02 * o.j02 + j11 * o.j11 + j12 * o.j12;
    point[0] += u;
    point[1] += v;
    point[2] = depth - point[0] * x - point[1] * y - stretch * o.inverse_z;

    f8 mean[3], r[9];  // r = dL/dR = W^T dL/d(W R)
    for (int k = 0; k < 3; ++k) {
        const f8 w0 = broadcast(w[k]), w1 = broadcast(w[4 + k]), w2 = broadcast(w[8 + k]);
        mean[k] = keep_where(any, w0 * point[0] + w1 * point[1] + w2 * point[2]);
        for (int j = 0; j < 3; ++j) r[3 * k + j] = w0 * world[j] + w1 * world[3 + j] + w2 * world[6 + j];
    }
    store_rows<3>(g.means, i, end, mean);
    for (int k = 0; k < 3; ++k)
        for (int j = 0; j < 4; ++j) {
            const f8 sent = j == 3 ? point[k]
                                   : point[k] * o.mean[j] + world[3 * k] * o.rotation[3 * j] +
                                         world[3 * k + 1] * o.rotation[3 * j + 1] + world[3 * k + 2] * o.rotation[3 * j + 2];
            alignas(32) float lanes[8];
            store(lanes, keep_where(any, sent));
            for (int lane = 0; lane < 8; ++lane) camera[4 * k + j][lane] += lanes[lane];
        }

    const f8 qw = o.q[0], qx = o.q[1], qy = o.q[2], qz = o.q[3];
    f8 q[4] = {
        two * (qx * (r[7] - r[5]) + qy * (r[2] - r[6]) + qz * (r[3] - r[1])),
        two * (qw * (r[7] - r[5]) + qy * (r[1] + r[3]) + qz * (r[2] + r[6]) - two * qx * (r[4] + r[8])),
        two * (qw * (r[2] - r[6]) + qx * (r[1] + r[3]) + qz * (r[5] + r[7]) - two * qy * (r[0] + r[8])),
        two * (qw * (r[3] - r[1]) + qx * (r[2] + r[6]) + qy * (r[5] + r[7]) - two * qz * (r[0] + r[4]))};
    const f8 along = q[0] * qw + q[1] * qx + q[2] * qy + q[3] * qz;
    const i8 turns = any & (o.norm >= broadcast(1e-12f));
    for (int k = 0; k < 4; ++k) q[k] = keep_where(turns, (q[k] - along * o.q[k]) / o.norm);
    store_rows<4>(g.quats, i, end, q);
}

// No gradient to the parameters of Gaussians `begin` to `end`, which contributed to no pixel.
F4X_HOT void clear_rows(int64_t begin, int64_t end, const Gradients& g) {
    const std::pair<float*, int> widths[] = {{g.means, 3}, {g.quats, 4}, {g.scales, 3}, {g.opacities, 1}, {g.offset, 2}};
    for (const auto& [rows, width] : widths) std::fill(rows + begin * width, rows + end * width, 0.0f);
}

// Sums the rows of every Gaussian and carries them on to its parameters; adds to camera[12].
F4X_TARGET void gather(const Problem& p, State& s, int64_t begin, int64_t end, const Gradients& g, double* camera) {
    const int vectors = row_vectors(p);
    Buffer<f8> table;
    f8* sums = table.resize(size_t(8) * vectors);
    double cameras[12][8] = {};
    for (int64_t i = begin; i < end; i += 8) {
        std::memset(sums, 0, sizeof(f8) * 8 * vectors);
        i8 any = {};
        for (int lane = 0; lane < 8 && i + lane < end; ++lane) {
            f8* sum = sums + lane * vectors;
            for (int64_t pair = s.extents[i + lane].pair; pair < s.extents[i + lane + 1].pair; ++pair) {
                if (!s.touched[pair]) continue;
                any[lane] = -1;
                const f8* row = s.rows + pair * vectors;
                for (int v = 0; v < vectors; ++v) sum[v] += row[v];
            }
            const float* colors = reinterpret_cast<const float*>(sum + 1) + 1;
            copy_floats(g.colors + (i + lane) * p.channels, colors, p.channels);
        }
        if (!mask_bits(any)) {
            clear_rows(i, std::min(i + 8, end), g);
            continue;
        }
        f8 moments[8], depth = broadcast(0.0f);
        for (int lane = 0; lane < 8; ++lane) {
            moments[lane] = sums[lane * vectors];
            depth[lane] = sums[lane * vectors + 1][0];
        }
        transpose(moments);
        unproject_eight(p, i, end, moments, depth, any, g, cameras);
    }
    for (int k = 0; k < 12; ++k)
        for (int lane = 0; lane < 8; ++lane) camera[k] += cameras[k][lane];
}

constexpr const char* NAMES[] = {"plain", "avx2", "avx512", "avx512-wide"};
const Kernels kernels = {
#if defined(F4X_WIDE)
    NAMES[3],
#elif defined(F4X_AVX512)
    NAMES[2],
#elif defined(F4X_AVX2)
    NAMES[1],
#else
    NAMES[0],
#endif
    project, measure, forward_tile, backward_tile, count_tile, gather};

#undef F4X_HOT

}  // namespace F4X_ISA
}  // namespace

#endif
