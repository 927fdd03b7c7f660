// Frames cut into strips, the strips shared out to threads.
#include <algorithm>
#include <new>

#include "interface.h"
#include "median_strip.h"
#include "parallel.h"
#include "workspace.h"

int fingerflow_median(const void* frames, void* medians, std::int64_t batch, std::int64_t height, std::int64_t width,
                      std::int64_t frame_stride, std::int64_t row_stride, int pixel_bytes, int size, int threads) try {
    using namespace fingerflow;
    MedianLimits limits;
    if (!FINGERFLOW_PICK(median_limits)(pixel_bytes, size, &limits)) return 2;

    // Strips of about equal width; more rows than threads only where rows are many, since each strip reads `size` extra.
    const std::int64_t widest = std::max(limits.width / limits.alignment * limits.alignment, limits.alignment);
    const std::int64_t across = (width + widest - 1) / widest;
    const std::int64_t strip_width = ((width + across - 1) / across + limits.alignment - 1) / limits.alignment * limits.alignment;
    const std::int64_t down = std::max<std::int64_t>(1, std::min<std::int64_t>(height / (4 * size), (2 * threads + batch - 1) / batch));
    const std::int64_t strip_height = ((height + down - 1) / down + 7) / 8 * 8;
    const std::int64_t rows = (height + strip_height - 1) / strip_height, columns = (width + strip_width - 1) / strip_width;

    const auto strip = FINGERFLOW_PICK(median_strip);
    parallel_for(batch * rows * columns, threads, [&](std::int64_t piece) {
        const std::int64_t frame = piece / (rows * columns), row = piece / columns % rows, column = piece % columns;
        const std::int64_t top = row * strip_height, left = column * strip_width;
        const MedianStrip part{height, width, row_stride, top, std::min(height, top + strip_height),
                               left, std::min(width, left + strip_width)};
        strip(static_cast<const char*>(frames) + frame * frame_stride * pixel_bytes,
              static_cast<char*>(medians) + frame * height * width * pixel_bytes, pixel_bytes, size, part,
              workspace(static_cast<std::size_t>(limits.workspace_bytes)));
    });
    return 0;
} catch (const std::exception&) {
    return 1;
}
