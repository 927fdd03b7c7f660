// Some rows of a frame at half resolution: means of 2 x 2 pixels.
#pragma once

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Writes rows `top` to before `bottom` of `halved`, which is contiguous and width / 2 wide.
    void halve_rows(const Frames& frames, std::int64_t frame, std::int64_t top, std::int64_t bottom, float* halved);
)
// clang-format on

}  // namespace fingerflow
