#include <algorithm>
#include <exception>

#include "interface.h"
#include "median_above_rows.h"
#include "parallel.h"
#include "workspace.h"

int fingerflow_median_above(const void* frames, unsigned char* above, std::int64_t batch, std::int64_t height,
                            std::int64_t width, std::int64_t frame_stride, std::int64_t row_stride, int kind,
                            const double* thresholds, int size, int threads) try {
    using namespace fingerflow;
    if (batch * height * width == 0) return 0;
    const Frames given{frames, batch, height, width, frame_stride, row_stride, static_cast<PixelKind>(kind)};
    const std::int64_t rows = std::max<std::int64_t>(8 * size, (height * batch + 2 * threads - 1) / (2 * threads));
    const std::int64_t pieces = (height + rows - 1) / rows;
    const auto count = FINGERFLOW_PICK(median_above_rows);
    parallel_for(batch * pieces, threads, [&](std::int64_t piece) {
        const std::int64_t frame = piece / pieces, top = piece % pieces * rows;
        const auto lines = workspace(static_cast<std::size_t>((size + 2) * (width + size + 64)));
        count(given, frame, top, std::min(height, top + rows), size, thresholds[frame], static_cast<unsigned char*>(lines), above);
    });
    return 0;
} catch (const std::exception&) {
    return 1;
}
