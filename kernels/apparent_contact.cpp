// Apparent (gross) contact region of a mask, on cells of `side` px (fingerflow/ops/contact/apparent_contact.py).
// The density of a cell is the share of its pixels that are set, smoothed by three box means of 2 radius + 1 px along
// each axis. A cell belongs to the region with part = clamp((density - limit) / |grad density| + 1/2, 0, 1); `limit` is
// iterated from the share of set pixels within the region. The density margin is density - limit at the component,
// +limit in its holes, -limit elsewhere; area, centre and semi-axes follow from the moments of the parts.
// Layout: planes of floats, one value a cell, row after row, with a margin of zeros on all sides and rows that begin at
// whole vectors. All planes of one frame lie in the thread's workspace, so that they stay in a cache.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

#include "apparent_contact_cells.h"
#include "interface.h"
#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
namespace {

constexpr float kLeastShare = 0.2f, kLeastLevel = 0.25f;
constexpr int kFirstRounds = 2, kRounds = 3;

float clamped(float value, float low, float high) { return std::min(std::max(value, low), high); }

class Finder {
public:
    Finder(const fingerflow_apparent_contacts& given, std::int64_t frame)
        : given_(given), mask_(given.masks + frame * given.height * given.width),
          margin_(given.density_margin + frame * cells_of(given.height, given.side) * cells_of(given.width, given.side)),
          numbers_(given.numbers + 7 * frame), width_(static_cast<float>(2 * given.radius + 1) / static_cast<float>(given.side)) {
        plane_.height = cells_of(given.height, given.side);
        plane_.width = cells_of(given.width, given.side);
        plane_.margin = static_cast<std::int64_t>(width_ / 2) + 3;
        left_ = whole(plane_.margin);
        plane_.pitch = left_ + whole(plane_.width) + whole(plane_.margin);
    }

    void find() {
        const std::int64_t all = (plane_.height + 2 * plane_.margin) * plane_.pitch, line = (given_.width + 127) / 64 * 64;
        const std::int64_t outline = 2 * plane_.pitch + 2 * whole(plane_.height);
        auto* const memory = static_cast<unsigned char*>(workspace(static_cast<std::size_t>(line + 4 * (6 * all + outline + 2 * plane_.pitch))));
        const std::int64_t origin = plane_.margin * plane_.pitch + left_;
        auto* const planes = reinterpret_cast<float*>(memory + line);
        // These planes and the lines are zero in their margins and wherever nothing is written.
        density_ = planes + origin;
        own_ = planes + all + origin;
        other_ = planes + 2 * all + origin;
        filled_ = planes + 3 * all + origin;
        float* const numbers = planes + 4 * all;
        outline_ = {numbers, numbers + plane_.pitch, numbers + 2 * plane_.pitch, numbers + 2 * plane_.pitch + whole(plane_.height)};
        std::memset(planes, 0, static_cast<std::size_t>(4 * (4 * all + outline + 2 * plane_.pitch)));
        line_ = numbers + outline + left_;
        among_ = numbers + outline + plane_.pitch;
        counts_ = among_ + plane_.pitch + origin;
        inverse_ = counts_ + all;

        FINGERFLOW_PICK(count_cells)(mask_, given_.height, given_.width, static_cast<int>(given_.side), plane_, memory, counts_);
        const float each = 1.0f / static_cast<float>(given_.side * given_.side);
        const double covered = FINGERFLOW_PICK(scale_cells)(plane_, counts_, each, density_);
        const auto smooth = FINGERFLOW_PICK(smooth_cells);
        smooth(plane_, width_, density_, other_);
        FINGERFLOW_PICK(inverse_slopes)(plane_, density_, inverse_);
        float limit = 0.25f;
        for (int round = 0; round < kFirstRounds; ++round) limit = share_above(limit) / 2;
        FINGERFLOW_PICK(parts_above)(plane_, density_, inverse_, limit, own_);
        smooth(plane_, width_, own_, other_);
        const BorderLevel border = FINGERFLOW_PICK(border_level)(plane_, density_, inverse_, own_, limit);
        const float level = clamped(static_cast<float>(border.density / std::max(border.weight, 1e-3)), kLeastLevel, 0.5f);
        for (int round = 0; round < kRounds; ++round) limit = share_above(limit) * level;
        fill(limit);
        const float* const coverage = cover(limit);
        measure(coverage, covered);
    }

    // Rounds up to whole vectors.
    static std::int64_t whole(std::int64_t count) { return cells_of(count, kCellLanes) * kCellLanes; }
    static std::int64_t cells_of(std::int64_t pixels, std::int64_t side) { return (pixels + side - 1) / side; }

private:
    float share_above(float limit) const {
        const CellShare share = FINGERFLOW_PICK(share_above)(plane_, density_, inverse_, counts_, limit);
        const double pixels = static_cast<double>(given_.side * given_.side) * std::max(share.parts, 1.0);
        return clamped(static_cast<float>(share.covered / pixels), kLeastShare, 1.0f);
    }

