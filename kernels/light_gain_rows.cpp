// build: each instruction set, fused
// Row loops of light_gain.cpp: sums by column over the lit pixels of lines, sums of blocks, and the mean of the
// quotients within a width of a value.
// Layout: one column a lane; four rows of floats hold frame - black, light and their squares. `numbers` of mean_within
// is a multiple of the vector length.
#include "light_gain_rows.h"

#include <float.h>
#include <math.h>

#include "floats.h"
#include "lanes.h"

namespace fingerflow {
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
