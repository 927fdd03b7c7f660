#include "noise_rows.h"

#include <math.h>

#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

// How many responses of a line are finite, and their sum.
std::int64_t finite_ones(const float* line, std::int64_t width, double* sum) {
    std::int64_t count = 0;
    *sum = 0;
    for (std::int64_t x = 0; x < width - 2; ++x) {
        const float response = fabsf((line[x] - 2 * line[x + 1]) + line[x + 2]);
        if (response - response == 0.0f) {
            *sum += static_cast<double>(response);
            ++count;
        }
    }
    return count;
}

template <class Pixel>
void respond(const Pixel* frame, const Frames& frames, std::int64_t top, std::int64_t bottom,
             float* FINGERFLOW_RESTRICT line, Responses* responses) {
    constexpr int kSums = 32;  // side by side: vectors, and short sums in float
    for (std::int64_t y = top; y < bottom; ++y) {
        const Pixel* FINGERFLOW_RESTRICT above = frame + (y - 1) * frames.row_stride;
        const Pixel* FINGERFLOW_RESTRICT here = above + frames.row_stride;
        const Pixel* FINGERFLOW_RESTRICT below = here + frames.row_stride;
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = 0; x < frames.width; ++x)
            line[x] = (static_cast<float>(above[x]) - 2 * static_cast<float>(here[x])) + static_cast<float>(below[x]);
        float sums[kSums] = {};
        std::int64_t x = 0;
        for (; x + kSums <= frames.width - 2; x += kSums)
            for (int k = 0; k < kSums; ++k) sums[k] += fabsf((line[x + k] - 2 * line[x + k + 1]) + line[x + k + 2]);
        for (; x < frames.width - 2; ++x) sums[0] += fabsf((line[x] - 2 * line[x + 1]) + line[x + 2]);
        double sum = 0;
        for (int k = 0; k < kSums; ++k) sum += static_cast<double>(sums[k]);
        std::int64_t count = frames.width - 2;
        if (!(sum - sum == 0.0)) count = finite_ones(line, frames.width, &sum);
        responses->sum += sum;
        responses->count += count;
    }
}

}  // namespace

void noise_rows(const Frames& frames, std::int64_t frame, std::int64_t top, std::int64_t bottom, float* line,
                Responses* responses) {
    const auto rows = [&](const auto* data) {
        respond(data + frame * frames.frame_stride, frames, top, bottom, line, responses);
    };
    FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, rows)
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
