// Agreement of points with their neighbours, for some blocks of points of a frame.
#pragma once

#include <cstdint>

#include "instruction_sets.h"
#include "interface.h"

namespace fingerflow {

constexpr int kJudged = 16;  // points of a block

// What is known of the points of a frame, (stride) each: by the first step u to `one`, by the second `level` to `trust`, by the
// third `agreement`. One is 0 where a point is not known, and so is all else of it.
struct OutlierFrame {
    float *u, *v, *variance, *certainty, *one;
    float *number, *level, *fitted, *slope[4], *trust;  // of the neighbours that count; a level is 1 where there are none
    float* agreement;
};
constexpr int kOutlierColumns = 14;

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Each from block `first` to before block `last`; `read` takes points.
    void read_displacements(const fingerflow_outliers& given, std::int64_t frame, const OutlierFrame& to);
    void fit_neighbours(const fingerflow_outliers& given, const OutlierFrame& of, std::int64_t first, std::int64_t last);
    void borrow_slopes(const fingerflow_outliers& given, const OutlierFrame& of, std::int64_t first, std::int64_t last);
    void judge_points(const fingerflow_outliers& given, std::int64_t frame, const OutlierFrame& of, std::int64_t first,
                      std::int64_t last);
)
// clang-format on

}  // namespace fingerflow
