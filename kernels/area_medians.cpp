// build: each instruction set, fused
// Medians over an ellipse of divergence, curl, exx, eyy and exy (fingerflow/ops/fields/area_medians.py).
// At each position of a lattice in the ellipse a plane is fitted to the displacements around it, with weights
// w = (1 - r^2 / radius^2)^2, which gives the gradient G of the displacement by current position. The displacement gradient
// is H = G (I - G)^-1; the fields are its divergence, curl and strain, and the median of each field is the result. Its
// standard deviation is sqrt(sum_k s_k' C_k s_k), with the sensitivity s_k of the median to point k of covariance C_k.
// Layout: coordinates are in radii from the ellipse's centre, in the current configuration. Points are sorted into
// cells, as arrays x, y, u, v, noise; positions go in blocks of kAreaBlock, one a lane, as arrays [quantity][kAreaBlock], each
// block with its own copy of the points within a radius. Sensitivities of a point are kAreaShares floats, two components
// a field.
#include <math.h>

#include "floats.h"
#include "instruction_sets.h"
#include "interface.h"
#include "lanes.h"
#include "strain.h"

namespace fingerflow {

constexpr int kAreaBlock = 16;   // positions
constexpr int kAreaFields = 5;   // divergence, curl, exx, eyy, exy
constexpr int kAreaShares = 16;  // floats a point: (field, component of its displacement), then zeros

// The points that may lie within a radius of a position of the block; `number` is the index in the frame's sorted
// points.
struct AreaPoints {
    const float *x, *y, *u, *v, *noise;  // noise: variance of the displacement over its mean
    const std::int32_t* number;
    std::int64_t count;
};

struct AreaFits {
    float x[kAreaBlock], y[kAreaBlock];
    float known[kAreaBlock];                              // 1 with fields, -1 with those of positions around it, else 0
    float center_x[kAreaBlock], center_y[kAreaBlock];     // weighted centroid of the points
    float inverse[3][kAreaBlock], share[kAreaBlock];      // inverse second moments xx, xy, yy; 1 / sum of weights
    float noise[kAreaBlock];                              // weighted mean of the points'
    float gradient[4][kAreaBlock];                        // displacement gradient H by reference coordinates: ux, uy, vx, vy
    float fields[kAreaFields][kAreaBlock];
};

struct AreaBlock {
    AreaFits fits;
    int positions;
    AreaPoints points;
    std::int64_t apart[kAreaBlock];  // index of the point with fields of its own that a position takes, or -1
};

namespace FINGERFLOW_ISA {
namespace {

// Count, w, w times x, y, xx, xy, yy, u, v, ux, uy, vx, vy and noise, with x and y relative to the position.
constexpr int kSums = 14;

void sum(const AreaPoints& points, const AreaFits& fits, float (&to)[kSums][kAreaBlock]) {
    for (int first = 0; first < kAreaBlock; first += kFloats) {
        const Floats place_x = load(fits.x + first), place_y = load(fits.y + first);
        Floats sums[kSums] = {};
        for (std::int64_t k = 0; k < points.count; ++k) {
            const Floats x = points.x[k] - place_x, y = points.y[k] - place_y;
            const Floats closeness = positive(1.0f - (x * x + y * y));
            const Floats w = closeness * closeness, wx = w * x, wy = w * y;
            const float u = points.u[k], v = points.v[k];
            const Floats terms[kSums] = {is_positive(closeness), w, wx, wy, wx * x, wx * y, wy * y, w * u, w * v, wx * u, wy * u, wx * v, wy * v, w * points.noise[k]};
            for (int s = 0; s < kSums; ++s) sums[s] += terms[s];
        }
        for (int s = 0; s < kSums; ++s) store(to[s] + first, sums[s]);
    }
}

// Derivatives of the fields by the gradient, [field][component][direction]; `to` is 0 before.
void sensitivity(std::int64_t measure, const float (&gradient)[4][kAreaBlock],
                 float (&to)[kAreaFields][2][2][kAreaBlock]) {
    for (int q = 0; q < kAreaBlock; ++q) {
        const float forward[2][2] = {{1 + gradient[0][q], gradient[1][q]}, {gradient[2][q], 1 + gradient[3][q]}};
        const float identity[2][2] = {{1, 0}, {0, 1}};
        to[0][0][0][q] = to[0][1][1][q] = 1;
        to[1][0][1][q] = -1;
        to[1][1][0][q] = 1;
        for (int c = 0; c < 2; ++c) {
            const float* const direct = measure == 2 ? identity[c] : forward[c];
            const float* const mixed = measure == 0 ? forward[c] : identity[c];
            to[2][c][0][q] = direct[0];
            to[3][c][1][q] = direct[1];
            to[4][c][0][q] = mixed[1] / 2;
            to[4][c][1][q] = mixed[0] / 2;
        }
    }
}

// Weight of each point at position q times its offset from the centroid, (count) each.
void moments(const AreaPoints& points, const AreaFits& fits, int q, float* FINGERFLOW_RESTRICT along_x, float* FINGERFLOW_RESTRICT along_y) {
    FINGERFLOW_INDEPENDENT
    for (std::int64_t k = 0; k < points.count; ++k) {
        const float dx = points.x[k] - fits.x[q], dy = points.y[k] - fits.y[q], left = 1 - (dx * dx + dy * dy);
        const float closeness = left > 0 ? left : 0.0f, w = closeness * closeness;
        along_x[k] = w * (points.x[k] - fits.center_x[q]);
        along_y[k] = w * (points.y[k] - fits.center_y[q]);
    }
}

}  // namespace

// Lengths are in radii from the centre of the ellipse, displacements in the unit of `given`.
void fit_area(const fingerflow_area_medians& given, const AreaPoints& points, AreaFits& fits) {
    float sums[kSums][kAreaBlock];
    sum(points, fits, sums);
    const auto per_length = static_cast<float>(1 / given.radius), fewest = static_cast<float>(given.minimum_points);
    const auto narrow = static_cast<float>(given.least_spread * given.least_spread);
    const auto farthest = static_cast<float>(given.farthest * given.farthest), folded = static_cast<float>(given.least_ratio);
    const float squared = squared_factor(given.measure), mixed = mixed_factor(given.measure);
    FINGERFLOW_INDEPENDENT
    for (int q = 0; q < kAreaBlock; ++q) {
        const bool enough = sums[0][q] >= fewest;
        const float share = 1 / (enough ? sums[1][q] : 1.0f), x = sums[2][q] * share, y = sums[3][q] * share;
        const float xx = sums[4][q] * share - x * x, xy = sums[5][q] * share - x * y, yy = sums[6][q] * share - y * y;
        const float u = sums[7][q] * share, v = sums[8][q] * share;
        const float ux = sums[9][q] * share - u * x, uy = sums[10][q] * share - u * y;
        const float vx = sums[11][q] * share - v * x, vy = sums[12][q] * share - v * y;
        const float half = (xx - yy) / 2, narrowest = (xx + yy) / 2 - sqrtf(half * half + xy * xy);
        const bool wide = enough && narrowest >= narrow && x * x + y * y < farthest;
        const float scale = 1 / (wide ? xx * yy - xy * xy : 1.0f);
        const float a = yy * scale, b = -xy * scale, d = xx * scale;
        const float gxx = (ux * a + uy * b) * per_length, gxy = (ux * b + uy * d) * per_length;
        const float gyx = (vx * a + vy * b) * per_length, gyy = (vx * b + vy * d) * per_length;
        // G (I - G)^-1 = (I - G)^-1 - I, without cancellation where G is small.
        const float ratio = (1 - gxx) * (1 - gyy) - gxy * gyx, lost = gxx * gyy - gxy * gyx;
        const bool known = wide && ratio > folded;
        const float grown = 1 / (known ? ratio : 1.0f);
        const float hxx = (gxx - lost) * grown, hxy = gxy * grown, hyx = gyx * grown, hyy = (gyy - lost) * grown;
        fits.known[q] = known ? 1.0f : 0.0f;
        fits.center_x[q] = x + fits.x[q];
        fits.center_y[q] = y + fits.y[q];
        fits.share[q] = share;
        fits.noise[q] = sums[13][q] * share;
        fits.inverse[0][q] = a, fits.inverse[1][q] = b, fits.inverse[2][q] = d;
        fits.gradient[0][q] = hxx, fits.gradient[1][q] = hxy, fits.gradient[2][q] = hyx, fits.gradient[3][q] = hyy;
        fits.fields[0][q] = hxx + hyy;
        fits.fields[1][q] = hyx - hxy;
        const Strain strain = strain_of(squared, mixed, hxx, hxy, hyx, hyy);
        fits.fields[2][q] = strain.xx, fits.fields[3][q] = strain.yy, fits.fields[4][q] = strain.xy;
    }
}

// Gives a position without a fit the fields of the nearest position with one, with the trace of the strain of a plane
// fitted to those known within a gauge length, unless the nearest has the fields of a point of its own. Points end before the
// border of the contact, and medians without its rim would be those of the inner part.
void fill_area(const fingerflow_area_medians& given, AreaBlock* blocks, std::int64_t count) {
    const auto far = static_cast<float>(given.same_place * given.same_place);
    const auto narrow = 4 * static_cast<float>(given.least_spread * given.least_spread);
    for (std::int64_t place = 0; place < count * kAreaBlock; ++place) {
        const std::int64_t q = place % kAreaBlock;
        AreaFits& to = blocks[place / kAreaBlock].fits;
        if (q >= blocks[place / kAreaBlock].positions || to.known[q] > 0) continue;
        // Weighted sums of 1, x, y, their products and those with the trace of the strain.
        Floats weighted[16] = {}, nearest = all(far), at = all(-1);  // number of the nearest position, less its lane
        for (std::int64_t number = 0; number < count * kAreaBlock; number += kFloats) {
            const AreaFits& from = blocks[number / kAreaBlock].fits;
            const std::int64_t first = number % kAreaBlock;
            const Floats x = load(from.x + first) - to.x[q], y = load(from.y + first) - to.y[q], square = x * x + y * y;
            const Floats left = 1.0f - square * 0.25f, usable = is_positive(load(from.known + first)) * is_positive(left);
            const Floats w = usable * left * left, wx = w * x, wy = w * y;
            const Floats trace = load(from.fields[2] + first) + load(from.fields[3] + first);
            const Floats terms[9] = {w, wx, wy, wx * x, wx * y, wy * y, w * trace, wx * trace, wy * trace};
            for (int s = 0; s < 9; ++s) weighted[s] += terms[s];
            const Floats away = square + (1.0f - usable) * 1e30f, closer = is_positive(nearest - away);
            nearest = lesser(nearest, away);
            at += closer * (static_cast<float>(number) - at);
        }
        int lane = 0;
        for (int k = 1; k < kFloats; ++k)
            if (nearest[k] < nearest[lane] || (nearest[k] == nearest[lane] && at[k] + k < at[lane] + lane)) lane = k;
        if (at[lane] < 0) continue;
        const std::int64_t chosen = static_cast<std::int64_t>(at[lane]) + lane;
        const AreaBlock& block = blocks[chosen / kAreaBlock];
        to.known[q] = -1;
        for (auto& field : to.fields) field[q] = block.fits.fields[&field - to.fields][chosen % kAreaBlock];
        float of[16];
        sums(weighted, of);
        const float x = of[1] / of[0], y = of[2] / of[0], xx = of[3] - x * of[1], xy = of[4] - x * of[2], yy = of[5] - y * of[2];
        const float xf = of[7] - x * of[6], yf = of[8] - y * of[6], mixed = x * (yy * xf - xy * yf) + y * (xx * yf - xy * xf);
        const float least = narrow * of[0];
        if (block.apart[chosen % kAreaBlock] >= 0 || !(xx > least && (xx - least) * (yy - least) > xy * xy)) continue;
        const float added = of[6] / of[0] - mixed / (xx * yy - xy * xy) - to.fields[2][q] - to.fields[3][q];
        to.fields[0][q] += added;
        to.fields[2][q] += added / 2;
        to.fields[3][q] += added / 2;
    }
}

// Adds to `shares` (points of the frame, kAreaShares) the sensitivity of the weighted sum of the fields near their
// `medians` to each point's displacement, and to `total` the sum of the weights. `own` (2, 2) is the mean covariance of a
// point; `memory` has space for 2 kAreaBlock count floats.
void add_shares(const fingerflow_area_medians& given, const AreaPoints& points, const AreaFits& fits, const float* medians,
                const float* own, float* memory, float* shares, float (&total)[kAreaFields]) {
    float by_gradient[kAreaFields][2][2][kAreaBlock] = {}, share[kAreaFields][kAreaBlock], any[kAreaBlock] = {};
    sensitivity(given.measure, fits.gradient, by_gradient);
    const auto even = static_cast<float>(given.even * given.reach * given.reach / (given.radius * given.radius));
    for (int field = 0; field < kAreaFields; ++field) {
        FINGERFLOW_INDEPENDENT
        for (int q = 0; q < kAreaBlock; ++q) {
            float variance = 0;
            for (int c = 0; c < 2; ++c)
                for (int e = 0; e < 2; ++e) {
                    const float cx = by_gradient[field][c][0][q], cy = by_gradient[field][c][1][q];
                    const float ex = by_gradient[field][e][0][q], ey = by_gradient[field][e][1][q];
                    variance += own[2 * c + e] * (cx * ex * fits.inverse[0][q] + (cx * ey + cy * ex) * fits.inverse[1][q] +
                                                        cy * ey * fits.inverse[2][q]);
                }
            variance *= even * fits.share[q] * fits.noise[q];
            const float away = fits.fields[field][q] - medians[field], wide = variance > 1e-30f ? variance : 1e-30f;
            const float left = 1 - away * away / wide;
            share[field][q] = left > 0 && fits.known[q] > 0 ? left * left / sqrtf(wide) : 0.0f;
        }
        for (int q = 0; q < kAreaBlock; ++q) {
            total[field] += share[field][q];
            any[q] += share[field][q];
        }
    }
    alignas(64) float along_x[kAreaBlock][kAreaShares] = {}, along_y[kAreaBlock][kAreaShares] = {};
    int positions = 0;  // with a weight above 0
    for (int q = 0; q < kAreaBlock; ++q) {
        if (!(any[q] > 0)) continue;
        // Change of a field by a displacement (1, 0) or (0, 1) of a point of weight 1 at (x, y) from the centroid.
        const float forward[2][2] = {{1 + fits.gradient[0][q], fits.gradient[1][q]},
                                     {fits.gradient[2][q], 1 + fits.gradient[3][q]}};
        const float a = fits.inverse[0][q], b = fits.inverse[1][q], d = fits.inverse[2][q];
        for (int field = 0; field < kAreaFields; ++field) {
            const float scale = share[field][q] * fits.share[q];
            for (int c = 0; c < 2; ++c) {
                const float sx = by_gradient[field][c][0][q], sy = by_gradient[field][c][1][q];
                const float x = sx * forward[0][0] + sy * forward[0][1], y = sx * forward[1][0] + sy * forward[1][1];
                along_x[positions][2 * field + c] = scale * (x * a + y * b);
                along_y[positions][2 * field + c] = scale * (x * b + y * d);
            }
        }
        float* const weighted = memory + 2 * positions++ * points.count;
        moments(points, fits, q, weighted, weighted + points.count);
    }
    // Two points at a time, so that additions of one sum do not wait for each other.
    for (std::int64_t k = 0; k < points.count; k += 2) {
        const std::int64_t next = k + 1 < points.count ? 1 : 0;
        for (int first = 0; first < kAreaShares; first += kFloats) {
            Floats sums[2][2] = {};
            const float* weighted = memory + k;
            for (int n = 0; n < positions; ++n, weighted += 2 * points.count) {
                const Floats x = load(along_x[n] + first), y = load(along_y[n] + first);
                sums[0][0] += x * weighted[0];
                sums[0][1] += y * weighted[points.count];
                sums[1][0] += x * weighted[next];
                sums[1][1] += y * weighted[points.count + next];
            }
            for (std::int64_t n = 0; n <= next; ++n) {
                float* const to = shares + points.number[k + n] * kAreaShares + first;
                store(to, load(to) + (sums[n][0] + sums[n][1]));
            }
        }
    }
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow

#if FINGERFLOW_ONCE

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
FINGERFLOW_OTHER_SETS(fit_area)
FINGERFLOW_OTHER_SETS(fill_area)
FINGERFLOW_OTHER_SETS(add_shares)
namespace {

constexpr std::int64_t kNumbers = 6;  // copied for each point of a block: x, y, u, v, noise and its index

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
          covariance_(part(given.covariance, 4 * number * given.point_count)),
          ellipse_(given.ellipses + 6 * number),
          apart_(part(given.apart, number * given.point_count)),
          apart_fields_(part(given.apart_fields, kAreaFields * number * given.point_count)),
          apart_deviations_(part(given.apart_deviations, kAreaFields * number * given.point_count)),
          medians_(given.medians + kAreaFields * number),
          deviations_(part(given.deviations, kAreaFields * number)),
          share_(given.shares + number),
          radius_(static_cast<float>(given.radius)),
          far_(static_cast<float>(given.same_place * given.same_place)) {}

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
            for (const AreaBlock& block : blocks_)
                for (int q = 0; q < block.positions; ++q)
                    if (block.fits.known[q] != 0) values.push_back(block.fits.fields[field][q]);
            const double share = static_cast<double>(values.size()) / static_cast<double>(given_.positions);
            *share_ = static_cast<float>(share);
            if (values.empty() || share < given_.least_share) return;
            medians_[field] = median(values);
        }
        if (covariance_ != nullptr) deviate();
    }

private:
    template <class Number>
    static Number* part(Number* all, std::int64_t first) { return all == nullptr ? nullptr : all + first; }

