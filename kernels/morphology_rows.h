// Dilation of some rows of one mask.
#pragma once

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

struct Element {
    const std::int32_t* half_widths;  // of its rows, 2 radius + 1, the same upwards and downwards
    std::int64_t radius;
    bool of_background;  // erosion: the background is dilated
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // `result` is of the whole batch; `lines` holds (2 radius + 3) x (width + 2 radius) bytes.
    void dilate_rows(const Frames& masks, std::int64_t frame, std::int64_t top, std::int64_t bottom, const Element& element,
                     unsigned char* lines, unsigned char* result);
)
// clang-format on

}  // namespace fingerflow
