// build: each instruction set, fused
// Strain, energy and corner forces of triangles, one frame a piece (fingerflow/ops/fields/triangle_strain.py).
// The displacement gradient of a triangle is sum_corner u grad(phi); its energy density is direct (exx^2 + eyy^2) +
// between exx eyy + shear exy^2, from which the mean energy of the points' noise is subtracted.
// Layout: triangles are arrays (triangles) or (3, triangles) by corner; points (points, 2) and (points, 2, 2) a frame. One
// triangle a lane, which gathers its corners from planes of u, v and covariances; corner forces are planes (3, triangles)
// and are added to the points one by one.
#include <float.h>
#include <math.h>
#include <string.h>

#include "instruction_sets.h"
#include "interface.h"
#include "lanes.h"
#include "strain.h"

namespace fingerflow {

// Triangles in the reference state, arrays (triangles) or (3, triangles) by corner.
struct Triangles {
    std::int64_t count, points;
    const std::int32_t* corners;
    const float *along, *down;    // gradients of the linear shape functions by x and y; 0 for a flat triangle
    const float* products;        // (3, 3, triangles): xx, xy, yy of each corner's gradient with that of all that shares its errors
    const float *areas, *flat;    // flat is NaN for a flat triangle, else 0
    float squared, mixed;         // factors of the quadratic terms of normal and shear strain
    float direct, between, shear; // factors of exx^2 + eyy^2, exx eyy, exy^2 in the energy
};

// One frame: displacement (points, 2), covariance (points, 2, 2), in_contact (triangles).
struct TriangleFrame {
    const float *displacement, *covariance;
    const unsigned char* in_contact;
    float *strain, *strain_std, *density;  // (triangles, 3), (triangles, 3), (triangles)
    double* energy;
    float* forces;  // (points, 2)
    double* own;    // sum over points of (noise energy of a point)^2
};

// Floats that `memory` of a frame must hold.
inline std::int64_t triangle_memory(const Triangles& triangles) { return 8 * triangles.points + 11 * triangles.count; }

namespace FINGERFLOW_ISA {
namespace {

inline float known_or_zero(float value) { return value == value ? value : 0.0f; }

// Planes of a frame, by points, then by triangles.
struct Planes {
    float *u, *v, *uu, *uv, *vv;             // (points)
    float* sums;                             // (points, 3): forces along x and y, noise energy
    float *force_x, *force_y, *noise;        // (3, triangles), per unit area
    float *energy, *counted;                 // (triangles): density and area of those that count

