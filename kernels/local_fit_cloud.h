// Points of local fits: records of their values, and their sorting into cells, with queries in blocks of neighbours, so
// that few points beyond the radius are visited.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

#include "local_fit_block.h"
#include "parallel.h"

namespace fingerflow {

template <class Real>
bool finite(const Real* numbers, std::int64_t count) {
    return std::all_of(numbers, numbers + count, [](Real number) { return std::isfinite(number); });
}

// Records (frames, points, 1 + components + noises) of FitFrames.
template <class Real>
class FitRecords {
public:
    FitRecords(std::int64_t frames, std::int64_t points, std::int64_t components, std::int64_t noises)
        : frames_(frames), points_(points), components_(components), fields_(1 + components + noises),
          records_(size(frames * points * fields_)), levels_(size(frames * components)), same_usable_(size(frames)) {}

    // Fills the records of a frame: write(point, to) writes the values and the noise of a point, and returns whether it
    // is usable.
    template <class Write>
    void fill(std::int64_t frame, const Write& write) {
        Real* const records = records_.data() + frame * points_ * fields_;
        std::vector<double> sums(size(components_));
        std::int64_t usable = 0;
        for (std::int64_t k = 0; k < points_; ++k) {
            Real* const to = records + k * fields_;
            if (!write(k, to + 1)) {
                std::fill_n(to, fields_, Real(0));
                continue;
            }
            ++usable;
            to[0] = 1;
            for (std::int64_t c = 0; c < components_; ++c) sums[size(c)] += static_cast<double>(to[1 + c]);
        }
        for (std::int64_t c = 0; c < components_; ++c) {
            // Subtracting the mean does not change the slope of the plane and keeps its significant digits.
            const auto level = static_cast<Real>(sums[size(c)] / static_cast<double>(std::max<std::int64_t>(usable, 1)));
            levels_[size(frame * components_ + c)] = level;
            for (Real* to = records; to < records + points_ * fields_; to += fields_)
                if (to[0] != 0) to[1 + c] -= level;
        }
    }

    // Compares the usable points of each frame with those of the previous one, once all are filled.
    void compare() {
        const std::int64_t numbers = points_ * fields_;
        for (std::int64_t frame = 1; frame < frames_; ++frame) {
            const Real* const here = of(frame);
            bool same = true;
            for (std::int64_t k = 0; same && k < numbers; k += fields_) same = here[k] == here[k - numbers];
            same_usable_[size(frame)] = same;
        }
    }

