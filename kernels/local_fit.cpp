// Weighted linear fits around queries. Queries that lie near each other go together, so that few points beyond the
// radius are looked at.
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "interface.h"
#include "local_fit_block.h"
#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
namespace {

template <class Real>
bool finite(const Real* numbers, std::int64_t count) {
    return std::all_of(numbers, numbers + count, [](Real number) { return std::isfinite(number); });
}

std::size_t size(std::int64_t count) { return static_cast<std::size_t>(count); }

template <class Real>
struct Place {
    Real x, y;
    std::int64_t number;
};

// The finite ones of places (count, 2).
template <class Real>
std::vector<Place<Real>> finite_of(const Real* places, std::int64_t count) {
    std::vector<Place<Real>> result;
    result.reserve(size(count));
    for (std::int64_t k = 0; k < count; ++k)
        if (finite(places + 2 * k, 2)) result.push_back({places[2 * k], places[2 * k + 1], k});
    return result;
}

// Which of `count` equal intervals between two numbers another lies in; the first or the last one beyond them.
class Intervals {
public:
    Intervals(double low, double high, std::int64_t count)
        : low_(low), scale_(high > low ? static_cast<double>(count) / (high - low) : 0), last_(count - 1) {}
    std::int64_t of(double number) const {
        const double place = (number - low_) * scale_;
        return place < 1 ? 0 : place < static_cast<double>(last_) ? static_cast<std::int64_t>(place) : last_;
    }

private:
    double low_, scale_;
    std::int64_t last_;
};

// Orders what lies between two pointers by a number 0 ... bins - 1 of each; returns where each bin begins, and the end.
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

// Of one coordinate of places, from where all but a hundredth at either end lie: one that is far away must not leave the
// others in one bin.
template <class Real>
Intervals intervals(const std::vector<Place<Real>>& places, Real Place<Real>::*coordinate, std::int64_t count) {
    if (places.empty()) return {0, 0, count};
    std::vector<Real> numbers;
    numbers.reserve(places.size());
    for (const Place<Real>& place : places) numbers.push_back(place.*coordinate);
    const auto few = static_cast<std::ptrdiff_t>(numbers.size() / 100);
    std::nth_element(numbers.begin(), numbers.begin() + few, numbers.end());
    const double low = numbers[size(few)];
    std::nth_element(numbers.begin() + few, numbers.end() - 1 - few, numbers.end());
    return {low, static_cast<double>(*(numbers.end() - 1 - few)), count};
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

// Points of one geometry, in square cells; queries in bands by y, in a band by x.
template <class Real>
class Cloud {
public:
    Cloud(const Real* points_at, std::int64_t point_count, const Real* queries_at, std::int64_t query_count)
        : points_(finite_of(points_at, point_count)),
          side_(side(points_.size())),
          columns_(intervals(points_, &Place<Real>::x, side_)),
          rows_(intervals(points_, &Place<Real>::y, side_)),
          starts_(order_by_bin(points_.data(), points_.data() + points_.size(), side_ * side_,
                               [this](const Place<Real>& place) { return rows_.of(place.y) * side_ + columns_.of(place.x); })),
          queries_(finite_of(queries_at, query_count)) {
        Place<Real>* const queries = queries_.data();
        const auto end = static_cast<std::int64_t>(queries_.size());
        const Intervals by_x = intervals(queries_, &Place<Real>::x, kFine), by_y = intervals(queries_, &Place<Real>::y, kFine);
        order_by_bin(queries, queries + end, kFine, [&](const Place<Real>& place) { return by_y.of(place.y); });
        // So many queries that a block of neighbours by x is about as wide as the band is high.
        const auto band = kFitBlock * static_cast<std::int64_t>(std::ceil(std::sqrt(static_cast<double>(end) / kFitBlock)));
        for (std::int64_t first = 0; first < end; first += band)
            order_by_bin(queries + first, queries + std::min(end, first + band), kFine,
                         [&](const Place<Real>& place) { return by_x.of(place.x); });
    }

    const std::vector<Place<Real>>& queries() const { return queries_; }

    // Calls act(place) for every point that may lie within `radius` of a box, and some more.
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
    // A cell holds a few points, so that rows of cells are not too many.
    static std::int64_t side(std::size_t points) {
        return std::max<std::int64_t>(1, static_cast<std::int64_t>(std::sqrt(static_cast<double>(points) / 2)));
    }

    std::vector<Place<Real>> points_;
    std::int64_t side_;
    Intervals columns_, rows_;
    std::vector<std::int64_t> starts_;
    std::vector<Place<Real>> queries_;
};

void fit_block(const FitFrames<float>& frames, const FitBlock<float>& block, float* memory) {
    FINGERFLOW_PICK(fit_floats)(frames, block, memory);
}
void fit_block(const FitFrames<double>& frames, const FitBlock<double>& block, double* memory) {
    FINGERFLOW_PICK(fit_doubles)(frames, block, memory);
}

template <class Real>
class Fits {
public:
    Fits(const fingerflow_local_fit& given, double radius, double least_spread)
        : given_(given),
          radius_(radius),
          shared_(given.points_batch == 1 && given.queries_batch == 1),
          fields_(1 + given.components + given.noises),
          records_(size(given.batch * given.point_count * fields_)),
          levels_(size(given.batch * given.components)),
          same_usable_(size(given.batch)),
          frames_{shared_ ? given.batch : 1,
                  given.point_count,
                  given.query_count,
                  given.components,
                  given.noises,
                  given.minimum_points,
                  static_cast<Real>(radius),
                  static_cast<Real>(least_spread),
                  nullptr,
                  nullptr,
                  same_usable_.data(),
                  symmetric(given),
                  nullptr,
                  nullptr,
                  nullptr,
                  nullptr,
                  nullptr} {}

    void run(int threads) {
        if (given_.batch == 0) return;
        parallel_for(given_.batch, threads, [&](std::int64_t frame) { record(frame); });
        for (std::int64_t frame = 1; frame < given_.batch; ++frame) same_usable_[size(frame)] = same_as_before(frame);
        if (shared_) {
            const Cloud<Real> cloud = cloud_of(0);
            parallel_for(blocks_of(cloud), threads, [&](std::int64_t block) { fit(0, cloud, block); });
            return;
        }
        parallel_for(given_.batch, threads, [&](std::int64_t geometry) {
            const Cloud<Real> cloud = cloud_of(geometry);
            for (std::int64_t block = 0; block < blocks_of(cloud); ++block) fit(geometry, cloud, block);
        });
    }

private:
    static bool symmetric(const fingerflow_local_fit& given) {
        const std::int64_t components = given.components, numbers = given.noise_batch * given.point_count * given.noises;
        if (given.noises != components * components) return false;
        const auto* const noise = static_cast<const Real*>(given.noise);
        for (const Real* own = noise; own < noise + numbers; own += given.noises)
            for (std::int64_t i = 1; i < components; ++i)
                for (std::int64_t j = 0; j < i; ++j) {
                    const Real one = own[i * components + j], other = own[j * components + i];
                    if (one != other && !(std::isnan(one) && std::isnan(other))) return false;
                }
        return true;
    }
    const Real* part(const void* all, std::int64_t batch, std::int64_t frame, std::int64_t numbers) const {
        return static_cast<const Real*>(all) + (batch == 1 ? 0 : frame) * numbers;
    }
    const Real* points(std::int64_t frame) const {
        return part(given_.points, given_.points_batch, frame, 2 * given_.point_count);
    }
    const Real* queries(std::int64_t frame) const {
        return part(given_.queries, given_.queries_batch, frame, 2 * given_.query_count);
    }

    // Writes the records and the level of a frame.
    void record(std::int64_t frame) {
        const std::int64_t count = given_.point_count, components = given_.components, noises = given_.noises;
        const Real* const place = points(frame);
        const Real* const values = part(given_.values, given_.values_batch, frame, count * components);
        const Real* const noise = part(given_.noise, given_.noise_batch, frame, count * noises);
        Real* const records = records_.data() + frame * count * fields_;
        const std::int64_t own = noises == 1 ? 1 : components + 1;  // steps from one component's variance to the next
        std::vector<double> sums(size(components));
        std::int64_t usable = 0;
        for (std::int64_t k = 0; k < count; ++k) {
            const Real *value = values + k * components, *variance = noise + k * noises;
            bool good = finite(place + 2 * k, 2) && finite(value, components) && finite(variance, noises);
            for (std::int64_t v = 0; v < noises; v += own) good = good && variance[v] >= 0;
            if (!good) continue;
            ++usable;
            Real* const to = records + k * fields_;
            to[0] = 1;
            std::copy(value, value + components, to + 1);
            std::copy(variance, variance + noises, to + 1 + components);
            for (std::int64_t c = 0; c < components; ++c) sums[size(c)] += static_cast<double>(value[c]);
        }
        for (std::int64_t c = 0; c < components; ++c) {
            // A plane fits as well from any height: taking off the mean keeps the digits that the slope needs.
            const auto level = static_cast<Real>(sums[size(c)] / static_cast<double>(std::max<std::int64_t>(usable, 1)));
            levels_[size(frame * components + c)] = level;
            for (Real* to = records; to < records + count * fields_; to += fields_)
                if (to[0] != 0) to[1 + c] -= level;
        }
    }

    unsigned char same_as_before(std::int64_t frame) const {
        const std::int64_t numbers = given_.point_count * fields_;
        const Real* const here = records_.data() + frame * numbers;
        for (std::int64_t k = 0; k < numbers; k += fields_)
            if (here[k] != here[k - numbers]) return 0;
        return 1;
    }

    // Of a geometry; writes the results of queries that are nowhere.
    Cloud<Real> cloud_of(std::int64_t geometry) {
        Cloud<Real> cloud(points(geometry), given_.point_count, queries(geometry), given_.query_count);
        if (static_cast<std::int64_t>(cloud.queries().size()) < given_.query_count) {
            const FitFrames<Real> frames = frames_of(geometry);
            const Real unknown = std::numeric_limits<Real>::quiet_NaN();
            for (std::int64_t k = 0; k < frames.count * frames.queries; ++k) {
                if (finite(queries(geometry) + 2 * (k % frames.queries), 2)) continue;
                const std::int64_t components = frames.components, squared = 4 * components * components;
                std::fill_n(frames.value + k * components, components, unknown);
                std::fill_n(frames.gradient + 2 * k * components, 2 * components, unknown);
                if (frames.covariance != nullptr) std::fill_n(frames.covariance + k * squared, squared, unknown);
                frames.point_count[k] = 0;
                frames.offset[k] = unknown;
            }
        }
        return cloud;
    }

    std::int64_t blocks_of(const Cloud<Real>& cloud) const {
        return (static_cast<std::int64_t>(cloud.queries().size()) + kFitBlock - 1) / kFitBlock;
    }

    FitFrames<Real> frames_of(std::int64_t geometry) {
        FitFrames<Real> frames = frames_;
        const std::int64_t components = given_.components, first = geometry * given_.query_count;
        frames.records = records_.data() + geometry * given_.point_count * fields_;
        frames.levels = levels_.data() + geometry * components;
        frames.value = static_cast<Real*>(given_.value) + first * components;
        frames.gradient = static_cast<Real*>(given_.gradient) + 2 * first * components;
        if (given_.covariance != nullptr)
            frames.covariance = static_cast<Real*>(given_.covariance) + 4 * first * components * components;
        frames.point_count = given_.counts + first;
        frames.offset = static_cast<Real*>(given_.offset) + first;
        return frames;
    }

    void fit(std::int64_t geometry, const Cloud<Real>& cloud, std::int64_t number) {
        const FitFrames<Real> frames = frames_of(geometry);
        const std::int64_t points = frames.points, first = number * kFitBlock;
        const std::size_t numbers = size(2 * points + fit_memory(frames));
        const auto memory = static_cast<unsigned char*>(workspace(8 * size(points) + sizeof(Real) * numbers));
        const auto point = reinterpret_cast<std::int64_t*>(memory);
        const auto x = reinterpret_cast<Real*>(point + points), y = x + points;

        FitBlock<Real> block;
        const auto left = static_cast<std::int64_t>(cloud.queries().size()) - first;
        block.queries = static_cast<int>(std::min<std::int64_t>(kFitBlock, left));
        Box box;
        for (int q = 0; q < kFitBlock; ++q) {
            const Place<Real>& query = cloud.queries()[size(first + std::min(q, block.queries - 1))];
            block.query[q] = query.number;
            block.query_x[q] = query.x;
            block.query_y[q] = query.y;
            box.add(query.x, query.y);
        }

        const double radius = radius_ * (1 + 1e-5);  // the block decides with the rounding of its number type
        std::int64_t candidates = 0;
        cloud.around(box, radius, [&](const Place<Real>& place) {
            const double dx = std::max(0.0, std::max(box.low_x - place.x, place.x - box.high_x));
            const double dy = std::max(0.0, std::max(box.low_y - place.y, place.y - box.high_y));
            x[candidates] = place.x;
            y[candidates] = place.y;
            point[candidates] = place.number;
            candidates += dx * dx + dy * dy < radius * radius;
        });
        block.x = x;
        block.y = y;
        block.point = point;
        block.candidates = candidates;
        fit_block(frames, block, y + points);
    }

    const fingerflow_local_fit given_;
    const double radius_;
    const bool shared_;
    const std::int64_t fields_;
    std::vector<Real> records_, levels_;
    std::vector<unsigned char> same_usable_;
    const FitFrames<Real> frames_;  // without what differs between the geometries
};

}  // namespace
}  // namespace fingerflow

void fingerflow_local_gradients(const fingerflow_local_fit* given, double radius, double least_spread, int wide,
                                int threads) {
    if (wide)
        fingerflow::Fits<double>(*given, radius, least_spread).run(threads);
    else
        fingerflow::Fits<float>(*given, radius, least_spread).run(threads);
}
