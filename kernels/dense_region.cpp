// The region that a mask spans, as fingerflow/ops/dense_region.py has it: planes of cells of one frame stay in a cache.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <exception>
#include <limits>
#include <vector>

#include "dense_region_cells.h"
#include "interface.h"
#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
namespace {

constexpr float kLeastShare = 0.2f, kLeastLevel = 0.25f;
constexpr int kFirstRounds = 2, kRounds = 3;
constexpr std::int64_t kBlock = 8;  // cells, a side of a block in which a component is followed

float clamped(float value, float low, float high) { return std::min(std::max(value, low), high); }

class Finder {
public:
    Finder(const fingerflow_dense_regions& given, std::int64_t frame)
        : given_(given), mask_(given.masks + frame * given.height * given.width),
          excess_(given.excess + frame * cells_of(given.height, given.side) * cells_of(given.width, given.side)),
          numbers_(given.numbers + 7 * frame), width_(static_cast<float>(2 * given.radius + 1) / static_cast<float>(given.side)) {
        plane_.height = cells_of(given.height, given.side);
        plane_.width = cells_of(given.width, given.side);
        plane_.margin = static_cast<std::int64_t>(width_ / 2) + 3;
        plane_.pitch = (plane_.width + 2 * plane_.margin + 31) / 16 * 16;
    }

    void find() {
        const std::int64_t all = (plane_.height + 2 * plane_.margin) * plane_.pitch + 16, line = (given_.width + 127) / 64 * 64;
        const std::size_t bytes = static_cast<std::size_t>(8 * 4 * all + line);
        auto* const memory = static_cast<unsigned char*>(workspace(bytes));
        std::memset(memory, 0, bytes);
        const std::int64_t origin = plane_.margin * plane_.pitch + plane_.margin;
        auto* const planes = reinterpret_cast<std::int32_t*>(memory + line);
        counts_ = planes + origin;
        inside_ = planes + all + origin;
        filled_ = planes + 2 * all + origin;
        near_ = planes + 3 * all + origin;
        density_ = reinterpret_cast<float*>(planes + 4 * all) + origin;
        own_ = reinterpret_cast<float*>(planes + 5 * all) + origin;
        other_ = reinterpret_cast<float*>(planes + 6 * all) + origin;
        inverse_ = reinterpret_cast<float*>(planes + 7 * all) + origin;

        FINGERFLOW_PICK(count_cells)(mask_, given_.height, given_.width, static_cast<int>(given_.side), plane_, memory, counts_);
        const float each = 1.0f / static_cast<float>(given_.side * given_.side);
        std::int64_t covered = 0;
        for (std::int64_t y = 0; y < plane_.height; ++y)
            for (std::int64_t x = 0; x < plane_.width; ++x) covered += counts_[y * plane_.pitch + x];
        FINGERFLOW_PICK(scale_cells)(plane_, counts_, each, density_);
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
        FINGERFLOW_PICK(above_limit)(plane_, density_, limit, inside_);
        fill();
        const float* const coverage = cover(limit);
        measure(coverage, covered);
    }

    static std::int64_t cells_of(std::int64_t pixels, std::int64_t side) { return (pixels + side - 1) / side; }

private:
    float share_above(float limit) const {
        const CellShare share = FINGERFLOW_PICK(share_above)(plane_, density_, inverse_, counts_, limit);
        const double pixels = static_cast<double>(given_.side * given_.side) * std::max(share.parts, 1.0);
        return clamped(static_cast<float>(static_cast<double>(share.covered) / pixels), kLeastShare, 1.0f);
    }