    Planes(float* memory, std::int64_t points, std::int64_t triangles)
        : u(memory), v(u + points), uu(v + points), uv(uu + points), vv(uv + points), sums(vv + points),
          force_x(sums + 3 * points), force_y(force_x + 3 * triangles), noise(force_y + 3 * triangles),
          energy(noise + 3 * triangles), counted(energy + triangles) {}
};

void take_apart(const TriangleFrame& frame, std::int64_t points, const Planes& planes) {
    const float *FINGERFLOW_RESTRICT moved = frame.displacement, *FINGERFLOW_RESTRICT covariance = frame.covariance;
    float *FINGERFLOW_RESTRICT u = planes.u, *FINGERFLOW_RESTRICT v = planes.v;
    float *FINGERFLOW_RESTRICT uu = planes.uu, *FINGERFLOW_RESTRICT uv = planes.uv, *FINGERFLOW_RESTRICT vv = planes.vv;
    for (std::int64_t k = 0; k < points; ++k) {
        u[k] = moved[2 * k];
        v[k] = moved[2 * k + 1];
        uu[k] = covariance[4 * k];
        uv[k] = covariance[4 * k + 1];
        vv[k] = covariance[4 * k + 3];
    }
}

// Strain, energy density and corner forces.
void deform(const Triangles& of, const TriangleFrame& frame, const Planes& planes) {
    const std::int64_t count = of.count;
    const std::int32_t *FINGERFLOW_RESTRICT a = of.corners, *FINGERFLOW_RESTRICT b = a + count, *FINGERFLOW_RESTRICT c = b + count;
    const float *FINGERFLOW_RESTRICT x = of.along, *FINGERFLOW_RESTRICT y = of.down, *FINGERFLOW_RESTRICT flat = of.flat;
    const float *FINGERFLOW_RESTRICT u = planes.u, *FINGERFLOW_RESTRICT v = planes.v;
    float *FINGERFLOW_RESTRICT strain = frame.strain, *FINGERFLOW_RESTRICT density = frame.density;
    float *FINGERFLOW_RESTRICT force_x = planes.force_x, *FINGERFLOW_RESTRICT force_y = planes.force_y;
    float *FINGERFLOW_RESTRICT energy = planes.energy, *FINGERFLOW_RESTRICT counted = planes.counted;
    const float *FINGERFLOW_RESTRICT areas = of.areas, squared = of.squared, mixed = of.mixed;
    const float direct = of.direct, between = of.between, shear = of.shear;
    const unsigned char* FINGERFLOW_RESTRICT in_contact = frame.in_contact;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t t = 0; t < count; ++t) {
        const float u1 = u[b[t]] - u[a[t]], u2 = u[c[t]] - u[a[t]], v1 = v[b[t]] - v[a[t]], v2 = v[c[t]] - v[a[t]];
        const float x1 = x[count + t], x2 = x[2 * count + t], y1 = y[count + t], y2 = y[2 * count + t];
        const float ux = x1 * u1 + x2 * u2 + flat[t], uy = y1 * u1 + y2 * u2;
        const float vx = x1 * v1 + x2 * v2, vy = y1 * v1 + y2 * v2 + flat[t];
        const Strain of_triangle = strain_of(squared, mixed, ux, uy, vx, vy);
        const float exx = of_triangle.xx, eyy = of_triangle.yy, exy = of_triangle.xy + flat[t];
        const float held = direct * (exx * exx + eyy * eyy) + between * (exx * eyy) + shear * (exy * exy);
        strain[3 * t] = exx;
        strain[3 * t + 1] = eyy;
        strain[3 * t + 2] = exy;
        density[t] = held;
        const bool counts = (fabsf(held) <= FLT_MAX) & (in_contact[t] != 0);
        counted[t] = counts ? areas[t] : 0.0f;
        energy[t] = counts ? held : 0.0f;
        const float sxx = counts ? 2 * direct * exx + between * eyy : 0.0f, syy = counts ? 2 * direct * eyy + between * exx : 0.0f;
        const float sxy = counts ? shear * exy : 0.0f;
        for (int corner = 0; corner < 3; ++corner) {
            const std::int64_t at = corner * count + t;
            force_x[at] = sxx * x[at] + sxy * y[at];
            force_y[at] = syy * y[at] + sxy * x[at];
        }
    }
}

// Standard deviations of the strain and the noise energy, from the covariances of the corners.
void deviate(const Triangles& of, const TriangleFrame& frame, const Planes& planes) {
    const std::int64_t count = of.count;
    const std::int32_t* FINGERFLOW_RESTRICT corners = of.corners;
    const float *FINGERFLOW_RESTRICT of_xx = of.products, *FINGERFLOW_RESTRICT of_xy = of_xx + 3 * count, *FINGERFLOW_RESTRICT of_yy = of_xy + 3 * count;
    const float *FINGERFLOW_RESTRICT uu = planes.uu, *FINGERFLOW_RESTRICT uv = planes.uv, *FINGERFLOW_RESTRICT vv = planes.vv;
    const float* FINGERFLOW_RESTRICT strain = frame.strain;
    float *FINGERFLOW_RESTRICT deviations = frame.strain_std, *FINGERFLOW_RESTRICT noise = planes.noise;
    const float direct = of.direct, between = of.between, shear = of.shear;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t t = 0; t < count; ++t) {
        float exx = 0, eyy = 0, exy = 0;
        for (int corner = 0; corner < 3; ++corner) {
            const std::int64_t at = corner * count + t;
            const std::int32_t k = corners[at];
            const float xx = of_xx[at], xy = of_xy[at], yy = of_yy[at];
            const float one = xx * uu[k], other = yy * vv[k], both = (yy * uu[k] + 2 * xy * uv[k] + xx * vv[k]) / 4;
            exx += one;
            eyy += other;
            exy += both;
            noise[at] = known_or_zero(direct * (one + other) + between * (xy * uv[k]) + shear * both);
        }
        deviations[3 * t] = sqrtf(exx > 0 ? exx : exx * 0) + 0 * strain[3 * t];
        deviations[3 * t + 1] = sqrtf(eyy > 0 ? eyy : eyy * 0) + 0 * strain[3 * t + 1];
        deviations[3 * t + 2] = sqrtf(exy > 0 ? exy : exy * 0) + 0 * strain[3 * t + 2];
    }
}

}  // namespace

