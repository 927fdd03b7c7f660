#include <algorithm>
#include <exception>

#include "interface.h"
#include "parallel.h"
#include "spline_rows.h"
#include "workspace.h"

int fingerflow_spline_coefficients(const void* frames, float* coefficients, std::int64_t batch, std::int64_t height,
                                   std::int64_t width, std::int64_t frame_stride, std::int64_t row_stride, int kind,
                                   int threads) try {
    using namespace fingerflow;
    const Frames given{frames, batch, height, width, frame_stride, row_stride, static_cast<PixelKind>(kind)};
    const std::int64_t rows = 32, pieces = (height + rows - 1) / rows;
    const auto smooth = FINGERFLOW_PICK(spline_rows);
    parallel_for(batch * pieces, threads, [&](std::int64_t piece) {
        const std::int64_t frame = piece / pieces, top = piece % pieces * rows;
        const auto line = static_cast<float*>(workspace(static_cast<std::size_t>(4 * width)));
        smooth(given, frame, top, std::min(height, top + rows), line, coefficients + frame * height * width);
    });
    return 0;
} catch (const std::exception&) {
    return 1;
}
