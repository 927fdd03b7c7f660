// Medians over an ellipse of divergence, curl, exx, eyy and exy (fingerflow/ops/fields/area_medians.py).
// At each position of a lattice in the ellipse a plane is fitted to the displacements around it, with weights
// (1 - r^2 / radius^2)^2; the fields follow from its gradient, and the median of each field is the result. Its standard
// deviation is sqrt(sum_k s_k' C_k s_k), with the sensitivity s_k of the median to point k of covariance C_k.
// Layout: coordinates are in radii from the ellipse's centre, in the current configuration. Points are sorted into
// cells, as arrays x, y, u, v; positions go in blocks of kAreaBlock, one a lane, each block with its own copy of the
// points within a radius.
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "area_medians_block.h"
#include "interface.h"
#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
namespace {

constexpr std::int64_t kNumbers = 5;  // copied for each point of a block: x, y, u, v and its index

std::size_t size(std::int64_t count) { return static_cast<std::size_t>(count); }

// max(|distance| - half, 0) without a branch.
float beyond(float distance, float half) {
    const float outside = std::fabs(distance) - half;
    return (outside + std::fabs(outside)) / 2;
}

// The median of at least one number; reorders them.
float median(std::vector<float>& numbers) {
    const auto middle = numbers.begin() + static_cast<std::ptrdiff_t>(numbers.size() / 2);
    std::nth_element(numbers.begin(), middle, numbers.end());
    return numbers.size() % 2 == 1 ? *middle : (*std::max_element(numbers.begin(), middle) + *middle) / 2;
}

class Frame {
public:
    Frame(const fingerflow_area_medians& given, std::int64_t number)
        : given_(given),
          reference_(given.reference + (given.reference_batch == 1 ? 0 : number) * 2 * given.point_count),
          displacement_(given.displacement + number * 2 * given.point_count),
          covariance_(given.covariance == nullptr ? nullptr : given.covariance + number * 4 * given.point_count),
          ellipse_(given.ellipses + 6 * number),
          apart_(given.apart == nullptr ? nullptr : given.apart + number * given.point_count),
          apart_fields_(given.apart == nullptr ? nullptr : given.apart_fields + kAreaFields * number * given.point_count),
          apart_deviations_(given.apart_deviations == nullptr
                                ? nullptr
                                : given.apart_deviations + kAreaFields * number * given.point_count),
          medians_(given.medians + kAreaFields * number),
          deviations_(given.deviations == nullptr ? nullptr : given.deviations + kAreaFields * number),
          share_(given.shares + number),
          settings_{given.measure,
                    static_cast<float>(given.minimum_points),
                    static_cast<float>(given.radius),
                    static_cast<float>(given.least_spread),
                    static_cast<float>(given.farthest),
                    static_cast<float>(given.least_ratio)} {}

    void run() {
        *share_ = std::numeric_limits<float>::quiet_NaN();
        std::fill_n(medians_, kAreaFields, std::numeric_limits<float>::quiet_NaN());
        if (deviations_ != nullptr) std::fill_n(deviations_, kAreaFields, std::numeric_limits<float>::quiet_NaN());
        const bool finite = std::all_of(ellipse_, ellipse_ + 6, [](float number) { return std::isfinite(number); });
        if (!finite || !(ellipse_[2] > 0) || !(ellipse_[3] > 0)) return;
        sort_points();
        fit();
        std::vector<float> values;
        values.reserve(size(given_.positions));
        for (int field = 0; field < kAreaFields; ++field) {
            values.clear();
            for (const Block& block : blocks_)
                for (int q = 0; q < block.positions; ++q)
                    if (block.fits.known[q] > 0) values.push_back(block.fits.fields[field][q]);
            const double share = static_cast<double>(values.size()) / static_cast<double>(given_.positions);
            *share_ = static_cast<float>(share);
            if (values.empty() || share < given_.least_share) return;
            medians_[field] = median(values);
        }
        if (covariance_ != nullptr) deviate();
    }

private:
    struct Block {
        AreaFits fits;
        int positions;
        AreaPoints points;
        std::int64_t apart[kAreaBlock];  // index of the point with fields of its own that a position takes, or -1
    };
    struct Place {
        float x, y;
        std::int64_t number;
    };

