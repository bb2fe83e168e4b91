// As-rigid-as-possible losses of the scaffold and their gradients; see scaffold/losses.py for the formulas. Edge by edge, eight
// times at once: the poses are turned first so that the times of one number lie side by side. Edges are cut into parts with sums
// of their own, which are added in order; how many there are does not depend on the threads.

#ifndef F4X_ISA

#include <cstdint>
#include <exception>
#include <vector>

#include "lanes.hpp"
#include "threads.hpp"

// Mirrored field by field in arap.py.
struct Arap {
    int64_t edges, leading;            // edges from `leading` on send no gradient to the position of the neighbour
    int32_t frames, nodes, shifts, threads;
    const float *xyz, *axes;           // (F, M, 3), (F, M, 3, 3) with the nodes' axes as columns
    const int64_t *node, *neighbour;   // (E,)
    const float* weight;               // (E,)
    const int32_t* shift;              // (S,) frames apart, from 1 to F - 1
    const float* factor;               // (S,)
    double* losses;                    // (2,): of coordinates and of lengths
    float *d_coordinate, *d_length;    // (F, M, 3): gradients of the two losses to the positions
    float* d_axes;                     // (F, M, 3, 3): of the first one
};

using namespace f4x;

namespace {
constexpr int MAX_PARTS = 8;
constexpr int64_t EDGES_OF_A_PART = 256;

// Poses with times last: (M, 3, stride) and (M, 9, stride), zero beyond the last time.
struct Turned {
    int stride;
    std::vector<float> xyz, axes;
};

// What a part of the edges adds up to, in the same layout.
struct Sums {
    std::vector<float> d_coordinate, d_length, d_axes;
    double losses[2];
};

// (F, rows) -> (rows, stride)
void turn(const float* from, int frames, int64_t rows, int stride, std::vector<float>& to) {
    to.assign(rows * stride, 0.0f);
    for (int t = 0; t < frames; ++t)
        for (int64_t r = 0; r < rows; ++r) to[r * stride + t] = from[t * rows + r];
}

struct ArapKernels {
    void (*run)(const Arap&, const Turned&, int64_t begin, int64_t end, Sums&);
};
}  // namespace

#define F4X_FILE "arap.cpp"
#include "each_isa.hpp"

namespace {
void arap(const Arap& a) {
    Turned w;
    w.stride = (a.frames + 7) / 8 * 8 + 8;  // eight times from any one on can be read
    turn(a.xyz, a.frames, 3 * int64_t(a.nodes), w.stride, w.xyz);
    turn(a.axes, a.frames, 9 * int64_t(a.nodes), w.stride, w.axes);
    const int64_t parts = std::max<int64_t>(1, std::min<int64_t>(MAX_PARTS, a.edges / EDGES_OF_A_PART));
    std::vector<Sums> sums(parts);
    parallel(a.threads, parts, [&](std::atomic<int64_t>& cursor) {
        for (int64_t part; (part = cursor++) < parts;) {
            Sums& own = sums[part];
            own.d_coordinate.assign(w.xyz.size(), 0.0f);
            own.d_length.assign(w.xyz.size(), 0.0f);
            own.d_axes.assign(w.axes.size(), 0.0f);
            kernels().run(a, w, a.edges * part / parts, a.edges * (part + 1) / parts, own);
        }
    });
    const int64_t nodes = a.nodes;
    const auto add_up = [&](std::vector<float> Sums::*kind, int width, int64_t node, float* to) {
        for (int64_t r = width * node; r < width * (node + 1); ++r)
            for (int t = 0; t < a.frames; ++t) {
                float sum = 0;
                for (const Sums& own : sums) sum += (own.*kind)[r * w.stride + t];
                to[t * width * nodes + r] = sum;
            }
    };
    parallel(a.threads, nodes, [&](std::atomic<int64_t>& cursor) {
        for (int64_t node; (node = cursor++) < nodes;) {
            add_up(&Sums::d_coordinate, 3, node, a.d_coordinate);
            add_up(&Sums::d_length, 3, node, a.d_length);
            add_up(&Sums::d_axes, 9, node, a.d_axes);
        }
    });
    a.losses[0] = a.losses[1] = 0;
    for (const Sums& own : sums)
        for (int k = 0; k < 2; ++k) a.losses[k] += own.losses[k];
}
}  // namespace

// 1 where memory runs out.
F4X_API int32_t f4x_arap(const Arap* a) {
    try {
        arap(*a);
        return 0;
    } catch (const std::exception&) {
        return 1;
    }
}

#else  // ------------------------------------------------------------------------------- compiled once per instruction set

namespace {
namespace F4X_ISA {

#include "lanes_isa.hpp"

// One edge at all times, rows of `stride`: the neighbour's offset to the node, the same in its own axes, and its length.
struct Edge {
    int stride;
    std::vector<float> offset, local, length, d_local, d_length;

