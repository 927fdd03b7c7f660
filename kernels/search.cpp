#include <algorithm>

#include "halve_rows.h"
#include "interface.h"
#include "parallel.h"
#include "search_points.h"
#include "workspace.h"

void fingerflow_halve(const void* frames, float* halved, std::int64_t batch, std::int64_t height, std::int64_t width,
                      std::int64_t frame_stride, std::int64_t row_stride, int kind, int threads) {
    using namespace fingerflow;
    const Frames given{frames, batch, height, width, frame_stride, row_stride, static_cast<PixelKind>(kind)};
    const std::int64_t rows = height / 2, at_a_time = 32, pieces = (rows + at_a_time - 1) / at_a_time;
    const auto halve = FINGERFLOW_PICK(halve_rows);
    parallel_for(batch * pieces, threads, [&](std::int64_t piece) {
        const std::int64_t frame = piece / pieces, top = piece % pieces * at_a_time;
        halve(given, frame, top, std::min(rows, top + at_a_time), halved + frame * rows * (width / 2));
    });
}

void fingerflow_search_windows(const float* templates, const float* images, std::int64_t height, std::int64_t width,
                               const std::int64_t* image_index, const float* points, const float* guess,
                               std::int64_t count, int size, int reach, float* found, int threads) {
    using namespace fingerflow;
    const Search search{templates, images, height, width, image_index, points, guess, size, reach, found};
    const std::int64_t at_a_time = 16;
    const auto bytes = static_cast<std::size_t>(FINGERFLOW_PICK(search_workspace_bytes)(size, reach));
    const auto find = FINGERFLOW_PICK(search_points);
    parallel_for((count + at_a_time - 1) / at_a_time, threads, [&](std::int64_t piece) {
        find(search, piece * at_a_time, std::min(count, (piece + 1) * at_a_time), workspace(bytes));
    });
}
