// Medians of a band of rows of one frame, the piece of one thread (median_band.cpp).
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

struct MedianBand {
    std::int64_t height, width, row_stride;  // of the frame
    std::int64_t top, bottom;                // rows from `top` to before `bottom`
};

struct MedianKind {
    int pixel_bytes, size;
    const std::uint16_t* table;  // of an interpreted network, else null
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Bytes of the workspace, aligned to 64, for `rows` rows; 0 if the size has no compiled network and no table.
    std::int64_t median_workspace_bytes(const MedianKind& kind, std::int64_t rows, std::int64_t width);
    // `frame` and `medians` point to the whole frame; `medians` is contiguous.
    void median_band(const MedianKind& kind, const void* frame, void* medians, const MedianBand& band, void* workspace);
)
// clang-format on

}  // namespace fingerflow
