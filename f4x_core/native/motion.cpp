// Speeds and accelerations of the scaffold's nodes with their gradients, and the nodes' axes; see scaffold/losses.py for the
// formulas. In doubles, node by node.

#include <cmath>
#include <cstdint>
#include <vector>

#include "lanes.hpp"
#include "threads.hpp"

// Mirrored field by field in motion.py.
struct Motion {
    int32_t frames, nodes, threads;
    float velocity, acceleration, spin, spin_change;  // weights of the four means
    const float *xyz, *quat;  // (F, M, 3), (F, M, 4) of any length
    const double* times;      // (F,)
    float* axes;              // (F, M, 3, 3) the axes as columns, written by f4x_node_axes
    const float* d_axes;      // (F, M, 3, 3) their gradient
    double* loss;             // (1,)
    float *d_xyz, *d_quat;    // of the loss, and what comes through the axes; written
};

namespace {

constexpr int64_t NODES_AT_A_TIME = 16;
constexpr double SHORTEST = 1e-12;  // a quaternion that is shorter counts as the identity
constexpr double STILL = 1e-9;      // a rotation by less is rounding, of quaternions in float32: it has no direction

struct Turn {
    double q[4], length;  // of length 1, and before; 0 where it counts as the identity
};

Turn turn_of(const float* quat) {
    double length = 0;
    for (int k = 0; k < 4; ++k) length += double(quat[k]) * quat[k];
    length = std::sqrt(length);
    if (length < SHORTEST) return {{1, 0, 0, 0}, 0};
    return {{quat[0] / length, quat[1] / length, quat[2] / length, quat[3] / length}, length};
}

void axes_of(const double* q, float* axes) {
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    const double rows[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
                            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)};
    for (int k = 0; k < 9; ++k) axes[k] = float(rows[k]);
}

void add_axes_gradient(const double* q, const float* g, double* to) {
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    to[0] += 2 * (z * (g[3] - g[1]) + y * (g[2] - g[6]) + x * (g[7] - g[5]));
    to[1] += 2 * (y * (g[1] + g[3]) + z * (g[2] + g[6]) + w * (g[7] - g[5])) - 4 * x * (g[4] + g[8]);
    to[2] += 2 * (x * (g[1] + g[3]) + w * (g[2] - g[6]) + z * (g[5] + g[7])) - 4 * y * (g[0] + g[8]);
    to[3] += 2 * (w * (g[3] - g[1]) + x * (g[2] + g[6]) + y * (g[5] + g[7])) - 4 * z * (g[0] + g[4]);
}

double sign(double x) { return double((x > 0) - (x < 0)); }

// Angle of the rotation from `b` to `a`, and its gradients to both, of quaternions of length 1.
double angle_between(const double* a, const double* b, double* to_a, double* to_b) {
    const double t[4] = {a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3],
                         a[1] * b[0] - a[0] * b[1] - a[2] * b[3] + a[3] * b[2],
                         a[2] * b[0] - a[0] * b[2] + a[1] * b[3] - a[3] * b[1],
                         a[3] * b[0] - a[0] * b[3] - a[1] * b[2] + a[2] * b[1]};
    const double sine = std::sqrt(t[1] * t[1] + t[2] * t[2] + t[3] * t[3]), cosine = std::abs(t[0]);
    const double squared = sine * sine + cosine * cosine, by_sine = sine > STILL ? 2 * cosine / squared / sine : 0.0;
    const double g[4] = {-2 * sine / squared * sign(t[0]), by_sine * t[1], by_sine * t[2], by_sine * t[3]};
    to_a[0] = g[0] * b[0] - g[1] * b[1] - g[2] * b[2] - g[3] * b[3];
    to_a[1] = g[0] * b[1] + g[1] * b[0] + g[2] * b[3] - g[3] * b[2];
    to_a[2] = g[0] * b[2] - g[1] * b[3] + g[2] * b[0] + g[3] * b[1];
    to_a[3] = g[0] * b[3] + g[1] * b[2] - g[2] * b[1] + g[3] * b[0];
    to_b[0] = g[0] * a[0] + g[1] * a[1] + g[2] * a[2] + g[3] * a[3];
    to_b[1] = g[0] * a[1] - g[1] * a[0] - g[2] * a[3] + g[3] * a[2];
    to_b[2] = g[0] * a[2] + g[1] * a[3] - g[2] * a[0] - g[3] * a[1];
    to_b[3] = g[0] * a[3] - g[1] * a[2] + g[2] * a[1] - g[3] * a[0];
    return 2 * std::atan2(sine, cosine);
}

// Of one node: its velocities and spins (F - 1 each), and the gradients to them.
struct Curve {
    std::vector<Turn> turns;
    std::vector<double> velocity, spin, d_velocity, d_spin, to_later, to_earlier, d_turn;
    explicit Curve(int frames)
        : turns(frames), velocity(3 * frames), spin(frames), d_velocity(3 * frames), d_spin(frames), to_later(4 * frames),
          to_earlier(4 * frames), d_turn(4 * frames) {}
};

