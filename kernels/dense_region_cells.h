// The region that a mask spans, on cells of one frame.
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

// Planes of `height` x `width` cells lie `pitch` numbers apart, and `margin` numbers and rows of zeros around them.
struct CellPlane {
    std::int64_t height, width, margin, pitch;
};

// Sums over cells: of the parts that lie inside, and of the pixels that the mask covers of cells that do in part.
struct CellShare {
    double parts;
    std::int64_t covered;
};

// Sums over the border: of the density there, and of its weights.
struct BorderLevel {
    double density, weight;
};

// Sums over rows of the coverage of each: of 1, x and x x, with x in cells from the first column.
struct RowMoments {
    double mass, first, second;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Pixels of a mask of bytes (rows x columns) in each cell of `side`, 1, 2, 4 or 8 px, whole numbers; `line` holds
    // the columns, up to whole cells and 64 more. `counts` is a plane.
    void count_cells(const unsigned char* mask, std::int64_t rows, std::int64_t columns, int side, const CellPlane& plane,
                     unsigned char* line, std::int32_t* counts);
    // Counts times a factor.
    void scale_cells(const CellPlane& plane, const std::int32_t* counts, float factor, float* cells);
    // Three box means of `width` cells, each way, in place; `other` is a plane with zeros around, too.
    void smooth_cells(const CellPlane& plane, float width, float* cells, float* other);
    // One over the length of the density's gradient, a cell.
    void inverse_slopes(const CellPlane& plane, const float* density, float* inverse);
    CellShare share_above(const CellPlane& plane, const float* density, const float* inverse, const std::int32_t* counts, float limit);
    // The part of each cell that lies inside.
    void parts_above(const CellPlane& plane, const float* density, const float* inverse, float limit, float* parts);
    BorderLevel border_level(const CellPlane& plane, const float* density, const float* inverse, const float* own, float limit);
    // 1 where the density lies above a limit, else 0.
    void above_limit(const CellPlane& plane, const float* density, float limit, std::int32_t* inside);
    // The cell counts by the part inside; `near` is 1 where the region is or touches, `filled` where it is.
    void cover_row(const CellPlane& plane, std::int64_t y, const float* density, const float* inverse,
                   const std::int32_t* inside, const std::int32_t* filled, const std::int32_t* near, float limit,
                   float* coverage, float* excess);
    RowMoments row_moments(const float* coverage, std::int64_t width);
)
// clang-format on

}  // namespace fingerflow
