// The course of a flow, as fingerflow/ops/flow/flow_course.py has it.
#pragma once

#include <cstdint>

#include "flow_cells_rows.h"

namespace fingerflow {

// Weights of a window along a line: the middle one and `half` more.
struct FlowWindow {
    const float* weights;
    std::int64_t half;
};

// The plane that fits a field of two channels best where it is known; all cells count, as known tells.
FlowPlane flow_whole_plane(const FlowCells& field, int threads);

// Numbers of memory that `flow_departure` asks for.
std::int64_t flow_departure_floats(std::int64_t height, std::int64_t width);

// What a field (2, height, width) has beside its course, into two planes; the window is that of cells of twice the size.
void flow_departure(const FlowCells& field, const FlowWindow& window, float* departure, float* memory, int threads);

// Weighted means of a plane along rows and columns, by way of another plane.
void flow_window(const float* from, const FlowWindow& window, std::int64_t height, std::int64_t width, float* between, float* to, int threads);

}  // namespace fingerflow
