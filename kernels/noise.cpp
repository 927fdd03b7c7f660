// build: each instruction set
// Mean absolute response of frames to the noise mask [1 -2 1]' [1 -2 1] (fingerflow/ops/filters/noise.py), from which
// follows the standard deviation of white noise. Every fourth row of a high frame is read. Responses of integer pixels are
// summed exactly, those of floats in float lanes; a row with a sum that is not finite is summed again over its finite
// responses.
// Layout: pieces of 32 read rows; sums and counts of pieces are added in order, so that threads do not change the result.
// `line` holds the vertical responses of one row; 32 lanes of short sums, added to 8 doubles before they overflow.
#include <math.h>

#include "instruction_sets.h"
#include "interface.h"
#include "lanes.h"
#include "pixels.h"

namespace fingerflow {

struct Responses {
    double sum;          // of the absolute values of finite responses
    std::int64_t count;  // of finite responses
};

namespace FINGERFLOW_ISA {
namespace {

// Counts the finite responses of a line and sums their absolute values.
template <class Number>
std::int64_t finite_ones(const Number* line, std::int64_t width, double* sum) {
    std::int64_t count = 0;
    *sum = 0;
    for (std::int64_t x = 0; x < width - 2; ++x) {
        const double response = static_cast<double>(line[x] - 2 * line[x + 1] + line[x + 2]);
        if (response - response == 0.0) {
            *sum += response < 0 ? -response : response;
            ++count;
        }
    }
    return count;
}

// Types in which responses of integers are exact (at most 8 times the pixel); `kSteps` of them fit into a sum.
template <class Pixel>
struct Exact {
    using Response = float;
    using Sum = float;
    static constexpr std::int64_t kSteps = 1 << 10;
};
template <>
struct Exact<std::uint8_t> {
    using Response = std::int16_t;
    using Sum = std::uint16_t;
    static constexpr std::int64_t kSteps = 31;
};
template <>
struct Exact<std::uint16_t> {
    using Response = std::int32_t;
    using Sum = std::uint32_t;
    static constexpr std::int64_t kSteps = 1 << 12;
};

// [1 -2 1], signed and absolute.
template <class Number>
Number second_difference(Number before, Number here, Number behind) {
    return static_cast<Number>(static_cast<Number>(before + behind) - static_cast<Number>(2 * here));
}
template <class Sum, class Number>
Sum response(Number before, Number here, Number behind) {
    const Number value = second_difference(before, here, behind);
    return static_cast<Sum>(value < 0 ? -value : value);
}

template <class Pixel>
void respond(const Pixel* frame, const Frames& frames, std::int64_t top, std::int64_t bottom, std::int64_t step, void* memory,
             Responses* responses) {
    using Response = typename Exact<Pixel>::Response;
    using Sum = typename Exact<Pixel>::Sum;
    constexpr int kSums = 32, kTotals = 8;  // lanes of sums, and of their double totals
    Response* FINGERFLOW_RESTRICT line = static_cast<Response*>(memory);
    const std::int64_t width = frames.width, responded = width - 2;
    for (std::int64_t y = top; y < bottom; y += step) {
        const Pixel* FINGERFLOW_RESTRICT above = frame + (y - 1) * frames.row_stride;
        const Pixel* FINGERFLOW_RESTRICT here = above + frames.row_stride;
        const Pixel* FINGERFLOW_RESTRICT below = here + frames.row_stride;
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = 0; x < width; ++x)
            line[x] = second_difference(static_cast<Response>(above[x]), static_cast<Response>(here[x]), static_cast<Response>(below[x]));
        double sum = 0, totals[kTotals] = {};
        std::int64_t x = 0;
        while (x + kSums <= responded) {
            Sum sums[kSums] = {};
            for (std::int64_t added = 0; added < Exact<Pixel>::kSteps && x + kSums <= responded; ++added, x += kSums)
                for (int k = 0; k < kSums; ++k)
                    sums[k] = static_cast<Sum>(sums[k] + response<Sum>(line[x + k], line[x + k + 1], line[x + k + 2]));
            const std::int64_t last = responded - kSums, seen = x - last;  // the last vector again, without the responses already added
            if (seen > 0 && seen < kSums) {
                for (int k = 0; k < kSums; ++k)
                    sums[k] = static_cast<Sum>(sums[k] + (k < seen ? Sum{0} : response<Sum>(line[last + k], line[last + k + 1], line[last + k + 2])));
                x = responded;
            }
            for (int k = 0; k < kSums; ++k) totals[k % kTotals] += static_cast<double>(sums[k]);
        }
        for (const double total : totals) sum += total;
        for (; x < responded; ++x) sum += static_cast<double>(response<Sum>(line[x], line[x + 1], line[x + 2]));
        std::int64_t count = responded;
        if (!(sum - sum == 0.0)) count = finite_ones(line, width, &sum);
        responses->sum += sum;
        responses->count += count;
    }
}

}  // namespace

// Adds the responses centred on every `step`-th row from `top` to before `bottom`. `line` has space for 4 width bytes.
void noise_rows(const Frames& frames, std::int64_t frame, std::int64_t top, std::int64_t bottom, std::int64_t step,
                void* line, Responses* responses) {
    const auto rows = [&](const auto* data) {
        respond(data + frame * frames.frame_stride, frames, top, bottom, step, line, responses);
    };
    FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, rows)
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow

#if FINGERFLOW_ONCE

#include <algorithm>
#include <vector>

#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
FINGERFLOW_OTHER_SETS(noise_rows)
}  // namespace fingerflow

void fingerflow_mean_response(const fingerflow_frames* frames, double* means, int threads) {
    using namespace fingerflow;
    const std::int64_t height = frames->height, step = std::max<std::int64_t>(1, std::min<std::int64_t>(4, height / 64));
    const std::int64_t rows = 32 * step, pieces = (height - 2 + rows - 1) / rows;
    std::vector<Responses> found(size(frames->batch * pieces), Responses{0, 0});
    for_bands(frames->batch, height - 2, rows, threads, [&](std::int64_t frame, std::int64_t top, std::int64_t bottom) {
        const auto line = static_cast<float*>(workspace(size(4 * frames->width)));
        Responses* const to = &found[size(frame * pieces + top / rows)];
        FINGERFLOW_PICK(noise_rows)(*frames, frame, 1 + top, 1 + bottom, step, line, to);
    });
    for (std::int64_t frame = 0; frame < frames->batch; ++frame) {
        double sum = 0;
        std::int64_t count = 0;
        for (std::int64_t piece = frame * pieces; piece < (frame + 1) * pieces; ++piece) {
            sum += found[size(piece)].sum;
            count += found[size(piece)].count;
        }
        means[frame] = sum / static_cast<double>(count);  // NaN if no response is finite
    }
}

#endif