    // The part around the densest place, by blocks, and what it encloses.
    void fill() {
        const std::int64_t down = cells_of(plane_.height, kBlock), across = cells_of(plane_.width, kBlock);
        std::vector<float> densest(static_cast<std::size_t>(down * across), 0.0f);
        std::vector<unsigned char> some(densest.size(), 0);
        for (std::int64_t y = 0; y < plane_.height; ++y)
            for (std::int64_t x = 0; x < plane_.width; ++x)
                if (inside_[y * plane_.pitch + x] != 0) {
                    const auto block = static_cast<std::size_t>(y / kBlock * across + x / kBlock);
                    some[block] = 1;
                    densest[block] = std::max(densest[block], density_[y * plane_.pitch + x]);
                }
        const float most = *std::max_element(densest.begin(), densest.end());
        std::vector<unsigned char> reached(some.size());
        std::vector<std::int64_t> edge, next;
        for (std::size_t k = 0; k < some.size(); ++k)
            if (some[k] != 0 && densest[k] >= most) {
                reached[k] = 1;
                edge.push_back(static_cast<std::int64_t>(k));
            }
        for (std::int64_t step = 0; step < std::max(down, across) && !edge.empty(); ++step) {
            next.clear();
            for (const std::int64_t block : edge)
                for (std::int64_t y = std::max<std::int64_t>(0, block / across - 1); y < std::min(down, block / across + 2); ++y)
                    for (std::int64_t x = std::max<std::int64_t>(0, block % across - 1); x < std::min(across, block % across + 2); ++x) {
                        const auto at = static_cast<std::size_t>(y * across + x);
                        if (some[at] == 0 || reached[at] != 0) continue;
                        reached[at] = 1;
                        next.push_back(static_cast<std::int64_t>(at));
                    }
            edge.swap(next);
        }
        std::vector<std::int64_t> top(static_cast<std::size_t>(plane_.width), plane_.height), bottom(top.size(), -1);
        std::vector<std::int64_t> left(static_cast<std::size_t>(plane_.height), plane_.width), right(left.size(), -1);
        for (std::int64_t y = 0; y < plane_.height; ++y)
            for (std::int64_t x = 0; x < plane_.width; ++x) {
                if (inside_[y * plane_.pitch + x] == 0 || reached[static_cast<std::size_t>(y / kBlock * across + x / kBlock)] == 0) continue;
                const auto row = static_cast<std::size_t>(y), column = static_cast<std::size_t>(x);
                top[column] = std::min(top[column], y);
                bottom[column] = y;
                left[row] = std::min(left[row], x);
                right[row] = x;
            }
        for (std::int64_t y = 0; y < plane_.height; ++y)
            for (std::int64_t x = left[static_cast<std::size_t>(y)]; x <= right[static_cast<std::size_t>(y)]; ++x) {
                const auto column = static_cast<std::size_t>(x);
                if (y < top[column] || y > bottom[column]) continue;
                filled_[y * plane_.pitch + x] = 1;
                for (std::int64_t row = -1; row <= 1; ++row)
                    for (std::int64_t beside = -1; beside <= 1; ++beside) near_[(y + row) * plane_.pitch + x + beside] = 1;
            }
    }

    const float* cover(float limit) {
        const auto cover = FINGERFLOW_PICK(cover_row);
        for (std::int64_t y = 0; y < plane_.height; ++y)
            cover(plane_, y, density_, inverse_, inside_, filled_, near_, limit, other_ + y * plane_.pitch, excess_ + y * plane_.width);
        return other_;
    }

    void measure(const float* coverage, std::int64_t covered) {
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

    const fingerflow_dense_regions& given_;
    const unsigned char* mask_;
    float *excess_, *numbers_;
    const float width_;
    CellPlane plane_;
    std::int32_t *counts_, *inside_, *filled_, *near_;
    float *density_, *own_, *other_, *inverse_;
};

}  // namespace
}  // namespace fingerflow

int fingerflow_dense_region(const fingerflow_dense_regions* given, int threads) try {
    using namespace fingerflow;
    parallel_for(given->batch, threads, [&](std::int64_t frame) { Finder(*given, frame).find(); });
    return 0;
} catch (const std::exception&) {
    return 1;
}
