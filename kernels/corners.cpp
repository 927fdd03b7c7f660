// build: each instruction set
// Corners of uint8 frames (fingerflow/ops/tracking/corners.py): local maxima of the smaller eigenvalue of the structure
// tensor, chosen greedily from the strongest on, with at least `min_distance` px between two. A corner must exceed
// max(quality * strongest response, floor).
// Sobel gradients gx, gy; sums xx, xy, yy of their products over window x window px; the response is the smaller
// eigenvalue, (xx + yy - sqrt((xx - yy)^2 + 4 xy^2)) / (128 window^2). Sums are exact int32 numbers, updated by adding the
// new row and subtracting the row a window above.
// Layout: one pixel a lane; `Lines` holds column sums padded by half a window, a ring of `window` rows of products, and
// rings of three rows of responses with a zero at either end. A candidate is a 64-bit key, the inverted bits of its
// response in the upper half and row * width + column in the lower: ascending keys are descending responses. Keys of a
// piece of kRows rows lie where its pixels would.
#include <math.h>
#include <cstring>

#include "floats.h"
#include "instruction_sets.h"
#include "interface.h"
#include "lanes.h"

namespace fingerflow {

// The window has at most 15 px, for which its integer sums fit into 32 bits.
struct CornerFrame {
    const std::uint8_t* data;
    const unsigned char* mask;  // or null
    std::int64_t height, width, row_stride, mask_row_stride, window, border;
    float floor;  // candidates have a larger response
};

struct CornerCandidates {
    std::uint64_t* keys;  // ascending keys are descending responses, equal ones in reading order; space for every pixel
    std::int64_t count;
    float strongest;  // greatest response inside mask and border, candidate or not; at least 0
};

// Bytes of memory that `corner_rows` needs.
constexpr std::int64_t kCornerPadding = 64;
constexpr std::int64_t corner_memory(std::int64_t width, std::int64_t window) {
    return 4 * (3 * window + 12) * (width + kCornerPadding);
}

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

#if FINGERFLOW_ONCE

#include <algorithm>
#include <limits>
#include <memory>
#include <vector>

#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
FINGERFLOW_OTHER_SETS(corner_rows)
namespace {

constexpr std::int64_t kRows = 64;     // of a piece; half a window of rows on either side is computed twice
constexpr std::int64_t kSorted = 2048;  // candidates sorted at a time, as the weakest are seldom needed

// Map of the pixels that lie nearer than a distance to a chosen corner.
class Taken {
public:
    Taken(std::int64_t height, std::int64_t width, double distance)
        : height_(height), width_(width), taken_(static_cast<std::size_t>(height * width)) {
        const auto squared = static_cast<float>(distance * distance);  // rounded as in the portable form
        const auto near = [=](std::int64_t x, std::int64_t y) { return static_cast<float>(x * x + y * y) < squared; };
        for (std::int64_t y = 0; y < height && near(0, y); ++y) {
            std::int64_t x = 0;
            while (x + 1 < width && near(x + 1, y)) ++x;
            half_widths_.push_back(x);
        }
    }
    bool at(std::int64_t x, std::int64_t y) const { return taken_[static_cast<std::size_t>(y * width_ + x)] != 0; }
    void take_around(std::int64_t x, std::int64_t y) {
        const auto reach = static_cast<std::int64_t>(half_widths_.size()) - 1;
        for (std::int64_t row = std::max<std::int64_t>(0, y - reach); row <= std::min(height_ - 1, y + reach); ++row) {
            const std::int64_t half = half_widths_[static_cast<std::size_t>(row < y ? y - row : row - y)];
            const std::int64_t first = std::max<std::int64_t>(0, x - half), last = std::min(width_ - 1, x + half);
            std::memset(taken_.data() + row * width_ + first, 1, static_cast<std::size_t>(last - first + 1));
        }
    }

private:
    std::int64_t height_, width_;
    std::vector<unsigned char> taken_;
    std::vector<std::int64_t> half_widths_;  // of the disc's rows, from the middle on
};

float response_of(std::uint64_t key) {
    const auto bits = ~static_cast<std::uint32_t>(key >> 32);
    float response;
    std::memcpy(&response, &bits, sizeof response);
    return response;
}

// Writes up to `count` corners above the floor, strongest first, and NaN behind them.
void select(std::uint64_t* keys, std::int64_t candidates, float floor, const CornerFrame& frame, std::int64_t count,
            double distance, float* points, float* responses) {
    Taken taken(frame.height, frame.width, distance);
    std::int64_t found = 0, sorted = 0;
    for (std::int64_t k = 0; k < candidates && found < count; ++k) {
        if (k == sorted) {
            sorted = std::min(candidates, sorted + kSorted);
            if (sorted < candidates) std::nth_element(keys + k, keys + sorted, keys + candidates);
            std::sort(keys + k, keys + sorted);
        }
        if (!(response_of(keys[k]) > floor)) break;
        const auto place = static_cast<std::int64_t>(keys[k] & 0xffffffffu);
        const std::int64_t x = place % frame.width, y = place / frame.width;
        if (taken.at(x, y)) continue;
        taken.take_around(x, y);
        points[2 * found] = static_cast<float>(x);
        points[2 * found + 1] = static_cast<float>(y);
        responses[found++] = response_of(keys[k]);
    }
    const float unknown = std::numeric_limits<float>::quiet_NaN();
    std::fill(points + 2 * found, points + 2 * count, unknown);
    std::fill(responses + found, responses + count, unknown);
}

}  // namespace
}  // namespace fingerflow

