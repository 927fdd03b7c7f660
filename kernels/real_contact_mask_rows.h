// Real-contact mask of some rows of all frames: the majority in each window of pixels below a share of the light.
#pragma once

#include <cstddef>

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

// Light and black, floats (height, width), one image or one a frame.
struct Lit {
    const float *light, *black;
    std::int64_t lights, blacks;
};

// Bytes of memory: lines of bytes of one frame, or lines of bits of all frames.
inline std::size_t real_contact_mask_memory(const Frames& frames, int size) {
    const std::int64_t bytes = (2 * size + 2) * (frames.width + size + 64), words = (frames.width + 63) / 64 + 2;
    const std::int64_t bits = 8 * words * (6 * frames.batch + 2);
    return static_cast<std::size_t>(bytes > bits ? bytes : bits);
}

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Writes some rows of all frames, each with its share. `size` is at most 15; `result` points to the whole batch;
    // `memory` has real_contact_mask_memory bytes.
    void real_contact_mask_rows(const Frames& frames, const Lit& lit, std::int64_t top, std::int64_t bottom, int size,
                       const float* shares, unsigned char* memory, unsigned char* result);
)
// clang-format on

}  // namespace fingerflow
