// Points tracked between two images, some of them: the piece of work of one thread.
#pragma once

#include <cstdint>

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

// As fingerflow/ops/tracking.py has them. Points, guesses and the results are (P, 2), warps and covariances (P, 2, 2).
struct TrackedPair {
    Frames images[2];                 // of one shape
    const std::int64_t* image_index;  // (P)
    const float* noise;               // (P)
    const float* start;
    const float* guess;
    const float* back_guess;  // or null: the predicted motion, reversed
    const float* warp;        // or null: the identity
    int window, gain_offset;
    float rounding, forward_backward_limit, mismatch_limit;
    float* points;
    float* error;
    float* covariance;
    unsigned char* status;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    std::int64_t tracking_workspace_bytes(int window);  // aligned to 64
    void track_points(const TrackedPair& pair, std::int64_t first, std::int64_t last, void* workspace);
)
// clang-format on

}  // namespace fingerflow