    // Sorts the usable points around the ellipse into cells of half a radius, with the mean displacement subtracted,
    // and lists the points with fields of their own that are known.
    void sort_points() {
        const std::int64_t count = given_.point_count;
        std::vector<std::int64_t> usable;
        usable.reserve(size(count));
        double mean_u = 0, mean_v = 0, xx = 0, xy = 0, yy = 0;
        for (std::int64_t k = 0; k < count; ++k) {
            const float u = displacement_[2 * k], v = displacement_[2 * k + 1];
            bool good = std::isfinite(reference_[2 * k] + u) && std::isfinite(reference_[2 * k + 1] + v);
            if (apart_ != nullptr && apart_[k]) {
                const float* const own = apart_fields_ + kAreaFields * k;
                if (good && std::all_of(own, own + kAreaFields, [](float field) { return std::isfinite(field); }))
                    places_apart_.push_back({place(k, 0), place(k, 1), k});
                continue;
            }
            if (covariance_ != nullptr) {
                const float* const own = covariance_ + 4 * k;
                good = good && std::isfinite(own[0] + own[1] + own[3]) && own[0] >= 0 && own[3] >= 0;
                xx += good ? own[0] : 0;
                xy += good ? own[1] : 0;
                yy += good ? own[3] : 0;
            }
            if (!good) continue;
            usable.push_back(k);
            mean_u += u;
            mean_v += v;
        }
        const double among = static_cast<double>(std::max<std::size_t>(usable.size(), 1));
        const auto level_u = static_cast<float>(mean_u / among), level_v = static_cast<float>(mean_v / among);
        beside_.xx = static_cast<float>(xx / among);
        beside_.xy = static_cast<float>(xy / among);
        beside_.yy = static_cast<float>(yy / among);

        const float radius = settings_.radius, cosine = ellipse_[4], sine = ellipse_[5];
        half_x_ = std::hypot(ellipse_[2] * cosine, ellipse_[3] * sine) / radius + 1.01f;
        half_y_ = std::hypot(ellipse_[2] * sine, ellipse_[3] * cosine) / radius + 1.01f;
        columns_ = cells(half_x_);
        rows_ = cells(half_y_);
        std::vector<std::int64_t> cell(usable.size());
        starts_.assign(size(rows_ * columns_ + 1), 0);
        for (std::size_t n = 0; n < usable.size(); ++n) {
            const float x = place(usable[n], 0), y = place(usable[n], 1);
            const bool near = std::fabs(x) < half_x_ && std::fabs(y) < half_y_;
            cell[n] = near ? row_of(y) * columns_ + column_of(x) : -1;
            if (near) ++starts_[size(cell[n] + 1)];
        }
        for (std::size_t k = 1; k < starts_.size(); ++k) starts_[k] += starts_[k - 1];
        const std::size_t near = size(starts_.back());
        for (std::vector<float>* one : {&x_, &y_, &u_, &v_}) one->resize(near);
        number_.resize(near);
        std::vector<std::int64_t> next(starts_.begin(), starts_.end() - 1);
        for (std::size_t n = 0; n < usable.size(); ++n) {
            if (cell[n] < 0) continue;
            const std::size_t to = size(next[size(cell[n])]++);
            const std::int64_t k = usable[n];
            x_[to] = place(k, 0);
            y_[to] = place(k, 1);
            u_[to] = displacement_[2 * k] - level_u;
            v_[to] = displacement_[2 * k + 1] - level_v;
            number_[to] = k;
        }
    }

    // Current coordinate of a point along an axis, in radii from the ellipse's centre.
    float place(std::int64_t k, int axis) const {
        return (reference_[2 * k + axis] + displacement_[2 * k + axis] - ellipse_[axis]) / settings_.radius;
    }
    static std::int64_t cells(float half) { return std::clamp<std::int64_t>(static_cast<std::int64_t>(4 * half), 1, 256); }
    std::int64_t column_of(float x) const { return of(x, half_x_, columns_); }
    std::int64_t row_of(float y) const { return of(y, half_y_, rows_); }
    static std::int64_t of(float place, float half, std::int64_t count) {
        const float cell = (place + half) / (2 * half) * static_cast<float>(count);
        return std::clamp<std::int64_t>(static_cast<std::int64_t>(cell), 0, count - 1);
    }

