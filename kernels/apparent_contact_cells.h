// Cells of the apparent contact region of one frame: density, coverage, outline and moments (apparent_contact.cpp).
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

// Plane of `height` x `width` cells: rows begin at whole vectors, `pitch` floats apart, with at least `margin` zeros on
// all sides and zeros behind a row up to a whole vector.
struct CellPlane {
    std::int64_t height, width, margin, pitch;
};
constexpr std::int64_t kCellLanes = 16;  // floats of the longest vector
constexpr std::int64_t kCellBlock = 8;   // cells a side of a block of the flood fill

// Sums over cells: parts inside the region, and set pixels of the mask in cells that lie at least partly inside.
struct CellShare {
    double parts, covered;
};

// Weighted sum of the density over the region's border, and sum of the weights.
struct BorderLevel {
    double density, weight;
};

// Extent of a region in each column (down, up) (width) and in each row (right, left) (height), counted from the
// opposite end, so that 0 means no cell.
struct Outline {
    float *down, *up, *right, *left;
};

// Moments 1, x, x^2 of a row's coverage, x in cells from the first column.
struct RowMoments {
    double mass, first, second;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Writes the number of set pixels of a mask (rows x columns bytes) in each cell of `side` 1, 2, 4 or 8 px. `line`
    // has space for the columns and 64 bytes more; `counts` is a plane.
    void count_cells(const unsigned char* mask, std::int64_t rows, std::int64_t columns, int side, const CellPlane& plane,
                     unsigned char* line, float* counts);
    // Writes counts times a factor; returns the sum of the counts.
    double scale_cells(const CellPlane& plane, const float* counts, float factor, float* cells);
    // Smooths by three box means of `width` cells along each axis, in place; `other` is a plane with zero margins.
    void smooth_cells(const CellPlane& plane, float width, float* cells, float* other);
    // Writes 1 / |grad density| of each cell; behind a row the value for a gradient of 0.
    void inverse_slopes(const CellPlane& plane, const float* density, float* inverse);
    CellShare share_above(const CellPlane& plane, const float* density, const float* inverse, const float* counts, float limit);
    // Writes the part of each cell inside the region.
    void parts_above(const CellPlane& plane, const float* density, const float* inverse, float limit, float* parts);
    BorderLevel border_level(const CellPlane& plane, const float* density, const float* inverse, const float* own, float limit);
    // Writes the greatest density of each block; `line` has space for a row.
    void densest_of_blocks(const CellPlane& plane, const float* density, float* line, float* densest);
    // Extends an outline, which begins as zeros, by the cells of a row denser than the limit where `among` is 1.
    void extend_outline(const CellPlane& plane, std::int64_t y, const float* density, const float* among, float limit,
                        const Outline& outline);
    // Writes 1 where outlined cells lie on all four sides of a cell, or at it.
    void fill_row(const CellPlane& plane, std::int64_t y, const Outline& outline, float* filled);
    // Writes coverage and density margin of a row: parts of cells in the filled region or next to it, 1 in its holes.
    // `filled` is 1 in the region; `line` has space for a row with its margins.
    void cover_row(const CellPlane& plane, std::int64_t y, const float* density, const float* inverse, const float* filled,
                   float limit, float* line, float* coverage, float* density_margin);
    RowMoments row_moments(const float* coverage, std::int64_t width);
)
// clang-format on

}  // namespace fingerflow
