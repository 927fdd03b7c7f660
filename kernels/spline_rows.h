// Rows of the coefficients of splines.
#pragma once

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Rows from `top` to before `bottom` of the coefficients of a frame. `line` holds width + 2 numbers.
    void spline_rows(const Frames& frames, std::int64_t frame, std::int64_t top, std::int64_t bottom, float* line, float* coefficients);
)
// clang-format on

}  // namespace fingerflow
