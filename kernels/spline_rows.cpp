// build: each instruction set
// Coefficients of a smoothing cubic spline: [1 2 1]' [1 2 1] / 16 of the pixels, the border repeated.
// Layout: one pixel a lane; `line` holds one row of vertical sums with a pixel repeated at either end. The order of the
// sums is that of the portable op: results agree bit for bit.
#include "spline_rows.h"

#include "lanes.h"

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

void spline_rows(const Frames& frames, std::int64_t frame, std::int64_t top, std::int64_t bottom, float* line, float* coefficients) {
    const auto rows = [&](const auto* data) { smooth(data + frame * frames.frame_stride, frames, top, bottom, line, coefficients); };
    FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, rows)
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
