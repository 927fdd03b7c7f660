// The region that a mask spans, on cells of one frame.
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

// Planes of `height` x `width` cells: rows begin at whole vectors and lie `pitch` numbers apart, `margin` zeros or more
// around them. Behind a row up to a whole vector lie zeros, too.
struct CellPlane {
    std::int64_t height, width, margin, pitch;
};
constexpr std::int64_t kCellLanes = 16;  // numbers of the longest vector
constexpr std::int64_t kCellBlock = 8;   // cells, a side of a block in which a component is followed

// Sums over cells: of the parts that lie inside, and of the pixels that the mask covers of cells that do in part.
struct CellShare {
    double parts, covered;
};

// Sums over the border: of the density there, and of its weights.
struct BorderLevel {
    double density, weight;
};

// How far a region reaches, counted from the other end so that 0 is nothing: in each column down and up, (width) each, in
// each row to the right and to the left, (height) each.
struct Outline {
    float *down, *up, *right, *left;
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
                     unsigned char* line, float* counts);
    // Counts times a factor; returns the sum of the counts.
    double scale_cells(const CellPlane& plane, const float* counts, float factor, float* cells);
    // Three box means of `width` cells, each way, in place; `other` is a plane with zeros around, too.
    void smooth_cells(const CellPlane& plane, float width, float* cells, float* other);
    // One over the length of the density's gradient, a cell; behind a row that of none.
    void inverse_slopes(const CellPlane& plane, const float* density, float* inverse);
    CellShare share_above(const CellPlane& plane, const float* density, const float* inverse, const float* counts, float limit);
    // The part of each cell that lies inside.
    void parts_above(const CellPlane& plane, const float* density, const float* inverse, float limit, float* parts);
    BorderLevel border_level(const CellPlane& plane, const float* density, const float* inverse, const float* own, float limit);
    // Greatest density of each block; `line` holds a row.
    void densest_of_blocks(const CellPlane& plane, const float* density, float* line, float* densest);
    // Extends an outline by a row of cells: those denser than the limit where `among` is 1. Zeros before the first row.
    void extend_outline(const CellPlane& plane, std::int64_t y, const float* density, const float* among, float limit,
                        const Outline& outline);
    // 1 where the outline lies on all four sides of a cell of a row, or at it.
    void fill_row(const CellPlane& plane, std::int64_t y, const Outline& outline, float* filled);
    // The cell counts by the part inside the region or beside it; `filled` is 1 where the region is, `line` holds a row
    // with its margins.
    void cover_row(const CellPlane& plane, std::int64_t y, const float* density, const float* inverse, const float* filled,
                   float limit, float* line, float* coverage, float* density_margin);
    RowMoments row_moments(const float* coverage, std::int64_t width);
)
// clang-format on

}  // namespace fingerflow
