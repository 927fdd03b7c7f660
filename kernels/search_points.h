// Windows found in another image by exhaustive search, some of them: the piece of work of one thread.
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

// As fingerflow/ops/tracking/search.py has them: images (B, height, width) of half resolution, points flat over them.
struct Search {
    const float* templates;
    const float* images;
    std::int64_t height, width;
    const std::int64_t* image_index;  // (P)
    const float* points;              // (P, 2) px of full resolution, as all positions
    const float* guess;
    int size, reach;  // of a template and of the search, px of half resolution
    float* found;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    std::int64_t search_workspace_bytes(int size, int reach);  // aligned to 64
    void search_points(const Search& search, std::int64_t first, std::int64_t last, void* workspace);
)
// clang-format on

}  // namespace fingerflow
