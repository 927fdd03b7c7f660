// Quotients of blocks, and their uppermost mode, as fingerflow/ops/light_gain.py has it: some thousand numbers a frame.
#include <algorithm>
#include <cmath>
#include <exception>
#include <functional>
#include <limits>
#include <vector>

#include "interface.h"
#include "parallel.h"
#include "pixels.h"

namespace fingerflow {
namespace {

constexpr std::int64_t kStep = 4;
constexpr float kRough = 0.15f, kLit = 0.25f, kMost = 1.4f, kLeast = 0.7f, kTop = 0.03f, kNarrow = 0.02f, kBeside = 0.06f;
constexpr float kWidths[] = {0.04f, 0.02f, 0.01f, 0.01f};

// Sums over the pixels of a block that are lit: counts less those without light, and light, and their squares.
struct Sums {
    float passed, light, passed_squared, light_squared;
};

// Adds a line to blocks.
template <class Pixel>
void add_line(const Pixel* row, const float* light, const float* black, std::int64_t blocks, std::int64_t side,
              Sums* sums) {
    for (std::int64_t block = 0; block < blocks; ++block) {
        Sums sum = sums[block];
        for (std::int64_t x = block * side; x < (block + 1) * side; ++x) {
            const float own = static_cast<float>(row[x]) - black[x];
            const bool lit = light[x] > 0.0f && std::fabs(own) <= std::numeric_limits<float>::max();
            const float count = lit ? own : 0.0f, lamp = lit ? light[x] : 0.0f;
            sum.passed += count;
            sum.light += lamp;
            sum.passed_squared += count * count;
            sum.light_squared += lamp * lamp;
        }
        sums[block] = sum;
    }
}

float uppermost_mode(const std::vector<Sums>& blocks) {
    float full = 0;
    for (const Sums& sums : blocks) full = std::max(full, sums.light);
    std::vector<float> quotients(blocks.size());
    std::int64_t number = 0;
    for (std::size_t k = 0; k < blocks.size(); ++k) {
        const Sums& sums = blocks[k];
        const bool lit = sums.light > kLit * full;
        const float quotient = lit ? sums.passed / sums.light : 0.0f;
        const float variance = lit ? sums.passed_squared / sums.light_squared - quotient * quotient : 0.0f;
        quotients[k] = variance < kRough * kRough ? quotient : 0.0f;
        number += lit;
    }
    std::vector<float> sorted = quotients;
    const auto kept = std::max<std::int64_t>(1, std::lrint(static_cast<double>(kTop) * static_cast<double>(sorted.size())));
    std::nth_element(sorted.begin(), sorted.begin() + (kept - 1), sorted.end(), std::greater<float>());
    float gain = sorted[static_cast<std::size_t>(kept - 1)];
    for (const float width : kWidths) {
        double sum = 0;
        std::int64_t count = 0;
        for (const float quotient : quotients)
            if (std::fabs(quotient - gain) <= width * gain) {
                sum += quotient;
                ++count;
            }
        gain = static_cast<float>(sum / static_cast<double>(std::max<std::int64_t>(count, 1)));
    }
    std::int64_t glass = 0, beside = 0;
    for (std::size_t k = 0; k < quotients.size(); ++k) {
        const float distance = quotients[k] / std::max(gain, 1e-6f) - 1;
        glass += std::fabs(distance) <= kNarrow && blocks[k].light > kLit * full;
        beside += distance < -kNarrow && distance >= -kBeside;
    }
    const bool seen = gain > kLeast && gain < kMost && static_cast<float>(glass) >= kTop * static_cast<float>(number) && glass >= 2 * beside;
    return seen ? gain : std::numeric_limits<float>::quiet_NaN();
}

}  // namespace
}  // namespace fingerflow

int fingerflow_light_gain(const fingerflow_lit_frames* given, std::int64_t side, float* gains, int threads) try {
    using namespace fingerflow;
    const std::int64_t width = given->width, rows = side / kStep, pixels = given->height * width;
    const std::int64_t lines = (given->height - kStep / 2 + kStep - 1) / kStep, down = lines / rows, across = width / side;
    parallel_for(given->batch, threads, [&](std::int64_t frame) {
        if (down * across <= 0) {
            gains[frame] = std::numeric_limits<float>::quiet_NaN();
            return;
        }
        std::vector<Sums> blocks(static_cast<std::size_t>(down * across));
        for (std::int64_t line = 0; line < down * rows; ++line) {
            const std::int64_t y = kStep / 2 + line * kStep, at = line / rows * across;
            const float* const lamp = given->light + (given->lights == 1 ? 0 : frame) * pixels + y * width;
            const float* const black = given->black + (given->blacks == 1 ? 0 : frame) * pixels + y * width;
            const auto add = [&](const auto* data) {
                const auto* const row = data + frame * given->frames.image_stride + y * given->frames.row_stride;
                add_line(row, lamp, black, across, side, blocks.data() + at);
            };
            [&] { FINGERFLOW_FOR_PIXEL(static_cast<PixelKind>(given->frames.kind), given->frames.data, add) }();
        }
        gains[frame] = uppermost_mode(blocks);
    });
    return 0;
} catch (const std::exception&) {
    return 1;
}
