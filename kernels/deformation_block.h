// Correction of the positions of a block of points for the deformation found by two local fits (deformation.cpp).
#pragma once

#include <cstdint>

#include "instruction_sets.h"
#include "interface.h"

namespace fingerflow {

constexpr int kDeformedPoints = 16;  // most points of one call

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Corrects `count` points, given by index, in all frames. `warp` holds the displacement gradient and becomes the
    // deformation gradient; `expected` holds a displacement and becomes a position. `second` (frames, points, 4, 2) is
    // the gradient of the displacement gradient.
    void correct_block(const fingerflow_deformation& given, const float* second, const std::int64_t* point, int count);
)
// clang-format on

}  // namespace fingerflow
