// How nodes carry Gaussians, with a hand-written backward pass. The formulas, with their sources, are those of
// scaffold/skinning.py and scaffold/deformation/reference.py, where they stand in numpy and torch.
//
//   relate   tables with one row per (node, reference) pair: node pose then, motion from then to each time
//   deform   per Gaussian: pose in the world, skinning weights, dual-quaternion blend, moved pose
//
// Eight pairs or Gaussians at a time, one per lane. The backward pass repeats the forward pass of its eight Gaussians instead of reading what that one would have stored.
// Table gradients are summed per part of the Gaussians, and the parts in order. The size of the problem decides how many parts
// there are, so the result is the same bit for bit for every number of threads.

#ifndef F4X_ISA

#include <cstdint>
#include <exception>
#include <limits>
#include <utility>
#include <vector>

#include "lanes.hpp"
#include "threads.hpp"

// Both are mirrored field by field in scaffold/deformation/native/library.py.

struct Relations {
    int64_t pairs, nodes;                // P, M
    int32_t times, threads;              // T
    const float *node_xyz, *node_quat;   // (F M, 3), (F M, 4) of any length
    const float* radius;                 // (M,)
    const int64_t *node, *then;          // (P,) rows of (M,) and of (F M)
    const float *now_xyz, *now_quat;     // (T, M, 3), (T, M, 4) unit
    float* tables;                       // (1 + T, P, 8): nodes and motions of Deformation, written by the forward pass
    const float* d_tables;               // gradient of these; the backward pass adds to those that follow
    float *d_node_xyz, *d_node_quat, *d_radius, *d_now_xyz, *d_now_quat;
};

struct Deformation {
    int64_t count, pairs;                  // N, P
    int32_t slots, times, sigma, threads;  // K, T, whether the kernel is "sigma"
    float floor, smallest_spread, sign_band, collapsed;
    const float *xyz, *quat;               // (N, 3), (N, 4) in the frame of the node of slot 0 at the reference time
    const int32_t* index;                  // (N, K) rows of the tables
    const float* motions;                  // (T, P, 8) unit dual quaternions
    const float* nodes;                    // (P, 8) position, radius, unit quaternion at the reference time
    const uint8_t* mask;                   // (N, K)
    const float* dw;                       // (N, K) or null
    const float* weights;                  // (N, K): then xyz and quat are in the world and the three above are not read
    const float* strength;                 // (N,), with weights only; null = 1
    float *means, *quats;                  // (T, N, 3), (T, N, 4), written by the forward pass
    const float *d_means, *d_quats;        // gradients of these
    float *d_xyz, *d_quat, *d_dw;          // written by the backward pass; d_dw may be null
    float* d_tables;                       // (1 + T, P, 8) of nodes and motions; the backward pass adds to it
};

using namespace f4x;

namespace {

constexpr int ROW = 8;  // floats per row of a table

// One neighbour of each of eight Gaussians. Without AVX compilers align f8 to 16 bytes only; the AVX2 half counts on 32.
struct alignas(32) Slot {
    int32_t row[8];
    f8 offset[3], radius, inverse_spread, exponential;
    f8 side;    // derivative of the weight before division by the sum: -1, 0 or 1
    f8 weight;
    f8 motion[ROW], sign;  // at one time
    f8 d_weight, d_node[ROW];
};

typedef void (*Forward)(const Deformation&, int64_t begin, int64_t end);
typedef void (*Backward)(const Deformation&, int64_t begin, int64_t end, float* d_tables);
struct DeformationKernels {
    Forward forward;
    Backward backward;
    void (*relate)(const Relations&, int64_t begin, int64_t end);
    void (*unrelate)(const Relations&, int64_t begin, int64_t end);
};

}  // namespace

#define F4X_FILE "deformation.cpp"
#include "each_isa.hpp"

