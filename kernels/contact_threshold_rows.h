// Intensity loss of the lines of a frame as 8-bit levels (contact_threshold.cpp).
#pragma once

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Writes the levels of a line and which pixels are lit; `light` and `black` are those of the line.
    void levels_of_line(const Frames& frames, std::int64_t y, const float* light, const float* black,
                        unsigned char* levels, unsigned char* lit);
)
// clang-format on

}  // namespace fingerflow
