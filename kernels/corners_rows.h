// Corner responses on some rows of one uint8 frame, and their local maxima (corners.cpp).
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

// The window has at most 15 px, for which its integer sums fit into 32 bits.
struct CornerFrame {
    const std::uint8_t* data;
    const unsigned char* mask;  // or null
    std::int64_t height, width, row_stride, mask_row_stride, window, border;
    float floor;  // candidates have a larger response
};

struct CornerCandidates {
    std::uint64_t* keys;  // ascending keys are descending responses, equal ones in reading order; space for every pixel
    std::int64_t count;
    float strongest;  // greatest response inside mask and border, candidate or not; at least 0
};

// Bytes of memory that `corner_rows` needs.
constexpr std::int64_t kCornerPadding = 64;
constexpr std::int64_t corner_memory(std::int64_t width, std::int64_t window) {
    return 4 * (3 * window + 12) * (width + kCornerPadding);
}

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    void corner_rows(const CornerFrame& frame, std::int64_t top, std::int64_t bottom, void* memory,
                     CornerCandidates* candidates);
)
// clang-format on

}  // namespace fingerflow
