// build: each instruction set
// Responses of the rows of a part, and which are local maxima (detect.cpp).
// Slopes: central differences, smoothed by [1 2 1] / 4 across them. Their products xx, xy, yy are averaged over 5 x 5
// px; the response is the smaller eigenvalue, (xx + yy) / 2 - sqrt(((xx - yy) / 2)^2 + xy^2), or 0 where that is not
// above 0.
// Layout: one pixel a lane; responses have a border of zeros around the part, products a ring of five rows.
// The order of the sums is that of the portable form: responses agree with it bit for bit.
#include "detect_rows.h"

#include <math.h>

#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

constexpr std::int64_t kSquare = 2 * kTensorReach + 1;

// The sum of five floats, `step` apart.
inline float sum_of_five(const float* first, std::int64_t step) {
    return first[0] + ((first[step] + first[2 * step]) + (first[3 * step] + first[4 * step]));
}

// Products xx, xy, yy of the slopes of a row, at columns from `first` on.
template <class Pixel>
void write_products(const Pixel* row, std::int64_t row_stride, std::int64_t first, std::int64_t count, float* memory, float* const (&to)[3]) {
    const Pixel* FINGERFLOW_RESTRICT const above = row - row_stride + first;
    const Pixel* FINGERFLOW_RESTRICT const here = row + first;
    const Pixel* FINGERFLOW_RESTRICT const below = row + row_stride + first;
    float* FINGERFLOW_RESTRICT const smooth = memory + 1;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = -1; x < count + 1; ++x)
        smooth[x] = (static_cast<float>(above[x]) + 2 * static_cast<float>(here[x]) + static_cast<float>(below[x])) / 4;
    float* FINGERFLOW_RESTRICT const xx = to[0];
    float* FINGERFLOW_RESTRICT const xy = to[1];
    float* FINGERFLOW_RESTRICT const yy = to[2];
    const auto smoothed = [](const Pixel* at) {
        return (static_cast<float>(at[-1]) + 2 * static_cast<float>(at[0]) + static_cast<float>(at[1])) / 4;
    };
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < count; ++x) {
        const float slope_x = (smooth[x + 1] - smooth[x - 1]) / 2, slope_y = (smoothed(below + x) - smoothed(above + x)) / 2;
        xx[x] = slope_x * slope_x;
        xy[x] = slope_x * slope_y;
        yy[x] = slope_y * slope_y;
    }
}

void respond(const float* const (&sums)[3], std::int64_t count, float* FINGERFLOW_RESTRICT to) {
    constexpr float kPixels = kSquare * kSquare;
    const float* FINGERFLOW_RESTRICT const sum_xx = sums[0];
    const float* FINGERFLOW_RESTRICT const sum_xy = sums[1];
    const float* FINGERFLOW_RESTRICT const sum_yy = sums[2];
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < count; ++x) {
        const float xx = sum_of_five(sum_xx + x, 1) / kPixels, xy = sum_of_five(sum_xy + x, 1) / kPixels;
        const float yy = sum_of_five(sum_yy + x, 1) / kPixels, half = (xx - yy) / 2;
        const float smaller = (xx + yy) / 2 - sqrtf(half * half + xy * xy);
        to[x] = smaller - smaller == 0 && smaller > 0 ? smaller : 0;
    }
}

template <class Pixel>
void write_responses(const DetectPart& part, const Pixel* pixels, float* memory) {
    const std::int64_t edge = part.edge, stride = part.stride();
    const auto from = [&](std::int64_t first) { return first - 1 > edge ? first - 1 : edge; };
    const auto to = [&](std::int64_t last, std::int64_t end) { return last + 1 < end - edge ? last + 1 : end - edge; };
    const std::int64_t top = from(part.top), bottom = to(part.bottom, part.frame.height);
    const std::int64_t left = from(part.left), right = to(part.right, part.frame.width);
    for (std::int64_t k = 0; k < part.response_floats(); ++k) memory[k] = 0;
    if (top >= bottom || left >= right) return;
    float* const lines = memory + part.response_floats();
    float* const sums[] = {lines, lines + stride, lines + 2 * stride};
    float* const smooth = lines + 3 * stride;
    float* const products = lines + 4 * stride;
    const std::int64_t first = left - kTensorReach, count = right - left + 2 * kTensorReach;
    const auto product = [&](std::int64_t row, int k) { return products + (3 * ((row + kSquare) % kSquare) + k) * stride; };
    const auto enter = [&](std::int64_t row) {
        float* const of_row[] = {product(row, 0), product(row, 1), product(row, 2)};
        write_products(pixels + row * part.frame.row_stride, part.frame.row_stride, first, count, smooth, of_row);
    };
    for (std::int64_t row = top - kTensorReach; row < top + kTensorReach; ++row) enter(row);
    for (std::int64_t y = top; y < bottom; ++y) {
        enter(y + kTensorReach);
        for (int k = 0; k < 3; ++k) {
            const float* FINGERFLOW_RESTRICT const a = product(y - 2, k);
            const float* FINGERFLOW_RESTRICT const b = product(y - 1, k);
            const float* FINGERFLOW_RESTRICT const c = product(y, k);
            const float* FINGERFLOW_RESTRICT const d = product(y + 1, k);
            const float* FINGERFLOW_RESTRICT const e = product(y + 2, k);
            float* FINGERFLOW_RESTRICT const sum = sums[k];
            FINGERFLOW_INDEPENDENT
            for (std::int64_t x = 0; x < count; ++x) sum[x] = a[x] + ((b[x] + c[x]) + (d[x] + e[x]));
        }
        const float* const of_columns[] = {sums[0], sums[1], sums[2]};
        respond(of_columns, right - left, memory + (y - part.top + 1) * stride + left - part.left + 1);
    }
}

}  // namespace

void detect_rows(const DetectPart& part, float* memory, unsigned char* peaks) {
    const auto write = [&](const auto* pixels) { write_responses(part, pixels, memory); };
    const auto all = [&] { FINGERFLOW_FOR_PIXEL(part.frame.kind, part.frame.data, write) };
    all();
    const std::int64_t stride = part.stride(), columns = part.columns();
    for (std::int64_t y = 0; y < part.rows(); ++y) {
        const float* FINGERFLOW_RESTRICT const here = memory + (y + 1) * stride + 1;
        const float* FINGERFLOW_RESTRICT const above = here - stride;
        const float* FINGERFLOW_RESTRICT const below = here + stride;
        const unsigned char* FINGERFLOW_RESTRICT const mask = part.mask + (part.top + y) * part.mask_row_stride + part.left;
        unsigned char* FINGERFLOW_RESTRICT const to = peaks + y * columns;
        const auto larger = [](float a, float b) { return a > b ? a : b; };
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = 0; x < columns; ++x) {
            const float before = larger(larger(above[x - 1], here[x - 1]), below[x - 1]);
            const float behind = larger(larger(above[x + 1], here[x + 1]), below[x + 1]);
            const float around = larger(larger(before, behind), larger(above[x], below[x]));
            to[x] = static_cast<unsigned char>((here[x] >= around) & (here[x] > 0) & (mask[x] != 0));
        }
    }
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
