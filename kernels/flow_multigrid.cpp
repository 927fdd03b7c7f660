// Dense flow: levels and V-cycles of the multigrid (fingerflow/ops/flow/flow_multigrid.py).
// Solves (T + L) step = pull - L (flow - course) for the 2-vector step of each cell: T is the structure tensor, L the
// Laplacian weighted by the edges, and the course a locally fitted plane. Damped block-Jacobi sweeps smooth each level;
// residuals are averaged over 2 x 2 cells to the next one, and corrections interpolated back. A coarser level averages
// tensors over 2 x 2 cells; its edge is 1/8 of the sum of the two edges across a border. Each level stores the inverses
// of its diagonal blocks, (T + sum of edges)^-1.
// Layout: planes of floats, row-major; a vector field is a plane of u and one of v, a symmetric tensor three of xx, xy,
// yy. `right` is one column narrower, `down` one row lower than a plane. Each level's two fields lie behind those of the
// finer level in the caller's workspace. Threads share the rows of a plane (flow_pieces.h).
#include <algorithm>
#include <memory>

#include "flow_course.h"
#include "flow_multigrid_rows.h"
#include "flow_pieces.h"
#include "interface.h"

namespace fingerflow {
namespace {

// The level of one image of a batch.
FlowLevel of_image(const FlowLevel& level, std::int64_t image) {
    const std::int64_t height = level.height, width = level.width, cells = height * width;
    return {level.tensor + 3 * cells * image,
            level.right + height * (width - 1) * image,
            level.down + (height - 1) * width * image,
            level.inverse + 3 * cells * image,
            level.inside + cells * image,
            height,
            width};
}

struct Cycle {
    const FlowLevel* levels;
    std::int64_t count;
    const float* zeros;
    int sweeps, coarsest;
    float damping;
    int threads;

    // Solves on a level and all coarser ones. The solution lies in one of two fields in `memory`, before those of the
    // coarser levels.
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
        for_rows(level.height, level.width, 3 * (coarser.width + 2), threads,
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

void fingerflow_flow_descend(const fingerflow_flow_descend_of* given, int threads) {
    using namespace fingerflow;
    const std::int64_t height = given->levels[0].height, width = given->levels[0].width, plane = height * width;
    std::int64_t floats = 0;
    for (std::int64_t k = 0; k < given->count; ++k) floats += 6 * given->levels[k].height * given->levels[k].width;
    const std::int64_t of_course = flow_departure_floats(height, width);
    auto* const memory = static_cast<float*>(
        workspace<Keeper::kCaller>(static_cast<std::size_t>(floats + of_course + 6 * plane + width) * sizeof(float)));
    float *const course = memory + floats, *const step_u = course + of_course, *const zeros = step_u + 6 * plane;
    const FlowField step{step_u, step_u + plane}, left{step_u + 2 * plane, step_u + 3 * plane};
    float* const beside = step_u + 4 * plane;
    std::fill(zeros, zeros + width, 0.0f);
    std::unique_ptr<FlowLevel[]> levels(new FlowLevel[static_cast<std::size_t>(given->count)]);
    for (std::int64_t image = 0; image < given->batch; ++image) {
        for (std::int64_t k = 0; k < given->count; ++k) levels[static_cast<std::size_t>(k)] = of_image(given->levels[k], image);
        const Cycle cycle{levels.get(), given->count, zeros, given->sweeps, given->coarsest, given->damping, threads};
        const float *const pull = given->pull + 2 * plane * image, *const from = given->flow + 2 * plane * image;
        const float* const known = given->known + plane * image;
        float* const moved = given->moved + 2 * plane * image;
        std::copy(from, from + 2 * plane, moved);
        for (int k = 0; k < given->cycles; ++k) {
            flow_departure({moved, known, 2, height, width}, {given->weights, given->half}, beside, course, threads);
            // Cells without data start at the course.
            if (k == 0)
                for_rows(height, width, 1, threads, [&](std::int64_t y, float*) {
                    for (std::int64_t x = y * width; x < (y + 1) * width; ++x)
                        if (!(known[x] > 0)) {
                            moved[x] -= beside[x];
                            moved[plane + x] -= beside[plane + x];
                            beside[x] = beside[plane + x] = 0.0f;
                        }
                });
            const FlowField departure{beside, beside + plane};
            for_rows(height, width, 1, threads, [&](std::int64_t y, float*) {
                FINGERFLOW_PICK(flow_left_over_row)(levels[0], k == 0 ? nullptr : &step, departure, pull, left, zeros, y);
            });
            const FlowField found = cycle.solved(0, left, memory);
            for_rows(height, width, 1, threads, [&](std::int64_t y, float*) {
                const std::int64_t at = y * width;
                FINGERFLOW_PICK(flow_add_row)(found.u + at, width, k == 0, step.u + at, moved + at);
                FINGERFLOW_PICK(flow_add_row)(found.v + at, width, k == 0, step.v + at, moved + plane + at);
            });
        }
    }
}
