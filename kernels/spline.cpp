// Spline coefficients of frames, pixels smoothed by [1 2 1]' [1 2 1] / 16 (fingerflow/ops/filters/spline.py), in pieces
// of 32 rows that threads share.
// Layout: coefficients are floats, contiguous (batch, height, width).
#include <algorithm>

#include "interface.h"
#include "parallel.h"
#include "spline_rows.h"
#include "workspace.h"

void fingerflow_spline_coefficients(const void* frames, float* coefficients, std::int64_t batch, std::int64_t height, std::int64_t width,
                                    std::int64_t frame_stride, std::int64_t row_stride, int kind, int threads) {
    using namespace fingerflow;
    constexpr std::int64_t rows = 32;  // of a piece
    const Frames given{frames, batch, height, width, frame_stride, row_stride, static_cast<PixelKind>(kind)};
    const std::int64_t pieces = (height + rows - 1) / rows;
    parallel_for(batch * pieces, threads, [&](std::int64_t piece) {
        const std::int64_t frame = piece / pieces, top = piece % pieces * rows;
        auto* const line = static_cast<float*>(workspace(static_cast<std::size_t>(width + 2) * sizeof(float)));
        FINGERFLOW_PICK(spline_rows)(given, frame, top, std::min(height, top + rows), line, coefficients + frame * height * width);
    });
}
