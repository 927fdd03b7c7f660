#include "light_gain_rows.h"

#include <float.h>
#include <math.h>

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
    // Pairs of neighbours first, three times: whole vectors until eight have become one.
    for (std::int64_t left = blocks * side / 2; left >= blocks * side / 8; left /= 2) {
        FINGERFLOW_INDEPENDENT
        for (std::int64_t k = 0; k < left; ++k) numbers[k] = numbers[2 * k] + numbers[2 * k + 1];
    }
    const std::int64_t eights = side / 8;
    for (std::int64_t block = 0; block < blocks; ++block) {
        float sum = 0;
        for (std::int64_t k = 0; k < eights; ++k) sum += numbers[block * eights + k];
        sums[block] = sum;
    }
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
