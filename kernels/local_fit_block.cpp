// build: each instruction set, fused
// Weighted linear fits around kFitBlock queries at once (local_fit.cpp, deformation.cpp).
// Sums of w = (1 - r^2 / radius^2)^2 times 1, dx, dy, dx dx, dx dy, dy dy and times the values give mean, gradient
// (second moments inverted) and value at the query; w^2 times the noise gives the sandwich covariance M^-1 (sum w^2 s x
// x') M^-1.
// Layout: one query a lane, arrays [quantity][kFitBlock]; records of points are read by all lanes. Weights of
// candidates are (candidates, kFitWeights, kFitBlock).
#include "local_fit_block.h"

#include <math.h>

#include <cstring>

#include "floats.h"
#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

// One vector register of floats or doubles, in which sums stay.
template <class Real>
constexpr int kWide = 4 * kFloats / static_cast<int>(sizeof(Real));
template <class Real>
using Wide = Register<Real, kWide<Real>>;
template <class Real>
Wide<Real> load_wide(const Real* from) { return loaded<Wide<Real>>(from); }

float root(float value) { return sqrtf(value); }
double root(double value) { return sqrt(value); }

// Weights (candidates, kFitWeights, kFitBlock).
template <class Real>
void weigh(const FitBlock<Real>& block, Real radius, Real* FINGERFLOW_RESTRICT weights) {
    const Real squared_radius = radius * radius, scale = 1 / squared_radius;
    for (std::int64_t k = 0; k < block.candidates; ++k, weights += kFitWeights * kFitBlock) {
        const Real point_x = block.x[k], point_y = block.y[k];
        FINGERFLOW_INDEPENDENT
        for (int q = 0; q < kFitBlock; ++q) {
            const Real dx = point_x - block.query_x[q], dy = point_y - block.query_y[q];
            const Real squared = dx * dx + dy * dy;
            const Real inside = squared < squared_radius ? Real(1) : Real(0);
            const Real closeness = squared < squared_radius ? 1 - squared * scale : Real(0);
            const Real weight = closeness * closeness, weight_x = weight * dx, weight_y = weight * dy;
            weights[q] = inside;
            weights[kFitBlock + q] = weight;
            weights[2 * kFitBlock + q] = weight_x;
            weights[3 * kFitBlock + q] = weight_y;
            weights[4 * kFitBlock + q] = weight_x * dx;
            weights[5 * kFitBlock + q] = weight_x * dy;
            weights[6 * kFitBlock + q] = weight_y * dy;
        }
    }
}

// The candidate points of a block with their records of one frame.
template <class Real>
struct Candidates {
    const std::int64_t* point;
    std::int64_t count, fields;
    const Real *weights, *records;
};

template <class Real, int kSums>
void write_sums(const Wide<Real> (&sums)[kSums], int first, Real* to) {
    for (int s = 0; s < kSums; ++s) std::memcpy(to + s * kFitBlock + first, &sums[s], sizeof sums[s]);
}

// Sums of all weights over the usable points, (kFitWeights, kFitBlock).
template <class Real>
void sum_usable(const Candidates<Real>& candidates, Real* to) {
    for (int first = 0; first < kFitBlock; first += kWide<Real>) {
        Wide<Real> sums[kFitWeights] = {};
        const Real* weights = candidates.weights + first;
        for (std::int64_t k = 0; k < candidates.count; ++k, weights += kFitWeights * kFitBlock) {
            const Real usable = candidates.records[candidates.point[k] * candidates.fields];
            FINGERFLOW_UNROLL
            for (int s = 0; s < kFitWeights; ++s) sums[s] += load_wide(weights + s * kFitBlock) * usable;
        }
        write_sums<Real>(sums, first, to);
    }
}

// Sums of w, w dx, w dy times kFields fields of the records, and of kFrames frames `frame_step` numbers apart:
// (kFrames, kFields, 3, kFitBlock). Up to four are summed at a time, so that weights are loaded once for them.
template <int kFields, int kFrames, class Real>
void sum_values(const Candidates<Real>& candidates, std::int64_t field, std::int64_t frame_step, Real* to) {
    for (int first = 0; first < kFitBlock; first += kWide<Real>) {
        Wide<Real> sums[3 * kFields * kFrames] = {};
        const Real* weights = candidates.weights + kFitBlock + first;
        for (std::int64_t k = 0; k < candidates.count; ++k, weights += kFitWeights * kFitBlock) {
            const Real* values = candidates.records + candidates.point[k] * candidates.fields + field;
            const Wide<Real> plain = load_wide(weights), x = load_wide(weights + kFitBlock);
            const Wide<Real> y = load_wide(weights + 2 * kFitBlock);
            FINGERFLOW_UNROLL
            for (int f = 0; f < kFields * kFrames; ++f) {
                const Real value = values[f / kFields * frame_step + f % kFields];
                sums[3 * f] += plain * value;
                sums[3 * f + 1] += x * value;
                sums[3 * f + 2] += y * value;
            }
        }
        write_sums<Real>(sums, first, to);
    }
}

