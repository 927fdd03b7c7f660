// Row loops of dense flow between pixels and cells of 2 x 2 px, and of its course (flow_cells.cpp, flow_course.cpp).
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

// Plane height + x slope_x + y slope_y for both components, x and y in cells from the middle of the field.
struct FlowPlane {
    float height[2], slope_x[2], slope_y[2];
};

// Planes of cells (channels, height, width), contiguous; known (height, width), 1 or 0, or null if all are known.
struct FlowCells {
    const float *planes, *known;
    std::int64_t channels, height, width;
};

constexpr int kFlowMoments = 12;

// First image on height x width px: spline values, slopes, and 1 inside the mask, else 0.
struct FlowPicture {
    const float *value, *slope_x, *slope_y, *inside;
    std::int64_t height, width;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Writes row y of the pixels, one row of `width` floats a channel: bilinear between known cells; in the first two
    // channels relative to the plane, unless that is null. `memory` has space for channels + 1 rows of cells + 2
    // floats.
    void flow_finer_row(const FlowCells& cells, const FlowPlane* plane, std::int64_t width, std::int64_t y, float* const* to,
                        float* memory);
    // Adds the 12 moments of a row of weights and a field (u, v), with x from `begin` on, to `sums`.
    void flow_moments_row(const float* known, const float* u, const float* v, std::int64_t width, float begin, float y, double* sums);
    // Keeps finite warped values of pixels that stay `margin` px inside the image, sets others to 0, and writes the
    // weights to `seen`; adds the count and the sums of both images to `sums`.
    void flow_seen_row(const FlowPicture& picture, const float* u, const float* v, float* warped, float* seen, float margin,
                       std::int64_t y, double* sums);
    // Adds the sums of squares and products of both images about their means.
    void flow_light_row(const FlowPicture& picture, const float* warped, const float* seen, const float* means, std::int64_t y, double* sums);
    // Row y of the spline of coefficients (height, width) at (x + u, y + v), the border repeated.
    void flow_warp_row(const float* coefficients, std::int64_t height, std::int64_t width, const float* u, const float* v,
                       float* values, std::int64_t y);
    // Writes row y of the cells: means of residual times slopes, of residual^2, and of `seen`. `memory`: 4 rows.
    void flow_left_row(const FlowPicture& picture, const float* warped, const float* seen, float gain, float offset, std::int64_t y,
                       float* const* to, float* memory);
    // Writes row y of the 12 moments of (u, v) less a plane, on cells of twice the size.
    void flow_halved_moments_row(const FlowCells& cells, const FlowPlane& plane, std::int64_t y, float* const* to, float* memory);
    // Writes weighted sums along a row, 0 beyond its ends; weights are the middle one and `half` more. `memory` has
    // space for the row and 2 half + 32 floats.
    void flow_across_row(const float* from, const float* weights, std::int64_t half, std::int64_t width, float* to, float* memory);
    // Writes row y of the weighted sums along the columns of a plane.
    void flow_down_row(const float* from, const float* weights, std::int64_t half, std::int64_t height, std::int64_t width, std::int64_t y, float* to);
    // Writes the heights of the planes of 12 rows of moments at their cells.
    void flow_heights_row(const float* const* moments, std::int64_t width, float begin, float y, float* u, float* v);
    // beside = from - whole - beside, with the plane `whole` at the cells of row y.
    void flow_departure_row(const float* const* from, const FlowPlane& whole, std::int64_t height, std::int64_t width, std::int64_t y, float* const* beside);
    // Writes coefficients, 0 where they are not finite.
    void flow_clean_row(const float* from, std::int64_t width, float* to);
    // Writes the slopes of the first image's spline (0 nearer than `margin` px to the border) and the pixels of the
    // mask with finite coefficients only. `memory` has space for 4 rows and 8 floats.
    void flow_slopes_row(const float* coefficients, const float* clean, const float* mask, std::int64_t margin, std::int64_t height,
                         std::int64_t width, std::int64_t y, float* slope_x, float* slope_y, float* inside, float* memory);
    // Writes row y of the cells: means of products of slopes, 1 where any pixel lies inside, edges to the next cell of
    // the row and, unless null, of the column. `memory`: 3 rows.
    void flow_tensor_row(const FlowPicture& picture, std::int64_t y, float* const* tensor, float* known, float* right, float* down, float* memory);
)
// clang-format on

}  // namespace fingerflow