    explicit Edge(int stride)
        : stride(stride), offset(3 * stride), local(3 * stride), length(stride), d_local(3 * stride), d_length(stride) {}
};

F4X_HOT void add(float* to, const f8& v) { store(to, load(to) + v); }

F4X_TARGET void look(Edge& edge, const float* node, const float* neighbour, const float* axes, int frames) {
    const int P = edge.stride;
    for (int t = 0; t < frames; t += 8) {
        f8 o[3];
        for (int i = 0; i < 3; ++i) {
            o[i] = load(node + i * P + t) - load(neighbour + i * P + t);
            store(edge.offset.data() + i * P + t, o[i]);
        }
        for (int j = 0; j < 3; ++j)
            store(edge.local.data() + j * P + t, load(axes + j * P + t) * o[0] + load(axes + (3 + j) * P + t) * o[1] +
                                                     load(axes + (6 + j) * P + t) * o[2]);
        store(edge.length.data() + t, root(o[0] * o[0] + o[1] * o[1] + o[2] * o[2]));
    }
}

// Adds what differs between times `shift` apart to the two losses, and its derivatives to those of the edge.
F4X_TARGET void compare(Edge& edge, int frames, int shift, float scale, f8* losses) {
    const int P = edge.stride;
    const f8 zero = broadcast(0.0f), one = broadcast(1.0f), times = broadcast(scale);
    const f8 lane = {0.f, 1.f, 2.f, 3.f, 4.f, 5.f, 6.f, 7.f};
    for (int t = 0; t < frames - shift; t += 8) {
        const i8 there = lane < broadcast(float(frames - shift - t));
        f8 d[3], squared = zero;
        for (int j = 0; j < 3; ++j) {
            d[j] = load(edge.local.data() + j * P + t + shift) - load(edge.local.data() + j * P + t);
            squared += d[j] * d[j];
        }
        const f8 norm = root(squared);
        const i8 moves = there & (norm > zero);
        losses[0] += keep_where(there, norm) * times;
        const f8 unit = keep_where(moves, times / select(moves, norm, one));
        for (int j = 0; j < 3; ++j) {
            const f8 pull = d[j] * unit;
            add(edge.d_local.data() + j * P + t + shift, pull);
            add(edge.d_local.data() + j * P + t, zero - pull);
        }
        const f8 longer = load(edge.length.data() + t + shift) - load(edge.length.data() + t);
        losses[1] += keep_where(there, maximum(longer, zero - longer)) * times;
        const f8 side = keep_where(there & (longer > zero), times) - keep_where(there & (longer < zero), times);
        add(edge.d_length.data() + t + shift, side);
        add(edge.d_length.data() + t, zero - side);
    }
}

struct Target {
    float *coordinate, *length;
};

// Sends the derivatives of the edge on to both nodes and to the axes, and clears them.
F4X_TARGET void send(Edge& edge, const float* axes, float* d_axes, Target node, Target neighbour, int frames) {
    const int P = edge.stride;
    const f8 zero = broadcast(0.0f), one = broadcast(1.0f);
    for (int t = 0; t < frames; t += 8) {
        f8 d[3];
        for (int j = 0; j < 3; ++j) {
            d[j] = load(edge.d_local.data() + j * P + t);
            store(edge.d_local.data() + j * P + t, zero);
        }
        const f8 length = load(edge.length.data() + t), d_length = load(edge.d_length.data() + t);
        const f8 along = keep_where(length > zero, d_length / select(length > zero, length, one));
        store(edge.d_length.data() + t, zero);
        for (int i = 0; i < 3; ++i) {
            const f8 o = load(edge.offset.data() + i * P + t);
            f8 sum = zero;
            for (int j = 0; j < 3; ++j) {
                sum += load(axes + (3 * i + j) * P + t) * d[j];
                add(d_axes + (3 * i + j) * P + t, o * d[j]);
            }
            add(node.coordinate + i * P + t, sum);
            add(node.length + i * P + t, o * along);
            if (neighbour.coordinate) {
                add(neighbour.coordinate + i * P + t, zero - sum);
                add(neighbour.length + i * P + t, zero - o * along);
            }
        }
    }
}

F4X_TARGET void run(const Arap& a, const Turned& w, int64_t begin, int64_t end, Sums& sums) {
    const int64_t P = w.stride;
    Edge edge(w.stride);
    sums.losses[0] = sums.losses[1] = 0;
    for (int64_t e = begin; e < end; ++e) {
        const int64_t from = a.node[e], to = a.neighbour[e];
        const float* axes = w.axes.data() + 9 * P * to;
        look(edge, w.xyz.data() + 3 * P * from, w.xyz.data() + 3 * P * to, axes, a.frames);
        f8 losses[2] = {broadcast(0.0f), broadcast(0.0f)};
        for (int s = 0; s < a.shifts; ++s) compare(edge, a.frames, a.shift[s], a.weight[e] * a.factor[s], losses);
        for (int k = 0; k < 2; ++k)
            for (int lane = 0; lane < 8; ++lane) sums.losses[k] += losses[k][lane];
        const Target node{sums.d_coordinate.data() + 3 * P * from, sums.d_length.data() + 3 * P * from};
        const Target neighbour{e < a.leading ? sums.d_coordinate.data() + 3 * P * to : nullptr,
                               e < a.leading ? sums.d_length.data() + 3 * P * to : nullptr};
        send(edge, axes, sums.d_axes.data() + 9 * P * to, node, neighbour, a.frames);
    }
}

const ArapKernels kernels = {run};

#undef F4X_HOT

}  // namespace F4X_ISA
}  // namespace

#endif