namespace {

constexpr int64_t MAX_PARTS = 16;      // threads that a backward pass keeps busy
constexpr int64_t PAIRS_OF_A_PART = 512;
constexpr int64_t SUMS_PER_ENTRY = 4;  // a part adds at least so many times more numbers than its table has

// Parts of equal size that Gaussians are cut into, each with a table of `size` floats of its own.
int64_t count_parts(const Deformation& d, int64_t size) {
    const int64_t sums = d.count * d.slots * (1 + d.times) * ROW;
    return std::max<int64_t>(1, std::min(MAX_PARTS, sums / std::max<int64_t>(1, SUMS_PER_ENTRY * size)));
}

void backward(const Deformation& d) {
    const int64_t batches = (d.count + 7) / 8, size = (1 + d.times) * d.pairs * ROW, parts = count_parts(d, size);
    static thread_local Buffer<float> memory;  // kept: a training loop does not fault in fresh pages at every step
    float* more = memory.resize((parts - 1) * size);  // the first part adds to the result itself
    parallel(d.threads, parts, [&](std::atomic<int64_t>& cursor) {
        for (int64_t part; (part = cursor++) < parts;) {
            const int64_t begin = batches * part / parts * 8, end = std::min(d.count, batches * (part + 1) / parts * 8);
            float* table = part ? more + (part - 1) * size : d.d_tables;
            if (part) std::fill(table, table + size, 0.0f);
            kernels().backward(d, begin, end, table);
        }
    });
    parallel_ranges(d.threads, size, [&](int64_t begin, int64_t end) {
        for (int64_t part = 1; part < parts; ++part)
            for (int64_t i = begin; i < end; ++i) d.d_tables[i] += more[(part - 1) * size + i];
    });
}

// Pairs differ, so each has rows of its own among the nodes at all times. What is summed by node (radius, and the poses now) has
// a table for each part of the pairs, added in order.
void relate_backward(const Relations& r) {
    const int64_t batches = (r.pairs + 7) / 8, parts = std::max<int64_t>(1, std::min(MAX_PARTS, r.pairs / PAIRS_OF_A_PART));
    const int64_t row = 1 + 7 * int64_t(r.times), size = row * r.nodes;
    std::vector<float> tables(parts * size, 0.0f);
    parallel(r.threads, parts, [&](std::atomic<int64_t>& cursor) {
        for (int64_t part; (part = cursor++) < parts;) {
            Relations own = r;
            own.d_radius = &tables[part * size];
            own.d_now_xyz = own.d_radius + r.nodes;
            own.d_now_quat = own.d_now_xyz + 3 * r.times * r.nodes;
            kernels().unrelate(own, batches * part / parts * 8, std::min(r.pairs, batches * (part + 1) / parts * 8));
        }
    });
    const std::pair<float*, int64_t> sums[] = {
        {r.d_radius, r.nodes}, {r.d_now_xyz, 3 * r.times * r.nodes}, {r.d_now_quat, 4 * r.times * r.nodes}};
    for (int64_t part = 0; part < parts; ++part) {
        const float* from = &tables[part * size];
        for (const auto& [to, count] : sums)
            for (int64_t i = 0; i < count; ++i) to[i] += *from++;
    }
}

// Returns 1 when memory ran out, else 0.
template <class Work>
int32_t guarded(const Work& work) {
    try {
        work();
        return 0;
    } catch (const std::exception&) {
        return 1;
    }
}

}  // namespace

// --------------------------------------------------------------------------------------------------------- C interface

// Both return 1 when memory ran out, else 0.
F4X_API int32_t f4x_relate(const Relations* r) {
    return guarded([&] {
        parallel_ranges(r->threads, r->pairs, [&](int64_t begin, int64_t end) { kernels().relate(*r, begin, end); });
    });
}

F4X_API int32_t f4x_relate_backward(const Relations* r) {
    return guarded([&] { relate_backward(*r); });
}

F4X_API int32_t f4x_deform(const Deformation* d) {
    return guarded([&] {
        parallel_ranges(d->threads, d->count, [&](int64_t begin, int64_t end) { kernels().forward(*d, begin, end); });
    });
}