    void fit() {
        const float along = ellipse_[2] / settings_.radius, across = ellipse_[3] / settings_.radius;
        const float cosine = ellipse_[4], sine = ellipse_[5];
        blocks_.resize(size((given_.positions + kAreaBlock - 1) / kAreaBlock));
        // Each block reserves space for all points; pages that stay unused are never touched.
        const auto room = static_cast<std::int64_t>(number_.size());
        auto* const memory = static_cast<float*>(workspace(blocks_.size() * kNumbers * number_.size() * sizeof(float)));
        std::int64_t first = 0;
        for (Block& block : blocks_) {
            block.positions = static_cast<int>(std::min<std::int64_t>(kAreaBlock, given_.positions - first));
            float low_x = INFINITY, low_y = INFINITY, high_x = -INFINITY, high_y = -INFINITY;
            for (int q = 0; q < kAreaBlock; ++q) {
                const float* const place = given_.lattice + 2 * (first + std::min(q, block.positions - 1));
                const float a = place[0] * along, b = place[1] * across;
                const float x = block.fits.x[q] = a * cosine - b * sine, y = block.fits.y[q] = a * sine + b * cosine;
                low_x = std::min(low_x, x);
                low_y = std::min(low_y, y);
                high_x = std::max(high_x, x);
                high_y = std::max(high_y, y);
            }
            block.points = near(low_x, low_y, high_x, high_y, memory + (&block - blocks_.data()) * kNumbers * room);
            FINGERFLOW_PICK(fit_area)(settings_, block.points, block.fits);
            std::fill_n(block.apart, kAreaBlock, -1);
            if (!places_apart_.empty()) take_apart(block);
            for (int q = block.positions; q < kAreaBlock; ++q) block.fits.known[q] = 0;
            first += kAreaBlock;
        }
    }

    // Gives a position the fields of its nearest point where that point has fields of its own; unknown where it is too
    // far.
    void take_apart(Block& block) const {
        const auto far = static_cast<float>(given_.same_place * given_.same_place);
        float others[kAreaBlock], nearest[kAreaBlock];
        std::fill_n(others, kAreaBlock, 1.0f);  // points farther than a radius are not considered
        std::fill_n(nearest, kAreaBlock, 1.0f);
        for (std::int64_t k = 0; k < block.points.count; ++k)
            for (int q = 0; q < kAreaBlock; ++q) {
                const float dx = block.points.x[k] - block.fits.x[q], dy = block.points.y[k] - block.fits.y[q];
                others[q] = std::min(others[q], dx * dx + dy * dy);
            }
        for (const Place& one : places_apart_)
            for (int q = 0; q < kAreaBlock; ++q) {
                const float dx = one.x - block.fits.x[q], dy = one.y - block.fits.y[q], distance = dx * dx + dy * dy;
                const bool nearer = distance < nearest[q];
                nearest[q] = nearer ? distance : nearest[q];
                block.apart[q] = nearer ? one.number : block.apart[q];
            }
        for (int q = 0; q < kAreaBlock; ++q) {
            if (!(nearest[q] < others[q])) {
                block.apart[q] = -1;
                continue;
            }
            block.fits.known[q] = nearest[q] < far ? 1.0f : 0.0f;
            for (int field = 0; field < kAreaFields; ++field)
                block.fits.fields[field][q] = apart_fields_[kAreaFields * block.apart[q] + field];
        }
    }