// Sums of w^2 times 1, dx, dy, dx dx, dx dy, dy dy times a field of the records, (6, kFitBlock).
template <class Real>
void sum_noise(const Candidates<Real>& candidates, std::int64_t field, Real* to) {
    for (int first = 0; first < kFitBlock; first += kWide<Real>) {
        Wide<Real> sums[6] = {};
        const Real* weights = candidates.weights + kFitBlock + first;
        for (std::int64_t k = 0; k < candidates.count; ++k, weights += kFitWeights * kFitBlock) {
            const Real noise = candidates.records[candidates.point[k] * candidates.fields + field];
            const Wide<Real> plain = load_wide(weights), x = load_wide(weights + kFitBlock);
            const Wide<Real> y = load_wide(weights + 2 * kFitBlock);
            const Wide<Real> noisy = plain * noise, noisy_x = x * noise, noisy_y = y * noise;
            sums[0] += plain * noisy;
            sums[1] += x * noisy;
            sums[2] += y * noisy;
            sums[3] += x * noisy_x;
            sums[4] += x * noisy_y;
            sums[5] += y * noisy_y;
        }
        write_sums<Real>(sums, first, to);
    }
}

#if defined(FINGERFLOW_VECTORS)
// The sums of `sum_usable` and `sum_values` for a single frame, without weights in memory: a third of the time.
template <int kValues, class Real>
void weigh_and_sum(const FitBlock<Real>& block, const FitFrames<Real>& frames, Real* usable_to, Real* values_to) {
    using Many = Wide<Real>;
    constexpr Many kNone = {};
    const Real squared_radius = frames.radius * frames.radius, scale = 1 / squared_radius;
    for (int first = 0; first < kFitBlock; first += kWide<Real>) {
        const Many query_x = load_wide(block.query_x + first), query_y = load_wide(block.query_y + first);
        Many usable[kFitWeights] = {}, sums[3 * kValues] = {};
        for (std::int64_t k = 0; k < block.candidates; ++k) {
            const Real* const record = frames.records + block.point[k] * (1 + kValues);
            const Many dx = block.x[k] - query_x, dy = block.y[k] - query_y, squared = dx * dx + dy * dy;
            const auto within = squared < kNone + squared_radius;
            const Many closeness = within ? 1 - squared * scale : kNone, weight = closeness * closeness;
            const Many weight_x = weight * dx, weight_y = weight * dy;
            const Real one = record[0];
            usable[0] += within ? kNone + one : kNone;
            usable[1] += weight * one;
            usable[2] += weight_x * one;
            usable[3] += weight_y * one;
            usable[4] += weight_x * dx * one;
            usable[5] += weight_x * dy * one;
            usable[6] += weight_y * dy * one;
            FINGERFLOW_UNROLL
            for (int f = 0; f < kValues; ++f) {
                sums[3 * f] += weight * record[1 + f];
                sums[3 * f + 1] += weight_x * record[1 + f];
                sums[3 * f + 2] += weight_y * record[1 + f];
            }
        }
        write_sums<Real>(usable, first, usable_to);
        write_sums<Real>(sums, first, values_to);
    }
}
#endif

// Geometry of the usable points around each query, independent of their values.
template <class Real>
struct Geometry {
    Real mass[kFitBlock], x[kFitBlock], y[kFitBlock];  // weighted centroid relative to the query
    Real inverse_xx[kFitBlock], inverse_xy[kFitBlock], inverse_yy[kFitBlock];  // of the second moments about the centroid
    Real nothing[kFitBlock];  // 0, or NaN where the points determine no plane
    Real offset[kFitBlock];
    std::int64_t points[kFitBlock];

