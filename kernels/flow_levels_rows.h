// Row loops of what dense flow prepares from the structure tensor: multigrid levels, and covariance (flow_levels.cpp).
#pragma once

#include <cstdint>

#include "flow_rows.h"
#include "instruction_sets.h"

namespace fingerflow {

// Planes of a coarser level, which are written.
struct FlowCoarser {
    float *tensor, *right, *down, *inside;
    std::int64_t height, width;
};

// Noise density and smoothing (fingerflow/ops/flow/flow_covariance.py), and the least eigenvalue of textured cells.
struct FlowNoise {
    float density, alpha, rho_square, textured;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Writes row y of (J + sum of edges)^-1, 0 where it is singular.
    void flow_inverse_row(const FlowLevel& level, const float* zeros, float* inverse, std::int64_t y);
    // Writes row y of the coarser level. `memory` has space for 4 rows of the finer one.
    void flow_coarser_row(const FlowLevel& level, const FlowCoarser& coarser, float* memory, std::int64_t y);
    // Writes a row of covariances xx, xy, yy from tensors xx, xy, yy.
    void flow_covariance_row(const float* const* tensor, const FlowNoise& noise, std::int64_t width, float* const* covariance);
)
// clang-format on

}  // namespace fingerflow
