// build: each instruction set, fused
// Illumination gain of each frame (fingerflow/ops/contact/illumination_gain.py): the uppermost mode of the quotients
// sum(frame - black) / sum(light) of blocks of side x side px. It is found by four means within a shrinking width
// around the largest kTop of the quotients, and is NaN where too few blocks lie at the mode or too many just below.
// Layout: every kStep-th line is read, one column a lane, into four rows of floats: frame - black, light and their
// squares. `Blocks` holds four arrays of (rows of blocks, columns of blocks) floats a frame. A row of blocks of all frames
// is one piece for a thread.
#include <float.h>
#include <math.h>
#include <cstring>

#include "floats.h"
#include "instruction_sets.h"
#include "interface.h"
#include "lanes.h"
#include "pixels.h"
#include "shared_limits.h"

namespace fingerflow {

// Sums over lines by column, (width) each: frame - black, light, and the squares of both.
struct LitColumns {
    float *passed, *light, *passed_squared, *light_squared;
};

namespace FINGERFLOW_ISA {
namespace {

template <class Pixel>
void add_line(const Pixel* FINGERFLOW_RESTRICT row, const float* FINGERFLOW_RESTRICT light,
              const float* FINGERFLOW_RESTRICT black, std::int64_t width, float* FINGERFLOW_RESTRICT passed,
              float* FINGERFLOW_RESTRICT lamps, float* FINGERFLOW_RESTRICT passed_squared,
              float* FINGERFLOW_RESTRICT lamps_squared) {
    for (std::int64_t x = 0; x < width; ++x) {
        const float own = static_cast<float>(row[x]) - black[x], lamp = light[x];
        const bool lit = (lamp > 0.0f) & (fabsf(own) <= FLT_MAX);
        const float count = lit ? own : 0.0f, given = lit ? lamp : 0.0f;
        passed[x] += count;
        lamps[x] += given;
        passed_squared[x] += count * count;
        lamps_squared[x] += given * given;
    }
}

}  // namespace

// Adds the lit pixels of a line to the columns; `light` and `black` are those of the line. `ahead` is a later line
// to prefetch, since hardware does not prefetch lines that do not follow each other.
void add_lit_line(const Frames& frames, std::int64_t frame, std::int64_t y, std::int64_t ahead, const float* light,
                  const float* black, const LitColumns& columns) {
    const auto add = [&](const auto* data) {
        const auto *const row = data + frame * frames.frame_stride, *const next = row + ahead * frames.row_stride;
        for (std::int64_t x = 0; x < frames.width; x += 64 / static_cast<std::int64_t>(sizeof *row)) FINGERFLOW_PREFETCH(next + x);
        add_line(row + y * frames.row_stride, light, black, frames.width, columns.passed, columns.light,
                 columns.passed_squared, columns.light_squared);
    };
    FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, add)
}

// Writes the sums of each `side` neighbours of blocks x side `numbers`, which are overwritten.
void sum_blocks(float* numbers, std::int64_t blocks, std::int64_t side, float* sums) {
    // Adds pairs of neighbours as long as `side` is even, which vectorizes.
    for (; side % 2 == 0; side /= 2) {
        const std::int64_t count = blocks * side / 2;
        FINGERFLOW_INDEPENDENT
        for (std::int64_t k = 0; k < count; ++k) numbers[k] = numbers[2 * k] + numbers[2 * k + 1];
    }
    for (std::int64_t block = 0; block < blocks; ++block) {
        float sum = numbers[block * side];
        for (std::int64_t k = 1; k < side; ++k) sum += numbers[block * side + k];
        sums[block] = sum;
    }
}

// Mean of the numbers within `width` of `middle`, 0 if there is none; `count` is a multiple of 16.
float mean_within(const float* numbers, std::int64_t count, float middle, float width) {
    Floats sum = all(0), number = all(0);
    for (std::int64_t k = 0; k < count; k += kFloats) {
        const Floats value = load(numbers + k), away = value - middle;
        const Floats beyond = is_positive(greater(away, 0.0f - away) - width);
        number += 1.0f - beyond;
        sum += value * (1.0f - beyond);
    }
    float sums[kFloats], counts[kFloats], total = 0, found = 0;
    store(sums, sum);
    store(counts, number);
    for (int k = 0; k < kFloats; ++k) {
        total += sums[k];
        found += counts[k];
    }
    return found > 0 ? total / found : 0.0f;
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow

#if FINGERFLOW_ONCE

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <vector>

#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
FINGERFLOW_OTHER_SETS(add_lit_line)
FINGERFLOW_OTHER_SETS(sum_blocks)
FINGERFLOW_OTHER_SETS(mean_within)
namespace {

constexpr std::int64_t kStep = contact::kLineStep;

// Sums over the lit pixels of each block, of the quantities of `LitColumns`.
struct Blocks {
    std::vector<float> passed, light, passed_squared, light_squared;
    explicit Blocks(std::size_t count) : passed(count), light(count), passed_squared(count), light_squared(count) {}
};

float uppermost_mode(const Blocks& blocks) {
    const float full = *std::max_element(blocks.light.begin(), blocks.light.end());
    std::vector<float> quotients(blocks.light.size());
    std::int64_t number = 0;
    for (std::size_t k = 0; k < quotients.size(); ++k) {
        const bool lit = blocks.light[k] > contact::kLit * full;
        const float quotient = lit ? blocks.passed[k] / blocks.light[k] : 0.0f;
        const float variance = lit ? blocks.passed_squared[k] / blocks.light_squared[k] - quotient * quotient : 0.0f;
        quotients[k] = variance < contact::kRough * contact::kRough ? quotient : 0.0f;
        number += lit;
    }
    std::vector<float> sorted = quotients;
    const auto kept = std::max<std::int64_t>(1, std::lrint(static_cast<double>(contact::kTop) * static_cast<double>(sorted.size())));
    std::nth_element(sorted.begin(), sorted.begin() + (kept - 1), sorted.end(), std::greater<float>());
    float gain = sorted[size(kept - 1)];
    quotients.resize((quotients.size() + 15) / 16 * 16);  // padding by zeros, which lie within no width of a gain above zero
    for (const float width : contact::kWidths)
        gain = FINGERFLOW_PICK(mean_within)(quotients.data(), static_cast<std::int64_t>(quotients.size()), gain, width * gain);
    std::int64_t glass = 0, beside = 0;
    for (std::size_t k = 0; k < blocks.light.size(); ++k) {
        const float distance = quotients[k] / std::max(gain, 1e-6f) - 1;
        glass += std::fabs(distance) <= contact::kNarrowGlass && blocks.light[k] > contact::kLit * full;
        beside += distance < -contact::kNarrowGlass && distance >= -contact::kBesideGlass;
    }
    const bool seen = gain > contact::kLeastGain && gain < contact::kMostGain &&
                      static_cast<float>(glass) >= contact::kTop * static_cast<float>(number) && glass >= 2 * beside;
    return seen ? gain : std::numeric_limits<float>::quiet_NaN();
}

}  // namespace
}  // namespace fingerflow

void fingerflow_illumination_gain(const fingerflow_lit_frames* given, std::int64_t side, float* gains, int threads) {
    using namespace fingerflow;
    const Frames& frames = given->frames;
    const std::int64_t width = frames.width, rows = side / kStep, pixels = frames.height * width;
    const std::int64_t lines = (frames.height - kStep / 2 + kStep - 1) / kStep, down = lines / rows, across = width / side;
    const auto add = FINGERFLOW_PICK(add_lit_line);
    const auto sum = FINGERFLOW_PICK(sum_blocks);
    if (down * across <= 0) {
        std::fill_n(gains, frames.batch, std::numeric_limits<float>::quiet_NaN());
        return;
    }
    std::vector<Blocks> blocks(size(frames.batch), Blocks(size(down * across)));
    // A row of blocks of all frames at a time, so that the empty glass is read once for all of them.
    parallel_for(down, threads, [&](std::int64_t row) {
        const std::size_t bytes = size(width) * sizeof(float);
        auto* const memory = static_cast<float*>(workspace(4 * bytes));
        const LitColumns columns{memory, memory + width, memory + 2 * width, memory + 3 * width};
        for (std::int64_t frame = 0; frame < frames.batch; ++frame) {
            const float* const light = given->light + (given->lights == 1 ? 0 : frame) * pixels;
            const float* const black = given->black + (given->blacks == 1 ? 0 : frame) * pixels;
            std::memset(memory, 0, 4 * bytes);
            for (std::int64_t line = row * rows; line < (row + 1) * rows; ++line) {
                const std::int64_t y = kStep / 2 + line * kStep;
                add(frames, frame, y, std::min(y + 2 * kStep, frames.height - 1), light + y * width, black + y * width, columns);
            }
            Blocks& to = blocks[size(frame)];
            sum(columns.passed, across, side, to.passed.data() + row * across);
            sum(columns.light, across, side, to.light.data() + row * across);
            sum(columns.passed_squared, across, side, to.passed_squared.data() + row * across);
            sum(columns.light_squared, across, side, to.light_squared.data() + row * across);
        }
    });
    parallel_for(frames.batch, threads, [&](std::int64_t frame) { gains[frame] = uppermost_mode(blocks[size(frame)]); });
}

#endif
