// build: each instruction set
// Intensity loss of one line as 8-bit levels: level = 255 - 204 (frame - black) / light, rounded and clamped to 0..255;
// level 51 is a loss of 0 and stands where a pixel is not lit.
// Layout: one pixel a lane; levels and `lit` (0 or 1) are bytes, light and black floats of the same line.
#include "contact_threshold_rows.h"

#include <float.h>
#include <math.h>

#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

constexpr float kScale = 204, kNone = 51, kAll = 255;  // levels per unit of loss, level of no loss, highest level
constexpr float kWhole = 8388608;                      // 2^23: adding and subtracting it rounds a smaller number to an integer

// The order of operations is that of the portable form: levels agree bit for bit.
template <bool finite, class Pixel>
void levels_of(const Pixel* FINGERFLOW_RESTRICT row, const float* FINGERFLOW_RESTRICT light,
               const float* FINGERFLOW_RESTRICT black, std::int64_t width, unsigned char* FINGERFLOW_RESTRICT levels,
               unsigned char* FINGERFLOW_RESTRICT lit) {
    for (std::int64_t x = 0; x < width; ++x) {
        const float lamp = light[x];
        const float lost = kAll - (static_cast<float>(row[x]) - black[x]) * (kScale * (1.0f / (lamp > 0 ? lamp : 1.0f)));
        const bool has = (lamp > 0) & (finite || fabsf(lost) <= FLT_MAX);
        const float level = has ? lost : kNone, above = level > 0 ? level : 0.0f, within = above < kAll ? above : kAll;
        levels[x] = static_cast<unsigned char>(static_cast<int>((within + kWhole) - kWhole));
        lit[x] = has;
    }
}

}  // namespace

void levels_of_line(const Frames& frames, std::int64_t y, const float* light, const float* black, unsigned char* levels,
                    unsigned char* lit) {
    const auto find = [&](const auto* data) {
        levels_of<true>(data + y * frames.row_stride, light, black, frames.width, levels, lit);
    };
    switch (frames.kind) {
        case kUint8: return find(static_cast<const std::uint8_t*>(frames.data));
        case kUint16: return find(static_cast<const std::uint16_t*>(frames.data));
        case kInt32: return find(static_cast<const std::int32_t*>(frames.data));
        default:
            return levels_of<false>(static_cast<const float*>(frames.data) + y * frames.row_stride, light, black, frames.width,
                                    levels, lit);
    }
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