// The node's part of the loss; writes its gradients.
double follow(const Motion& m, int node, Curve& c) {
    const int frames = m.frames, spans = frames - 1;
    const auto at = [&](int t) { return int64_t(t) * m.nodes + node; };
    const auto interval = [&](int t) { return m.times[t + 1] - m.times[t]; };
    double loss = 0;
    for (int t = 0; t < frames; ++t) c.turns[t] = turn_of(m.quat + 4 * at(t));
    const double speeds = spans > 0 ? 1.0 / (double(spans) * m.nodes) : 0, changes = spans > 1 ? 1.0 / (double(spans - 1) * m.nodes) : 0;
    for (int t = 0; t < spans; ++t) {
        double squared = 0;
        for (int k = 0; k < 3; ++k) {
            double& v = c.velocity[3 * t + k];
            v = (double(m.xyz[3 * at(t + 1) + k]) - m.xyz[3 * at(t) + k]) / interval(t);
            squared += v * v;
        }
        const double speed = std::sqrt(squared), weight = m.velocity * speeds;
        loss += weight * speed;
        for (int k = 0; k < 3; ++k) c.d_velocity[3 * t + k] = speed > 0 ? weight * c.velocity[3 * t + k] / speed : 0.0;
        c.spin[t] = angle_between(c.turns[t + 1].q, c.turns[t].q, &c.to_later[4 * t], &c.to_earlier[4 * t]) / interval(t);
        loss += m.spin * speeds * c.spin[t];
        c.d_spin[t] = m.spin * speeds;
    }
    for (int t = 0; t + 1 < spans; ++t) {
        const double middle = (interval(t + 1) + interval(t)) / 2;
        double change[3], squared = 0;
        for (int k = 0; k < 3; ++k) {
            change[k] = c.velocity[3 * (t + 1) + k] - c.velocity[3 * t + k];
            squared += change[k] * change[k];
        }
        const double size = std::sqrt(squared), weight = m.acceleration * changes / middle;
        loss += weight * size;
        for (int k = 0; k < 3 && size > 0; ++k) {
            c.d_velocity[3 * (t + 1) + k] += weight * change[k] / size;
            c.d_velocity[3 * t + k] -= weight * change[k] / size;
        }
        const double turned = c.spin[t + 1] - c.spin[t], by_spin = m.spin_change * changes / middle;
        loss += by_spin * std::abs(turned);
        c.d_spin[t + 1] += by_spin * sign(turned);
        c.d_spin[t] -= by_spin * sign(turned);
    }
    std::fill(c.d_turn.begin(), c.d_turn.end(), 0.0);
    for (int t = 0; t < spans; ++t)
        for (int k = 0; k < 4; ++k) {
            c.d_turn[4 * (t + 1) + k] += c.d_spin[t] / interval(t) * c.to_later[4 * t + k];
            c.d_turn[4 * t + k] += c.d_spin[t] / interval(t) * c.to_earlier[4 * t + k];
        }
    for (int t = 0; t < frames; ++t) {
        for (int k = 0; k < 3; ++k) {
            const double later = t < spans ? c.d_velocity[3 * t + k] / interval(t) : 0.0;
            const double earlier = t > 0 ? c.d_velocity[3 * (t - 1) + k] / interval(t - 1) : 0.0;
            m.d_xyz[3 * at(t) + k] = float(earlier - later);
        }
        const Turn& turn = c.turns[t];
        double* sent = &c.d_turn[4 * t];
        if (m.d_axes) add_axes_gradient(turn.q, m.d_axes + 9 * at(t), sent);
        double along = 0;
        for (int k = 0; k < 4; ++k) along += sent[k] * turn.q[k];
        for (int k = 0; k < 4; ++k)
            m.d_quat[4 * at(t) + k] = turn.length > 0 ? float((sent[k] - along * turn.q[k]) / turn.length) : 0.0f;
    }
    return loss;
}

}  // namespace

F4X_API void f4x_node_axes(const Motion* motion) {
    const Motion& m = *motion;
    f4x::parallel_ranges(m.threads, int64_t(m.frames) * m.nodes, [&](int64_t begin, int64_t end) {
        for (int64_t i = begin; i < end; ++i) axes_of(turn_of(m.quat + 4 * i).q, m.axes + 9 * i);
    });
}

// Returns 1 when memory ran out.
F4X_API int32_t f4x_node_motion(const Motion* motion) {
    try {
        const Motion& m = *motion;
        std::vector<double> losses(m.nodes);  // summed in a fixed order: the same for every number of threads
        f4x::parallel(m.threads, (m.nodes + NODES_AT_A_TIME - 1) / NODES_AT_A_TIME, [&](std::atomic<int64_t>& cursor) {
            Curve curve(m.frames);
            for (int64_t first; (first = NODES_AT_A_TIME * cursor++) < m.nodes;)
                for (int64_t node = first; node < std::min<int64_t>(first + NODES_AT_A_TIME, m.nodes); ++node)
                    losses[node] = follow(m, int(node), curve);
        });
        *m.loss = 0;
        for (const double loss : losses) *m.loss += loss;
        return 0;
    } catch (const std::exception&) {
        return 1;
    }
}
