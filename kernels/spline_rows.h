// Spline coefficients of some rows of one frame: samples smoothed by [1 2 1] / 4 both ways, mirrored about the border.
#pragma once

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // `line` holds width floats; rows from `top` to before `bottom` of `coefficients`, which is contiguous.
    void spline_rows(const Frames& frames, std::int64_t frame, std::int64_t top, std::int64_t bottom, float* line,
                     float* coefficients);
)
// clang-format on

}  // namespace fingerflow
