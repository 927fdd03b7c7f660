// Fits at a block of neighbouring positions of an ellipse, for medians over its area (area_medians.cpp).
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

constexpr int kAreaBlock = 16;   // positions
constexpr int kAreaFields = 5;   // divergence, curl, exx, eyy, exy
constexpr int kAreaShares = 16;  // floats a point: (field, component of its displacement), then zeros

// `radius` and displacements are in the unit given; other lengths are in radii, from the centre of the ellipse.
struct AreaSettings {
    std::int64_t measure;
    float minimum_points, radius, least_spread, farthest, least_ratio;
};

// The points that may lie within a radius of a position of the block; `number` is the index in the frame's sorted
// points.
struct AreaPoints {
    const float *x, *y, *u, *v;
    const std::int32_t* number;
    std::int64_t count;
};

struct AreaFits {
    float x[kAreaBlock], y[kAreaBlock];
    float known[kAreaBlock];                              // 0 or 1
    float center_x[kAreaBlock], center_y[kAreaBlock];     // weighted centroid of the points
    float inverse[3][kAreaBlock], share[kAreaBlock];      // inverse second moments xx, xy, yy; 1 / sum of weights
    float gradient[4][kAreaBlock];                        // displacement gradient H by reference coordinates: ux, uy, vx, vy
    float fields[kAreaFields][kAreaBlock];
};

// Which positions count towards a median's error: those whose field lies near the median.
struct AreaBeside {
    float median[kAreaFields];
    float xx, xy, yy;    // mean covariance of a point
    float reach, even;   // constants of fingerflow/ops/fields/area_medians.py
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    void fit_area(const AreaSettings& settings, const AreaPoints& points, AreaFits& fits);
    // Adds to `shares` (points of the frame, kAreaShares) the sensitivity of the weighted sum of the fields near their
    // medians to each point's displacement, and to `total` the sum of the weights. `memory` has space for
    // 2 kAreaBlock count floats.
    void add_shares(const AreaSettings& settings, const AreaPoints& points, const AreaFits& fits,
                    const AreaBeside& beside, float* memory, float* shares,
                    float (&total)[kAreaFields]);
)
// clang-format on

}  // namespace fingerflow
