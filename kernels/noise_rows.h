// Responses of the mask [1 -2 1]^T [1 -2 1] on some rows of one frame.
#pragma once

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

struct Responses {
    double sum;          // of the finite ones, without their signs
    std::int64_t count;  // of the finite ones
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // `line` holds 4 width bytes; the masks whose middle lies on every `step`-th row from `top` to before `bottom`.
    void noise_rows(const Frames& frames, std::int64_t frame, std::int64_t top, std::int64_t bottom, std::int64_t step,
                    void* line, Responses* responses);
)
// clang-format on

}  // namespace fingerflow