    // Sorts the usable points around the ellipse into cells of half a radius, with the mean displacement subtracted,
    // and lists the points with fields of their own that are known.
    void sort_points() {
        std::vector<std::int64_t> usable;
        double sums[6] = {};  // covariance and displacement
        for (std::int64_t k = 0; k < given_.point_count; ++k) {
            const float u = displacement_[2 * k], v = displacement_[2 * k + 1];
            bool good = std::isfinite(reference_[2 * k] + u) && std::isfinite(reference_[2 * k + 1] + v);
            if (apart_ != nullptr && apart_[k]) {
                const float* const own = apart_fields_ + kAreaFields * k;
                if (good && std::all_of(own, own + kAreaFields, [](float field) { return std::isfinite(field); }))
                    places_apart_.push_back(k);
                continue;
            }
            if (covariance_ != nullptr) {
                const float* const own = covariance_ + 4 * k;
                good = good && std::isfinite(own[0] + own[1] + own[3]) && own[0] >= 0 && own[3] >= 0;
                for (int c = 0; c < 4; ++c) sums[c] += good ? own[c] : 0;
            }
            if (!good) continue;
            usable.push_back(k);
            sums[4] += u;
            sums[5] += v;
        }
        const double among = static_cast<double>(std::max<std::size_t>(usable.size(), 1));
        const auto level_u = static_cast<float>(sums[4] / among), level_v = static_cast<float>(sums[5] / among);
        for (int c = 0; c < 4; ++c) own_[c] = static_cast<float>(sums[c] / among);
        const float mean = std::max(own_[0] + own_[3], 1e-30f);
        const float cosine = ellipse_[4], sine = ellipse_[5];
        half_[0] = std::hypot(ellipse_[2] * cosine, ellipse_[3] * sine) / radius_ + 1.01f;
        half_[1] = std::hypot(ellipse_[2] * sine, ellipse_[3] * cosine) / radius_ + 1.01f;
        for (int axis : {0, 1}) cells_[axis] = std::clamp<std::int64_t>(static_cast<std::int64_t>(4 * half_[axis]), 1, 256);
        std::vector<std::int64_t> cell(usable.size());
        starts_.assign(size(cells_[0] * cells_[1] + 1), 0);
        for (std::size_t n = 0; n < usable.size(); ++n) {
            const float x = place(usable[n], 0), y = place(usable[n], 1);
            const bool near = std::fabs(x) < half_[0] && std::fabs(y) < half_[1];
            cell[n] = near ? cell_of(y, 1) * cells_[0] + cell_of(x, 0) : -1;
            if (near) ++starts_[size(cell[n] + 1)];
        }
        for (std::size_t k = 1; k < starts_.size(); ++k) starts_[k] += starts_[k - 1];
        const std::size_t near = size(starts_.back());
        for (auto& one : of_points_) one.resize(near);
        number_.resize(near);
        std::vector<std::int64_t> next = starts_;
        for (std::size_t n = 0; n < usable.size(); ++n) {
            if (cell[n] < 0) continue;
            const std::size_t to = size(next[size(cell[n])]++);
            const std::int64_t k = usable[n];
            const float noise = covariance_ == nullptr ? 0 : (covariance_[4 * k] + covariance_[4 * k + 3]) / mean;
            const float u = displacement_[2 * k] - level_u, v = displacement_[2 * k + 1] - level_v;
            const float values[] = {place(k, 0), place(k, 1), u, v, noise};
            for (int c = 0; c < 5; ++c) of_points_[c][to] = values[c];
            number_[to] = k;
        }
    }

