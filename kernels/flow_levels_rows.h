// Rows of what dense flow prepares of its structure tensor: the levels of its multigrid, and the covariance of noise.
#pragma once

#include <cstdint>

#include "flow_rows.h"
#include "instruction_sets.h"

namespace fingerflow {

// Planes of a coarser level to be written.
struct FlowCoarser {
    float *tensor, *right, *down, *inside;
    std::int64_t height, width;
};

// Variance of noise and smoothing, as fingerflow/ops/flow/flow_covariance.py names them; the eigenvalue from which texture is known.
struct FlowNoise {
    float density, alpha, rho_square, textured;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Row y of the inverses of J + alpha deg, 0 where they are not known.
    void flow_inverse_row(const FlowLevel& level, const float* zeros, float* inverse, std::int64_t y);
    // Row y of the level of twice the size. `memory` holds 4 rows of the finer one.
    void flow_coarser_row(const FlowLevel& level, const FlowCoarser& coarser, float* memory, std::int64_t y);
    // Row of covariances xx, xy, yy of tensors xx, xy, yy.
    void flow_covariance_row(const float* const* tensor, const FlowNoise& noise, std::int64_t width, float* const* covariance);
)
// clang-format on

}  // namespace fingerflow
