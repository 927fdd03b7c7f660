// Which points lie in the apparent contact region (fingerflow/ops/contact/cells.py), some hundred points a frame.
// A point is transformed by 2 x 3 numbers to pixels; it is covered where the density margin, interpolated bilinearly
// between the centres of cells, exceeds 0.
// Layout: density margins (batch, cells down, cells across), points (batch, count, 2), results (batch, count) bytes.
#include <algorithm>
#include <cmath>

#include "interface.h"

// Whether (batch, count) regions of density margins (batch, cells down, cells across) on cells of `side` px cover points
void fingerflow_covered(const float* density_margin /* (batch, 1, down, across) */, std::int64_t batch, std::int64_t down /* from 1 */,
    std::int64_t across /* from 1 */, std::int64_t side /* from 1 */, const float* points /* (batch, count, 2) */, std::int64_t count,
    const float* transform /* (2, 3) */, unsigned char* covered /* bool (batch, count) */) {
    const auto middle = static_cast<float>(side - 1) / 2, each = static_cast<float>(side);
    const auto last_row = static_cast<float>(down), last_column = static_cast<float>(across);
    const std::int64_t right = std::min<std::int64_t>(1, across - 1), below = across * std::min<std::int64_t>(1, down - 1);
    // First of the two cells that a coordinate lies between, clamped to the grid, and the fraction in between.
    const auto placed = [](float place, float cells, float& part) {
        const float within = std::min(std::max(place, 0.0f), cells - 1);
        const float first = std::min(static_cast<float>(static_cast<std::int32_t>(within)), std::max(cells - 2, 0.0f));
        part = within - first;
        return static_cast<std::int64_t>(first);
    };
    for (std::int64_t frame = 0; frame < batch; ++frame) {
        const float* const cells = density_margin + frame * down * across;
        for (std::int64_t k = frame * count; k < (frame + 1) * count; ++k) {
            const float px = points[2 * k], py = points[2 * k + 1];
            const float x = transform[0] * px + transform[1] * py + transform[2];
            const float y = transform[3] * px + transform[4] * py + transform[5];
            const float column = (x - middle) / each, row = (y - middle) / each;
            covered[k] = 0;
            if (!(std::isfinite(x) && std::isfinite(y))) continue;
            if (!(column >= -0.5f && column < last_column - 0.5f && row >= -0.5f && row < last_row - 0.5f)) continue;
            float over, along;
            const std::int64_t left = placed(column, last_column, over), top = placed(row, last_row, along);
            const float* const first = cells + top * across + left;
            const float upper = first[0] * (1 - over) + first[right] * over;
            const float lower = first[below] * (1 - over) + first[below + right] * over;
            covered[k] = upper * (1 - along) + lower * along > 0;
        }
    }
}
