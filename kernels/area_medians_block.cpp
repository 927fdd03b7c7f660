#include "area_medians_block.h"

#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

// A place within the grid: first node of its cell, and where in the cell it lies.
struct Cell {
    std::int32_t node;
    double x, y;
};

inline Cell cell_of(const LeadingGrid& grid, double x, double y) {
    const double last_x = grid.columns - 1, last_y = grid.rows - 1;
    x = x > 0 ? x : 0;  // in this order a NaN becomes 0
    y = y > 0 ? y : 0;
    x = x < last_x ? x : last_x;
    y = y < last_y ? y : last_y;
    std::int32_t column = static_cast<std::int32_t>(x), row = static_cast<std::int32_t>(y);
    column = column < grid.columns - 2 ? column : grid.columns - 2;
    row = row < grid.rows - 2 ? row : grid.rows - 2;
    return {row * grid.columns + column, x - column, y - row};
}

struct Bilinear {
    double value, along_x, along_y;
};

template <class Real>
inline Bilinear at(const Real* nodes, std::int32_t columns, const Cell& cell) {
    const Real* const below = nodes + columns;
    double upper = nodes[cell.node], lower = below[cell.node];
    const double upper_slope = nodes[cell.node + 1] - upper, lower_slope = below[cell.node + 1] - lower;
    upper = upper + cell.x * upper_slope;
    lower = lower + cell.x * lower_slope;
    return {upper + cell.y * (lower - upper), upper_slope + cell.y * (lower_slope - upper_slope), lower - upper};
}

}  // namespace

void lead_back(const LeadingGrid& grid, Places& places) {
    for (int q = 0; q < kPlaces; ++q) {
        places.x[q] = places.wanted_x[q] - grid.start_x;
        places.y[q] = places.wanted_y[q] - grid.start_y;
        places.found[q] = 0;
    }
    for (int step = 0; step < grid.newton_steps; ++step) {
        FINGERFLOW_INDEPENDENT
        for (int q = 0; q < kPlaces; ++q) {
            const Cell cell = cell_of(grid, places.x[q], places.y[q]);
            const Bilinear x = at(grid.x, grid.columns, cell), y = at(grid.y, grid.columns, cell);
            const double missing_x = places.wanted_x[q] - places.x[q] - x.value;
            const double missing_y = places.wanted_y[q] - places.y[q] - y.value;
            double ratio = (1 + x.along_x) * (1 + y.along_y) - x.along_y * y.along_x;
            ratio = ratio > grid.least_ratio ? ratio : grid.least_ratio;
            const double step_x = ((1 + y.along_y) * missing_x - x.along_y * missing_y) / ratio;
            const double step_y = ((1 + x.along_x) * missing_y - y.along_x * missing_x) / ratio;
            const double size_x = step_x < 0 ? -step_x : step_x, size_y = step_y < 0 ? -step_y : step_y;
            const double size = size_x > size_y ? size_x : size_y;
            places.x[q] = places.found[q] != 0 ? places.x[q] : places.x[q] + step_x;
            places.y[q] = places.found[q] != 0 ? places.y[q] : places.y[q] + step_y;
            places.found[q] |= size < grid.settled ? 1 : 0;
        }
        std::int64_t all = 1;
        for (int q = 0; q < kPlaces; ++q) all &= places.found[q];
        if (all != 0) break;
    }
    for (int q = 0; q < kPlaces; ++q) {
        const bool within = places.x[q] >= 0 && places.y[q] >= 0 && places.x[q] <= grid.columns - 1 &&
                            places.y[q] <= grid.rows - 1;
        places.found[q] &= within ? 1 : 0;
    }
}

void read_field(const LeadingGrid& grid, const float* field, const Places& places, double* FINGERFLOW_RESTRICT values) {
    const double *const x = places.x, *const y = places.y;
    FINGERFLOW_INDEPENDENT
    for (int q = 0; q < kPlaces; ++q) values[q] = at(field, grid.columns, cell_of(grid, x[q], y[q])).value;
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
