// build: each instruction set
// Integer moments of some rows of a mask: 1, x, y, xx, xy, yy over its set pixels.
// Each line gives its count and its sum of x, of which the moments by y are made; the counts of the columns give x and
// xx.
// Layout: one pixel a lane, masks are bytes, `columns` holds one int32 count a column.
#include "ellipse_rows.h"

#include <string.h>

#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

struct Line {
    std::uint32_t number, x;
};

Line add_line(const unsigned char* FINGERFLOW_RESTRICT row, std::int32_t width, std::int32_t* FINGERFLOW_RESTRICT columns) {
    std::uint32_t number = 0, sum = 0;
    for (std::int32_t x = 0; x < width; ++x) {
        const std::int32_t set = row[x] != 0 ? 1 : 0;
        columns[x] += set;
        number += static_cast<std::uint32_t>(set);
        sum += static_cast<std::uint32_t>(x & -set);
    }
    return {number, sum};
}

}  // namespace

Moments moments_of_rows(const unsigned char* mask, std::int64_t width, std::int64_t row_stride, std::int64_t top,
                        std::int64_t bottom, std::int32_t* columns) {
    Moments sums{0, 0, 0, 0, 0, 0};
    memset(columns, 0, static_cast<std::size_t>(width) * sizeof(std::int32_t));
    for (std::int64_t y = top; y < bottom; ++y) {
        const Line line = add_line(mask + y * row_stride, static_cast<std::int32_t>(width), columns);
        sums.number += line.number;
        sums.y += y * line.number;
        sums.xy += y * line.x;
        sums.yy += y * y * line.number;
    }
    for (std::int64_t x = 0; x < width; ++x) {
        sums.x += x * columns[x];
        sums.xx += x * x * columns[x];
    }
    return sums;
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
