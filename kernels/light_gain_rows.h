// Lines of a frame beside those of the empty glass.
#pragma once

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

// Sums over lines, a number a column, `width` floats each: counts less those without light, and light, and their squares.
struct LitColumns {
    float *passed, *light, *passed_squared, *light_squared;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Adds the pixels of a line that are lit to the columns; `light` and `black` are those of the line. The line `ahead`
    // is the next one that will be asked for: lines that do not follow each other are fetched by no processor by itself.
    void add_lit_line(const Frames& frames, std::int64_t frame, std::int64_t y, std::int64_t ahead, const float* light,
                      const float* black, const LitColumns& columns);
    // Sums of `side` neighbours of `blocks` x `side` numbers, which are lost.
    void sum_blocks(float* numbers, std::int64_t blocks, std::int64_t side, float* sums);
    // Mean of those of the numbers, a multiple of 16 of them, that lie within `width` of a middle; 0 if none do.
    float mean_within(const float* numbers, std::int64_t count, float middle, float width);
)
// clang-format on

}  // namespace fingerflow
