// Medians of some rows of one frame, the piece of work of one thread.
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
    const std::uint16_t* table;  // of a network that was not compiled, else null
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Of a workspace, aligned to 64, for so many rows of a frame; 0 where there is no compiled network for the size.
    std::int64_t median_workspace_bytes(const MedianKind& kind, std::int64_t rows, std::int64_t width);
    // `frame` and `medians` are of the whole frame; `medians` is contiguous.
    void median_band(const MedianKind& kind, const void* frame, void* medians, const MedianBand& band, void* workspace);
)
// clang-format on

}  // namespace fingerflow
