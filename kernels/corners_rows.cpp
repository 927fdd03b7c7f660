// build: each instruction set
// Corner responses and their local maxima, row by row (corners.cpp).
// Sobel gradients gx, gy of bytes; sums xx, xy, yy of their products over window x window px; the response is the
// smaller eigenvalue, (xx + yy - sqrt((xx - yy)^2 + 4 xy^2)) / (128 window^2). Sums are exact int32 numbers, updated by
// adding the new row and subtracting the row a window above.
// Layout: one pixel a lane; `Lines` holds column sums padded by half a window, a ring of `window` rows of products, and
// rings of three rows of responses with a zero at either end.
#include "corners_rows.h"

#include <math.h>

#include <cstring>

#include "floats.h"
#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

// Least ratio of the smaller eigenvalue to the larger one, as in fingerflow/ops/tracking/corners.py.
constexpr float kRounding = 1e-5f;

struct Lines {
    std::int64_t stride;
    std::int32_t* sums[3];      // of the products of gradients over the window's rows, padded by half a window
    std::int32_t* products;     // (window, 3) lines, by row modulo window
    std::int16_t *smooth, *difference;
    float *response[3], *larger[3];  // by row modulo 3
    unsigned char* peaks;

    Lines(void* memory, std::int64_t width, std::int64_t window) : stride(width + kCornerPadding) {
        auto line = static_cast<std::int32_t*>(memory);
        for (std::int32_t*& sum : sums) {
            sum = line;
            line += stride;
        }
        products = line;
        line += 3 * window * stride;
        for (int k = 0; k < 3; ++k) {
            response[k] = reinterpret_cast<float*>(line);
            larger[k] = response[k] + stride;
            line += 2 * stride;
        }
        smooth = reinterpret_cast<std::int16_t*>(line);
        difference = reinterpret_cast<std::int16_t*>(line + stride);
        peaks = reinterpret_cast<unsigned char*>(line + 2 * stride);
    }
};

std::int64_t kept_within(std::int64_t value, std::int64_t end) { return value < 0 ? 0 : value < end ? value : end - 1; }

// Adds the products of a row's Sobel gradients to the sums and subtracts those of the row a window above.
void enter(const CornerFrame& frame, std::int64_t row, Lines& lines) {
    const std::int64_t y = kept_within(row, frame.height), width = frame.width, half = frame.window / 2;
    const std::uint8_t* FINGERFLOW_RESTRICT above = frame.data + kept_within(y - 1, frame.height) * frame.row_stride;
    const std::uint8_t* FINGERFLOW_RESTRICT here = frame.data + y * frame.row_stride;
    const std::uint8_t* FINGERFLOW_RESTRICT below = frame.data + kept_within(y + 1, frame.height) * frame.row_stride;
    std::int16_t* FINGERFLOW_RESTRICT smooth = lines.smooth + 1;
    std::int16_t* FINGERFLOW_RESTRICT difference = lines.difference + 1;
    for (std::int64_t x = 0; x < width; ++x) {
        smooth[x] = static_cast<std::int16_t>(above[x] + 2 * here[x] + below[x]);
        difference[x] = static_cast<std::int16_t>(below[x] - above[x]);
    }
    smooth[-1] = smooth[0];
    difference[-1] = difference[0];
    smooth[width] = smooth[width - 1];
    difference[width] = difference[width - 1];

    std::int32_t* FINGERFLOW_RESTRICT old_xx =
        lines.products + 3 * ((row + 2 * frame.window) % frame.window) * lines.stride;
    std::int32_t* FINGERFLOW_RESTRICT old_xy = old_xx + lines.stride;
    std::int32_t* FINGERFLOW_RESTRICT old_yy = old_xy + lines.stride;
    std::int32_t* FINGERFLOW_RESTRICT sum_xx = lines.sums[0] + half;
    std::int32_t* FINGERFLOW_RESTRICT sum_xy = lines.sums[1] + half;
    std::int32_t* FINGERFLOW_RESTRICT sum_yy = lines.sums[2] + half;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < width; ++x) {
        const std::int32_t gradient_x = smooth[x + 1] - smooth[x - 1];
        const std::int32_t gradient_y = difference[x - 1] + 2 * difference[x] + difference[x + 1];
        const std::int32_t xx = gradient_x * gradient_x, xy = gradient_x * gradient_y, yy = gradient_y * gradient_y;
        sum_xx[x] += xx - old_xx[x];
        sum_xy[x] += xy - old_xy[x];
        sum_yy[x] += yy - old_yy[x];
        old_xx[x] = xx;
        old_xy[x] = xy;
        old_yy[x] = yy;
    }
}

// Smaller and larger eigenvalue along a row, from the column sums.
template <int kWindow>
void respond(const Lines& lines, std::int64_t width, float* FINGERFLOW_RESTRICT smaller,
             float* FINGERFLOW_RESTRICT larger) {
    const std::int32_t* FINGERFLOW_RESTRICT sums_xx = lines.sums[0];
    const std::int32_t* FINGERFLOW_RESTRICT sums_xy = lines.sums[1];
    const std::int32_t* FINGERFLOW_RESTRICT sums_yy = lines.sums[2];
    const float scale = static_cast<float>(1.0 / (128 * kWindow * kWindow));
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < width; ++x) {
        std::int32_t xx = 0, xy = 0, yy = 0;
        FINGERFLOW_UNROLL
        for (int k = 0; k < kWindow; ++k) {
            xx += sums_xx[x + k];
            xy += sums_xy[x + k];
            yy += sums_yy[x + k];
        }
        const float both = static_cast<float>(xx + yy), apart = static_cast<float>(xx - yy);
        const float twice = static_cast<float>(2 * xy), root = sqrtf(apart * apart + twice * twice);
        smaller[x] = (both - root) * scale;
        larger[x] = (both + root) * scale;
    }
}

