// Agreement of points with their neighbours, for some blocks of points of a frame (outliers.cpp).
#pragma once

#include <cstdint>

#include "instruction_sets.h"
#include "interface.h"

namespace fingerflow {

constexpr int kJudged = 16;  // points of a block

// Columns (stride) of a frame's points: read_displacements writes u to `one`, fit_neighbours `number` to `trust`,
// borrow_slopes `agreement`. `one` is 1 for a known point, else 0, with u = v = 0.
struct OutlierFrame {
    float *u, *v, *variance, *certainty, *one;
    float *number, *level, *fitted, *slope[4], *trust;  // `number` of neighbours that count; `level` is 1 without any
    float* agreement;
};
constexpr int kOutlierColumns = 14;

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Three steps over blocks `first` to before `last`, after read_displacements for all points of a frame.
    void read_displacements(const fingerflow_outliers& given, std::int64_t frame, const OutlierFrame& to);
    void fit_neighbours(const fingerflow_outliers& given, const OutlierFrame& of, std::int64_t first, std::int64_t last);
    void borrow_slopes(const fingerflow_outliers& given, const OutlierFrame& of, std::int64_t first, std::int64_t last);
    void judge_points(const fingerflow_outliers& given, std::int64_t frame, const OutlierFrame& of, std::int64_t first,
                      std::int64_t last);
)
// clang-format on

}  // namespace fingerflow
