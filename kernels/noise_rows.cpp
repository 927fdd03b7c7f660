// build: each instruction set
// Sums of |response| along rows, the response being [1 -2 1] applied down and along: integer pixels exactly, floats in
// float lanes; a row with a sum that is not finite is summed again over its finite responses.
// Layout: `line` holds the vertical responses of one row; 32 lanes of short sums, added to 8 doubles before they
// overflow.
#include "noise_rows.h"

#include <math.h>

#include "lanes.h"

namespace fingerflow {
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

void noise_rows(const Frames& frames, std::int64_t frame, std::int64_t top, std::int64_t bottom, std::int64_t step,
                void* line, Responses* responses) {
    const auto rows = [&](const auto* data) {
        respond(data + frame * frames.frame_stride, frames, top, bottom, step, line, responses);
    };
    FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, rows)
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
