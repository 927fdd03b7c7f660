// Medians of displacements over an ellipse, and their deviations (fingerflow/tracker/displacement_medians.py has the
// equations). Each place of a lattice in the ellipse counts for the nearest point.
// Layout: coordinates are in semi-axes from the ellipse's centre, so that the ellipse is the unit disc. Points are sorted
// into square cells, about one a cell; rings of cells around a place are searched until none can hold a nearer point.
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "interface.h"
#include "parallel.h"

namespace fingerflow {
namespace {

struct Point {
    double x, y;
    std::int64_t number;
};

struct Part {
    double value, area;
};

class PointCells {
public:
    // Cells of at least `reach` / 64, which bounds their number, for the points in the disc and up to `reach` beside it.
    PointCells(const std::vector<Point>& points, double reach)
        : half_(1 + reach), side_(std::clamp(std::sqrt(4.0 / static_cast<double>(points.size() + 1)), half_ / 64, half_)) {
        count_ = static_cast<std::int64_t>(2 * half_ / side_) + 1;
        starts_.assign(size(count_ * count_ + 1), 0);
        for (const Point& point : points) ++starts_[cell(point) + 1];
        for (std::size_t k = 1; k < starts_.size(); ++k) starts_[k] += starts_[k - 1];
        sorted_.resize(points.size());
        std::vector<std::size_t> next(starts_.begin(), starts_.end() - 1);
        for (const Point& point : points) sorted_[next[cell(point)]++] = point;
    }

    // The point nearest to a place in the disc, nullptr if none is nearer than `reach`.
    const Point* nearest(double x, double y, double reach) const {
        const std::int64_t column = index(x), row = index(y);
        const Point* found = nullptr;
        double least = reach * reach;
        const auto search = [&](std::int64_t r, std::int64_t first, std::int64_t last) {
            if (r < 0 || r >= count_ || first >= count_ || last < 0) return;
            const std::size_t end = starts_[size(r * count_ + std::min(last, count_ - 1) + 1)];
            for (std::size_t k = starts_[size(r * count_ + std::max<std::int64_t>(first, 0))]; k < end; ++k) {
                const double dx = sorted_[k].x - x, dy = sorted_[k].y - y, distance = dx * dx + dy * dy;
                if (distance < least) least = distance, found = &sorted_[k];
            }
        };
        for (std::int64_t r = row - 1; r <= row + 1; ++r) search(r, column - 1, column + 1);
        for (std::int64_t ring = 2; ring < count_; ++ring) {
            // Points of this ring are at least this far away.
            const double away = static_cast<double>(ring - 1) * side_;
            if (away * away >= least) break;
            for (std::int64_t r = row - ring; r <= row + ring; ++r)
                if (r == row - ring || r == row + ring) {
                    search(r, column - ring, column + ring);
                } else {
                    search(r, column - ring, column - ring);
                    search(r, column + ring, column + ring);
                }
        }
        return found;
    }

private:
    std::int64_t index(double coordinate) const {
        return std::clamp<std::int64_t>(static_cast<std::int64_t>((coordinate + half_) / side_), 0, count_ - 1);
    }
    std::size_t cell(const Point& point) const { return size(index(point.y) * count_ + index(point.x)); }

    double half_, side_;
    std::int64_t count_;
    std::vector<std::size_t> starts_;
    std::vector<Point> sorted_;
};

// The value below which the share `rank` of the area lies, between parts in the order of their values.
double at_rank(const std::vector<Part>& parts, double total, double rank) {
    double below = 0, before = 0;
    for (std::size_t k = 0; k < parts.size(); ++k) {
        const double middle = (below + parts[k].area / 2) / total;
        if (middle >= rank)
            return k == 0 ? parts[0].value
                          : parts[k - 1].value + (rank - before) / (middle - before) * (parts[k].value - parts[k - 1].value);
        below += parts[k].area;
        before = middle;
    }
    return parts.back().value;
}

}  // namespace
}  // namespace fingerflow

