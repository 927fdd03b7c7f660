// Dilation of some rows of one mask (morphology.cpp).
#pragma once

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

struct Element {
    const std::int32_t* half_widths;  // of its 2 radius + 1 rows, symmetric about the middle
    std::int64_t radius;
    bool of_background;  // true for erosion: the background is dilated
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // `result` points to the whole batch; `lines` has space for (2 radius + 3) x (width + 2 radius) bytes.
    void dilate_rows(const Frames& masks, std::int64_t frame, std::int64_t top, std::int64_t bottom, const Element& element,
                     unsigned char* lines, unsigned char* result);
)
// clang-format on

}  // namespace fingerflow
