// Moments of some rows of a mask.
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

struct Moments {
    std::int64_t number, x, y, xx, xy, yy;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // Of rows from `top` to before `bottom`; `columns` holds `width` numbers. Fewer than 2^16 columns.
    Moments moments_of_rows(const unsigned char* mask, std::int64_t width, std::int64_t row_stride, std::int64_t top,
                            std::int64_t bottom, std::int32_t* columns);
)
// clang-format on

}  // namespace fingerflow