// Medians (batch, 2) of displacements over ellipses with centre, semi axes, cosine and sine, and their deviations; NaN
// where too little is known.
void fingerflow_displacement_medians(const double* position /* (batch, count, 2) */, const double* displacement /* (batch, count, 2) */,
    const double* variance /* (batch, count) */, const double* ellipses /* (batch, 6) */, const double* lattice /* (places, 2) */,
    std::int64_t batch, std::int64_t count, std::int64_t places, double reach, double border, double least_share, double beside,
    double* medians /* (batch, 2) */, double* deviations /* (batch, 2) */, int threads) {
    using namespace fingerflow;
    parallel_for(batch, threads, [&](std::int64_t frame) {
        const double* const ellipse = ellipses + 6 * frame;
        std::fill_n(medians + 2 * frame, 2, std::numeric_limits<double>::quiet_NaN());
        std::fill_n(deviations + 2 * frame, 2, std::numeric_limits<double>::quiet_NaN());
        const double along = ellipse[2], across = ellipse[3], cosine = ellipse[4], sine = ellipse[5];
        if (!(std::isfinite(ellipse[0] + ellipse[1] + along + across + cosine + sine) && along > 0 && across > 0)) return;
        const double farthest = reach / std::sqrt(along * across);
        std::vector<Point> points;
        for (std::int64_t k = frame * count; k < (frame + 1) * count; ++k) {
            const double right = position[2 * k] - ellipse[0], down = position[2 * k + 1] - ellipse[1];
            const Point point{(right * cosine + down * sine) / along, (down * cosine - right * sine) / across, k};
            if (std::isfinite(point.x + point.y + displacement[2 * k] + displacement[2 * k + 1] + variance[k]) &&
                std::fabs(point.x) < 1 + farthest && std::fabs(point.y) < 1 + farthest)
                points.push_back(point);
        }
        const PointCells cells(points, farthest);
        std::vector<double> area(size(count));
        double total = 0;
        for (std::int64_t place = 0; place < places; ++place)
            if (const Point* const point = cells.nearest(lattice[2 * place], lattice[2 * place + 1], farthest)) {
                area[size(point->number - frame * count)] += 1;
                total += 1;
            }
        const double share = total / static_cast<double>(places);
        if (!(share >= least_share)) return;
        const auto number = static_cast<double>(std::count_if(area.begin(), area.end(), [](double part) { return part > 0; }));
        const double rim = 1 - std::max(along - border, 0.0) * std::max(across - border, 0.0) / (along * across);
        const double unknown = (1 - share) / (2 * share);
        const double rank = std::sqrt(rim * rim / 4 + unknown * unknown / 3 + 1 / (6 * number * std::sqrt(number)));
        std::vector<Part> parts;
        for (std::int64_t component = 0; component < 2; ++component) {
            const auto value = [&](std::int64_t k) { return displacement[2 * (frame * count + k) + component]; };
            parts.clear();
            for (std::int64_t k = 0; k < count; ++k)
                if (area[size(k)] > 0) parts.push_back({value(k), area[size(k)]});
            std::sort(parts.begin(), parts.end(), [](const Part& one, const Part& other) { return one.value < other.value; });
            const double middle = at_rank(parts, total, 0.5);
            const double half = (at_rank(parts, total, 0.5 + rank) - at_rank(parts, total, 0.5 - rank)) / 2;
            double weights = 0, noise = 0;
            for (std::int64_t k = 0; k < count; ++k) {
                if (!(area[size(k)] > 0)) continue;
                const double away = value(k) - middle, own = variance[frame * count + k];
                const double left = std::max(1 - away * away / ((own + half * half + 1e-30) * beside * beside), 0.0);
                const double weight = area[size(k)] * left * left;
                weights += weight;
                noise += weight * weight * own;
            }
            weights = std::max(weights, 1e-30);
            medians[2 * frame + component] = middle;
            deviations[2 * frame + component] = std::sqrt(noise / (weights * weights) + half * half);
        }
    });
}
