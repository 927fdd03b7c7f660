// Division of the rows of dense flow among threads.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "parallel.h"
#include "workspace.h"

namespace fingerflow {

// Calls work(y, memory) for each row of a field, with space for `floats` floats.
template <class Work>
void for_rows(std::int64_t height, std::int64_t width, std::int64_t floats, int threads, const Work& work) {
    constexpr std::int64_t rows = 16;        // of a piece
    constexpr std::int64_t worth_it = 8192;  // cells from which several threads are used
    const std::int64_t pieces = (height + rows - 1) / rows;
    const auto piece = [&](std::int64_t number) {
        auto* const memory = static_cast<float*>(workspace(static_cast<std::size_t>(floats) * sizeof(float)));
        for (std::int64_t y = number * rows; y < std::min(height, (number + 1) * rows); ++y) work(y, memory);
    };
    parallel_for(pieces, height * width < worth_it ? 1 : threads, piece);
}

}  // namespace fingerflow