void fingerflow_corners(const fingerflow_frames* frames, const unsigned char* mask, std::int64_t masks,
                        std::int64_t mask_stride, std::int64_t mask_row_stride, const float* floors, float quality,
                        std::int64_t window, std::int64_t border, std::int64_t count, double min_distance, float* points,
                        float* responses, int threads) {
    using namespace fingerflow;
    const std::int64_t batch = frames->batch, height = frames->height, width = frames->width;
    const std::int64_t pieces = (height + kRows - 1) / kRows, area = height * width;
    const std::unique_ptr<std::uint64_t[]> keys(new std::uint64_t[static_cast<std::size_t>(batch * area)]);
    std::vector<CornerCandidates> found(static_cast<std::size_t>(batch * pieces));
    const auto frame_of = [&](std::int64_t number) {
        const unsigned char* const own_mask = mask == nullptr ? nullptr : mask + (masks == 1 ? 0 : number) * mask_stride;
        return CornerFrame{static_cast<const std::uint8_t*>(frames->data) + number * frames->frame_stride, own_mask, height, width,
                           frames->row_stride, mask_row_stride, window, border, floors[number]};
    };
    for_bands(batch, height, kRows, threads, [&](std::int64_t number, std::int64_t top, std::int64_t bottom) {
        CornerCandidates& candidates = found[static_cast<std::size_t>(number * pieces + top / kRows)];
        candidates.keys = keys.get() + number * area + top * width;
        candidates.count = 0;
        void* const memory = workspace(static_cast<std::size_t>(corner_memory(width, window)));
        FINGERFLOW_PICK(corner_rows)(frame_of(number), top, bottom, memory, &candidates);
    });
    parallel_for(batch, threads, [&](std::int64_t number) {
        std::uint64_t* const own = keys.get() + number * area;
        std::int64_t candidates = 0;
        float strongest = 0;
        for (std::int64_t piece = number * pieces; piece < (number + 1) * pieces; ++piece) {
            const CornerCandidates& some = found[static_cast<std::size_t>(piece)];
            std::copy(some.keys, some.keys + some.count, own + candidates);  // forwards, as ranges may overlap
            candidates += some.count;
            strongest = std::max(strongest, some.strongest);
        }
        const float floor = std::max(quality * strongest, floors[number]);
        select(own, candidates, floor, frame_of(number), count, min_distance, points + 2 * number * count,
               responses + number * count);
    });
}

#endif
