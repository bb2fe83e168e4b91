// What is drawn of Gaussians: colours of spherical harmonics (degree 0 to 3) seen from one point, evaluated in each Gaussian's own
// frame, and, where they are asked for, activated scales and opacities, those of dynamic Gaussians faded as they come and go; with
// the gradients of all. Eight Gaussians at a time; see geometry/spherical_harmonics.py for basis, order and signs, and
// gaussians/parameters.py for the activations.

#ifndef F4X_ISA

#include <cstdint>

#include "lanes.hpp"
#include "threads.hpp"

// Mirrored field by field in appearance.py.
struct Appearance {
    int64_t count;
    int32_t coefficients, threads;            // 1, 4, 9 or 16
    int32_t channels;                         // floats from one Gaussian's colours to the next one's
    int32_t first_stride, more_stride;        // floats from one Gaussian's coefficients to the next one's
    float mark;                               // written into channel 3 where there is one
    float centre[3];
    const float *first, *more;                // (N, 3) and (N, S - 1, 3) coefficients
    const float *means, *quats;               // (N, 3), (N, 4) of any length
    const float* there;                       // (N, 3) written into channels 4 to 6 where there are any
    float* colors;                            // (N, channels), written by the forward pass

    // What is activated, as arrays of its own: all null where colours alone are wanted.
    const float *log_scales, *logits;         // (N, 3), (N,)
    const float *log_lifetimes, *born;        // (N, 2), (N,): null where Gaussians are there at all times
    float time;                               // that is drawn, in the unit of `born`
    float whole;                              // fraction of a lifetime in which a Gaussian is there wholly
    float margin;                             // opacities are kept this far from 1 before they fade
    float *drawn_means, *drawn_quats;         // copies, written by the forward pass like the two that follow
    float *scales, *opacities;                // (N, 3), (N,)

    const float *sent, *sent_means, *sent_quats, *sent_scales, *sent_opacities;  // gradients of what is drawn
    float *d_first, *d_more, *d_means, *d_quats, *d_there;                       // written by the backward pass
    float *d_log_scales, *d_logits, *d_log_lifetimes;
};

using namespace f4x;

namespace {
typedef void (*Range)(const Appearance&, int64_t begin, int64_t end);
struct AppearanceKernels {
    Range forward, backward;
};
}  // namespace

#define F4X_FILE "appearance.cpp"
#include "each_isa.hpp"

F4X_API void f4x_appearance(const Appearance* a) {
    parallel_ranges(a->threads, a->count, [&](int64_t begin, int64_t end) { kernels().forward(*a, begin, end); });
}

F4X_API void f4x_appearance_backward(const Appearance* a) {
    parallel_ranges(a->threads, a->count, [&](int64_t begin, int64_t end) { kernels().backward(*a, begin, end); });
}

#else  // ------------------------------------------------------------------------------- compiled once per instruction set

