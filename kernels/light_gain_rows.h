// Sums over lines of a frame and of the empty glass, for the illumination gain (light_gain.cpp).
#pragma once

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

// Sums over lines by column, (width) each: frame - black, light, and the squares of both.
struct LitColumns {
    float *passed, *light, *passed_squared, *light_squared;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Adds the lit pixels of a line to the columns; `light` and `black` are those of the line. `ahead` is a later line
    // to prefetch, since hardware does not prefetch lines that do not follow each other.
    void add_lit_line(const Frames& frames, std::int64_t frame, std::int64_t y, std::int64_t ahead, const float* light,
                      const float* black, const LitColumns& columns);
    // Writes the sums of each `side` neighbours of blocks x side `numbers`, which are overwritten.
    void sum_blocks(float* numbers, std::int64_t blocks, std::int64_t side, float* sums);
    // Mean of the numbers within `width` of `middle`, 0 if there is none; `count` is a multiple of 16.
    float mean_within(const float* numbers, std::int64_t count, float middle, float width);
)
// clang-format on

}  // namespace fingerflow
