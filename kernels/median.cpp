// Medians of size x size windows (fingerflow/ops/filters/median.py): frames divided into bands of rows that threads
// share. The networks of minima and maxima run in median_band.cpp.
// Layout: pixels of 8 or 16 bit; a band and its kept planes fit into a second-level cache, and its rows are a multiple
// of 8.
#include <algorithm>
#include <stdexcept>

#include "interface.h"
#include "median_band.h"
#include "parallel.h"
#include "workspace.h"

void fingerflow_median(const void* frames, void* medians, std::int64_t batch, std::int64_t height, std::int64_t width,
                       std::int64_t frame_stride, std::int64_t row_stride, int pixel_bytes, int size, const std::uint16_t* table, int threads) {
    using namespace fingerflow;
    if (batch * height * width == 0) return;

    // Bands fit into a second-level cache and occupy all threads, but have at least four windows of rows, since each
    // band also reads half a window above and below it.
    const std::int64_t cached = std::max<std::int64_t>(1, (256 * 1024) / (width * pixel_bytes));
    const std::int64_t shared = (height * batch + threads - 1) / threads;
    const std::int64_t most = std::max<std::int64_t>(4 * size, std::min(cached, shared));
    const std::int64_t bands = (height + most - 1) / most;
    const std::int64_t rows = ((height + bands - 1) / bands + 7) / 8 * 8;

    const MedianKind kind{pixel_bytes, size, table};
    const auto bytes = static_cast<std::size_t>(FINGERFLOW_PICK(median_workspace_bytes)(kind, rows, width));
    if (bytes == 0) throw std::invalid_argument("the library holds no median of this size, and was given no table of it");
    const auto filter = FINGERFLOW_PICK(median_band);
    const std::int64_t pieces = (height + rows - 1) / rows;
    parallel_for(batch * pieces, threads, [&](std::int64_t piece) {
        const std::int64_t frame = piece / pieces, top = piece % pieces * rows;
        const MedianBand band{height, width, row_stride, top, std::min(height, top + rows)};
        filter(kind, static_cast<const char*>(frames) + frame * frame_stride * pixel_bytes,
               static_cast<char*>(medians) + frame * height * width * pixel_bytes, band,
               workspace(bytes));
    });
}