F4X_API int32_t f4x_deform_backward(const Deformation* d) {
    return guarded([&] { backward(*d); });
}

#else  // ------------------------------------------------------------------------------- compiled once per instruction set

namespace {
namespace F4X_ISA {

#include "lanes_isa.hpp"

// --------------------------------------------------------------------------------------------- vectors and quaternions

struct Vector {
    f8 x, y, z;
};
struct Quaternion {
    f8 w, x, y, z;
};

F4X_HOT Vector operator+(const Vector& a, const Vector& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
F4X_HOT Vector operator*(const Vector& a, const f8& s) { return {a.x * s, a.y * s, a.z * s}; }
F4X_HOT f8 dot(const Vector& a, const Vector& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
F4X_HOT Vector cross(const Vector& a, const Vector& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

F4X_HOT Quaternion operator+(const Quaternion& a, const Quaternion& b) {
    return {a.w + b.w, a.x + b.x, a.y + b.y, a.z + b.z};
}
F4X_HOT Quaternion operator-(const Quaternion& a, const Quaternion& b) {
    return {a.w - b.w, a.x - b.x, a.y - b.y, a.z - b.z};
}
F4X_HOT Quaternion operator*(const Quaternion& a, const f8& s) { return {a.w * s, a.x * s, a.y * s, a.z * s}; }
F4X_HOT Quaternion operator*(const Quaternion& a, const Quaternion& b) {
    return {a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z, a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
            a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x, a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
}
F4X_HOT f8 dot(const Quaternion& a, const Quaternion& b) { return a.w * b.w + a.x * b.x + a.y * b.y + a.z * b.z; }
F4X_HOT Quaternion conjugate(const Quaternion& q) {
    const f8 zero = broadcast(0.0f);
    return {q.w, zero - q.x, zero - q.y, zero - q.z};
}
F4X_HOT Quaternion pure(const Vector& v) { return {broadcast(0.0f), v.x, v.y, v.z}; }
F4X_HOT Vector imaginary(const Quaternion& q) { return {q.x, q.y, q.z}; }

// Makes q unit; returns 1 / |q|. A zero quaternion becomes the identity and 0 is returned: it gets no gradient.
F4X_HOT f8 normalise(Quaternion& q) {
    const f8 one = broadcast(1.0f), tiny = broadcast(1e-24f), squared = dot(q, q);
    const i8 turned = squared > tiny;
    const f8 inverse_length = keep_where(turned, one / root(maximum(squared, tiny)));
    q = q * inverse_length;
    q.w = select(turned, q.w, one);
    return inverse_length;
}
// Gradient before normalisation, given the results and the gradient after.
F4X_HOT Quaternion d_normalise(const Quaternion& unit, const f8& inverse_length, const Quaternion& gradient) {
    return (gradient - unit * dot(unit, gradient)) * inverse_length;
}

F4X_HOT Vector rotate(const Quaternion& unit, const Vector& v) {
    const Vector u = imaginary(unit), uv = cross(u, v);
    return v + (uv * unit.w + cross(u, uv)) * broadcast(2.0f);
}
// Gradient of rotate to the quaternion, given that of the result. Rotation is q v q*, so <g, dq v q* + q v dq*> gives
// -2 g q v. Its part along q means nothing: q comes from a normalisation, which projects it out.
F4X_HOT Quaternion d_rotate(const Quaternion& unit, const Vector& v, const Vector& gradient) {
    return pure(gradient) * unit * pure(v) * broadcast(-2.0f);
}

// ------------------------------------------------------------------------------------------------------ loads and stores

// The Gaussians of the lanes; past the last one it is repeated.
struct Lanes {
    int64_t at[8];
    int count;
};

F4X_HOT Lanes lanes_of(int64_t begin, int64_t end) {
    Lanes lanes;
    lanes.count = int(std::min<int64_t>(8, end - begin));
    for (int i = 0; i < 8; ++i) lanes.at[i] = begin + std::min(i, lanes.count - 1);
    return lanes;
}

F4X_HOT f8 component(const float* rows, int stride, const Lanes& lanes) {
    alignas(32) float v[8];
    for (int i = 0; i < 8; ++i) v[i] = rows[lanes.at[i] * stride];
    return load(v);
}
F4X_HOT Vector load_vector(const float* rows, const Lanes& l) {
    return {component(rows, 3, l), component(rows + 1, 3, l), component(rows + 2, 3, l)};
}
F4X_HOT Quaternion load_quaternion(const float* rows, const Lanes& l) {
    return {component(rows, 4, l), component(rows + 1, 4, l), component(rows + 2, 4, l), component(rows + 3, 4, l)};
}

F4X_HOT void store_component(float* rows, int stride, const Lanes& lanes, const f8& value) {
    alignas(32) float v[8];
    store(v, value);
    for (int i = 0; i < lanes.count; ++i) rows[lanes.at[i] * stride] = v[i];
}
F4X_HOT void store_vector(float* rows, const Lanes& l, const Vector& v) {
    store_component(rows, 3, l, v.x);
    store_component(rows + 1, 3, l, v.y);
    store_component(rows + 2, 3, l, v.z);
}
F4X_HOT void store_quaternion(float* rows, const Lanes& l, const Quaternion& q) {
    store_component(rows, 4, l, q.w);
    store_component(rows + 1, 4, l, q.x);
    store_component(rows + 2, 4, l, q.y);
    store_component(rows + 3, 4, l, q.z);
}

F4X_HOT void add_component(float* rows, int stride, const Lanes& lanes, const f8& value) {
    alignas(32) float v[8];
    store(v, value);
    for (int i = 0; i < lanes.count; ++i) rows[lanes.at[i] * stride] += v[i];
}
F4X_HOT void add_vector(float* rows, const Lanes& l, const Vector& v) {
    add_component(rows, 3, l, v.x);
    add_component(rows + 1, 3, l, v.y);
    add_component(rows + 2, 3, l, v.z);
}
F4X_HOT void add_quaternion(float* rows, const Lanes& l, const Quaternion& q) {
    add_component(rows, 4, l, q.w);
    add_component(rows + 1, 4, l, q.x);
    add_component(rows + 2, 4, l, q.y);
    add_component(rows + 3, 4, l, q.z);
}

// The eight columns of one table row per lane.
F4X_HOT void gather(const float* table, const int32_t* row, f8* columns) {
    F4X_UNROLL
    for (int i = 0; i < 8; ++i) columns[i] = load(table + ROW * int64_t(row[i]));
    transpose(columns);
}
// -------------------------------------------------------------------------------------------------------------- tables

// Eight pairs: their node poses at the reference times.
struct Pairs {
    Lanes own, node, then;  // rows of the tables, of the nodes, and of the nodes at all times
    Vector x;
    Quaternion q;
    f8 inverse_length;      // of q before it was made unit
};

F4X_HOT Pairs load_pairs(const Relations& r, int64_t begin) {
    Pairs p;
    p.own = p.node = p.then = lanes_of(begin, r.pairs);
    for (int i = 0; i < 8; ++i) {
        p.node.at[i] = r.node[p.own.at[i]];
        p.then.at[i] = r.then[p.own.at[i]];
    }
    p.x = load_vector(r.node_xyz, p.then);
    p.q = load_quaternion(r.node_quat, p.then);
    p.inverse_length = normalise(p.q);
    return p;
}

F4X_HOT void store_rows(float* table, const Lanes& lanes, f8* columns) {
    transpose(columns);
    for (int i = 0; i < lanes.count; ++i) store(table + ROW * lanes.at[i], columns[i]);
}
F4X_HOT void load_rows(const float* table, const Lanes& lanes, f8* columns) {
    for (int i = 0; i < 8; ++i) columns[i] = load(table + ROW * lanes.at[i]);
    transpose(columns);
}

// With (x, q) the pose then and (X, Q) that at another time: motion (P, D) = (Q q*, (X P - P x) / 2).
F4X_TARGET void relate(const Relations& r, int64_t begin, int64_t end) {
    const f8 half = broadcast(0.5f);
    for (int64_t i = begin; i < end; i += 8) {
        const Pairs p = load_pairs(r, i);
        f8 pose[ROW] = {p.x.x, p.x.y, p.x.z, component(r.radius, 1, p.node), p.q.w, p.q.x, p.q.y, p.q.z};
        store_rows(r.tables, p.own, pose);
        for (int64_t time = 0; time < r.times; ++time) {
            const Vector x = load_vector(r.now_xyz + time * r.nodes * 3, p.node);
            const Quaternion turn = load_quaternion(r.now_quat + time * r.nodes * 4, p.node) * conjugate(p.q);
            const Quaternion dual = (pure(x) * turn - turn * pure(p.x)) * half;
            f8 motion[ROW] = {turn.w, turn.x, turn.y, turn.z, dual.w, dual.x, dual.y, dual.z};
            store_rows(r.tables + (1 + time) * r.pairs * ROW, p.own, motion);
        }
    }
}

// Everything above is bilinear; <g, a b> = <g b*, a> = <a* g, b>, and v* = -v for vectors.
F4X_TARGET void unrelate(const Relations& r, int64_t begin, int64_t end) {
    const f8 half = broadcast(0.5f);
    for (int64_t i = begin; i < end; i += 8) {
        const Pairs p = load_pairs(r, i);
        f8 g[ROW];
        load_rows(r.d_tables, p.own, g);
        Vector d_x = {g[0], g[1], g[2]};
        Quaternion d_q = {g[4], g[5], g[6], g[7]};
        add_component(r.d_radius, 1, p.node, g[3]);
        for (int64_t time = 0; time < r.times; ++time) {
            const Vector x = load_vector(r.now_xyz + time * r.nodes * 3, p.node);
            const Quaternion q = load_quaternion(r.now_quat + time * r.nodes * 4, p.node), turn = q * conjugate(p.q);
            load_rows(r.d_tables + (1 + time) * r.pairs * ROW, p.own, g);
            const Quaternion dual = Quaternion{g[4], g[5], g[6], g[7]} * half;
            const Quaternion real = Quaternion{g[0], g[1], g[2], g[3]} + dual * pure(p.x) - pure(x) * dual;
            add_vector(r.d_now_xyz + time * r.nodes * 3, p.node, imaginary(dual * conjugate(turn)));
            add_quaternion(r.d_now_quat + time * r.nodes * 4, p.node, real * p.q);
            d_x = d_x + imaginary(conjugate(dual) * turn);  // = -turn* dual, as vectors
            d_q = d_q + conjugate(real) * q;
        }
        add_vector(r.d_node_xyz, p.then, d_x);
        add_quaternion(r.d_node_quat, p.then, d_normalise(p.q, p.inverse_length, d_q));
    }
}

// --------------------------------------------------------------------------------------------------------- forward pass

// Eight Gaussians at their own reference time.
struct Placed {
    Vector local;                       // the stored position, and
    Quaternion own;                     // the stored orientation made unit; zero becomes the identity
    f8 inverse_length;                  // of the stored orientation, 0 where it is zero
    Quaternion node;                    // orientation of the attach node
    Vector x;                           // in the world
    Quaternion q;
    f8 inverse_total;                   // of the raw weights
};

F4X_HOT void take_rows(const Deformation& d, const Lanes& lanes, Slot* slots) {
    for (int i = 0; i < 8; ++i)
        for (int k = 0; k < d.slots; ++k) slots[k].row[i] = d.index[lanes.at[i] * d.slots + k];
}

F4X_HOT void place(const Deformation& d, const Lanes& lanes, const Slot& attach, Placed& p) {
    f8 node[ROW];
    gather(d.nodes, attach.row, node);
    p.node = {node[4], node[5], node[6], node[7]};
    p.local = load_vector(d.xyz, lanes);
    p.own = load_quaternion(d.quat, lanes);
    p.inverse_length = normalise(p.own);
    p.x = rotate(p.node, p.local) + Vector{node[0], node[1], node[2]};
    p.q = p.node * p.own;
}

F4X_HOT void skin(const Deformation& d, const Lanes& lanes, Slot* slots, Placed& p) {
    const f8 zero = broadcast(0.0f), one = broadcast(1.0f), tiny = broadcast(std::numeric_limits<float>::min());
    f8 total = zero;
    for (int k = 0; k < d.slots; ++k) {
        Slot& s = slots[k];
        f8 node[ROW];
        gather(d.nodes, s.row, node);
        s.offset[0] = p.x.x - node[0];
        s.offset[1] = p.x.y - node[1];
        s.offset[2] = p.x.z - node[2];
        s.radius = node[3];
        const f8 spread = d.sigma ? s.radius * s.radius : s.radius;
        s.inverse_spread = one / maximum(spread, broadcast(d.smallest_spread));
        const f8 squared = s.offset[0] * s.offset[0] + s.offset[1] * s.offset[1] + s.offset[2] * s.offset[2];
        const f8 exponent = squared * broadcast(-0.72134752f) * s.inverse_spread;  // log2(e) / 2
        alignas(32) float inside[8];
        for (int i = 0; i < 8; ++i) inside[i] = d.mask[lanes.at[i] * d.slots + k] ? 1.0f : 0.0f;
        s.side = load(inside);
        s.exponential = keep_where(exponent > broadcast(-125.0f), exp2_fast(exponent)) * s.side;
        s.weight = s.exponential + broadcast(d.floor) * s.side;
        if (d.dw) {
            const f8 corrected = s.weight + component(d.dw + k, d.slots, lanes);
            s.side = select(corrected > zero, s.side, select(corrected < zero, zero - s.side, zero));
            s.weight = corrected * s.side;
        }
        total += s.weight;
    }
    p.inverse_total = select(total > tiny, one / maximum(total, tiny), one);
    for (int k = 0; k < d.slots; ++k) slots[k].weight = slots[k].weight * p.inverse_total;
}

// Motion of eight Gaussians from their reference time to another.
struct Motion {
    Quaternion real, dual;        // the blend
    i8 whole;                     // it has not cancelled out; the motion is the identity where it has
    f8 inverse_length, double_inverse_squared;
    Quaternion turn;
    Vector shift;
};

F4X_HOT void blend(const Deformation& d, const Lanes& lanes, const float* motions, Slot* slots, Motion& m) {
    const f8 zero = broadcast(0.0f), one = broadcast(1.0f), two = broadcast(2.0f);
    f8 sum[ROW];
    for (int c = 0; c < ROW; ++c) sum[c] = zero;
    const f8* attach = slots[0].motion;
    for (int k = 0; k < d.slots; ++k) {
        Slot& s = slots[k];
        gather(motions, s.row, s.motion);
        f8 agree = s.motion[0] * attach[0];
        for (int c = 1; c < 4; ++c) agree += s.motion[c] * attach[c];
        s.sign = select(agree < broadcast(-d.sign_band), broadcast(-1.0f), one);
        const f8 weight = s.weight * s.sign;
        for (int c = 0; c < ROW; ++c) sum[c] += weight * s.motion[c];
    }
    if (d.strength) {  // towards the identity, on its hemisphere
        const f8 strength = component(d.strength, 1, lanes), factor = select(sum[0] < zero, zero - strength, strength);
        for (int c = 0; c < ROW; ++c) sum[c] = sum[c] * factor;
        sum[0] += one - strength;
    }
    m.real = {sum[0], sum[1], sum[2], sum[3]};
    m.dual = {sum[4], sum[5], sum[6], sum[7]};
    const f8 least = broadcast(d.collapsed * d.collapsed), squared = dot(m.real, m.real);
    m.whole = squared > least;
    m.inverse_length = keep_where(m.whole, one / root(maximum(squared, least)));
    m.double_inverse_squared = keep_where(m.whole, two / maximum(squared, least));
    m.turn = m.real * m.inverse_length;
    m.turn.w = select(m.whole, m.turn.w, one);
    m.shift = imaginary(m.dual * conjugate(m.real) * m.double_inverse_squared);
}

F4X_TARGET void forward(const Deformation& d, int64_t begin, int64_t end) {
    std::vector<Slot> slots(d.slots);
    Placed p;
    Motion m;
    for (int64_t i = begin; i < end; i += 8) {
        const Lanes lanes = lanes_of(i, end);
        take_rows(d, lanes, slots.data());
        if (d.weights) {
            p.x = load_vector(d.xyz, lanes);
            p.q = load_quaternion(d.quat, lanes);
            for (int k = 0; k < d.slots; ++k) slots[k].weight = component(d.weights + k, d.slots, lanes);
        } else {
            place(d, lanes, slots[0], p);
            skin(d, lanes, slots.data(), p);
        }
        for (int64_t time = 0; time < d.times; ++time) {
            blend(d, lanes, d.motions + time * d.pairs * ROW, slots.data(), m);
            store_vector(d.means + time * d.count * 3, lanes, rotate(m.turn, p.x) + m.shift);
            store_quaternion(d.quats + time * d.count * 4, lanes, m.turn * p.q);
        }
    }
}

// -------------------------------------------------------------------------------------------------------- backward pass

// Gradients of eight Gaussians at their reference time, summed over the times.
struct Sent {
    Vector x;
    Quaternion q;
};

// From the pose at one time to the pose at the reference time, the weights and that time's table.
F4X_HOT void unblend(const Deformation& d, const Lanes& lanes, int64_t time, const Placed& p, Slot* slots, Sent& sent,
                     float* d_motions) {
    Motion m;
    blend(d, lanes, d.motions + time * d.pairs * ROW, slots, m);
    const Vector g = load_vector(d.d_means + time * d.count * 3, lanes);
    const Quaternion h = load_quaternion(d.d_quats + time * d.count * 4, lanes);
    sent.x = sent.x + rotate(conjugate(m.turn), g);
    sent.q = sent.q + conjugate(m.turn) * h;

    // turn = P / |P| and shift = 2 vec(D P*) / |P|^2
    const Quaternion turn = d_rotate(m.turn, p.x, g) + h * conjugate(p.q);
    const Quaternion product = pure(g * m.double_inverse_squared);
    const Quaternion real = conjugate(product) * m.dual + d_normalise(m.turn, m.inverse_length, turn) -
                            m.real * (m.double_inverse_squared * dot(g, m.shift));
    const Quaternion dual = product * m.real;
    // Where the blend has collapsed both inverse lengths are 0 and so is everything here.
    const f8 columns[ROW] = {real.w, real.x, real.y, real.z, dual.w, dual.x, dual.y, dual.z};
    f8 rows[ROW];
    for (int c = 0; c < ROW; ++c) rows[c] = columns[c];
    transpose(rows);
    for (int k = 0; k < d.slots; ++k) {
        Slot& s = slots[k];
        f8 along = columns[0] * s.motion[0];
        for (int c = 1; c < ROW; ++c) along += columns[c] * s.motion[c];
        s.d_weight += along * s.sign;
        s.sign = s.weight * s.sign;  // how the row enters the blend
    }
    // Gaussians side by side tend to follow the same nodes: with the slots innermost, no sum waits for the one before.
    for (int i = 0; i < lanes.count; ++i)
        for (int k = 0; k < d.slots; ++k) {
            float* to = d_motions + ROW * int64_t(slots[k].row[i]);
            store(to, load(to) + broadcast(slots[k].sign[i]) * rows[i]);
        }
}

// From the weights to the node positions and radii, the corrections and the position at the reference time.
F4X_HOT void unskin(const Deformation& d, const Lanes& lanes, const Placed& p, Slot* slots, Sent& sent) {
    const f8 zero = broadcast(0.0f), half = broadcast(0.5f);
    f8 mean = zero;
    for (int k = 0; k < d.slots; ++k) mean += slots[k].weight * slots[k].d_weight;
    for (int k = 0; k < d.slots; ++k) {
        Slot& s = slots[k];
        const f8 raw = (s.d_weight - mean) * p.inverse_total * s.side;
        if (d.d_dw) store_component(d.d_dw + k, d.slots, lanes, raw);
        const f8 squared = s.offset[0] * s.offset[0] + s.offset[1] * s.offset[1] + s.offset[2] * s.offset[2];
        const f8 steep = raw * s.exponential * s.inverse_spread;  // of -squared / 2
        const f8 spread = steep * half * squared * s.inverse_spread;
        // A spread held at its lower bound has no gradient.
        const i8 free = (d.sigma ? s.radius * s.radius : s.radius) >= broadcast(d.smallest_spread);
        const Vector offset = {zero - steep * s.offset[0], zero - steep * s.offset[1], zero - steep * s.offset[2]};
        sent.x = sent.x + offset;
        for (int c = 0; c < 3; ++c) s.d_node[c] = steep * s.offset[c];
        s.d_node[3] = keep_where(free, d.sigma ? spread * (s.radius + s.radius) : spread);
        for (int c = 4; c < ROW; ++c) s.d_node[c] = zero;
    }
}

// From the pose at the reference time to the stored one and to the attach node.
F4X_HOT void unplace(const Deformation& d, const Lanes& lanes, const Placed& p, Slot& attach, const Sent& sent) {
    const Quaternion own = conjugate(p.node) * sent.q;
    store_vector(d.d_xyz, lanes, rotate(conjugate(p.node), sent.x));
    store_quaternion(d.d_quat, lanes, d_normalise(p.own, p.inverse_length, own));
    const Quaternion node = d_rotate(p.node, p.local, sent.x) + sent.q * conjugate(p.own);
    const f8 columns[ROW] = {sent.x.x, sent.x.y, sent.x.z, broadcast(0.0f), node.w, node.x, node.y, node.z};
    for (int c = 0; c < ROW; ++c) attach.d_node[c] += columns[c];
}

F4X_TARGET void backward(const Deformation& d, int64_t begin, int64_t end, float* d_tables) {
    const f8 zero = broadcast(0.0f);
    std::vector<Slot> slots(d.slots);
    Placed p;
    for (int64_t i = begin; i < end; i += 8) {
        const Lanes lanes = lanes_of(i, end);
        take_rows(d, lanes, slots.data());
        place(d, lanes, slots[0], p);
        skin(d, lanes, slots.data(), p);
        for (int k = 0; k < d.slots; ++k) slots[k].d_weight = zero;
        Sent sent = {{zero, zero, zero}, {zero, zero, zero, zero}};
        for (int64_t time = 0; time < d.times; ++time)
            unblend(d, lanes, time, p, slots.data(), sent, d_tables + (1 + time) * d.pairs * ROW);
        unskin(d, lanes, p, slots.data(), sent);
        unplace(d, lanes, p, slots[0], sent);
        for (Slot& s : slots) transpose(s.d_node);
        for (int lane = 0; lane < lanes.count; ++lane)
            for (const Slot& s : slots) {
                float* to = d_tables + ROW * int64_t(s.row[lane]);
                store(to, load(to) + s.d_node[lane]);
            }
    }
}

const DeformationKernels kernels = {forward, backward, relate, unrelate};

#undef F4X_HOT

}  // namespace F4X_ISA
}  // namespace

#endif
