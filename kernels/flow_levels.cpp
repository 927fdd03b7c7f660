// Dense flow: levels of the multigrid and covariance of the flow, from the structure tensor of the first image
// (fingerflow/ops/flow/flow_descent.py, flow_covariance.py).
// A coarser level averages tensors over 2 x 2 cells; its edge is 1/8 of the sum of the two edges across a border. Each
// level stores the inverses of its diagonal blocks, (T + sum of edges)^-1.
// Layout: planes of floats, row-major; symmetric tensors are three planes xx, xy, yy. `right` is one column narrower,
// `down` one row lower than a plane. Threads share rows.
#include <algorithm>

#include "flow_levels_rows.h"
#include "flow_pieces.h"
#include "interface.h"

void fingerflow_flow_levels(const fingerflow_flow_levels_of* given, int threads) {
    using namespace fingerflow;
    const fingerflow_flow_level_to* const levels = given->levels;
    const std::int64_t count = given->count;
    const std::int64_t widest = levels[0].width;
    auto* const zeros = static_cast<float*>(workspace<Keeper::kCaller>(static_cast<std::size_t>(widest) * sizeof(float)));
    std::fill(zeros, zeros + widest, 0.0f);
    for (std::int64_t image = 0; image < given->batch; ++image)
        for (std::int64_t k = 0; k < count; ++k) {
            const auto part = [image](float* plane, std::int64_t channels, std::int64_t height, std::int64_t width) {
                return plane + channels * height * width * image;
            };
            const fingerflow_flow_level_to& one = levels[k];
            const std::int64_t height = one.height, width = one.width;
            float* const inverse = part(one.inverse, 3, height, width);
            const FlowLevel level{part(one.tensor, 3, height, width),   part(one.right, 1, height, width - 1),
                                  part(one.down, 1, height - 1, width), inverse,
                                  part(one.inside, 1, height, width),   height,
                                  width};
            for_rows(height, width, 1, threads, [&](std::int64_t y, float*) { FINGERFLOW_PICK(flow_inverse_row)(level, zeros, inverse, y); });
            if (k + 1 == count) break;
            const fingerflow_flow_level_to& next = levels[k + 1];
            const FlowCoarser coarser{part(next.tensor, 3, next.height, next.width),   part(next.right, 1, next.height, next.width - 1),
                                      part(next.down, 1, next.height - 1, next.width), part(next.inside, 1, next.height, next.width),
                                      next.height,                                     next.width};
            for_rows(next.height, 4 * next.width, 4 * width, threads,
                     [&](std::int64_t y, float* memory) { FINGERFLOW_PICK(flow_coarser_row)(level, coarser, memory, y); });
        }
}

void fingerflow_flow_covariance(const float* tensor, const float* density, const float* alpha, const float* textured, float rho_square,
                                float* covariance, std::int64_t batch, std::int64_t height, std::int64_t width, int threads) {
    using namespace fingerflow;
    const std::int64_t plane = height * width;
    for (std::int64_t image = 0; image < batch; ++image) {
        const FlowNoise noise{density[image], alpha[image], rho_square, textured[image]};
        const float* const from = tensor + 3 * plane * image;
        float* const to = covariance + 3 * plane * image;
        for_rows(height, 8 * width, 1, threads, [&](std::int64_t y, float*) {
            const std::int64_t at = y * width;
            const float* const of[3] = {from + at, from + plane + at, from + 2 * plane + at};
            float* const rows[3] = {to + at, to + plane + at, to + 2 * plane + at};
            FINGERFLOW_PICK(flow_covariance_row)(of, noise, width, rows);
        });
    }
}
