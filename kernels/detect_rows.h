// Local maxima of the smaller eigenvalue of the structure tensor, on some rows of a frame.
#pragma once

#include <cstdint>

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

constexpr std::int64_t kTensorReach = 2;                 // px, of the structure tensor's square of 5 x 5
constexpr std::int64_t kDetectReach = kTensorReach + 1;  // from a response to the farthest pixel it depends on

// Rows `top` to before `bottom` and columns `left` to before `right` of an image. Nearer than `edge` to that of the frame, at
// least kDetectReach, responses are 0.
struct DetectPart {
    Frames frame;
    const unsigned char* mask;
    std::int64_t mask_row_stride, edge, top, bottom, left, right;
    // Responses have one more row above, and one more column to the left.
    std::int64_t rows() const { return bottom - top; }
    std::int64_t columns() const { return right - left; }
    std::int64_t stride() const { return columns() + 2 + 2 * kDetectReach; }
    std::int64_t response_floats() const { return (rows() + 2) * stride(); }
    std::int64_t floats() const { return response_floats() + (3 * (2 * kTensorReach + 1) + 3 + 3) * stride(); }
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Writes responses (rows + 2, stride) to `memory`, which holds floats() numbers, and to `peaks` (rows, columns) whether a
    // pixel of the mask is as large as all its neighbours, and above 0.
    void detect_rows(const DetectPart& part, float* memory, unsigned char* peaks);
)
// clang-format on

}  // namespace fingerflow
