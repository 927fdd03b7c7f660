// Strain of triangles in one frame, and its energy.
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

// Triangles in their reference state, (triangles) or (3, triangles) by corners.
struct Triangles {
    std::int64_t count, points;
    const std::int32_t* corners;
    const float *along, *down;    // gradients of the functions that are 1 at a corner; 0 for a flat triangle
    const float* products;        // (3, 3, triangles), xx, xy, yy of a corner's gradient with that of what shares its errors
    const float *areas, *flat;    // flat is NaN for a flat triangle, else 0
    float squared, mixed;         // factors of the squares in the strain, of the direct parts and of the shear
    float direct, between, shear; // of exx^2 + eyy^2, exx eyy and exy^2 in the energy
};

// Of one frame; displacement (points, 2), covariance (points, 2, 2), in_contact (triangles).
struct TriangleFrame {
    const float *displacement, *covariance;
    const unsigned char* in_contact;
    float *strain, *strain_std, *density;  // (triangles, 3), (triangles, 3), (triangles)
    double* energy;
    float* forces;  // (points, 2)
    double* own;    // sum of the squares of what each point's error adds to the energy
};

// How many floats `memory` of a frame has to hold.
inline std::int64_t triangle_memory(const Triangles& triangles) { return 8 * triangles.points + 11 * triangles.count; }

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    void strain_of_frame(const Triangles& triangles, const TriangleFrame& frame, float* memory);
)
// clang-format on

}  // namespace fingerflow
