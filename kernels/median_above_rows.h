// Where more than half of a window lies above a threshold, in some rows of one frame.
#pragma once

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // `size` at most 15. `result` is of the whole batch; `lines` holds (size + 2) x (width + size + 64) bytes.
    void median_above_rows(const Frames& frames, std::int64_t frame, std::int64_t top, std::int64_t bottom, int size,
                           double threshold, unsigned char* lines, unsigned char* result);
)
// clang-format on

}  // namespace fingerflow
