// Templates of points prepared, and found in frames, some of them: the piece of work of one thread.
#pragma once

#include <cstdint>

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

// As fingerflow/ops/tracking/templates.py has them, n the window: start (P, 2), samples (P, 3, n, n), numbers (P, 32).
struct TemplatesToPrepare {
    Frames image;
    const std::int64_t* order;  // numbers of points, as they are gone through
    std::int64_t points_an_image;
    int window, gain_offset;
    float rounding;
    float* start;               // NaN is written where there is no point
    const float* inverse_warp;  // (P, 2, 2), or null: the identity
    const float* variance;      // an image
    float* samples;
    float* numbers;
};

// The points of `batch` images followed through `steps` frames: image k * batch + b is frame k of the points of batch b.
struct TemplatesToFind {
    Frames frames;
    const std::int64_t* order;  // numbers of points, as they are gone through
    std::int64_t batch, points_an_image, steps;
    int window, rounds;
    const float* start;
    const float* samples;
    const float* numbers;
    const float* variance;  // a frame, or null: that of the key frame
    float* place;           // (P, 2), of the frame before the first, and of the last one afterwards
    float* speed;           // (P, 2) px a frame, likewise
    float rounding, forward_backward_limit, mismatch_limit;
    float* points;  // (steps, P, 2) and so on
    float* error;
    float* covariance;
    unsigned char* status;
    float* estimate;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    std::int64_t templates_workspace_bytes(int window);  // aligned to 64
    void prepare_templates(const TemplatesToPrepare& all, std::int64_t first, std::int64_t last, void* workspace);
    void find_templates(const TemplatesToFind& all, std::int64_t first, std::int64_t last, void* workspace);
    // Both at once, for one frame: samples are kept nowhere.
    void find_pairs(const TemplatesToPrepare& ones, const TemplatesToFind& others, std::int64_t first, std::int64_t last, void* workspace);
)
// clang-format on

}  // namespace fingerflow
