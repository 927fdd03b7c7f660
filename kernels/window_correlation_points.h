// Samples of some deformed windows by cubic convolution, the piece of one thread (window_correlation_points.cpp).
#pragma once

#include <cstdint>

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

// Windows of fingerflow/ops/tracking/window_correlation.py: grids from -reach to reach, `step` px apart.
struct WindowsToSample {
    Frames frames;
    const std::int64_t* image_index;  // (N)
    const float* places;              // (N, 2)
    const float* warp;                // (N, 2, 2)
    int reach, step;
    float* found;  // (N, side, side)
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    std::int64_t windows_workspace_bytes(int reach, int step);
    void sample_windows(const WindowsToSample& windows, std::int64_t first, std::int64_t last, void* workspace);
)
// clang-format on

}  // namespace fingerflow