    // Current coordinate of a point along an axis, in radii from the ellipse's centre.
    float place(std::int64_t k, int axis) const {
        return (reference_[2 * k + axis] + displacement_[2 * k + axis] - ellipse_[axis]) / radius_;
    }
    // Index along an axis of the cell of a place.
    std::int64_t cell_of(float place, int axis) const {
        const float cell = (place + half_[axis]) / (2 * half_[axis]) * static_cast<float>(cells_[axis]);
        return std::clamp<std::int64_t>(static_cast<std::int64_t>(cell), 0, cells_[axis] - 1);
    }

    void fit() {
        const float along = ellipse_[2] / radius_, across = ellipse_[3] / radius_;
        const float cosine = ellipse_[4], sine = ellipse_[5];
        blocks_.resize(size((given_.positions + kAreaBlock - 1) / kAreaBlock));
        // Each block reserves space for all points; pages that stay unused are never touched.
        auto* memory = static_cast<float*>(workspace(blocks_.size() * kNumbers * number_.size() * sizeof(float)));
        std::int64_t first = 0;
        for (AreaBlock& block : blocks_) {
            block.positions = static_cast<int>(std::min<std::int64_t>(kAreaBlock, given_.positions - first));
            for (int q = 0; q < kAreaBlock; ++q) {
                const float* const place = given_.lattice + 2 * (first + std::min(q, block.positions - 1));
                const float a = place[0] * along, b = place[1] * across;
                block.fits.x[q] = a * cosine - b * sine;
                block.fits.y[q] = a * sine + b * cosine;
            }
            block.points = near(block.fits, memory);
            FINGERFLOW_PICK(fit_area)(given_, block.points, block.fits);
            std::fill_n(block.apart, kAreaBlock, -1);
            if (!places_apart_.empty()) take_apart(block);
            for (int q = block.positions; q < kAreaBlock; ++q) block.fits.known[q] = 0;
            first += kAreaBlock;
            memory += kNumbers * number_.size();
        }
        FINGERFLOW_PICK(fill_area)(given_, blocks_.data(), static_cast<std::int64_t>(blocks_.size()));
    }