    // Copies the points within a radius of a box to `memory`, which has space for all of them.
    AreaPoints near(float low_x, float low_y, float high_x, float high_y, float* memory) const {
        const auto room = static_cast<std::int64_t>(number_.size());
        float *const x = memory, *const y = x + room, *const u = y + room, *const v = u + room;
        auto* const number = reinterpret_cast<std::int32_t*>(v + room);
        const float middle_x = (low_x + high_x) / 2, half_x = (high_x - low_x) / 2;
        const float middle_y = (low_y + high_y) / 2, half_y = (high_y - low_y) / 2;
        std::int64_t count = 0;
        const std::int64_t left = column_of(low_x - 1), right = column_of(high_x + 1), bottom = row_of(high_y + 1);
        for (std::int64_t row = row_of(low_y - 1); row <= bottom; ++row) {
            const std::int64_t end = starts_[size(row * columns_ + right + 1)];
            for (std::int64_t k = starts_[size(row * columns_ + left)]; k < end; ++k) {
                // Written always, kept if near: a branch would be mispredicted half the time.
                x[count] = x_[size(k)];
                y[count] = y_[size(k)];
                u[count] = u_[size(k)];
                v[count] = v_[size(k)];
                number[count] = static_cast<std::int32_t>(k);
                const float dx = beyond(x_[size(k)] - middle_x, half_x), dy = beyond(y_[size(k)] - middle_y, half_y);
                count += dx * dx + dy * dy < 1.00001f;
            }
        }
        return {x, y, u, v, number, count};
    }

    // Standard deviations of the medians, from the points' covariances and the medians' sensitivities to them.
    void deviate() {
        std::copy(medians_, medians_ + kAreaFields, beside_.median);
        beside_.reach = static_cast<float>(given_.reach);
        beside_.even = static_cast<float>(given_.even);
        float total[kAreaFields] = {};
        double joint[kAreaFields] = {};  // of points with fields of their own, whose errors are taken as fully correlated
        for (Block& block : blocks_)
            for (int q = 0; q < block.positions; ++q)
                if (block.apart[q] >= 0 && block.fits.known[q] > 0) {
                    block.fits.known[q] = 0;  // no fit
                    for (int field = 0; field < kAreaFields; ++field) {
                        const float own = apart_deviations_[kAreaFields * block.apart[q] + field], wide = beside_.reach * own;
                        const float away = block.fits.fields[field][q] - medians_[field];
                        const float left = std::max(1 - away * away / std::max(wide * wide, 1e-30f), 0.0f);
                        total[field] += left * left;
                        joint[field] += left * left * own;
                    }
                }
        std::vector<float> all(number_.size() * kAreaShares), memory;
        for (const Block& block : blocks_) {
            memory.resize(std::max(memory.size(), 2 * kAreaBlock * size(block.points.count)));
            FINGERFLOW_PICK(add_shares)(settings_, block.points, block.fits, beside_, memory.data(), all.data(), total);
        }
        double variance[kAreaFields] = {};
        for (std::size_t k = 0; k < number_.size(); ++k) {
            const float *const shares = all.data() + k * kAreaShares, *const c = covariance_ + 4 * number_[k];
            for (int field = 0; field < kAreaFields; ++field) {
                const double x = shares[2 * field], y = shares[2 * field + 1];
                variance[field] += x * x * c[0] + 2 * x * y * c[1] + y * y * c[3];
            }
        }
        for (int field = 0; field < kAreaFields; ++field) {
            const double scale = static_cast<double>(std::max(total[field], 1.0f));
            const double by_points = std::sqrt(std::max(variance[field], 0.0)) / (settings_.radius * scale);
            deviations_[field] = static_cast<float>(joint[field] > 0 ? std::hypot(by_points, joint[field] / scale) : by_points);
        }
    }

    const fingerflow_area_medians& given_;
    const float *const reference_, *const displacement_, *const covariance_, *const ellipse_;
    const unsigned char* const apart_;
    const float *const apart_fields_, *const apart_deviations_;
    float *const medians_, *const deviations_, *const share_;
    const AreaSettings settings_;
    AreaBeside beside_{};
    float half_x_ = 0, half_y_ = 0;
    std::int64_t columns_ = 0, rows_ = 0;
    std::vector<std::int64_t> starts_, number_;
    std::vector<float> x_, y_, u_, v_;
    std::vector<Place> places_apart_;
    std::vector<Block> blocks_;
};

}  // namespace
}  // namespace fingerflow

void fingerflow_medians_over_area(const fingerflow_area_medians* given, int threads) {
    fingerflow::parallel_for(given->batch, threads, [&](std::int64_t frame) { fingerflow::Frame(*given, frame).run(); });
}
