#include <algorithm>
#include <exception>

#include "interface.h"
#include "parallel.h"
#include "search_points.h"
#include "workspace.h"

int fingerflow_search_windows(const float* templates, const float* images, std::int64_t height, std::int64_t width,
                              const std::int64_t* image_index, const float* points, const float* guess,
                              std::int64_t count, int size, int reach, float* found, int threads) try {
    using namespace fingerflow;
    const Search search{templates, images, height, width, image_index, points, guess, size, reach, found};
    const std::int64_t at_a_time = 16;
    const auto bytes = static_cast<std::size_t>(FINGERFLOW_PICK(search_workspace_bytes)(size, reach));
    const auto find = FINGERFLOW_PICK(search_points);
    parallel_for((count + at_a_time - 1) / at_a_time, threads, [&](std::int64_t piece) {
        find(search, piece * at_a_time, std::min(count, (piece + 1) * at_a_time), workspace(bytes));
    });
    return 0;
} catch (const std::exception&) {
    return 1;
}
