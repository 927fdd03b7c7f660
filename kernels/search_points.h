// Exhaustive search for some windows in another image, the piece of one thread (search_points.cpp).
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

// Arguments of fingerflow/ops/tracking/search.py: images (B, height, width) of half resolution, P points.
struct Search {
    const float* templates;
    const float* images;
    std::int64_t height, width;
    const std::int64_t* image_index;  // (P)
    const float* points;              // (P, 2) px of full resolution, as are guess and found
    const float* guess;
    int size, reach;  // template width and search radius, px of half resolution
    float* found;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    std::int64_t search_workspace_bytes(int size, int reach);  // aligned to 64
    void search_points(const Search& search, std::int64_t first, std::int64_t last, void* workspace);
)
// clang-format on

}  // namespace fingerflow
