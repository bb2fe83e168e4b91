// Colours of spherical harmonics (degree 0 to 3) seen from one point, evaluated in each Gaussian's own frame, and their
// gradients. Eight Gaussians at a time; see geometry/spherical_harmonics.py for basis, order and signs.

#ifndef F4X_ISA

#include <cstdint>

#include "lanes.hpp"
#include "threads.hpp"

// Mirrored field by field in appearance.py.
struct Appearance {
    int64_t count;
    int32_t coefficients, threads;  // 1, 4, 9 or 16
    float centre[3];
    const float *sh, *means, *quats;          // (N, S, 3), (N, 3), (N, 4) of any length
    float* colors;                            // (N, 3), written by the forward pass
    const float* sent;                        // (N, 3) gradient of the colours
    float *d_sh, *d_means, *d_quats;          // written by the backward pass
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
        for (int k = 0; k < S; ++k) rgb[c] += basis[k] * column(a.sh + 3 * k + c, 3 * S, i, n);
    }
}

template <int DEGREE>
F4X_TARGET void forward_range(const Appearance& a, int64_t begin, int64_t end) {
    f8 basis[16], rgb[3];
    Sight s;
    for (int64_t i = begin; i < end; i += 8) {
        const int n = int(std::min<int64_t>(8, end - i));
        shade<DEGREE>(a, i, n, s, basis, rgb);
        for (int c = 0; c < 3; ++c) put(a.colors + c, 3, i, n, maximum(rgb[c], broadcast(0.0f)));
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
        for (int c = 0; c < 3; ++c) sent[c] = keep_where(rgb[c] > zero, column(a.sent + c, 3, i, n));
        for (int k = 0; k < S; ++k) {
            t[k] = zero;
            for (int c = 0; c < 3; ++c) {
                t[k] += sent[c] * column(a.sh + 3 * k + c, 3 * S, i, n);
                put(a.d_sh + 3 * k + c, 3 * S, i, n, sent[c] * basis[k]);
            }
        }
        if (DEGREE == 0) {
            for (int k = 0; k < 3; ++k) put(a.d_means + k, 3, i, n, zero);
            for (int k = 0; k < 4; ++k) put(a.d_quats + k, 4, i, n, zero);
            continue;
        }
        differentiate_basis<DEGREE>(s.own[0], s.own[1], s.own[2], t, g);

        // own = R^T d, so dL/dR = d g^T, and dL/dd = R g.
        const f8 w = s.q[0], x = s.q[1], y = s.q[2], z = s.q[3], *d = s.direction;
        const f8 c[3] = {y * g[2] - z * g[1] + w * g[0], z * g[0] - x * g[2] + w * g[1], x * g[1] - y * g[0] + w * g[2]};
        const f8 turned[3] = {g[0] + two * (y * c[2] - z * c[1]), g[1] + two * (z * c[0] - x * c[2]),
                              g[2] + two * (x * c[1] - y * c[0])};
        const f8 along = turned[0] * d[0] + turned[1] * d[1] + turned[2] * d[2];
        for (int k = 0; k < 3; ++k)
            put(a.d_means + k, 3, i, n, (turned[k] - along * d[k]) * s.inverse_distance);

        // Antisymmetric and symmetric parts of d g^T.
        const f8 rx = d[2] * g[1] - d[1] * g[2], ry = d[0] * g[2] - d[2] * g[0], rz = d[1] * g[0] - d[0] * g[1];
        const f8 xy = d[0] * g[1] + d[1] * g[0], xz = d[0] * g[2] + d[2] * g[0], yz = d[1] * g[2] + d[2] * g[1];
        const f8 xx = d[0] * g[0], yy = d[1] * g[1], zz = d[2] * g[2];
        const f8 q[4] = {two * (x * rx + y * ry + z * rz), two * (w * rx + y * xy + z * xz - two * x * (yy + zz)),
                         two * (w * ry + x * xy + z * yz - two * y * (xx + zz)),
                         two * (w * rz + x * xz + y * yz - two * z * (xx + yy))};
        const f8 radial = q[0] * w + q[1] * x + q[2] * y + q[3] * z;
        for (int k = 0; k < 4; ++k) put(a.d_quats + k, 4, i, n, (q[k] - radial * s.q[k]) * s.inverse_length);
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
