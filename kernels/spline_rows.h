// Spline coefficients of some rows of a frame (spline.cpp).
#pragma once

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Writes rows `top` to before `bottom` of a frame's coefficients. `line` has space for width + 2 floats.
    void spline_rows(const Frames& frames, std::int64_t frame, std::int64_t top, std::int64_t bottom, float* line, float* coefficients);
)
// clang-format on

}  // namespace fingerflow
