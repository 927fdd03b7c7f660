// Preparation and search of the templates of some points, the piece of one thread (templates_points.cpp).
#pragma once

#include <cstdint>

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

// Arrays of fingerflow/ops/tracking/templates.py, n the window: start (P, 2), samples (P, 3, n, n), numbers (template
// statistics) (P, 32).
struct TemplatesToPrepare {
    Frames image;
    const std::int64_t* order;  // order in which points are processed
    std::int64_t points_an_image;
    int window, gain_offset;
    float rounding;
    float* start;               // NaN is written where the point is not finite
    const float* inverse_warp;  // (P, 2, 2), or null for the identity
    const float* variance;      // (images)
    float* samples;
    float* numbers;
};

// Points of `batch` images followed through `steps` frames: image k * batch + b is frame k of the points of image b.
struct TemplatesToFind {
    Frames frames;
    const std::int64_t* order;  // order in which points are processed
    std::int64_t batch, points_an_image, steps;
    int window, rounds;
    const float* start;
    const float* samples;
    const float* numbers;
    const float* variance;  // one a frame, or null for that of the key frame
    float* place;           // (P, 2) in the frame before the first; after the call in the last
    float* speed;           // (P, 2) px a frame, as `place`
    float rounding, forward_backward_limit, mismatch_limit;
    float* points;  // (steps, P, 2); the others likewise (steps, P, ...)
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
    // Prepares and finds templates in one frame, without storing samples.
    void find_pairs(const TemplatesToPrepare& ones, const TemplatesToFind& others, std::int64_t first, std::int64_t last, void* workspace);
)
// clang-format on

}  // namespace fingerflow
