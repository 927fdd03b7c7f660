// Strain of triangles in one frame, and its energy (triangle_strain_frame.cpp).
#pragma once

#include <cstdint>

#include "instruction_sets.h"

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

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    void strain_of_frame(const Triangles& triangles, const TriangleFrame& frame, float* memory);
)
// clang-format on

}  // namespace fingerflow
