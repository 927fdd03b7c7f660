// build: each instruction set, fused
// Row loops of flow_multigrid.cpp: the operator T + L, levels of it, damped block-Jacobi sweeps, and transfers.
// L u at a cell: sum over its four neighbours of edge * (u - u_neighbour).
// Layout: one cell of a row a lane; the two ends of a row, which lack a neighbour, are computed separately.
#include "flow_multigrid_rows.h"

#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

// Pointers to the rows that the operator reads; beyond the border a row of zero weights and the row itself.
struct Stencil {
    const float *FINGERFLOW_RESTRICT xx, *FINGERFLOW_RESTRICT xy, *FINGERFLOW_RESTRICT yy;
    const float *FINGERFLOW_RESTRICT right, *FINGERFLOW_RESTRICT up, *FINGERFLOW_RESTRICT down;
    const float *u, *u_up, *u_down, *v, *v_up, *v_down;

    Stencil(const FlowLevel& level, const FlowField& of, const float* zeros, std::int64_t y) {
        const std::int64_t width = level.width, plane = level.height * width, at = y * width;
        xx = level.tensor + at;
        xy = xx + plane;
        yy = xy + plane;
        right = level.right + y * (width - 1);
        const bool first = y == 0, last = y == level.height - 1;
        up = first ? zeros : level.down + at - width;
        down = last ? zeros : level.down + at;
        u = of.u + at;
        v = of.v + at;
        u_up = first ? u : u - width;
        v_up = first ? v : v - width;
        u_down = last ? u : u + width;
        v_down = last ? v : v + width;
    }
};

// The operator T + L at a cell, or L alone.
template <bool tensor>
inline void applied(const Stencil& s, std::int64_t x, float before, float after, std::int64_t left, std::int64_t right,
                    float& on_u, float& on_v) {
    const float u = s.u[x], v = s.v[x];
    on_u = (before * (u - s.u[left]) - after * (s.u[right] - u)) + (s.up[x] * (u - s.u_up[x]) - s.down[x] * (s.u_down[x] - u));
    on_v = (before * (v - s.v[left]) - after * (s.v[right] - v)) + (s.up[x] * (v - s.v_up[x]) - s.down[x] * (s.v_down[x] - v));
    if constexpr (tensor) {
        on_u += s.xx[x] * u + s.xy[x] * v;
        on_v += s.xy[x] * u + s.yy[x] * v;
    }
}

// Calls work(x, on_u, on_v) for every cell of a row.
template <bool tensor = true, class Work>
inline void along_row(const Stencil& s, std::int64_t width, const Work& work) {
    float on_u, on_v;
    applied<tensor>(s, 0, 0.0f, width > 1 ? s.right[0] : 0.0f, 0, width > 1 ? 1 : 0, on_u, on_v);
    work(0, on_u, on_v);
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 1; x < width - 1; ++x) {
        float a, b;
        applied<tensor>(s, x, s.right[x - 1], s.right[x], x - 1, x + 1, a, b);
        work(x, a, b);
    }
    if (width > 1) {
        applied<tensor>(s, width - 1, s.right[width - 2], 0.0f, width - 2, width - 1, on_u, on_v);
        work(width - 1, on_u, on_v);
    }
}

}  // namespace

void flow_start_row(const FlowLevel& level, const FlowField& right_side, const FlowField& to, float damping, std::int64_t y) {
    const std::int64_t width = level.width, plane = level.height * width, at = y * width;
    const float *FINGERFLOW_RESTRICT xx = level.inverse + at, *FINGERFLOW_RESTRICT xy = xx + plane, *FINGERFLOW_RESTRICT yy = xy + plane;
    const float *FINGERFLOW_RESTRICT ru = right_side.u + at, *FINGERFLOW_RESTRICT rv = right_side.v + at;
    float *FINGERFLOW_RESTRICT u = to.u + at, *FINGERFLOW_RESTRICT v = to.v + at;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < width; ++x) {
        u[x] = damping * (xx[x] * ru[x] + xy[x] * rv[x]);
        v[x] = damping * (xy[x] * ru[x] + yy[x] * rv[x]);
    }
}

void flow_relax_row(const FlowLevel& level, const FlowField& from, const FlowField& right_side, const FlowField& to, float damping,
                    const float* zeros, std::int64_t y) {
    const std::int64_t width = level.width, plane = level.height * width, at = y * width;
    const float *FINGERFLOW_RESTRICT xx = level.inverse + at, *FINGERFLOW_RESTRICT xy = xx + plane, *FINGERFLOW_RESTRICT yy = xy + plane;
    const float *FINGERFLOW_RESTRICT ru = right_side.u + at, *FINGERFLOW_RESTRICT rv = right_side.v + at;
    float *FINGERFLOW_RESTRICT u = to.u + at, *FINGERFLOW_RESTRICT v = to.v + at;
    const Stencil stencil(level, from, zeros, y);
    along_row(stencil, width, [&](std::int64_t x, float on_u, float on_v) {
        const float left_u = ru[x] - on_u, left_v = rv[x] - on_v;
        u[x] = stencil.u[x] + damping * (xx[x] * left_u + xy[x] * left_v);
        v[x] = stencil.v[x] + damping * (xy[x] * left_u + yy[x] * left_v);
    });
}