    // Finds the component around the densest cell, by flood fill over blocks of cells, and fills its outline.
    void fill(float limit) {
        const std::int64_t down = cells_of(plane_.height, kCellBlock), across = cells_of(plane_.width, kCellBlock);
        std::vector<float> densest(static_cast<std::size_t>(down * across));
        FINGERFLOW_PICK(densest_of_blocks)(plane_, density_, among_, densest.data());
        const float most = *std::max_element(densest.begin(), densest.end());
        std::vector<unsigned char> reached(densest.size());
        std::vector<std::int64_t> edge, next;
        for (std::size_t k = 0; k < densest.size(); ++k)
            if (densest[k] > limit && densest[k] >= most) {
                reached[k] = 1;
                edge.push_back(static_cast<std::int64_t>(k));
            }
        for (std::int64_t step = 0; step < std::max(down, across) && !edge.empty(); ++step) {
            next.clear();
            for (const std::int64_t block : edge)
                for (std::int64_t y = std::max<std::int64_t>(0, block / across - 1); y < std::min(down, block / across + 2); ++y)
                    for (std::int64_t x = std::max<std::int64_t>(0, block % across - 1); x < std::min(across, block % across + 2); ++x) {
                        const auto at = static_cast<std::size_t>(y * across + x);
                        if (densest[at] <= limit || reached[at] != 0) continue;
                        reached[at] = 1;
                        next.push_back(static_cast<std::int64_t>(at));
                    }
            edge.swap(next);
        }
        const auto extend = FINGERFLOW_PICK(extend_outline);
        for (std::int64_t y = 0; y < plane_.height; ++y) {
            if (y % kCellBlock == 0)
                for (std::int64_t x = 0; x < plane_.width; ++x)
                    among_[x] = reached[static_cast<std::size_t>(y / kCellBlock * across + x / kCellBlock)];
            extend(plane_, y, density_, among_, limit, outline_);
        }
        const auto fill = FINGERFLOW_PICK(fill_row);
        for (std::int64_t y = 0; y < plane_.height; ++y) fill(plane_, y, outline_, filled_ + y * plane_.pitch);
    }

    const float* cover(float limit) {
        const auto cover = FINGERFLOW_PICK(cover_row);
        for (std::int64_t y = 0; y < plane_.height; ++y)
            cover(plane_, y, density_, inverse_, filled_, limit, line_, other_ + y * plane_.pitch, margin_ + y * plane_.width);
        return other_;
    }

    void measure(const float* coverage, double covered) {
        double mass = 0, x = 0, y = 0, xx = 0, xy = 0, yy = 0;
        const auto sum = FINGERFLOW_PICK(row_moments);
        for (std::int64_t row = 0; row < plane_.height; ++row) {
            const RowMoments of_row = sum(coverage + row * plane_.pitch, plane_.width);
            const auto at = static_cast<double>(row);
            mass += of_row.mass;
            x += of_row.first;
            xx += of_row.second;
            y += of_row.mass * at;
            yy += of_row.mass * at * at;
            xy += of_row.first * at;
        }
        const auto side = static_cast<double>(given_.side), square = side * side;
        numbers_[0] = static_cast<float>(covered);
        if (mass <= 0.5) {
            numbers_[1] = 0;
            for (int k = 2; k < 7; ++k) numbers_[k] = std::numeric_limits<float>::quiet_NaN();
            return;
        }
        x /= mass;
        y /= mass;
        xx = (xx / mass - x * x) * square + (square - 1) / 12;
        yy = (yy / mass - y * y) * square + (square - 1) / 12;
        xy = (xy / mass - x * y) * square;
        const double middle = (xx + yy) / 2, half = (xx - yy) / 2, spread = std::sqrt(half * half + xy * xy);
        const double results[] = {mass * square, x * side + (side - 1) / 2, y * side + (side - 1) / 2, 2 * std::sqrt(middle + spread),
                                  2 * std::sqrt(std::max(middle - spread, 0.0)), std::atan2(xy, half) / 2};
        for (int k = 0; k < 6; ++k) numbers_[k + 1] = static_cast<float>(results[k]);
    }

    const fingerflow_apparent_contacts& given_;
    const unsigned char* mask_;
    float *margin_, *numbers_;
    const float width_;
    CellPlane plane_;
    std::int64_t left_;  // floats before the first cell of a row
    float *density_, *own_, *other_, *filled_, *counts_, *inverse_, *line_, *among_;
    Outline outline_;
};

}  // namespace
}  // namespace fingerflow

void fingerflow_apparent_contact(const fingerflow_apparent_contacts* given, int threads) {
    using namespace fingerflow;
    parallel_for(given->batch, threads, [&](std::int64_t frame) { Finder(*given, frame).find(); });
}