    // From sums (kFitWeights, kFitBlock).
    Geometry(const Real* sums, const FitFrames<Real>& frames) {
        const Real narrow = frames.least_spread * frames.least_spread, unknown = static_cast<Real>(NAN);
        const auto enough = static_cast<Real>(frames.minimum_points);
        FINGERFLOW_INDEPENDENT
        for (int q = 0; q < kFitBlock; ++q) {
            const Real *moments = sums + q, found = moments[0];
            mass[q] = found >= enough ? moments[kFitBlock] : Real(1);
            const Real share = 1 / mass[q], cx = moments[2 * kFitBlock] * share, cy = moments[3 * kFitBlock] * share;
            const Real xx = moments[4 * kFitBlock] * share - cx * cx, xy = moments[5 * kFitBlock] * share - cx * cy;
            const Real yy = moments[6 * kFitBlock] * share - cy * cy, half = (xx - yy) / 2;
            const Real narrowest = (xx + yy) / 2 - root(half * half + xy * xy);
            const Real known = found >= enough && narrowest >= narrow ? Real(1) : Real(0);
            const Real scale = 1 / (known != 0 ? xx * yy - xy * xy : Real(1));
            x[q] = cx;
            y[q] = cy;
            inverse_xx[q] = yy * scale;
            inverse_xy[q] = -xy * scale;
            inverse_yy[q] = xx * scale;
            nothing[q] = known != 0 ? Real(0) : unknown;
            offset[q] = root(cx * cx + cy * cy) + nothing[q];
        }
        for (int q = 0; q < kFitBlock; ++q) points[q] = static_cast<std::int64_t>(sums[q]);
    }
};

// Value and gradient of a component from its sums (3, kFitBlock).
template <class Real>
void solve(const Geometry<Real>& at, const Real* sums, Real level, Real (&value)[kFitBlock],
           Real (&along_x)[kFitBlock], Real (&along_y)[kFitBlock]) {
    FINGERFLOW_INDEPENDENT
    for (int q = 0; q < kFitBlock; ++q) {
        const Real share = 1 / at.mass[q], mean = sums[q] * share;
        const Real moment_x = sums[kFitBlock + q] * share - mean * at.x[q];
        const Real moment_y = sums[2 * kFitBlock + q] * share - mean * at.y[q];
        const Real slope_x = moment_x * at.inverse_xx[q] + moment_y * at.inverse_xy[q];
        const Real slope_y = moment_x * at.inverse_xy[q] + moment_y * at.inverse_yy[q];
        along_x[q] = slope_x + at.nothing[q];
        along_y[q] = slope_y + at.nothing[q];
        value[q] = mean - (slope_x * at.x[q] + slope_y * at.y[q]) + level + at.nothing[q];
    }
}

// Sandwich covariance xx, xy, yy of the gradient from the sums of a variance (6, kFitBlock), shifted to the centroid.
template <class Real>
void sandwich(const Geometry<Real>& at, const Real* sums, Real (&result)[3][kFitBlock]) {
    FINGERFLOW_INDEPENDENT
    for (int q = 0; q < kFitBlock; ++q) {
        const Real share = 1 / (at.mass[q] * at.mass[q]), x = at.x[q], y = at.y[q];
        const Real plain = sums[q] * share;
        const Real along_x = sums[kFitBlock + q] * share, along_y = sums[2 * kFitBlock + q] * share;
        const Real xx = sums[3 * kFitBlock + q] * share - 2 * x * along_x + x * x * plain;
        const Real xy = sums[4 * kFitBlock + q] * share - x * along_y - y * along_x + x * y * plain;
        const Real yy = sums[5 * kFitBlock + q] * share - 2 * y * along_y + y * y * plain;
        const Real a = at.inverse_xx[q], b = at.inverse_xy[q], d = at.inverse_yy[q];
        const Real left_xx = a * xx + b * xy, left_xy = a * xy + b * yy, left_yx = b * xx + d * xy;
        const Real left_yy = b * xy + d * yy;
        result[0][q] = left_xx * a + left_xy * b + at.nothing[q];
        result[1][q] = left_xx * b + left_xy * d + at.nothing[q];
        result[2][q] = left_yx * b + left_yy * d + at.nothing[q];
    }
}

template <class Real>
void write_covariance(const FitFrames<Real>& frames, const FitBlock<Real>& block, const Geometry<Real>& at,
                      const Real* sums, std::int64_t first) {
    const std::int64_t components = frames.components, size = 4 * components * components;
    Real pairs[3][kFitBlock];
    Real* const covariance = frames.covariance + first * size;
    const auto write = [&](std::int64_t i, std::int64_t j) {
        for (int q = 0; q < block.queries; ++q) {
            Real* const to = covariance + block.query[q] * size + 4 * components * i + 2 * j;
            to[0] = pairs[0][q];
            to[1] = to[2 * components] = pairs[1][q];
            to[2 * components + 1] = pairs[2][q];
        }
    };
    if (frames.noises == 1) {  // one common variance: components are independent
        for (int q = 0; q < block.queries; ++q)
            for (std::int64_t k = 0; k < size; ++k)
                covariance[block.query[q] * size + k] = at.nothing[q];
        sandwich(at, sums, pairs);
        for (std::int64_t c = 0; c < components; ++c) write(c, c);
        return;
    }
    for (std::int64_t i = 0; i < components; ++i)
        for (std::int64_t j = frames.symmetric ? i : 0; j < components; ++j) {
            sandwich(at, sums + (i * components + j) * 6 * kFitBlock, pairs);
            write(i, j);
            if (frames.symmetric && j > i) write(j, i);
        }
}

