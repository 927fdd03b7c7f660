// Places of a grid that a displacement brings to wanted ones, and fields there, a few places at a time.
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

constexpr int kPlaces = 16;

// Displacement (rows, columns) in steps of the grid, known everywhere.
struct LeadingGrid {
    const double *x, *y;
    std::int32_t rows, columns;
    double start_x, start_y;  // displacement with which a search begins
    int newton_steps;
    double settled, least_ratio;
};

struct Places {
    double wanted_x[kPlaces], wanted_y[kPlaces];
    double x[kPlaces], y[kPlaces];
    std::int64_t found[kPlaces];  // 0 or 1, and on the grid
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    void lead_back(const LeadingGrid& grid, Places& places);
    // Values of a field (rows, columns) at all places; NaN beside a NaN.
    void read_field(const LeadingGrid& grid, const float* field, const Places& places, double* values);
)
// clang-format on

}  // namespace fingerflow
