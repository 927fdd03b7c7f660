// Responses of the mask [1 -2 1]' [1 -2 1] on some rows of one frame (noise.cpp).
#pragma once

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

struct Responses {
    double sum;          // of the absolute values of finite responses
    std::int64_t count;  // of finite responses
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Adds the responses centred on every `step`-th row from `top` to before `bottom`. `line` has space for 4 width
    // bytes.
    void noise_rows(const Frames& frames, std::int64_t frame, std::int64_t top, std::int64_t bottom, std::int64_t step,
                    void* line, Responses* responses);
)
// clang-format on

}  // namespace fingerflow