    const Real* of(std::int64_t frame) const { return records_.data() + frame * points_ * fields_; }
    const Real* levels_of(std::int64_t frame) const { return levels_.data() + frame * components_; }
    const unsigned char* same_usable() const { return same_usable_.data(); }

private:
    const std::int64_t frames_, points_, components_, fields_;
    std::vector<Real> records_, levels_;
    std::vector<unsigned char> same_usable_;
};

template <class Real>
struct Place {
    Real x, y;
    std::int64_t number;
};

// The finite positions of (count, 2), with their indices.
template <class Real>
std::vector<Place<Real>> finite_of(const Real* places, std::int64_t count) {
    std::vector<Place<Real>> result;
    result.reserve(size(count));
    for (std::int64_t k = 0; k < count; ++k)
        if (finite(places + 2 * k, 2)) result.push_back({places[2 * k], places[2 * k + 1], k});
    return result;
}

// Division of [low, high] into `count` equal intervals; numbers beyond belong to the first or the last one.
class Intervals {
public:
    Intervals() = default;
    Intervals(double low, double high, std::int64_t count)
        : low_(low), scale_(high > low ? static_cast<double>(count) / (high - low) : 0), last_(count - 1) {}
    std::int64_t of(double number) const {
        const double place = (number - low_) * scale_;
        return place < 1 ? 0 : place < static_cast<double>(last_) ? static_cast<std::int64_t>(place) : last_;
    }

private:
    double low_ = 0, scale_ = 0;
    std::int64_t last_ = 0;
};

// Counting sort of the items by bin 0 ... bins - 1; returns where each bin begins, and the end.
template <class Item, class BinOf>
std::vector<std::int64_t> order_by_bin(Item* begin, Item* end, std::int64_t bins, const BinOf& bin_of) {
    std::vector<std::int64_t> bin(size(end - begin)), starts(size(bins + 1));
    for (Item* item = begin; item != end; ++item) ++starts[size((bin[size(item - begin)] = bin_of(*item)) + 1)];
    for (std::int64_t k = 0; k < bins; ++k) starts[size(k + 1)] += starts[size(k)];
    const std::vector<Item> items(begin, end);
    std::vector<std::int64_t> next(starts.begin(), starts.end() - 1);
    for (std::size_t k = 0; k < items.size(); ++k) begin[next[size(bin[k])]++] = items[k];
    return starts;
}

// Range of positions along an axis without the outer hundredth at either end: a single distant position must not put
// all others into one bin.
struct Extent {
    double low = 0, high = 0;
    Intervals cut(std::int64_t count) const { return {low, high, count}; }
};

template <class Real>
Extent extent_of(const std::vector<Place<Real>>& places, Real Place<Real>::*coordinate) {
    if (places.empty()) return {};
    std::vector<Real> numbers;
    numbers.reserve(places.size());
    for (const Place<Real>& place : places) numbers.push_back(place.*coordinate);
    const auto few = static_cast<std::ptrdiff_t>(numbers.size() / 100);
    std::nth_element(numbers.begin(), numbers.begin() + few, numbers.end());
    const double low = numbers[size(few)];
    std::nth_element(numbers.begin() + few, numbers.end() - 1 - few, numbers.end());
    return {low, static_cast<double>(*(numbers.end() - 1 - few))};
}

struct Box {
    double low_x = INFINITY, low_y = INFINITY, high_x = -INFINITY, high_y = -INFINITY;
    void add(double x, double y) {
        low_x = std::min(low_x, x);
        low_y = std::min(low_y, y);
        high_x = std::max(high_x, x);
        high_y = std::max(high_y, y);
    }
};

// Points of one geometry in a grid of cells; queries sorted by bands of y, within a band by x.
template <class Real>
class Cloud {
public:
    Cloud(const Real* points_at, std::int64_t point_count, const Real* queries_at, std::int64_t query_count)
        : points_(finite_of(points_at, point_count)),
          queries_(points_at == queries_at && point_count == query_count ? points_ : finite_of(queries_at, query_count)),
          side_(side(points_.size())) {
        Extent across = extent_of(points_, &Place<Real>::x), down = extent_of(points_, &Place<Real>::y);
        columns_ = across.cut(side_);
        rows_ = down.cut(side_);
        starts_ = order_by_bin(points_.data(), points_.data() + points_.size(), side_ * side_,
                               [this](const Place<Real>& place) { return rows_.of(place.y) * side_ + columns_.of(place.x); });
        if (points_at != queries_at || point_count != query_count) {
            across = extent_of(queries_, &Place<Real>::x);
            down = extent_of(queries_, &Place<Real>::y);
        }
        Place<Real>* const queries = queries_.data();
        const auto end = static_cast<std::int64_t>(queries_.size());
        const Intervals by_x = across.cut(kFine), by_y = down.cut(kFine);
        order_by_bin(queries, queries + end, kFine, [&](const Place<Real>& place) { return by_y.of(place.y); });
        // Queries a band, chosen so that a block is about as wide as the band is high.
        const auto band = kFitBlock * static_cast<std::int64_t>(std::ceil(std::sqrt(static_cast<double>(end) / kFitBlock)));
        for (std::int64_t first = 0; first < end; first += band)
            order_by_bin(queries + first, queries + std::min(end, first + band), kFine,
                         [&](const Place<Real>& place) { return by_x.of(place.x); });
    }

    const std::vector<Place<Real>>& queries() const { return queries_; }

    // Calls act(place) for every point within `radius` of a box, and for some more.
    template <class Act>
    void around(const Box& box, double radius, const Act& act) const {
        const std::int64_t left = columns_.of(box.low_x - radius), right = columns_.of(box.high_x + radius);
        const std::int64_t bottom = rows_.of(box.high_y + radius);
        for (std::int64_t row = rows_.of(box.low_y - radius); row <= bottom; ++row) {
            const std::int64_t end = starts_[size(row * side_ + right + 1)];
            for (std::int64_t k = starts_[size(row * side_ + left)]; k < end; ++k) act(points_[size(k)]);
        }
    }

private:
    static constexpr std::int64_t kFine = 256;
    // Cells a side: about two points a cell.
    static std::int64_t side(std::size_t points) {
        return std::max<std::int64_t>(1, static_cast<std::int64_t>(std::sqrt(static_cast<double>(points) / 2)));
    }

