// Fits at positions of an ellipse that lie near each other, for medians over its area.
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

constexpr int kAreaBlock = 16;   // positions
constexpr int kAreaFields = 5;   // divergence, curl, exx, eyy, exy
constexpr int kAreaShares = 16;  // numbers a point gets: of each field, by the components of its displacement; zeros

// Lengths are in radii of a fit's support from the centre of the ellipse, displacements in the unit that was given.
struct AreaSettings {
    std::int64_t measure;
    float minimum_points, radius, least_spread, farthest, least_ratio;
};

// The points that may lie within a radius of a position of the block; number among those of the frame.
struct AreaPoints {
    const float *x, *y, *u, *v;
    const std::int32_t* number;
    std::int64_t count;
};

struct AreaFits {
    float x[kAreaBlock], y[kAreaBlock];
    float known[kAreaBlock];                              // 0 or 1
    float center_x[kAreaBlock], center_y[kAreaBlock];     // weighted mean place of the points
    float inverse[3][kAreaBlock], share[kAreaBlock];      // xx, xy, yy of the second moments' inverse; 1 / sum of weights
    float gradient[4][kAreaBlock];                        // by reference coordinates, ux, uy, vx, vy
    float fields[kAreaFields][kAreaBlock];
};

// What the positions beside a median take part in its error with.
struct AreaBeside {
    float median[kAreaFields];
    float xx, xy, yy;    // mean covariance of a point
    float reach, even;   // as in fingerflow/ops/fields/area_medians.py
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    void fit_area(const AreaSettings& settings, const AreaPoints& points, AreaFits& fits);
    // Adds to (points of the frame, kAreaShares) numbers how much each point's displacement moves the sum of the fields
    // beside their medians, and to `total` how many positions these are. `memory` has room for 2 kAreaBlock count numbers.
    void add_shares(const AreaSettings& settings, const AreaPoints& points, const AreaFits& fits,
                    const AreaBeside& beside, float* memory, float* shares,
                    float (&total)[kAreaFields]);
)
// clang-format on

}  // namespace fingerflow
