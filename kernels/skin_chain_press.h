// Presses of skin chains, one chain or a vector of chains at a time (skin_chain_press.cpp).
#pragma once

#include "instruction_sets.h"
#include "interface.h"

namespace fingerflow {

// Chains in the lanes of a vector, and bytes of memory that they need.
struct SkinGroup {
    std::int64_t chains, bytes;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    SkinGroup skin_group(std::int64_t count, std::int64_t batch);
    // Presses chains `first` to `first + chains - 1`, fewer at the end of the batch.
    void press_skin(const fingerflow_skin_chain& given, std::int64_t first, std::int64_t chains, void* memory);
)
// clang-format on

}  // namespace fingerflow