    std::vector<Place<Real>> points_, queries_;
    std::int64_t side_;
    Intervals columns_, rows_;
    std::vector<std::int64_t> starts_;
};

// Blocks of queries of one geometry, each with its candidates within a radius. Positions and radius of a thread's last
// calls come again with every frame of a recording or stream, so that their blocks are kept (`around`).
template <class Real>
class FitBlocks {
public:
    using Shared = std::shared_ptr<const FitBlocks>;

    FitBlocks(const Real* points, std::int64_t point_count, const Real* queries, std::int64_t query_count, double radius, int threads)
        : radius_(radius), points_(points, points + 2 * point_count), queries_(queries, queries + 2 * query_count) {
        const Cloud<Real> cloud(points, point_count, queries, query_count);
        finite_queries_ = static_cast<std::int64_t>(cloud.queries().size());
        blocks_.resize(size((finite_queries_ + kFitBlock - 1) / kFitBlock));
        parallel_for(count(), threads, [&](std::int64_t number) { blocks_[size(number)].gather(cloud, number, radius); });
    }

    // The blocks of these positions, kept from one of the thread's last calls or new ones.
    static Shared around(const Real* points, std::int64_t point_count, const Real* queries, std::int64_t query_count, double radius,
                         int threads) {
        constexpr std::size_t kKept = 6;
        constexpr std::int64_t kMostKept = 4096;  // positions: a share of them is near each block
        static thread_local std::vector<Shared> kept;
        const auto same = [](const std::vector<Real>& ours, const Real* theirs, std::int64_t numbers) {
            return ours.size() == size(numbers) && (numbers == 0 || std::memcmp(ours.data(), theirs, size(numbers) * sizeof(Real)) == 0);
        };
        for (const Shared& of : kept)
            if (of->radius_ == radius && same(of->points_, points, 2 * point_count) && same(of->queries_, queries, 2 * query_count)) return of;
        const auto made = std::make_shared<const FitBlocks>(points, point_count, queries, query_count, radius, threads);
        if (point_count + query_count > kMostKept) return made;
        if (kept.size() == kKept) kept.erase(kept.begin());
        kept.push_back(made);
        return made;
    }

    std::int64_t count() const { return static_cast<std::int64_t>(blocks_.size()); }
    std::int64_t finite_queries() const { return finite_queries_; }
    const FitBlock<Real>& operator[](std::int64_t number) const { return blocks_[size(number)].block; }

private:
    struct Gathered {
        FitBlock<Real> block;
        std::vector<Real> x, y;
        std::vector<std::int64_t> point;

        void gather(const Cloud<Real>& cloud, std::int64_t number, double radius) {
            const std::int64_t first = number * kFitBlock, left = static_cast<std::int64_t>(cloud.queries().size()) - first;
            block.queries = static_cast<int>(std::min<std::int64_t>(kFitBlock, left));
            Box box;
            for (int q = 0; q < kFitBlock; ++q) {
                const Place<Real>& query = cloud.queries()[size(first + std::min(q, block.queries - 1))];
                block.query[q] = query.number;
                block.query_x[q] = query.x;
                block.query_y[q] = query.y;
                box.add(query.x, query.y);
            }
            radius *= 1 + 1e-5;  // a margin for rounding: the block decides in its own number type
            cloud.around(box, radius, [&](const Place<Real>& place) {
                const double dx = std::max(0.0, std::max(box.low_x - place.x, place.x - box.high_x));
                const double dy = std::max(0.0, std::max(box.low_y - place.y, place.y - box.high_y));
                if (!(dx * dx + dy * dy < radius * radius)) return;
                x.push_back(place.x);
                y.push_back(place.y);
                point.push_back(place.number);
            });
            block.x = x.data();
            block.y = y.data();
            block.point = point.data();
            block.candidates = static_cast<std::int64_t>(point.size());
        }
    };

    const double radius_;
    const std::vector<Real> points_, queries_;
    std::int64_t finite_queries_ = 0;
    std::vector<Gathered> blocks_;
};

inline void fit_block(const FitFrames<float>& frames, const FitBlock<float>& block, float* memory) {
    FINGERFLOW_PICK(fit_floats)(frames, block, memory);
}
inline void fit_block(const FitFrames<double>& frames, const FitBlock<double>& block, double* memory) {
    FINGERFLOW_PICK(fit_doubles)(frames, block, memory);
}

}  // namespace fingerflow
