// Normal equations and cost of bundle adjustment, camera and point by camera and point; see priors/bundle.py, whose plain form
// computes the same. In doubles, without vectors: a sighting is a hundred numbers that fit in registers and cache, while numpy
// writes each of them for all sightings.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "lanes.hpp"

// Mirrored field by field in bundle.py.
struct Sightings {
    int64_t count;
    int32_t frames, points, unknowns;            // unknowns of a camera that couple with points: 6, or 7 where it zooms
    int32_t centers, lens, shared;               // whether centres move, a focal length does, one is shared by all frames
    double robust, behind, min_depth;            // Cauchy scale (px), error of a point behind its camera (px)
    double principal[2];
    const int64_t *frame, *point;                // (O,)
    const double *uv, *weight;                   // (O, 2) pixels, (O,)
    const double *rotation, *center, *focal;     // (F, 3, 3), (F, 3), (F,)
    const double* homogeneous;                   // (P, 4)
    const double* tangents;                      // (P, 4, 3)
    double* costs;                               // (F,)
    double *blocks, *slopes;                     // (F, 7, 7), (F, 7)
    double* coupling;                            // (3, unknowns F + 1, P), or null: then nothing of the points is written
    double *point_blocks, *point_slopes;         // (P, 3, 3), (P, 3)
};

namespace {

struct Seen {
    double x, y, z, plane[2], missed[2];
    bool ahead;
};

Seen look(const Sightings& s, int64_t i) {
    const double *R = s.rotation + 9 * s.frame[i], *c = s.center + 3 * s.frame[i], *p = s.homogeneous + 4 * s.point[i];
    const double offset[3] = {p[0] - p[3] * c[0], p[1] - p[3] * c[1], p[2] - p[3] * c[2]};
    double local[3];
    for (int k = 0; k < 3; ++k) local[k] = R[3 * k] * offset[0] + R[3 * k + 1] * offset[1] + R[3 * k + 2] * offset[2];
    Seen seen{local[0], local[1], local[2], {0, 0}, {0, 0}, local[2] > s.min_depth};
    for (int a = 0; a < 2; ++a) {
        seen.plane[a] = local[a] / (seen.ahead ? local[2] : 1.0);
        const double projected = s.focal[s.frame[i]] * seen.plane[a] + s.principal[a];
        seen.missed[a] = seen.ahead ? projected - s.uv[2 * i + a] : 0.0;
    }
    return seen;
}

// Derivatives of both pixel coordinates by rotation (R <- exp(omega) R), centre and log focal length of the camera.
void by_camera(const Sightings& s, int64_t i, const Seen& seen, double turned[2][3], double out[2][7]) {
    const double *R = s.rotation + 9 * s.frame[i], focal = s.focal[s.frame[i]], w = s.homogeneous[4 * s.point[i] + 3];
    const double x = seen.plane[0], y = seen.plane[1], scale = focal / (seen.ahead ? seen.z : 1.0);
    const double turns[2][3] = {{-x * y, 1 + x * x, -y}, {-1 - y * y, x * y, x}};
    for (int a = 0; a < 2; ++a) {
        for (int k = 0; k < 3; ++k) {
            out[a][k] = focal * turns[a][k];
            turned[a][k] = scale * (R[3 * a + k] - seen.plane[a] * R[6 + k]);
            out[a][3 + k] = s.centers ? -turned[a][k] * w : 0.0;
        }
        out[a][6] = s.lens ? focal * seen.plane[a] : 0.0;
    }
}

void add_point(const Sightings& s, int64_t i, const Seen& seen, double weight, const double turned[2][3],
               const double camera[2][7]) {
    const int64_t f = s.frame[i], p = s.point[i], rows = int64_t(s.unknowns) * s.frames + 1;
    const double *t = s.tangents + 12 * p, *c = s.center + 3 * f;
    double by[2][3];
    for (int a = 0; a < 2; ++a)
        for (int k = 0; k < 3; ++k) {
            by[a][k] = 0;
            for (int j = 0; j < 3; ++j) by[a][k] += turned[a][j] * (t[3 * j + k] - c[j] * t[9 + k]);
        }
    for (int k = 0; k < 3; ++k) {
        const double one = weight * by[0][k], two = weight * by[1][k];
        for (int j = 0; j < 3; ++j) s.point_blocks[9 * p + 3 * k + j] += one * by[0][j] + two * by[1][j];
        s.point_slopes[3 * p + k] += one * seen.missed[0] + two * seen.missed[1];
        double* row = s.coupling + (k * rows + s.unknowns * f) * s.points + p;
        for (int j = 0; j < s.unknowns; ++j, row += s.points) *row += one * camera[0][j] + two * camera[1][j];
        if (s.shared) s.coupling[(k * rows + rows - 1) * s.points + p] += one * camera[0][6] + two * camera[1][6];
    }
}

}  // namespace

// Cost of each frame: Cauchy's of the squared errors.
F4X_API void f4x_bundle_costs(const Sightings* s) {
    const double scale = s->robust * s->robust;
    std::fill(s->costs, s->costs + s->frames, 0.0);
    for (int64_t i = 0; i < s->count; ++i) {
        const Seen seen = look(*s, i);
        const double squared = seen.missed[0] * seen.missed[0] + seen.missed[1] * seen.missed[1];
        const double counted = seen.ahead ? squared : s->behind * s->behind;
        s->costs[s->frame[i]] += s->weight[i] * scale * std::log1p(counted / scale);
    }
}

// Normal equations of half the cost; the output arrays are zero.
F4X_API void f4x_bundle_equations(const Sightings* s) {
    const double scale = s->robust * s->robust;
    for (int64_t i = 0; i < s->count; ++i) {
        const Seen seen = look(*s, i);
        if (!seen.ahead) continue;
        const double squared = seen.missed[0] * seen.missed[0] + seen.missed[1] * seen.missed[1];
        const double weight = s->weight[i] / (1 + squared / scale);
        double turned[2][3], camera[2][7];
        by_camera(*s, i, seen, turned, camera);
        double *block = s->blocks + 49 * s->frame[i], *slope = s->slopes + 7 * s->frame[i];
        for (int k = 0; k < 7; ++k) {
            const double one = weight * camera[0][k], two = weight * camera[1][k];
            for (int j = 0; j < 7; ++j) block[7 * k + j] += one * camera[0][j] + two * camera[1][j];
            slope[k] += one * seen.missed[0] + two * seen.missed[1];
        }
        if (s->coupling) add_point(*s, i, seen, weight, turned, camera);
    }
}