void flow_left_over_row(const FlowLevel& level, const FlowField* step, const FlowField& departure, const float* pull, const FlowField& to,
                        const float* zeros, std::int64_t y) {
    const std::int64_t width = level.width, plane = level.height * width, at = y * width;
    const float *FINGERFLOW_RESTRICT ru = pull + at, *FINGERFLOW_RESTRICT rv = pull + plane + at;
    float *FINGERFLOW_RESTRICT u = to.u + at, *FINGERFLOW_RESTRICT v = to.v + at;
    const Stencil smooth(level, departure, zeros, y);
    along_row<false>(smooth, width, [&](std::int64_t x, float on_u, float on_v) {
        u[x] = ru[x] - on_u;
        v[x] = rv[x] - on_v;
    });
    if (!step) return;
    const float *FINGERFLOW_RESTRICT xx = smooth.xx, *FINGERFLOW_RESTRICT xy = smooth.xy, *FINGERFLOW_RESTRICT yy = smooth.yy;
    const float *FINGERFLOW_RESTRICT su = step->u + at, *FINGERFLOW_RESTRICT sv = step->v + at;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < width; ++x) {
        u[x] -= xx[x] * su[x] + xy[x] * sv[x];
        v[x] -= xy[x] * su[x] + yy[x] * sv[x];
    }
}

void flow_restrict_row(const FlowLevel& level, const FlowField& from, const FlowField& right_side, const FlowLevel& coarser,
                       const FlowField& to, const float* zeros, float* memory, std::int64_t y) {
    const std::int64_t width = level.width;
    float *FINGERFLOW_RESTRICT u = memory, *FINGERFLOW_RESTRICT v = memory + 2 * width;
    const std::int64_t rows = 2 * y + 1 < level.height ? 2 : 1;
    for (std::int64_t row = 0; row < rows; ++row) {
        const std::int64_t at = (2 * y + row) * width;
        const float *FINGERFLOW_RESTRICT ru = right_side.u + at, *FINGERFLOW_RESTRICT rv = right_side.v + at;
        const bool second = row == 1;
        along_row(Stencil(level, from, zeros, 2 * y + row), width, [&](std::int64_t x, float on_u, float on_v) {
            u[x] = (second ? u[x] : 0.0f) + (ru[x] - on_u);
            v[x] = (second ? v[x] : 0.0f) + (rv[x] - on_v);
        });
    }
    float *FINGERFLOW_RESTRICT sum_u = to.u + y * coarser.width, *FINGERFLOW_RESTRICT sum_v = to.v + y * coarser.width;
    const std::int64_t pairs = width / 2;
    for (std::int64_t x = 0; x < pairs; ++x) {
        sum_u[x] = (u[2 * x] + u[2 * x + 1]) / 4;
        sum_v[x] = (v[2 * x] + v[2 * x + 1]) / 4;
    }
    if (pairs < coarser.width) {
        sum_u[pairs] = u[2 * pairs] / 4;
        sum_v[pairs] = v[2 * pairs] / 4;
    }
}

void flow_spread_row(const FlowLevel& level, const FlowLevel& coarser, const FlowField& from, const FlowField& to, float* memory,
                     std::int64_t y) {
    const std::int64_t cells = coarser.width, near = y / 2;
    const std::int64_t next = y % 2 ? (near + 1 < coarser.height ? near + 1 : near) : (near > 0 ? near - 1 : 0);
    // The end cells are repeated.
    float *FINGERFLOW_RESTRICT u = memory + 1, *FINGERFLOW_RESTRICT v = memory + cells + 3, *FINGERFLOW_RESTRICT share = memory + 2 * cells + 5;
    const float *FINGERFLOW_RESTRICT one = coarser.inside + near * cells, *FINGERFLOW_RESTRICT other = coarser.inside + next * cells;
    const float *FINGERFLOW_RESTRICT near_u = from.u + near * cells, *FINGERFLOW_RESTRICT next_u = from.u + next * cells;
    const float *FINGERFLOW_RESTRICT near_v = from.v + near * cells, *FINGERFLOW_RESTRICT next_v = from.v + next * cells;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < cells; ++x) {
        u[x] = 0.75f * (near_u[x] * one[x]) + 0.25f * (next_u[x] * other[x]);
        v[x] = 0.75f * (near_v[x] * one[x]) + 0.25f * (next_v[x] * other[x]);
        share[x] = 0.75f * one[x] + 0.25f * other[x];
    }
    float* const lines[3] = {u, v, share};
    for (float* const line : lines) {
        line[-1] = line[0];
        line[cells] = line[cells - 1];
    }
    const float* FINGERFLOW_RESTRICT inside = level.inside + y * level.width;
    float *FINGERFLOW_RESTRICT to_u = to.u + y * level.width, *FINGERFLOW_RESTRICT to_v = to.v + y * level.width;
    const auto before = [&](std::int64_t x) {
        const float known = 0.75f * share[x] + 0.25f * share[x - 1], by = inside[2 * x] / (known > 0 ? known : 1.0f);
        to_u[2 * x] += by * (0.75f * u[x] + 0.25f * u[x - 1]);
        to_v[2 * x] += by * (0.75f * v[x] + 0.25f * v[x - 1]);
    };
    const std::int64_t pairs = level.width / 2;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < pairs; ++x) {
        before(x);
        const float known = 0.75f * share[x] + 0.25f * share[x + 1], by = inside[2 * x + 1] / (known > 0 ? known : 1.0f);
        to_u[2 * x + 1] += by * (0.75f * u[x] + 0.25f * u[x + 1]);
        to_v[2 * x + 1] += by * (0.75f * v[x] + 0.25f * v[x + 1]);
    }
    if (level.width % 2) before(pairs);
}

void flow_add_row(const float* step, std::int64_t width, bool first, float* sum, float* moved) {
    const float* FINGERFLOW_RESTRICT by = step;
    float *FINGERFLOW_RESTRICT all = sum, *FINGERFLOW_RESTRICT to = moved;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < width; ++x) {
        all[x] = (first ? 0.0f : all[x]) + by[x];
        to[x] += by[x];
    }
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
