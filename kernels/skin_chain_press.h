// Presses of skin chains, one or a vector of them at a time.
#pragma once

#include <cstdint>

#include "instruction_sets.h"
#include "interface.h"

namespace fingerflow {

// How many chains go side by side, and how many bytes of memory they need.
struct SkinGroup {
    std::int64_t chains, bytes;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    SkinGroup skin_group(std::int64_t count, std::int64_t batch);
    // Chains first .. first + chains - 1 of those given, fewer at the end.
    void press_skin(const fingerflow_skin_chain& given, std::int64_t first, std::int64_t chains, void* memory);
    // One chain, with memory for a batch of 1.
    void press_skin_back(const fingerflow_skin_back& given, std::int64_t chain, void* memory);
)
// clang-format on

}  // namespace fingerflow
