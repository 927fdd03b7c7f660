// Connected components of one mask of bytes, in place.
#pragma once

#include <cstdint>

namespace fingerflow {

// Sets background pixels without a 4-connected path to the border of the frame.
void fill_holes(unsigned char* mask, std::int64_t height, std::int64_t width, std::int64_t row_stride);

// Clears all but the largest 8-connected component; of equal ones the first in reading order stays.
void keep_largest(unsigned char* mask, std::int64_t height, std::int64_t width, std::int64_t row_stride);

}  // namespace fingerflow