void respond(std::int64_t window, const Lines& lines, std::int64_t width, float* smaller, float* larger) {
    switch (window) {
        case 1: return respond<1>(lines, width, smaller, larger);
        case 3: return respond<3>(lines, width, smaller, larger);
        case 5: return respond<5>(lines, width, smaller, larger);
        case 7: return respond<7>(lines, width, smaller, larger);
        case 9: return respond<9>(lines, width, smaller, larger);
        case 11: return respond<11>(lines, width, smaller, larger);
        case 13: return respond<13>(lines, width, smaller, larger);
        default: return respond<15>(lines, width, smaller, larger);
    }
}

// Writes the responses of a row, 0 outside mask and border. The sums must hold the rows of its window.
void fill_row(const CornerFrame& frame, std::int64_t row, Lines& lines) {
    const std::int64_t width = frame.width, half = frame.window / 2, border = frame.border;
    float* FINGERFLOW_RESTRICT response = lines.response[(row + 3) % 3] + 1;
    if (row < border || row >= frame.height - border || 2 * border >= width) {
        std::memset(response, 0, static_cast<std::size_t>(4 * width));
        return;
    }
    for (std::int32_t* sums : lines.sums)
        for (std::int64_t k = 0; k < half; ++k) {
            sums[k] = sums[half];
            sums[half + width + k] = sums[half + width - 1];
        }
    respond(frame.window, lines, width, response, lines.larger[(row + 3) % 3]);
    if (frame.mask != nullptr) {
        const unsigned char* FINGERFLOW_RESTRICT mask = frame.mask + row * frame.mask_row_stride;
        for (std::int64_t x = 0; x < width; ++x) response[x] = mask[x] != 0 ? response[x] : 0.0f;
    }
    std::memset(response, 0, static_cast<std::size_t>(4 * border));
    std::memset(response + width - border, 0, static_cast<std::size_t>(4 * border));
}

// Appends the local maxima of a row, whose neighbours are in `lines`, and updates the strongest response.
void find_peaks(const CornerFrame& frame, std::int64_t row, const Lines& lines, CornerCandidates* candidates,
                std::int32_t* strongest_bits) {
    const std::int64_t width = frame.width;
    const float* FINGERFLOW_RESTRICT above = lines.response[(row + 2) % 3] + 1;
    const float* FINGERFLOW_RESTRICT here = lines.response[row % 3] + 1;
    const float* FINGERFLOW_RESTRICT below = lines.response[(row + 1) % 3] + 1;
    const float* FINGERFLOW_RESTRICT larger = lines.larger[row % 3];
    unsigned char* FINGERFLOW_RESTRICT peaks = lines.peaks;
    const float floor = frame.floor;
    // Positive floats have the order of their bits.
    const auto bits = reinterpret_cast<const std::int32_t*>(here);
    std::int32_t strongest = *strongest_bits;
    for (std::int64_t x = 0; x < width; ++x) strongest = bits[x] > strongest ? bits[x] : strongest;
    *strongest_bits = strongest;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < width; ++x) {
        const float middle = here[x];
        const bool sides = (middle >= here[x - 1]) & (middle >= here[x + 1]);
        const bool up = (middle >= above[x - 1]) & (middle >= above[x]) & (middle >= above[x + 1]);
        const bool down = (middle >= below[x - 1]) & (middle >= below[x]) & (middle >= below[x + 1]);
        peaks[x] = sides & up & down & (middle > floor) & (middle > kRounding * larger[x]);
    }
    for (std::int64_t first = 0; first < width; first += 8) {  // zeros follow the last
        std::uint64_t eight;
        std::memcpy(&eight, peaks + first, 8);
        if (eight == 0) continue;
        for (std::int64_t x = first; x < first + 8; ++x)
            if (peaks[x] != 0)
                candidates->keys[candidates->count++] =
                    static_cast<std::uint64_t>(~static_cast<std::uint32_t>(bits[x])) << 32 |
                    static_cast<std::uint32_t>(row * width + x);
    }
}

}  // namespace

void corner_rows(const CornerFrame& frame, std::int64_t top, std::int64_t bottom, void* memory,
                 CornerCandidates* candidates) {
    std::memset(memory, 0, static_cast<std::size_t>(4 * (3 * frame.window + 12) * (frame.width + kCornerPadding)));
    Lines lines(memory, frame.width, frame.window);
    const std::int64_t half = frame.window / 2;
    std::int32_t strongest = 0;
    for (std::int64_t row = top - 1 - half; row < top - 1 + half; ++row) enter(frame, row, lines);
    for (std::int64_t row = top - 1; row <= bottom; ++row) {
        enter(frame, row + half, lines);
        fill_row(frame, row, lines);
        if (row > top) find_peaks(frame, row - 1, lines, candidates, &strongest);
    }
    std::memcpy(&candidates->strongest, &strongest, sizeof strongest);
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