namespace {
namespace F4X_ISA {

#include "lanes_isa.hpp"

// One component of eight Gaussians from `i` on; past the last one it is repeated.
F4X_HOT f8 column(const float* rows, int stride, int64_t i, int n) {
    f8 v;
    for (int lane = 0; lane < 8; ++lane) v[lane] = rows[(i + std::min(lane, n - 1)) * stride];
    return v;
}
F4X_HOT void put(float* rows, int stride, int64_t i, int n, const f8& v) {
    for (int lane = 0; lane < n; ++lane) rows[(i + lane) * stride] = v[lane];
}

struct Basis {
    static constexpr float C0 = 0.28209479177387814f, C1 = 0.4886025119029199f;
    static constexpr float C20 = 1.0925484305920792f, C21 = 0.31539156525252005f, C22 = 0.5462742152960396f;
    static constexpr float C30 = 0.5900435899266435f, C31 = 2.890611442640554f, C32 = 0.4570457994644658f,
                           C33 = 0.3731763325901154f, C34 = 1.445305721320277f;
};

template <int DEGREE>
F4X_HOT void evaluate_basis(const f8& x, const f8& y, const f8& z, f8* b) {
    using B = Basis;
    b[0] = broadcast(B::C0);
    if (DEGREE >= 1) {
        b[1] = broadcast(-B::C1) * y;
        b[2] = broadcast(B::C1) * z;
        b[3] = broadcast(-B::C1) * x;
    }
    const f8 xx = x * x, yy = y * y, zz = z * z, two = broadcast(2.0f), three = broadcast(3.0f), four = broadcast(4.0f);
    if (DEGREE >= 2) {
        b[4] = broadcast(B::C20) * x * y;
        b[5] = broadcast(-B::C20) * y * z;
        b[6] = broadcast(B::C21) * (two * zz - xx - yy);
        b[7] = broadcast(-B::C20) * x * z;
        b[8] = broadcast(B::C22) * (xx - yy);
    }
    if (DEGREE >= 3) {
        b[9] = broadcast(-B::C30) * y * (three * xx - yy);
        b[10] = broadcast(B::C31) * x * y * z;
        b[11] = broadcast(-B::C32) * y * (four * zz - xx - yy);
        b[12] = broadcast(B::C33) * z * (two * zz - three * xx - three * yy);
        b[13] = broadcast(-B::C32) * x * (four * zz - xx - yy);
        b[14] = broadcast(B::C34) * z * (xx - yy);
        b[15] = broadcast(-B::C30) * x * (xx - three * yy);
    }
}

// Gradient of sum_s t[s] basis[s] to the direction.
template <int DEGREE>
F4X_HOT void differentiate_basis(const f8& x, const f8& y, const f8& z, const f8* t, f8* g) {
    using B = Basis;
    g[0] = broadcast(-B::C1) * t[3];
    g[1] = broadcast(-B::C1) * t[1];
    g[2] = broadcast(B::C1) * t[2];
    const f8 xx = x * x, yy = y * y, zz = z * z, xy = x * y, yz = y * z, xz = x * z, two = broadcast(2.0f);
    const f8 three = broadcast(3.0f), four = broadcast(4.0f), six = broadcast(6.0f), eight = broadcast(8.0f);
    if (DEGREE >= 2) {
        const f8 a = broadcast(B::C20), b = broadcast(2 * B::C21) * t[6], c = broadcast(2 * B::C22) * t[8];
        g[0] += a * (y * t[4] - z * t[7]) - b * x + c * x;
        g[1] += a * (x * t[4] - z * t[5]) - b * y - c * y;
        g[2] += two * b * z - a * (y * t[5] + x * t[7]);
    }
    if (DEGREE >= 3) {
        const f8 a = broadcast(B::C30), b = broadcast(B::C31) * t[10], c = broadcast(B::C32), d = broadcast(B::C33) * t[12];
        const f8 e = broadcast(B::C34) * t[14], split = three * (xx - yy);
        g[0] += b * yz - a * (six * xy * t[9] + split * t[15]) + c * (two * xy * t[11] - (four * zz - three * xx - yy) * t[13]) -
                six * d * xz + two * e * xz;
        g[1] += b * xz + a * (six * xy * t[15] - split * t[9]) + c * (two * xy * t[13] - (four * zz - xx - three * yy) * t[11]) -
                six * d * yz - two * e * yz;
        g[2] += b * xy - eight * c * (yz * t[11] + xz * t[13]) + d * (six * zz - three * (xx + yy)) + e * (xx - yy);
    }
}

// The unit direction from the centre, and the same in the Gaussian's frame.
struct Sight {
    f8 direction[3], inverse_distance;
    f8 q[4], inverse_length;  // a zero quaternion counts as the identity and has no gradient: its inverse length is 0
    f8 own[3];
};

F4X_HOT void look(const Appearance& a, int64_t i, int n, Sight& s) {
    const f8 zero = broadcast(0.0f), one = broadcast(1.0f), tiny = broadcast(1e-24f);
    f8 squared = zero;
    for (int k = 0; k < 3; ++k) {
        s.direction[k] = column(a.means + k, 3, i, n) - broadcast(a.centre[k]);
        squared += s.direction[k] * s.direction[k];
    }
    s.inverse_distance = keep_where(squared > tiny, one / root(maximum(squared, tiny)));
    for (int k = 0; k < 3; ++k) s.direction[k] = s.direction[k] * s.inverse_distance;
    f8 length = zero;
    for (int k = 0; k < 4; ++k) {
        s.q[k] = column(a.quats + k, 4, i, n);
        length += s.q[k] * s.q[k];
    }
    const i8 turned = length > tiny;
    s.inverse_length = keep_where(turned, one / root(maximum(length, tiny)));
    for (int k = 0; k < 4; ++k) s.q[k] = s.q[k] * s.inverse_length;
    s.q[0] = select(turned, s.q[0], one);
    // R^T d = d + 2 u x (u x d + w d) with u = -(x, y, z)
    const f8 w = s.q[0], two = broadcast(2.0f), *d = s.direction;
    const f8 u[3] = {zero - s.q[1], zero - s.q[2], zero - s.q[3]};
    const f8 c[3] = {u[1] * d[2] - u[2] * d[1] + w * d[0], u[2] * d[0] - u[0] * d[2] + w * d[1],
                     u[0] * d[1] - u[1] * d[0] + w * d[2]};
    s.own[0] = d[0] + two * (u[1] * c[2] - u[2] * c[1]);
    s.own[1] = d[1] + two * (u[2] * c[0] - u[0] * c[2]);
    s.own[2] = d[2] + two * (u[0] * c[1] - u[1] * c[0]);
}

// Colours before they are cut off at 0, and what they were made of.
template <int DEGREE>
F4X_HOT void shade(const Appearance& a, int64_t i, int n, Sight& s, f8* basis, f8* rgb) {
    constexpr int S = (DEGREE + 1) * (DEGREE + 1);
    if (DEGREE > 0) look(a, i, n, s);
    evaluate_basis<DEGREE>(s.own[0], s.own[1], s.own[2], basis);
    for (int c = 0; c < 3; ++c) {
        rgb[c] = broadcast(0.5f);
        rgb[c] += basis[0] * column(a.first + c, a.first_stride, i, n);
        for (int k = 1; k < S; ++k) rgb[c] += basis[k] * column(a.more + 3 * (k - 1) + c, a.more_stride, i, n);
    }
}

// Base-2 logarithm of positive normal numbers, to 1e-7.
F4X_HOT f8 log2_fast(const f8& x) {
    f8 whole, m;
    for (int lane = 0; lane < 8; ++lane) {
        const float value = x[lane];
        uint32_t bits;
        std::memcpy(&bits, &value, 4);
        const int32_t exponent = int32_t(bits - 0x3f3504f3u) >> 23;  // so that m lies between the roots of 1/2 and 2
        bits -= uint32_t(exponent) << 23;
        float rest;
        std::memcpy(&rest, &bits, 4);
        whole[lane] = float(exponent);
        m[lane] = rest;
    }
    const f8 one = broadcast(1.0f), t = (m - one) / (m + one), z = t * t;
    f8 series = broadcast(1.0f / 9);
    for (const float term : {1.0f / 7, 1.0f / 5, 1.0f / 3, 1.0f}) series = series * z + broadcast(term);
    return whole + broadcast(2.88539008177792681472f) * t * series;  // 2 / ln 2
}

F4X_HOT f8 exp_fast(const f8& x) {
    const f8 most = broadcast(125.0f);
    return exp2_fast(maximum(broadcast(0.0f) - most, minimum(x * broadcast(1.44269504088896340736f), most)));
}

// The opacity of eight Gaussians, and what its gradient is made of.
struct Opacity {
    f8 plain, rest;        // sigmoid of the logit, and 1 less that
    f8 drawn;
    // Of Gaussians that come and go: 1 - drawn = kept = rest^there, where `rest` is kept above the margin.
    f8 there, kept, log_rest, passed;  // presence; `passed`: of a lifetime, |time - born| / lifetime
    i8 free, later, fades;             // the margin does not bind; the second lifetime counts; presence is not clamped
};

F4X_HOT void fade(const Appearance& a, int64_t i, int n, Opacity& o) {
    const f8 zero = broadcast(0.0f), one = broadcast(1.0f), e = exp_fast(zero - column(a.logits, 1, i, n));
    o.plain = o.drawn = one / (one + e);
    o.rest = e * o.plain;
    if (!a.log_lifetimes) return;
    const f8 away = broadcast(a.time) - column(a.born, 1, i, n);
    o.later = away >= zero;
    const f8 life = exp_fast(select(o.later, column(a.log_lifetimes + 1, 2, i, n), column(a.log_lifetimes, 2, i, n)));
    o.passed = maximum(away, zero - away) / life;
    const f8 unclamped = (one - o.passed) / broadcast(1 - a.whole);
    o.fades = (unclamped >= zero) & (unclamped <= one);
    o.there = minimum(maximum(unclamped, zero), one);
    const f8 margin = broadcast(a.margin);
    o.free = o.rest >= margin;
    o.log_rest = log2_fast(maximum(o.rest, margin));
    o.kept = exp2_fast(o.there * o.log_rest);
    o.drawn = one - o.kept;
}

F4X_HOT void copy_rows(const float* from, float* to, int width, int64_t i, int n) {
    std::memcpy(to + i * width, from + i * width, sizeof(float) * size_t(n) * width);
}

F4X_HOT void activate(const Appearance& a, int64_t i, int n) {
    copy_rows(a.means, a.drawn_means, 3, i, n);
    copy_rows(a.quats, a.drawn_quats, 4, i, n);
    for (int k = 0; k < 3; ++k) put(a.scales + k, 3, i, n, exp_fast(column(a.log_scales + k, 3, i, n)));
    Opacity o;
    fade(a, i, n, o);
    put(a.opacities, 1, i, n, o.drawn);
}

F4X_HOT void deactivate(const Appearance& a, int64_t i, int n) {
    for (int k = 0; k < 3; ++k) {
        const f8 scale = exp_fast(column(a.log_scales + k, 3, i, n));
        put(a.d_log_scales + k, 3, i, n, scale * column(a.sent_scales + k, 3, i, n));
    }
    Opacity o;
    fade(a, i, n, o);
    const f8 sent = column(a.sent_opacities, 1, i, n), zero = broadcast(0.0f);
    if (!a.log_lifetimes) return put(a.d_logits, 1, i, n, sent * o.plain * o.rest);
    put(a.d_logits, 1, i, n, keep_where(o.free, sent * o.there * o.kept * o.plain));
    const f8 by_presence = zero - sent * o.kept * o.log_rest * broadcast(0.69314718055994530942f);
    const f8 by_lifetime = keep_where(o.fades, by_presence * o.passed / broadcast(1 - a.whole));
    put(a.d_log_lifetimes, 2, i, n, select(o.later, zero, by_lifetime));
    put(a.d_log_lifetimes + 1, 2, i, n, keep_where(o.later, by_lifetime));
}

template <int DEGREE>
F4X_TARGET void forward_range(const Appearance& a, int64_t begin, int64_t end) {
    f8 basis[16], rgb[3];
    Sight s;
    for (int64_t i = begin; i < end; i += 8) {
        const int n = int(std::min<int64_t>(8, end - i));
        shade<DEGREE>(a, i, n, s, basis, rgb);
        for (int c = 0; c < 3; ++c) put(a.colors + c, a.channels, i, n, maximum(rgb[c], broadcast(0.0f)));
        if (a.channels > 3) put(a.colors + 3, a.channels, i, n, broadcast(a.mark));
        for (int c = 4; c < a.channels; ++c) put(a.colors + c, a.channels, i, n, column(a.there + c - 4, 3, i, n));
        if (a.log_scales) activate(a, i, n);
    }
}

template <int DEGREE>
F4X_TARGET void backward_range(const Appearance& a, int64_t begin, int64_t end) {
    constexpr int S = (DEGREE + 1) * (DEGREE + 1);
    const f8 zero = broadcast(0.0f), two = broadcast(2.0f);
    f8 basis[16], rgb[3], sent[3], t[16], g[3];
    Sight s;
    for (int64_t i = begin; i < end; i += 8) {
        const int n = int(std::min<int64_t>(8, end - i));
        shade<DEGREE>(a, i, n, s, basis, rgb);
        for (int c = 0; c < 3; ++c) {
            sent[c] = keep_where(rgb[c] > zero, column(a.sent + c, a.channels, i, n));
            put(a.d_first + c, a.first_stride, i, n, sent[c] * basis[0]);
        }
        if (a.log_scales) deactivate(a, i, n);
        if (a.d_there)
            for (int c = 0; c < 3; ++c) put(a.d_there + c, 3, i, n, column(a.sent + 4 + c, a.channels, i, n));
        f8 d_mean[3], d_quat[4];
        for (int k = 0; k < 3; ++k) d_mean[k] = a.sent_means ? column(a.sent_means + k, 3, i, n) : zero;
        for (int k = 0; k < 4; ++k) d_quat[k] = a.sent_quats ? column(a.sent_quats + k, 4, i, n) : zero;
        if (DEGREE == 0) {
            for (int k = 0; k < 3; ++k) put(a.d_means + k, 3, i, n, d_mean[k]);
            for (int k = 0; k < 4; ++k) put(a.d_quats + k, 4, i, n, d_quat[k]);
            continue;
        }
        for (int k = 1; k < S; ++k) {
            t[k] = zero;
            for (int c = 0; c < 3; ++c) {
                t[k] += sent[c] * column(a.more + 3 * (k - 1) + c, a.more_stride, i, n);
                put(a.d_more + 3 * (k - 1) + c, a.more_stride, i, n, sent[c] * basis[k]);
            }
        }
        differentiate_basis<DEGREE>(s.own[0], s.own[1], s.own[2], t, g);

        // own = R^T d, so dL/dR = d g^T, and dL/dd = R g.
        const f8 w = s.q[0], x = s.q[1], y = s.q[2], z = s.q[3], *d = s.direction;
        const f8 c[3] = {y * g[2] - z * g[1] + w * g[0], z * g[0] - x * g[2] + w * g[1], x * g[1] - y * g[0] + w * g[2]};
        const f8 turned[3] = {g[0] + two * (y * c[2] - z * c[1]), g[1] + two * (z * c[0] - x * c[2]),
                              g[2] + two * (x * c[1] - y * c[0])};
        const f8 along = turned[0] * d[0] + turned[1] * d[1] + turned[2] * d[2];
        for (int k = 0; k < 3; ++k)
            put(a.d_means + k, 3, i, n, d_mean[k] + (turned[k] - along * d[k]) * s.inverse_distance);

        // Antisymmetric and symmetric parts of d g^T.
        const f8 rx = d[2] * g[1] - d[1] * g[2], ry = d[0] * g[2] - d[2] * g[0], rz = d[1] * g[0] - d[0] * g[1];
        const f8 xy = d[0] * g[1] + d[1] * g[0], xz = d[0] * g[2] + d[2] * g[0], yz = d[1] * g[2] + d[2] * g[1];
        const f8 xx = d[0] * g[0], yy = d[1] * g[1], zz = d[2] * g[2];
        const f8 q[4] = {two * (x * rx + y * ry + z * rz), two * (w * rx + y * xy + z * xz - two * x * (yy + zz)),
                         two * (w * ry + x * xy + z * yz - two * y * (xx + zz)),
                         two * (w * rz + x * xz + y * yz - two * z * (xx + yy))};
        const f8 radial = q[0] * w + q[1] * x + q[2] * y + q[3] * z;
        for (int k = 0; k < 4; ++k) put(a.d_quats + k, 4, i, n, d_quat[k] + (q[k] - radial * s.q[k]) * s.inverse_length);
    }
}

F4X_TARGET void forward(const Appearance& a, int64_t begin, int64_t end) {
    switch (a.coefficients) {
        case 1: return forward_range<0>(a, begin, end);
        case 4: return forward_range<1>(a, begin, end);
        case 9: return forward_range<2>(a, begin, end);
        default: return forward_range<3>(a, begin, end);
    }
}

F4X_TARGET void backward(const Appearance& a, int64_t begin, int64_t end) {
    switch (a.coefficients) {
        case 1: return backward_range<0>(a, begin, end);
        case 4: return backward_range<1>(a, begin, end);
        case 9: return backward_range<2>(a, begin, end);
        default: return backward_range<3>(a, begin, end);
    }
}

const AppearanceKernels kernels = {forward, backward};

#undef F4X_HOT

}  // namespace F4X_ISA
}  // namespace

#endif
