// build: each instruction set
// Means of 2 x 2 pixels, for the search in half resolution, in pieces of 32 rows that threads share: ((a + c) + (b + d)) /
// 4 of the upper pixels a, b and the lower ones c, d. The order of the sums is that of the portable op: results agree bit
// for bit.
// Layout: one halved pixel a lane; results (batch, height / 2, width / 2), contiguous.
#include "instruction_sets.h"
#include "interface.h"
#include "lanes.h"
#include "pixels.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

template <class Pixel>
void halve(const Pixel* frame, const Frames& frames, std::int64_t top, std::int64_t bottom, float* halved) {
    const std::int64_t columns = frames.width / 2;
    for (std::int64_t y = top; y < bottom; ++y) {
        const Pixel* FINGERFLOW_RESTRICT upper = frame + 2 * y * frames.row_stride;
        const Pixel* FINGERFLOW_RESTRICT lower = upper + frames.row_stride;
        float* FINGERFLOW_RESTRICT to = halved + y * columns;
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = 0; x < columns; ++x) {
            const float left = static_cast<float>(upper[2 * x]) + static_cast<float>(lower[2 * x]);
            to[x] = (left + (static_cast<float>(upper[2 * x + 1]) + static_cast<float>(lower[2 * x + 1]))) / 4;
        }
    }
}

}  // namespace

// Writes rows `top` to before `bottom` of `halved`, which is contiguous and width / 2 wide.
void halve_rows(const Frames& frames, std::int64_t frame, std::int64_t top, std::int64_t bottom, float* halved) {
    const auto rows = [&](const auto* data) { halve(data + frame * frames.frame_stride, frames, top, bottom, halved); };
    FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, rows)
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow

#if FINGERFLOW_ONCE

#include "parallel.h"

namespace fingerflow {
FINGERFLOW_OTHER_SETS(halve_rows)
}  // namespace fingerflow

void fingerflow_halve(const fingerflow_frames* frames, float* halved, int threads) {
    using namespace fingerflow;
    const std::int64_t height = frames->height / 2, width = frames->width / 2;
    for_bands(frames->batch, height, 32, threads, [&](std::int64_t frame, std::int64_t top, std::int64_t bottom) {
        FINGERFLOW_PICK(halve_rows)(*frames, frame, top, bottom, halved + frame * height * width);
    });
}

#endif
