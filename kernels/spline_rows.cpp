#include "spline_rows.h"

#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

std::int64_t mirrored(std::int64_t place, std::int64_t count) {
    return place < 0 ? -place : place >= count ? 2 * (count - 1) - place : place;
}

// The order of the sums is that of the portable op, so that floating frames give the same bits.
template <class Pixel>
void smooth(const Pixel* frame, const Frames& frames, std::int64_t top, std::int64_t bottom,
            float* FINGERFLOW_RESTRICT line, float* FINGERFLOW_RESTRICT coefficients) {
    const std::int64_t width = frames.width;
    for (std::int64_t y = top; y < bottom; ++y) {
        const Pixel* FINGERFLOW_RESTRICT above = frame + mirrored(y - 1, frames.height) * frames.row_stride;
        const Pixel* FINGERFLOW_RESTRICT here = frame + y * frames.row_stride;
        const Pixel* FINGERFLOW_RESTRICT below = frame + mirrored(y + 1, frames.height) * frames.row_stride;
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = 0; x < width; ++x)
            line[x] = (static_cast<float>(above[x]) + 2 * static_cast<float>(here[x])) + static_cast<float>(below[x]);
        float* FINGERFLOW_RESTRICT to = coefficients + y * width;
        to[0] = ((line[1] + 2 * line[0]) + line[1]) / 16;
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = 1; x < width - 1; ++x) to[x] = ((line[x - 1] + 2 * line[x]) + line[x + 1]) / 16;
        to[width - 1] = ((line[width - 2] + 2 * line[width - 1]) + line[width - 2]) / 16;
    }
}

}  // namespace

void spline_rows(const Frames& frames, std::int64_t frame, std::int64_t top, std::int64_t bottom, float* line,
                 float* coefficients) {
    const auto rows = [&](const auto* data) {
        smooth(data + frame * frames.frame_stride, frames, top, bottom, line, coefficients);
    };
    FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, rows)
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