template <class Real>
void fit_block(const FitFrames<Real>& frames, const FitBlock<Real>& block, Real* memory) {
    Real* const usable = memory;
    Real* const values_of_two = usable + kFitWeights * kFitBlock;
    const std::int64_t sums_a_frame = 3 * kFitBlock * frames.components;
    Real* const noise = values_of_two + 2 * sums_a_frame;
    Real* const weights = noise + 6 * kFitBlock * frames.noises;
    const std::int64_t components = frames.components, fields = 1 + components + frames.noises;
    Candidates<Real> candidates{block.point, block.candidates, fields, weights, frames.records};
    bool at_once = false;
#if defined(FINGERFLOW_VECTORS)
    at_once = frames.count == 1 && frames.noises == 0 && (components == 2 || components == 4);
    if (at_once) (components == 2 ? weigh_and_sum<2, Real> : weigh_and_sum<4, Real>)(block, frames, usable, values_of_two);
#endif
    if (!at_once) {
        weigh(block, frames.radius, weights);
        sum_usable(candidates, usable);
    }
    Geometry<Real> at(usable, frames);
    const std::int64_t frame_step = frames.points * fields;
    bool known = at_once;  // whether values were already summed with those of the previous frame
    for (std::int64_t frame = 0; frame < frames.count; ++frame) {
        candidates.records = frames.records + frame * frame_step;
        if (frame > 0 && !frames.same_usable[frame]) {
            sum_usable(candidates, usable);
            at = Geometry<Real>(usable, frames);
        }
        Real* const values = values_of_two + (known && frame > 0 ? sums_a_frame : 0);
        const bool two = !known && components == 2 && frame + 1 < frames.count && frames.same_usable[frame + 1];
        std::int64_t c = 0;
        if (two) {
            sum_values<2, 2>(candidates, 1, frame_step, values);
        } else if (!known) {
            for (; c + 4 <= components; c += 4) sum_values<4, 1>(candidates, 1 + c, 0, values + 3 * kFitBlock * c);
            for (; c + 2 <= components; c += 2) sum_values<2, 1>(candidates, 1 + c, 0, values + 3 * kFitBlock * c);
            if (c < components) sum_values<1, 1>(candidates, 1 + c, 0, values + 3 * kFitBlock * c);
        }
        known = two;
        for (std::int64_t v = 0; v < frames.noises; ++v)
            if (!frames.symmetric || v % components >= v / components)
                sum_noise(candidates, 1 + components + v, noise + 6 * kFitBlock * v);

        const std::int64_t first = frame * frames.queries;
        for (c = 0; c < components; ++c) {
            Real value[kFitBlock], along_x[kFitBlock], along_y[kFitBlock];
            solve(at, values + 3 * kFitBlock * c, frames.levels[frame * components + c], value, along_x, along_y);
            Real* const values_to = frames.value + first * components + c;
            Real* const gradient_to = frames.gradient + 2 * (first * components + c);
            for (int q = 0; q < block.queries; ++q) {
                const std::int64_t place = block.query[q] * components;
                if (frames.value != nullptr) values_to[place] = value[q];
                gradient_to[2 * place] = along_x[q];
                gradient_to[2 * place + 1] = along_y[q];
            }
        }
        if (frames.covariance != nullptr) write_covariance(frames, block, at, noise, first);
        if (frames.point_count == nullptr) continue;
        std::int64_t* const counts = frames.point_count + first;
        Real* const offsets = frames.offset + first;
        for (int q = 0; q < block.queries; ++q) {
            counts[block.query[q]] = at.points[q];
            offsets[block.query[q]] = at.offset[q];
        }
    }
}

}  // namespace

void fit_floats(const FitFrames<float>& frames, const FitBlock<float>& block, float* memory) {
    fit_block(frames, block, memory);
}
void fit_doubles(const FitFrames<double>& frames, const FitBlock<double>& block, double* memory) {
    fit_block(frames, block, memory);
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