    // Gives a position the fields of its nearest point where that point has fields of its own; unknown where it is too
    // far.
    void take_apart(AreaBlock& block) const {
        float nearest[kAreaBlock];
        std::fill_n(nearest, kAreaBlock, 1.0f);  // points farther than a radius are not considered
        for (std::int64_t k = 0; k < block.points.count; ++k)
            for (int q = 0; q < kAreaBlock; ++q) {
                const float dx = block.points.x[k] - block.fits.x[q], dy = block.points.y[k] - block.fits.y[q];
                nearest[q] = std::min(nearest[q], dx * dx + dy * dy);
            }
        for (const std::int64_t k : places_apart_) {
            const float x = place(k, 0), y = place(k, 1);
            for (int q = 0; q < kAreaBlock; ++q) {
                const float dx = x - block.fits.x[q], dy = y - block.fits.y[q], distance = dx * dx + dy * dy;
                if (!(distance < nearest[q])) continue;
                nearest[q] = distance;
                block.apart[q] = k;
            }
        }
        for (int q = 0; q < kAreaBlock; ++q) {
            if (block.apart[q] < 0) continue;
            block.fits.known[q] = nearest[q] < far_ ? 1.0f : 0.0f;
            for (int field = 0; field < kAreaFields; ++field)
                block.fits.fields[field][q] = apart_fields_[kAreaFields * block.apart[q] + field];
        }
    }

