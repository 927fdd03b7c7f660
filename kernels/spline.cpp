// build: each instruction set
// Spline coefficients of frames, pixels smoothed by [1 2 1]' [1 2 1] / 16, the border repeated
// (fingerflow/ops/filters/spline.py), in pieces of 32 rows that threads share.
// Layout: one pixel a lane; coefficients are floats, contiguous (batch, height, width); `line` holds one row of vertical
// sums with a pixel repeated at either end. The order of the sums is that of the portable op: results agree bit for bit.
#include "instruction_sets.h"
#include "interface.h"
#include "lanes.h"
#include "pixels.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

template <class Pixel>
void smooth(const Pixel* frame, const Frames& frames, std::int64_t top, std::int64_t bottom, float* memory, float* coefficients) {
    const std::int64_t width = frames.width;
    float* FINGERFLOW_RESTRICT line = memory + 1;  // the end pixels are repeated
    for (std::int64_t y = top; y < bottom; ++y) {
        const Pixel* FINGERFLOW_RESTRICT here = frame + y * frames.row_stride;
        const Pixel* FINGERFLOW_RESTRICT above = y > 0 ? here - frames.row_stride : here;
        const Pixel* FINGERFLOW_RESTRICT below = y + 1 < frames.height ? here + frames.row_stride : here;
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = 0; x < width; ++x)
            line[x] = (static_cast<float>(above[x]) + 2 * static_cast<float>(here[x])) + static_cast<float>(below[x]);
        line[-1] = line[0];
        line[width] = line[width - 1];
        float* FINGERFLOW_RESTRICT to = coefficients + y * width;
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = 0; x < width; ++x) to[x] = ((line[x - 1] + 2 * line[x]) + line[x + 1]) / 16;
    }
}

}  // namespace

// Writes rows `top` to before `bottom` of a frame's coefficients. `line` has space for width + 2 floats.
void spline_rows(const Frames& frames, std::int64_t frame, std::int64_t top, std::int64_t bottom, float* line, float* coefficients) {
    const auto rows = [&](const auto* data) { smooth(data + frame * frames.frame_stride, frames, top, bottom, line, coefficients); };
    FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, rows)
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow

#if FINGERFLOW_ONCE

#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
FINGERFLOW_OTHER_SETS(spline_rows)
}  // namespace fingerflow

// Spline coefficients (batch, height, width), contiguous (fingerflow/ops/filters/spline.py).
void fingerflow_spline_coefficients(const fingerflow_frames* frames, float* coefficients /* (batch, 1, height, width) */, int threads) {
    using namespace fingerflow;
    const std::int64_t height = frames->height, width = frames->width;
    for_bands(frames->batch, height, 32, threads, [&](std::int64_t frame, std::int64_t top, std::int64_t bottom) {
        auto* const line = static_cast<float*>(workspace(static_cast<std::size_t>(width + 2) * sizeof(float)));
        FINGERFLOW_PICK(spline_rows)(*frames, frame, top, bottom, line, coefficients + frame * height * width);
    });
}

#endif
