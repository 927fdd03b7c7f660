// Lines of a frame as levels of intensity loss, of one byte.
#pragma once

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Levels of a line, and bytes that say where it is lit; `light` and `black` are those of the line.
    void levels_of_line(const Frames& frames, std::int64_t y, const float* light, const float* black,
                        unsigned char* levels, unsigned char* lit);
)
// clang-format on

}  // namespace fingerflow
