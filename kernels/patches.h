// Spline coefficients of a small rectangle, computed from the pixels on demand, since windows cover less than a frame.
#pragma once

#include "floats.h"
#include "pixels.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {

// Position of a patch in its frame, px.
struct Rectangle {
    std::int64_t x, y;
    int rows, columns;
};

constexpr int kPatchBlock = 32;  // columns at a time; rows are read and written in whole blocks
constexpr int patch_span(int columns) { return (columns + kPatchBlock - 1) / kPatchBlock * kPatchBlock; }

// Types in which sums of integer pixels are exact.
template <class Pixel>
struct PixelSum {
    using Type = float;
};
template <>
struct PixelSum<std::uint8_t> {
    using Type = std::uint16_t;
};
template <>
struct PixelSum<std::uint16_t> {
    using Type = std::int32_t;
};

inline std::int64_t nearest(std::int64_t place, std::int64_t count) {
    return place < 0 ? 0 : place >= count ? count - 1 : place;
}

// Three pixels weighted by 1, 2, 1.
template <class Sum, class Pixel>
inline Sum smooth(Pixel before, Pixel here, Pixel behind) {
    return static_cast<Sum>(static_cast<Sum>(before) + static_cast<Sum>(here) + static_cast<Sum>(here) + static_cast<Sum>(behind));
}

// Writes the coefficients of a rectangle less `level`, rows `stride` floats apart. The border is repeated.
template <class Pixel>
void cut_anywhere(const Pixel* frame, const Frames& frames, const Rectangle& where, float level, float* to, int stride) {
    using Sum = typename PixelSum<Pixel>::Type;
    for (int r = 0; r < where.rows; ++r) {
        const std::int64_t y = where.y + r;
        const Pixel* above = frame + nearest(y - 1, frames.height) * frames.row_stride;
        const Pixel* here = frame + nearest(y, frames.height) * frames.row_stride;
        const Pixel* below = frame + nearest(y + 1, frames.height) * frames.row_stride;
        for (int c = 0; c < where.columns; ++c) {
            const std::int64_t x = nearest(where.x + c, frames.width);
            const std::int64_t left = nearest(where.x + c - 1, frames.width), right = nearest(where.x + c + 1, frames.width);
            const Sum sum = smooth<Sum>(smooth<Sum>(above[left], above[x], above[right]), smooth<Sum>(here[left], here[x], here[right]),
                                        smooth<Sum>(below[left], below[x], below[right]));
            to[r * stride + c] = static_cast<float>(sum) * (1.0f / 16) - level;
        }
    }
}

// The same, faster away from the border: rows are written in whole blocks, which the next row partly overwrites.
// `lines` has space for rows + 2 rows of whole blocks of 4-byte numbers.
template <class Pixel>
void cut_patch(const Pixel* frame, const Frames& frames, const Rectangle& where, float level, void* lines, float* to, int stride) {
    using Sum = typename PixelSum<Pixel>::Type;
    const int span = patch_span(where.columns);
    const bool inside = where.x >= 1 && where.y >= 1 && where.x + span < frames.width && where.y + where.rows < frames.height;
    if (!inside) {
        // Padding is read by whole vectors and weighted by 0, so it must be finite.
        for (int r = 0; r < where.rows; ++r)
            for (int c = where.columns; c < stride; ++c) to[r * stride + c] = 0.0f;
        return cut_anywhere(frame, frames, where, level, to, stride);
    }
    Sum* const sums = static_cast<Sum*>(lines);
    const std::int64_t row_stride = frames.row_stride;
    const Pixel* const corner = frame + (where.y - 1) * row_stride + where.x - 1;
    const int rows = where.rows;
    for (int r = 0; r < rows + 2; ++r)
        for (int block = 0; block < span; block += kPatchBlock) {
            const Pixel* FINGERFLOW_RESTRICT from = corner + r * row_stride + block;
            Sum* FINGERFLOW_RESTRICT line = sums + r * span + block;
            FINGERFLOW_INDEPENDENT
            for (int c = 0; c < kPatchBlock; ++c) line[c] = smooth<Sum>(from[c], from[c + 1], from[c + 2]);
        }
    for (int r = 0; r < rows; ++r)
        for (int block = 0; block < span; block += kPatchBlock) {
            const Sum* FINGERFLOW_RESTRICT above = sums + r * span + block;
            const Sum* FINGERFLOW_RESTRICT here = above + span;
            const Sum* FINGERFLOW_RESTRICT below = here + span;
            float* FINGERFLOW_RESTRICT row = to + r * stride + block;
            FINGERFLOW_INDEPENDENT
            for (int c = 0; c < kPatchBlock; ++c)
                row[c] = static_cast<float>(smooth<Sum>(above[c], here[c], below[c])) * (1.0f / 16) - level;
        }
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
