// Course of a flow: at each cell the value of a weighted plane fit of the flow in a window around it, and the departure
// of the flow from it (fingerflow/ops/flow/flow_cells.py). The plane of the whole field is subtracted first.
// Each plane follows from 12 moments: of the weight 1, x, y, xx, xy, yy; of u and v each 1, x, y.
// Layout: moments are planes on cells of twice the size, (12, ceil(height / 2), ceil(width / 2)), averaged with the
// window's weights along rows, then along columns; one cell a lane.
#include "flow_course.h"

#include "flow_pieces.h"

namespace fingerflow {
namespace {

// The least-squares plane of 12 moments, or the mean where the cells do not span a plane.
FlowPlane flow_plane(const double* sums) {
    const double tiny = 1e-12, narrow = 0.01;
    const double some = sums[0] > tiny ? sums[0] : 1.0, x = sums[1] / some, y = sums[2] / some;
    const double xx = sums[3] / some - x * x, xy = sums[4] / some - x * y, yy = sums[5] / some - y * y;
    const double determinant = xx * yy - xy * xy, trace = xx + yy;
    const bool spanned = determinant > narrow * trace * trace && determinant > tiny;
    FlowPlane plane;
    for (int k = 0; k < 2; ++k) {
        const double mean = sums[6 + k] / some, by_x = sums[8 + k] / some - x * mean, by_y = sums[10 + k] / some - y * mean;
        const double slope_x = spanned ? (by_x * yy - by_y * xy) / determinant : 0.0;
        const double slope_y = spanned ? (by_y * xx - by_x * xy) / determinant : 0.0;
        plane.height[k] = static_cast<float>(mean - slope_x * x - slope_y * y);
        plane.slope_x[k] = static_cast<float>(slope_x);
        plane.slope_y[k] = static_cast<float>(slope_y);
    }
    return plane;
}

}  // namespace

FlowPlane flow_whole_plane(const FlowCells& field, int threads) {
    const std::int64_t width = field.width, area = field.height * width;
    // Sums of rows are added in order: the result does not depend on the number of threads.
    auto* const rows = static_cast<double*>(workspace<Keeper::kSums>(static_cast<std::size_t>(field.height * kFlowMoments) * sizeof(double)));
    for_rows(field.height, width, 1, threads, [&](std::int64_t y, float*) {
        double* const sums = rows + y * kFlowMoments;
        for (int k = 0; k < kFlowMoments; ++k) sums[k] = 0;
        const float* const u = field.planes + y * width;
        FINGERFLOW_PICK(flow_moments_row)
        (field.known + y * width, u, u + area, width, -0.5f * static_cast<float>(width - 1),
         static_cast<float>(y) - 0.5f * static_cast<float>(field.height - 1), sums);
    });
    double sums[kFlowMoments] = {};
    for (std::int64_t y = 0; y < field.height; ++y)
        for (int k = 0; k < kFlowMoments; ++k) sums[k] += rows[y * kFlowMoments + k];
    return flow_plane(sums);
}

std::int64_t flow_departure_floats(std::int64_t height, std::int64_t width) {
    return 2 * kFlowMoments * ((height + 1) / 2) * ((width + 1) / 2);
}

void flow_departure(const FlowCells& field, const FlowWindow& window, float* departure, float* memory, int threads) {
    const FlowPlane whole = flow_whole_plane(field, threads);
    const std::int64_t height = (field.height + 1) / 2, width = (field.width + 1) / 2, area = height * width;
    float *const wide = memory, *const means = memory + kFlowMoments * area;
    // Moments and their window means along the rows.
    for_rows(height, 4 * kFlowMoments * width, (2 * kFlowMoments + 4) * width + 2 * window.half + 64, threads, [&](std::int64_t y, float* rows) {
        float *to[kFlowMoments], *const behind = rows + kFlowMoments * width;
        for (int k = 0; k < kFlowMoments; ++k) to[k] = rows + k * width;
        FINGERFLOW_PICK(flow_halved_moments_row)(field, whole, y, to, behind);
        for (int k = 0; k < kFlowMoments; ++k)
            FINGERFLOW_PICK(flow_across_row)(to[k], window.weights, window.half, width, wide + k * area + y * width, behind);
    });
    for_rows(height, 4 * kFlowMoments * width, kFlowMoments * width, threads, [&](std::int64_t y, float* rows) {
        const float* of[kFlowMoments];
        for (int k = 0; k < kFlowMoments; ++k) {
            FINGERFLOW_PICK(flow_down_row)(wide + k * area, window.weights, window.half, height, width, y, rows + k * width);
            of[k] = rows + k * width;
        }
        FINGERFLOW_PICK(flow_heights_row)
        (of, width, -0.5f * static_cast<float>(width - 1), static_cast<float>(y) - 0.5f * static_cast<float>(height - 1), means + y * width,
         means + area + y * width);
    });
    const std::int64_t plane = field.height * field.width;
    const FlowCells around{means, nullptr, 2, height, width};
    for_rows(field.height, field.width, 3 * (width + 2), threads, [&](std::int64_t y, float* rows) {
        const std::int64_t at = y * field.width;
        float* const to[2] = {departure + at, departure + plane + at};
        const float* const from[2] = {field.planes + at, field.planes + plane + at};
        FINGERFLOW_PICK(flow_finer_row)(around, nullptr, field.width, y, to, rows);
        FINGERFLOW_PICK(flow_departure_row)(from, whole, field.height, field.width, y, to);
    });
}

}  // namespace fingerflow
