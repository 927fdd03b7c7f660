// Moments of some rows of a mask (ellipse.cpp).
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

struct Moments {
    std::int64_t number, x, y, xx, xy, yy;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Moments of rows `top` to before `bottom`; `columns` has space for `width` numbers. Fewer than 2^16 columns.
    Moments moments_of_rows(const unsigned char* mask, std::int64_t width, std::int64_t row_stride, std::int64_t top,
                            std::int64_t bottom, std::int32_t* columns);
)
// clang-format on

}  // namespace fingerflow