void strain_of_frame(const Triangles& of, const TriangleFrame& frame, float* memory) {
    const Planes planes(memory, of.points, of.count);
    take_apart(frame, of.points, planes);
    deform(of, frame, planes);
    deviate(of, frame, planes);

    double whole = 0, seen = 0;
    for (std::int64_t t = 0; t < of.count; ++t) {
        whole += static_cast<double>(frame.in_contact[t] != 0 ? known_or_zero(of.areas[t]) : 0.0f);
        seen += static_cast<double>(planes.counted[t]);
    }
    // Unknown triangles are assumed to have the mean of the known ones; NaN where less than half the area is known.
    if (!(seen > 0 && seen >= whole / 2)) {
        *frame.energy = *frame.own = static_cast<double>(NAN);
        memset(frame.forces, 0, static_cast<std::size_t>(2 * of.points) * sizeof(float));
        return;
    }
    const auto share = static_cast<float>(whole / seen);
    memset(planes.sums, 0, static_cast<std::size_t>(3 * of.points) * sizeof(float));
    double energy = 0;
    for (std::int64_t t = 0; t < of.count; ++t) {
        const float area = planes.counted[t] * share;
        if (!(area > 0)) continue;
        float left = planes.energy[t];
        for (std::int64_t at = t; at < 3 * of.count; at += of.count) {
            float* const to = planes.sums + 3 * of.corners[at];
            to[0] += area * planes.force_x[at];
            to[1] += area * planes.force_y[at];
            to[2] += area * planes.noise[at];
            left -= planes.noise[at];
        }
        energy += static_cast<double>(area * left);
    }
    double own = 0;
    for (std::int64_t k = 0; k < of.points; ++k) {
        const float* const sum = planes.sums + 3 * k;
        frame.forces[2 * k] = sum[0];
        frame.forces[2 * k + 1] = sum[1];
        own += static_cast<double>(sum[2] * sum[2]);
    }
    *frame.energy = energy;
    *frame.own = own;
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow

#if FINGERFLOW_ONCE

#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
FINGERFLOW_OTHER_SETS(strain_of_frame)
}  // namespace fingerflow

void fingerflow_strain_of_triangles(const fingerflow_triangle_strain* given, int threads) {
    using namespace fingerflow;
    const std::int64_t points = given->point_count, count = given->triangle_count;
    const Triangles triangles{count,
                              points,
                              given->corners,
                              given->slopes,
                              given->slopes + 3 * count,
                              given->products,
                              given->areas,
                              given->flat,
                              squared_factor(given->measure),
                              mixed_factor(given->measure),
                              static_cast<float>(given->direct),
                              static_cast<float>(given->between),
                              static_cast<float>(given->shear)};
    parallel_for(given->batch, threads, [&](std::int64_t number) {
        const TriangleFrame frame{given->displacement + 2 * points * number,
                                  given->covariance + 4 * points * number,
                                  given->in_contact + count * number,
                                  given->strain + 3 * count * number,
                                  given->strain_std + 3 * count * number,
                                  given->density + count * number,
                                  given->energy + number,
                                  given->forces + 2 * points * number,
                                  given->own + number};
        const std::size_t bytes = static_cast<std::size_t>(triangle_memory(triangles)) * sizeof(float);
        FINGERFLOW_PICK(strain_of_frame)(triangles, frame, static_cast<float*>(workspace(bytes)));
    });
}

#endif
