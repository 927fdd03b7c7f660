// Density of a mask, three box sums of it, on some rows of one frame.
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

// A part of a frame; rows of its density lie `pitch` numbers apart. The radius is at most 17 px: sums of up to
// (2 radius + 1)^6 stay below 2^31.
struct Plane {
    std::int64_t height, width, radius, pitch;
};

// Rows and columns from the first that something covers to the one behind the last; no rows where it covers nothing.
struct Box {
    std::int64_t top, bottom, left, right;
};

// Pixels that are denser than a limit, and how many of them the mask covers.
struct DenseCount {
    std::int64_t all, covered;
};

// Pixels at the border of a region, and the sum of the region's own density there.
struct BorderSum {
    std::int64_t pixels, density;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Of a mask, and of what is denser than a limit; `columns` holds `width` bytes.
    Box covered_box(const unsigned char* mask, std::int64_t height, std::int64_t width, std::int64_t row_stride,
                    unsigned char* columns);
    Box denser_box(const Plane& plane, const std::int32_t* density, std::int32_t limit, unsigned char* columns);
    // Of the memory, aligned to 64, that the smoothing of some rows takes.
    std::int64_t smoothing_bytes(const Plane& plane);
    // Writes the density of rows from `top` to before `bottom` into that of the plane.
    void density_rows(const Plane& plane, const unsigned char* mask, std::int64_t row_stride, std::int64_t top,
                      std::int64_t bottom, void* memory, std::int32_t* density);
    DenseCount count_denser(const Plane& plane, const std::int32_t* density, const unsigned char* mask,
                            std::int64_t row_stride, std::int64_t top, std::int64_t bottom, std::int32_t limit);
    // Of the region that is denser than the limit.
    BorderSum border_density(const Plane& plane, const std::int32_t* density, std::int32_t limit, std::int64_t top,
                             std::int64_t bottom, void* memory);
    void write_denser(const Plane& plane, const std::int32_t* density, std::int32_t limit, std::int64_t top,
                      std::int64_t bottom, unsigned char* region, std::int64_t region_stride);
)
// clang-format on

}  // namespace fingerflow
