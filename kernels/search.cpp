// Search by normalised cross-correlation in half resolution, forwards and back (fingerflow/ops/tracking/search.py), and
// the halved images. A window returns if the search back ends within `limit` px of its start.
// Layout: halved images are floats (batch, height / 2, width / 2); points, guesses and results (count, 2) px of full
// resolution. Pieces of 16 points or 32 rows.
#include <algorithm>
#include <cmath>
#include <vector>

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

void fingerflow_search_and_return(const fingerflow_search_both_ways* given, int threads) {
    const std::int64_t count = given->count, height = given->height / 2, width = given->width / 2;
    if (count == 0) return;
    const auto pixels = static_cast<std::size_t>(given->batch * height * width);
    std::vector<float> key(pixels), current(pixels), back(static_cast<std::size_t>(2 * count));
    fingerflow_halve(given->key, key.data(), given->batch, given->height, given->width, given->key_stride, given->key_row_stride,
                     static_cast<int>(given->key_kind), threads);
    fingerflow_halve(given->current, current.data(), given->batch, given->height, given->width, given->current_stride,
                     given->current_row_stride, static_cast<int>(given->current_kind), threads);
    const auto search = [&](const std::vector<float>& templates, const std::vector<float>& images, const float* points,
                            const float* guess, float* found) {
        fingerflow_search_windows(templates.data(), images.data(), height, width, given->image_index, points, guess, count,
                                  given->size, given->reach, found, threads);
    };
    search(key, current, given->start, given->guess, given->found);
    search(current, key, given->found, given->start, back.data());
    for (std::int64_t k = 0; k < count; ++k) {
        const float *const end = back.data() + 2 * k, *const start = given->start + 2 * k;
        const float x = end[0] - start[0], y = end[1] - start[1];
        given->returns[k] = std::sqrt(x * x + y * y) <= given->limit;
    }
}
