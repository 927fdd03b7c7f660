// Dilation of masks, or erosion as dilation of the background (fingerflow/ops/filters/morphology.py).
// The element is symmetric, given by the half widths of its 2 radius + 1 rows.
// Layout: masks and results are bytes, results contiguous. Frames are divided into bands of rows that threads share.
#include <algorithm>

#include "interface.h"
#include "morphology_rows.h"
#include "parallel.h"
#include "workspace.h"

void fingerflow_dilate(const void* masks, unsigned char* dilated, std::int64_t batch, std::int64_t height,
                       std::int64_t width, std::int64_t frame_stride, std::int64_t row_stride,
                       const std::int32_t* half_widths, std::int64_t radius, int of_background, int threads) {
    using namespace fingerflow;
    if (batch * height * width == 0) return;
    const Frames given{masks, batch, height, width, frame_stride, row_stride, kUint8};
    const Element element{half_widths, radius, of_background != 0};
    const std::int64_t rows = std::max<std::int64_t>({16, 4 * radius, (height * batch + 2 * threads - 1) / (2 * threads)});
    const std::int64_t pieces = (height + rows - 1) / rows;
    const auto dilate = FINGERFLOW_PICK(dilate_rows);
    parallel_for(batch * pieces, threads, [&](std::int64_t piece) {
        const std::int64_t top = piece % pieces * rows;
        const auto lines = workspace(static_cast<std::size_t>((2 * radius + 3) * (width + 2 * radius)));
        dilate(given, piece / pieces, top, std::min(height, top + rows), element, static_cast<unsigned char*>(lines), dilated);
    });
}
