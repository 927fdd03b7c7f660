// Local maxima of the smaller eigenvalue of the structure tensor on some rows of a frame (detect.cpp).
#pragma once

#include <cstdint>

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

constexpr std::int64_t kTensorReach = 2;                 // px from the middle of the structure tensor's 5 x 5 square
constexpr std::int64_t kDetectReach = kTensorReach + 1;  // px from a response to the farthest pixel that it depends on

// Rows `top` to before `bottom` and columns `left` to before `right` of an image. Responses nearer than `edge` px to
// the frame's border are 0; `edge` is at least kDetectReach.
struct DetectPart {
    Frames frame;
    const unsigned char* mask;
    std::int64_t mask_row_stride, edge, top, bottom, left, right;
    // Responses have one more row above and below, and one more column to the left.
    std::int64_t rows() const { return bottom - top; }
    std::int64_t columns() const { return right - left; }
    std::int64_t stride() const { return columns() + 2 + 2 * kDetectReach; }
    std::int64_t response_floats() const { return (rows() + 2) * stride(); }
    std::int64_t floats() const { return response_floats() + (3 * (2 * kTensorReach + 1) + 3 + 3) * stride(); }
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Writes responses (rows + 2, stride) to `memory`, which has space for floats() floats, and to `peaks` (rows,
    // columns) 1 where a pixel of the mask has a response above 0 and not below any neighbour's.
    void detect_rows(const DetectPart& part, float* memory, unsigned char* peaks);
)
// clang-format on

}  // namespace fingerflow
