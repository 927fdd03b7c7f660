// Rows of what dense flow does between pixels and its cells of 2 x 2 px, as fingerflow/ops/flow/flow_cells.py, flow_course.py and
// flow.py have it.
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

// u = height + x slope_x + y slope_y for both components, x and y in cells from the middle of a field.
struct FlowPlane {
    float height[2], slope_x[2], slope_y[2];
};

// Planes of cells (channels, height, width), one behind the other; known (height, width), 1 or 0, null where all are.
struct FlowCells {
    const float *planes, *known;
    std::int64_t channels, height, width;
};

constexpr int kFlowMoments = 12;

// Of a picture of `width` px: spline and slopes of the first image, what lies inside.
struct FlowPicture {
    const float *value, *slope_x, *slope_y, *inside;
    std::int64_t height, width;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Row y of the pixels, `width` of them in each channel's row of `to`: bilinear between cells that are known, for the first
    // two channels beside the plane, unless that is null. `memory` holds (channels + 1) rows of the cells and two more numbers each.
    void flow_finer_row(const FlowCells& cells, const FlowPlane* plane, std::int64_t width, std::int64_t y, float* const* to,
                        float* memory);
    // Adds to the 12 sums what a row of weights and of a field (u, v), at x from `begin` on, asks of a plane.
    void flow_moments_row(const float* known, const float* u, const float* v, std::int64_t width, float begin, float y, double* sums);
    // Keeps of warped values what arrives (`margin` px inside) and is finite, 0 elsewhere, and tells where in `seen`; adds
    // count and sums of both images.
    void flow_seen_row(const FlowPicture& picture, const float* u, const float* v, float* warped, float* seen, float margin,
                       std::int64_t y, double* sums);
    // Adds the sums of products of both images about their means.
    void flow_light_row(const FlowPicture& picture, const float* warped, const float* seen, const float* means, std::int64_t y, double* sums);
    // Row y of the cells: means of what is left times the slopes, of its square, and of `seen`. `memory` holds 4 rows.
    void flow_left_row(const FlowPicture& picture, const float* warped, const float* seen, float gain, float offset, std::int64_t y,
                       float* const* to, float* memory);
    // Row y of the cells of twice the size: 12 moments of what (u, v) has beside a plane.
    void flow_halved_moments_row(const FlowCells& cells, const FlowPlane& plane, std::int64_t y, float* const* to, float* memory);
    // Weighted means along a row, 0 beyond its ends; of weights, from the middle on, there are half + 1. `memory` holds the row and 2 half + 32.
    void flow_across_row(const float* from, const float* weights, std::int64_t half, std::int64_t width, float* to, float* memory);
    // Weighted means along the columns of a plane.
    void flow_down_row(const float* from, const float* weights, std::int64_t half, std::int64_t height, std::int64_t width, std::int64_t y, float* to);
    // Heights of the planes that 12 rows of moments ask for.
    void flow_heights_row(const float* const* moments, std::int64_t width, float begin, float y, float* u, float* v);
    // from - whole - beside, the plane taken at the cells of row y.
    void flow_departure_row(const float* const* from, const FlowPlane& whole, std::int64_t height, std::int64_t width, std::int64_t y, float* const* beside);
    // Coefficients, 0 where they are not finite.
    void flow_clean_row(const float* from, std::int64_t width, float* to);
    // Of the first image: slopes of the spline (0 nearer than `margin` px to the border), and where in the mask it takes finite
    // coefficients alone. `memory` holds 4 rows and 8 numbers.
    void flow_slopes_row(const float* coefficients, const float* clean, const float* mask, std::int64_t margin, std::int64_t height,
                         std::int64_t width, std::int64_t y, float* slope_x, float* slope_y, float* inside, float* memory);
    // Row y of the cells: means of the products of slopes, whether any pixel lies inside, edges to the next cell of the row
    // and, unless null, of the column. `memory` holds 3 rows.
    void flow_tensor_row(const FlowPicture& picture, std::int64_t y, float* const* tensor, float* known, float* right, float* down, float* memory);
    // Means of what lies inside of each cell.
    void flow_mean_row(const float* const* planes, const float* inside, std::int64_t height, std::int64_t width, std::int64_t y, float* const* to, float* memory);
    // NaN in `channels` rows where a pixel is not inside or has left the image.
    void flow_lost_row(const float* inside, std::int64_t height, std::int64_t width, std::int64_t y, float* const* rows, int channels);
)
// clang-format on

// The plane that 12 sums ask for, or the mean where they do not span one.
FlowPlane flow_plane(const double* sums);

}  // namespace fingerflow