    // Copies the points within a radius of the box around the positions to `memory`, which has space for all of them.
    AreaPoints near(const AreaFits& fits, float* memory) const {
        const auto room = static_cast<std::int64_t>(number_.size());
        auto* const number = reinterpret_cast<std::int32_t*>(memory + 5 * room);
        const auto ends_x = std::minmax_element(fits.x, fits.x + kAreaBlock), ends_y = std::minmax_element(fits.y, fits.y + kAreaBlock);
        const float low_x = *ends_x.first, high_x = *ends_x.second, low_y = *ends_y.first, high_y = *ends_y.second;
        std::int64_t count = 0;
        const std::int64_t left = cell_of(low_x - 1, 0), right = cell_of(high_x + 1, 0), bottom = cell_of(high_y + 1, 1);
        for (std::int64_t row = cell_of(low_y - 1, 1); row <= bottom; ++row) {
            const std::int64_t end = starts_[size(row * cells_[0] + right + 1)];
            for (std::int64_t k = starts_[size(row * cells_[0] + left)]; k < end; ++k) {
                // Written always, kept if near: a branch would be mispredicted half the time.
                for (int c = 0; c < 5; ++c) memory[c * room + count] = of_points_[c][size(k)];
                number[count] = static_cast<std::int32_t>(k);
                const float x = of_points_[0][size(k)], y = of_points_[1][size(k)];
                const float dx = x - std::min(std::max(x, low_x), high_x), dy = y - std::min(std::max(y, low_y), high_y);
                count += dx * dx + dy * dy < 1.00001f;
            }
        }
        return {memory, memory + room, memory + 2 * room, memory + 3 * room, memory + 4 * room, number, count};
    }

