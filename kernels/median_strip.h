// A part of one frame that one thread filters at a time.
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

// Pixels from row `top` to before `bottom` and from column `left` to before `right`.
struct MedianStrip {
    std::int64_t height, width, row_stride;  // of the frame
    std::int64_t top, bottom, left, right;
};

struct MedianLimits {
    std::int64_t width;            // of the widest strip; strips begin at multiples of `alignment`
    std::int64_t alignment;
    std::int64_t workspace_bytes;  // aligned to 64
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // False where there is no compiled network for the size.
    bool median_limits(int pixel_bytes, int size, MedianLimits* limits);
    void median_strip(const void* frame, void* medians, int pixel_bytes, int size, const MedianStrip& strip, void* workspace);
)
// clang-format on

}  // namespace fingerflow
