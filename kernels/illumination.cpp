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

}  // namespace
}  // namespace fingerflow

// Light over that of the empty glass, (frame - black) / light, and where it is known
void fingerflow_normalize(const fingerflow_lit_frames* given, const float* least /* (lights) */, float* quotients /* (batch, 1, height, width) */,
    unsigned char* known /* bool (batch, 1, height, width) */, int threads) {
    using namespace fingerflow;
    const Frames& frames = given->frames;
    const std::int64_t width = frames.width, pixels = frames.height * width;
    if (frames.batch * pixels == 0) return;
    const std::int64_t rows = std::max<std::int64_t>(16, (frames.height * frames.batch + 2 * threads - 1) / (2 * threads));
    for_bands(frames.batch, frames.height, rows, threads, [&](std::int64_t frame, std::int64_t top, std::int64_t bottom) {
        const std::int64_t light = given->lights == 1 ? 0 : frame, black = given->blacks == 1 ? 0 : frame;
        const auto divide_rows = [&](const auto* data) {
            for (std::int64_t y = top; y < bottom; ++y) {
                const std::int64_t row = y * width, out = frame * pixels + row;
                divide(data + frame * frames.frame_stride + y * frames.row_stride, given->light + light * pixels + row,
                       given->black + black * pixels + row, least[light], width, quotients + out, known + out);
            }
        };
        FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, divide_rows)
    });
}
