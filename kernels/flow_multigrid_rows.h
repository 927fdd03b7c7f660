// Row loops of the multigrid of dense flow, A = J + L with tensor J and Laplacian L (flow_multigrid.cpp).
#pragma once

#include "instruction_sets.h"
#include "interface.h"

namespace fingerflow {

// Operator on height x width cells: tensor and inverse are three planes, right (height, width - 1), down
// (height - 1, width).
using FlowLevel = fingerflow_flow_level;

// A field of two planes.
struct FlowField {
    float* u;
    float* v;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // First sweep from 0: to = damping inverse r.
    void flow_start_row(const FlowLevel& level, const FlowField& right_side, const FlowField& to, float damping, std::int64_t y);
    // One sweep: to = from + damping inverse (r - A from).
    void flow_relax_row(const FlowLevel& level, const FlowField& from, const FlowField& right_side, const FlowField& to,
                        float damping, const float* zeros, std::int64_t y);
    // to = pull - J step - L departure; step is null where it is 0.
    void flow_left_over_row(const FlowLevel& level, const FlowField* step, const FlowField& departure, const float* pull,
                            const FlowField& to, const float* zeros, std::int64_t y);
    // Row y of the coarser right side: means over 2 x 2 cells of r - A from. `memory` has space for 4 rows.
    void flow_restrict_row(const FlowLevel& level, const FlowField& from, const FlowField& right_side, const FlowLevel& coarser,
                           const FlowField& to, const float* zeros, float* memory, std::int64_t y);
    // Adds the interpolated solution of the coarser level. `memory` has space for 3 rows of it and 6 floats.
    void flow_spread_row(const FlowLevel& level, const FlowLevel& coarser, const FlowField& from, const FlowField& to,
                         float* memory, std::int64_t y);
    // Adds a row of a cycle's step to the sum of all steps (or starts it) and to the flow.
    void flow_add_row(const float* step, std::int64_t width, bool first, float* sum, float* moved);
)
// clang-format on

}  // namespace fingerflow
