// Course of a flow: local plane fits (fingerflow/ops/flow/flow_cells.py).
#pragma once

#include <cstdint>

#include "flow_cells_rows.h"

namespace fingerflow {

// Weights of a symmetric window along a line: the middle one and `half` more.
struct FlowWindow {
    const float* weights;
    std::int64_t half;
};

// Least-squares plane of a field of two channels, weighted by `known`.
FlowPlane flow_whole_plane(const FlowCells& field, int threads);

// Floats of memory that `flow_departure` needs.
std::int64_t flow_departure_floats(std::int64_t height, std::int64_t width);

// Writes field (2, height, width) less its course to two planes; the window is on cells of twice the size.
void flow_departure(const FlowCells& field, const FlowWindow& window, float* departure, float* memory, int threads);

}  // namespace fingerflow
