// Corners of uint8 frames (fingerflow/ops/tracking/corners.py): local maxima of the smaller eigenvalue of the structure
// tensor, chosen greedily from the strongest on, with at least `min_distance` px between two.
// A corner must exceed max(quality * strongest response, floor).
// Layout: a candidate is a 64-bit key, the inverted bits of its response in the upper half and row * width + column in
// the lower: ascending keys are descending responses. Keys of a piece of kRows rows lie where its pixels would.
#include <algorithm>
#include <cstring>
#include <limits>
#include <memory>
#include <vector>

#include "corners_rows.h"
#include "interface.h"
#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
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

void fingerflow_corners(const unsigned char* frames, std::int64_t batch, std::int64_t height, std::int64_t width,
                        std::int64_t frame_stride, std::int64_t row_stride, const unsigned char* mask,
                        std::int64_t masks, std::int64_t mask_stride, std::int64_t mask_row_stride, const float* floors,
                        float quality, std::int64_t window, std::int64_t border, std::int64_t count,
                        double min_distance, float* points, float* responses, int threads) {
    using namespace fingerflow;
    const std::int64_t pieces = (height + kRows - 1) / kRows, area = height * width;
    const std::unique_ptr<std::uint64_t[]> keys(new std::uint64_t[static_cast<std::size_t>(batch * area)]);
    std::vector<CornerCandidates> found(static_cast<std::size_t>(batch * pieces));
    const auto frame_of = [&](std::int64_t number) {
        const unsigned char* const own_mask = mask == nullptr ? nullptr : mask + (masks == 1 ? 0 : number) * mask_stride;
        return CornerFrame{frames + number * frame_stride, own_mask, height, width, row_stride, mask_row_stride,
                           window, border, floors[number]};
    };
    const auto look = FINGERFLOW_PICK(corner_rows);
    parallel_for(batch * pieces, threads, [&](std::int64_t piece) {
        const std::int64_t top = piece % pieces * kRows, number = piece / pieces;
        CornerCandidates& candidates = found[static_cast<std::size_t>(piece)];
        candidates.keys = keys.get() + number * area + top * width;
        candidates.count = 0;
        look(frame_of(number), top, std::min(height, top + kRows),
             workspace(static_cast<std::size_t>(corner_memory(width, window))), &candidates);
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
