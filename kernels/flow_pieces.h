// How dense flow shares its rows out to threads.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "parallel.h"
#include "workspace.h"

namespace fingerflow {

// Calls work(y, memory) for the rows of a field, with room for `floats` numbers.
template <class Work>
void for_rows(std::int64_t height, std::int64_t width, std::int64_t floats, int threads, const Work& work) {
    constexpr std::int64_t rows = 16;        // of a piece of work
    constexpr std::int64_t worth_it = 8192;  // cells from which threads are asked to help
    const std::int64_t pieces = (height + rows - 1) / rows;
    const auto piece = [&](std::int64_t number) {
        auto* const memory = static_cast<float*>(workspace(static_cast<std::size_t>(floats) * sizeof(float)));
        for (std::int64_t y = number * rows; y < std::min(height, (number + 1) * rows); ++y) work(y, memory);
    };
    parallel_for(pieces, height * width < worth_it ? 1 : threads, piece);
}

}  // namespace fingerflow
