// Frames normalised by the illumination of the empty glass: (frame - black) / light, and where that is known
// (fingerflow/ops/filters/illumination.py); elsewhere the quotient is 1.
// Layout: quotients (floats) and known (bytes) are contiguous (batch, height, width). Frames are divided into bands of
// at least 16 rows, which threads share.
#include <algorithm>
#include <cmath>

#include "interface.h"
#include "parallel.h"
#include "pixels.h"

namespace fingerflow {
namespace {

// Without branches, so that the compiler vectorizes it.
template <class Pixel>
void divide(const Pixel* frame, const float* light, const float* black, float least, std::int64_t width, float* quotients,
            unsigned char* known) {
    for (std::int64_t x = 0; x < width; ++x) {
        const float passed = static_cast<float>(frame[x]) - black[x], given = light[x];
        const bool lit = std::fabs(given) < INFINITY && given > 0 && given > least && std::fabs(passed) < INFINITY;
        const float quotient = (lit ? passed : 1.0f) / (lit ? given : 1.0f);
        const bool valid = lit && std::fabs(quotient) < INFINITY;
        quotients[x] = valid ? quotient : 1.0f;
        known[x] = valid;
    }
}

template <class Pixel>
void divide_rows(const fingerflow_lit_frames& given, const float* least, std::int64_t frame, std::int64_t top,
                 std::int64_t bottom, float* quotients, unsigned char* known) {
    const std::int64_t pixels = given.height * given.width, light = given.lights == 1 ? 0 : frame;
    for (std::int64_t y = top; y < bottom; ++y) {
        const std::int64_t row = y * given.width, out = frame * pixels + row;
        const auto* const counts =
            static_cast<const Pixel*>(given.frames.data) + frame * given.frames.image_stride + y * given.frames.row_stride;
        const float* const black = given.black + (given.blacks == 1 ? 0 : frame) * pixels + row;
        divide(counts, given.light + light * pixels + row, black, least[light], given.width, quotients + out, known + out);
    }
}

}  // namespace
}  // namespace fingerflow

void fingerflow_normalize(const fingerflow_lit_frames* given, const float* least, float* quotients, unsigned char* known,
                          int threads) {
    using namespace fingerflow;
    if (given->batch * given->height * given->width == 0) return;
    const std::int64_t rows = std::max<std::int64_t>(16, (given->height * given->batch + 2 * threads - 1) / (2 * threads));
    const std::int64_t pieces = (given->height + rows - 1) / rows;
    parallel_for(given->batch * pieces, threads, [&](std::int64_t piece) {
        const std::int64_t frame = piece / pieces, top = piece % pieces * rows, bottom = std::min(given->height, top + rows);
        const auto as = [&](auto pixel) {
            divide_rows<decltype(pixel)>(*given, least, frame, top, bottom, quotients, known);
        };
        switch (static_cast<PixelKind>(given->frames.kind)) {
            case kUint8: return as(std::uint8_t());
            case kUint16: return as(std::uint16_t());
            case kInt32: return as(std::int32_t());
            default: return as(float());
        }
    });
}
