// Dense flow: V-cycles of its multigrid, level by level, and images warped by it.
#include <algorithm>
#include <memory>

#include "flow_rows.h"
#include "interface.h"
#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
namespace {

constexpr std::int64_t kRows = 16;       // of a piece of work
constexpr std::int64_t kWorthIt = 8192;  // cells from which threads are asked to help

// Calls work(y, memory) for the rows of a level, with room for `floats` numbers.
template <class Work>
void for_rows(std::int64_t height, std::int64_t width, std::int64_t floats, int threads, const Work& work) {
    const std::int64_t pieces = (height + kRows - 1) / kRows;
    const auto piece = [&](std::int64_t number) {
        auto* const memory = static_cast<float*>(workspace(static_cast<std::size_t>(floats) * sizeof(float)));
        for (std::int64_t y = number * kRows; y < std::min(height, (number + 1) * kRows); ++y) work(y, memory);
    };
    parallel_for(pieces, height * width < kWorthIt ? 1 : threads, piece);
}

struct Cycle {
    const FlowLevel* levels;
    std::int64_t count;
    const float* zeros;
    int sweeps, coarsest;
    float damping;
    int threads;

    // The solution on a level, in one of two fields in `memory`, behind which the coarser levels have theirs.
    FlowField solved(std::int64_t number, const FlowField& right_side, float* memory) const {
        const FlowLevel& level = levels[number];
        const std::int64_t plane = level.height * level.width;
        FlowField now{memory, memory + plane}, next{memory + 2 * plane, memory + 3 * plane};
        const bool last = number + 1 == count;
        for_rows(level.height, level.width, 1, threads,
                 [&](std::int64_t y, float*) { FINGERFLOW_PICK(flow_start_row)(level, right_side, now, damping, y); });
        relax(level, right_side, now, next, last ? coarsest : sweeps - 1);
        if (last) return now;
        const FlowLevel& coarser = levels[number + 1];
        const std::int64_t cells = coarser.height * coarser.width;
        float* const behind = memory + 4 * plane;
        const FlowField left{behind, behind + cells};
        for_rows(coarser.height, 4 * coarser.width, 4 * level.width, threads, [&](std::int64_t y, float* rows) {
            FINGERFLOW_PICK(flow_restrict_row)(level, now, right_side, coarser, left, zeros, rows, y);
        });
        const FlowField found = solved(number + 1, left, behind + 2 * cells);
        for_rows(level.height, level.width, 3 * coarser.width, threads,
                 [&](std::int64_t y, float* rows) { FINGERFLOW_PICK(flow_spread_row)(level, coarser, found, now, rows, y); });
        relax(level, right_side, now, next, sweeps);
        return now;
    }

    void relax(const FlowLevel& level, const FlowField& right_side, FlowField& now, FlowField& next, int times) const {
        for (int k = 0; k < times; ++k) {
            for_rows(level.height, level.width, 1, threads, [&](std::int64_t y, float*) {
                FINGERFLOW_PICK(flow_relax_row)(level, now, right_side, next, damping, zeros, y);
            });
            std::swap(now, next);
        }
    }
};

}  // namespace
}  // namespace fingerflow

void fingerflow_flow_cycles(const fingerflow_flow_cycles_of* given, int threads) {
    using namespace fingerflow;
    const FlowLevel finest{given->levels[0].tensor,  given->levels[0].right,  given->levels[0].down, given->levels[0].inverse,
                           given->levels[0].inside, given->levels[0].height, given->levels[0].width};
    const std::int64_t plane = finest.height * finest.width;
    std::int64_t floats = 0;
    for (std::int64_t k = 0; k < given->count; ++k) floats += 6 * given->levels[k].height * given->levels[k].width;
    std::unique_ptr<float[]> memory(new float[static_cast<std::size_t>(floats + 2 * plane)]);
    std::unique_ptr<float[]> zeros(new float[static_cast<std::size_t>(finest.width)]());
    std::unique_ptr<FlowLevel[]> levels(new FlowLevel[static_cast<std::size_t>(given->count)]);
    for (std::int64_t image = 0; image < given->batch; ++image) {
        for (std::int64_t k = 0; k < given->count; ++k) {
            const fingerflow_flow_level& one = given->levels[k];
            const std::int64_t cells = one.height * one.width;
            levels[static_cast<std::size_t>(k)] = {one.tensor + 3 * cells * image,
                                                   one.right + one.height * (one.width - 1) * image,
                                                   one.down + (one.height - 1) * one.width * image,
                                                   one.inverse + 3 * cells * image,
                                                   one.inside + cells * image,
                                                   one.height,
                                                   one.width};
        }
        const Cycle cycle{levels.get(), given->count, zeros.get(), given->sweeps, given->coarsest, given->damping, threads};
        auto* const right_side = const_cast<float*>(given->right_side) + 2 * plane * image;  // read only
        const FlowField wanted{right_side, right_side + plane};
        const FlowField to{given->solution + 2 * plane * image, given->solution + 2 * plane * image + plane};
        const FlowField left{memory.get() + floats, memory.get() + floats + plane};
        for (int k = 0; k < given->cycles; ++k) {
            if (k > 0)
                for_rows(finest.height, finest.width, 1, threads, [&](std::int64_t y, float*) {
                    FINGERFLOW_PICK(flow_residual_row)(levels[0], to, wanted, left, zeros.get(), y);
                });
            const FlowField found = cycle.solved(0, k == 0 ? wanted : left, memory.get());
            for_rows(finest.height, finest.width, 1, threads, [&](std::int64_t y, float*) {
                const std::int64_t at = y * finest.width;
                for (std::int64_t x = at; x < at + finest.width; ++x) {
                    to.u[x] = k == 0 ? found.u[x] : to.u[x] + found.u[x];
                    to.v[x] = k == 0 ? found.v[x] : to.v[x] + found.v[x];
                }
            });
        }
    }
}

void fingerflow_flow_warp(const float* coefficients, const float* flow, float* values, std::int64_t batch, std::int64_t height,
                          std::int64_t width, int threads) {
    using namespace fingerflow;
    const std::int64_t plane = height * width;
    for (std::int64_t image = 0; image < batch; ++image) {
        const float *u = flow + 2 * plane * image, *v = u + plane;
        for_rows(height, width, 1, threads, [&](std::int64_t y, float*) {
            FINGERFLOW_PICK(flow_warp_row)
            (coefficients + plane * image, height, width, u + y * width, v + y * width, values + plane * image + y * width, y);
        });
    }
}