    // Standard deviations of the medians, from the points' covariances and the medians' sensitivities to them.
    void deviate() {
        float total[kAreaFields] = {};
        double joint[kAreaFields] = {};  // of points with fields of their own, whose errors are taken as fully correlated
        for (AreaBlock& block : blocks_)
            for (int q = 0; q < block.positions; ++q)
                if (block.apart[q] >= 0 && block.fits.known[q] > 0) {
                    block.fits.known[q] = 0;  // no fit
                    for (int field = 0; field < kAreaFields; ++field) {
                        const float own = apart_deviations_[kAreaFields * block.apart[q] + field];
                        const float wide = std::max(static_cast<float>(given_.reach) * own, 1e-15f);
                        const float away = (block.fits.fields[field][q] - medians_[field]) / wide;
                        const float left = std::max(1 - away * away, 0.0f), weight = left * left / wide;
                        total[field] += weight;
                        joint[field] += weight * own;
                    }
                }
        std::vector<float> all(number_.size() * kAreaShares), memory;
        for (const AreaBlock& block : blocks_) {
            memory.resize(std::max(memory.size(), 2 * kAreaBlock * size(block.points.count)));
            FINGERFLOW_PICK(add_shares)(given_, block.points, block.fits, medians_, own_, memory.data(), all.data(), total);
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
            const double scale = std::max(total[field], 1e-30f);
            const double by_points = std::sqrt(std::max(variance[field], 0.0)) / (radius_ * scale);
            deviations_[field] = static_cast<float>(std::hypot(by_points, joint[field] / scale));
        }
    }

    const fingerflow_area_medians& given_;
    const float *const reference_, *const displacement_, *const covariance_, *const ellipse_;
    const unsigned char* const apart_;
    const float *const apart_fields_, *const apart_deviations_;
    float *const medians_, *const deviations_, *const share_;
    const float radius_, far_;
    float own_[4] = {}, half_[2] = {};  // mean covariance of a point; half width and height of the cells
    std::int64_t cells_[2] = {};
    std::vector<std::int64_t> starts_, number_, places_apart_;
    std::vector<float> of_points_[5];  // x, y, u, v and noise
    std::vector<AreaBlock> blocks_;
};

}  // namespace
}  // namespace fingerflow

void fingerflow_medians_over_area(const fingerflow_area_medians* given, int threads) {
    fingerflow::parallel_for(given->batch, threads, [&](std::int64_t frame) { fingerflow::Frame(*given, frame).run(); });
}

#endif
