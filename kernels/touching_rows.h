// Pixels below a share of the light of the empty glass, the majority in every window, in some rows of one frame.
#pragma once

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

// Light and black (height, width) float, one image or one a frame.
struct Lit {
    const float *light, *black;
    std::int64_t lights, blacks;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // `size` at most 15. `result` is of the whole batch; `lines` holds (2 size + 2) x (width + size + 64) bytes.
    void touching_rows(const Frames& frames, const Lit& lit, std::int64_t frame, std::int64_t top, std::int64_t bottom,
                       int size, float share, unsigned char* lines, unsigned char* result);
)
// clang-format on

}  // namespace fingerflow
