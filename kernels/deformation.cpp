// build: each instruction set, fused
// Positions corrected for the deformation of the skin (fingerflow/ops/tracking/deformation.py). Local linear fits to
// the displacements, over the gauge length and, less what its gradient makes lean, over kInnerGauge of it, give the warp F = I + grad u at each point, a fit
// to these gradients gives u's second derivatives; their effect on a template's position is subtracted.
// E = F F_0^-1 - I, with F_0 the warp of the template. Position: x - lean E - (area - 1) / 24 laplacian u. Noise of the
// fit: max(noise - e' Q e / freedom, min(noise, template noise)), which scales the covariance. With the extrapolation e
// of the gradient to a gauge of 0, the covariance grows by (lean e) (lean e)'.
// Layout: points are their own queries, in blocks of kFitBlock, one a lane; `Columns` transposes [point][component] to
// [component][point] and back. `second_` is (frames, points, 4 gradient components, 2 directions).
#include <math.h>

#include "instruction_sets.h"
#include "interface.h"
#include "lanes.h"
#include "local_fit_block.h"
#include "local_fit_cloud.h"
#include "shared_limits.h"

namespace fingerflow {

namespace FINGERFLOW_ISA {
namespace {

inline float known_or_zero(float value) { return value - value == 0.0f ? value : 0.0f; }

constexpr int kMany = kFitBlock;
constexpr float kTiny = 1e-20f;
// What a fit flattens is proportional to its gauge squared: E(0) - E(inner) = kBeyond (E(inner) - E(outer)).
constexpr float kBeyond = kInnerGauge * kInnerGauge / (1 - kInnerGauge * kInnerGauge);

// Components of all points of a block, component by component.
template <int kComponents>
struct Columns {
    float of[kComponents][kMany];

    void read(const float* from, std::int64_t stride, const std::int64_t* point, int count) {
        for (int q = 0; q < kMany; ++q) {
            const float* const numbers = from + point[q < count ? q : 0] * stride;
            for (int k = 0; k < kComponents; ++k) of[k][q] = numbers[k];
        }
    }
    void write(float* to, const std::int64_t* point, int count) const {
        for (int q = 0; q < count; ++q)
            for (int k = 0; k < kComponents; ++k) to[point[q] * kComponents + k] = of[k][q];
    }
};

// NaN where either is NaN.
inline float lesser(float a, float b) { return a < b || a != a ? a : b; }
inline float greater(float a, float b) { return a > b || a != a ? a : b; }

// Template statistics of a block's points.
struct Statistics {
    Columns<4> inverse_warp;
    Columns<8> lean;
    Columns<10> bending;
    Columns<1> unit, noise;
};

}  // namespace

// Extrapolates `count` displacement gradients (4) of the inner gauge in `inner` to a gauge of 0, where both are known;
// otherwise the outer one is taken. `outer` becomes the step of the extrapolation.
void extrapolate(float* inner, float* outer, std::int64_t count) {
    for (std::int64_t k = 0; k < 4 * count; ++k) {
        const float apart = inner[k] - outer[k];
        const bool known = apart - apart == 0.0f;
        const float step = known ? kBeyond * apart : 0.0f;
        inner[k] = (known ? inner[k] : outer[k]) + step;
        outer[k] = step;
    }
}

// Corrects `count` points, given by index, in all frames. `warp` holds the displacement gradient and becomes the
// deformation gradient; `expected` holds a displacement and becomes a position. `second` (frames, points, 4, 2) is
// the gradient of the displacement gradient, `beyond` (frames, points, 4) the step of its extrapolation.
void correct_block(const fingerflow_deformation& given, const float* second, const float* beyond, const std::int64_t* point, int count) {
    Statistics of;
    of.inverse_warp.read(given.inverse_warp, 4, point, count);
    of.lean.read(given.numbers + kLean, kNumbers, point, count);
    of.bending.read(given.numbers + kBending, kNumbers, point, count);
    of.unit.read(given.numbers + kCovarianceXx, kNumbers, point, count);
    of.noise.read(given.numbers + kNoise, kNumbers, point, count);
    Columns<2> start;
    start.read(given.start, 2, point, count);
    const auto area = static_cast<float>(given.window * given.window), half = static_cast<float>(given.window / 2);
    const float bulging = (area - 1) / 24, freedom = 1 / ((area - 4) * kValueNoise);
    for (std::int64_t frame = 0; frame < given.frames; ++frame) {
        const std::int64_t first = frame * given.points;
        Columns<2> place, expected;
        Columns<4> warp, covariance, step;
        Columns<8> bend;
        Columns<1> shift;
        place.read(given.found + 2 * first, 2, point, count);
        expected.read(given.expected + 2 * first, 2, point, count);
        warp.read(given.warp + 4 * first, 4, point, count);
        covariance.read(given.covariance + 4 * first, 4, point, count);
        bend.read(second + 8 * first, 8, point, count);
        step.read(beyond + 4 * first, 4, point, count);
        FINGERFLOW_INDEPENDENT
        for (int q = 0; q < kMany; ++q) {
            const float xx = 1 + known_or_zero(warp.of[0][q]), xy = known_or_zero(warp.of[1][q]);
            const float yx = known_or_zero(warp.of[2][q]), yy = 1 + known_or_zero(warp.of[3][q]);
            warp.of[0][q] = xx;
            warp.of[1][q] = xy;
            warp.of[2][q] = yx;
            warp.of[3][q] = yy;
            // E = F F_0^-1 - I.
            const float(&inverse)[4][kMany] = of.inverse_warp.of;
            const float unknown[] = {xx * inverse[0][q] + xy * inverse[2][q] - 1, xx * inverse[1][q] + xy * inverse[3][q],
                                     yx * inverse[0][q] + yy * inverse[2][q], yx * inverse[1][q] + yy * inverse[3][q] - 1};
            float x = place.of[0][q] - bulging * known_or_zero(bend.of[0][q] + bend.of[3][q]);
            float y = place.of[1][q] - bulging * known_or_zero(bend.of[4][q] + bend.of[7][q]);
            float squares = 0, off_x = 0, off_y = 0;
            for (int k = 0; k < 4; ++k) {
                x -= of.lean.of[k][q] * unknown[k];
                y -= of.lean.of[4 + k][q] * unknown[k];
                off_x += of.lean.of[k][q] * step.of[k][q];
                off_y += of.lean.of[4 + k][q] * step.of[k][q];
                squares += unknown[k] * unknown[k];
            }
            place.of[0][q] = x;
            place.of[1][q] = y;
            shift.of[0][q] = half * sqrtf(squares);
            // Unmodelled deformation adds e'Qe to the residual, which would otherwise count as noise.
            float bending = 0;
            for (int i = 0, pair = 0; i < 4; ++i)
                for (int j = i; j < 4; ++j, ++pair) bending += of.bending.of[pair][q] * (unknown[i] * unknown[j]);
            const float noise = covariance.of[0][q] / of.unit.of[0][q];
            const float remaining = greater(noise - bending * freedom, lesser(noise, of.noise.of[0][q]));
            const float share = remaining / greater(noise, kTiny);
            for (int k = 0; k < 4; ++k) covariance.of[k][q] *= share;
            covariance.of[0][q] += off_x * off_x;
            covariance.of[1][q] += off_x * off_y;
            covariance.of[2][q] += off_x * off_y;
            covariance.of[3][q] += off_y * off_y;
            for (int k = 0; k < 2; ++k) expected.of[k][q] += start.of[k][q];
        }
        place.write(given.corrected + 2 * first, point, count);
        expected.write(given.expected + 2 * first, point, count);
        warp.write(given.warp + 4 * first, point, count);
        covariance.write(given.remaining + 4 * first, point, count);
        shift.write(given.shift + first, point, count);
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
FINGERFLOW_OTHER_SETS(correct_block)
FINGERFLOW_OTHER_SETS(extrapolate)
namespace {

using baseline::known_or_zero;

// A local linear fit of `components` values at the points themselves, in all frames.
class SelfFit {
public:
    SelfFit(const fingerflow_deformation& given, std::int64_t components)
        : given_(given), components_(components), records_(given.frames, given.points, components, 0) {}

    // Records the values of one frame; value_of(point, component) is not finite where it is unknown.
    template <class ValueOf>
    void record(std::int64_t frame, const ValueOf& value_of) {
        records_.fill(frame, [&](std::int64_t k, float* to) {
            for (std::int64_t c = 0; c < components_; ++c) to[c] = value_of(k, c);
            return finite(to, components_);
        });
    }

    // The arguments of a fit over `share` of the gauge length, once all frames are recorded; `value` may be null.
    FitFrames<float> fit(double share, float* value, float* gradient) {
        records_.compare();
        return {given_.frames, given_.points, given_.points, components_, 0, given_.minimum_points, static_cast<float>(share * given_.radius),
                static_cast<float>(share * given_.least_spread), records_.of(0), records_.levels_of(0), records_.same_usable(), false, value, gradient};
    }

private:
    const fingerflow_deformation& given_;
    const std::int64_t components_;
    FitRecords<float> records_;
};

class Correction {
public:
    explicit Correction(const fingerflow_deformation& given)
        : given_(given),
          displacement_(given, 2),
          unleaned_(given, 2),
          gradient_(given, 4),
          second_(size(8 * given.frames * given.points)),
          beyond_(size(4 * given.frames * given.points)) {
        for (std::int64_t k = 0; k < given.points; ++k)
            if (!finite(given.start + 2 * k, 2)) nowhere_.push_back(k);
    }

    void run(int threads) {
        const std::int64_t frames = given_.frames;
        const auto rest = static_cast<std::int64_t>(nowhere_.size() + kFitBlock - 1) / kFitBlock;
        parallel_for(frames, threads, [&](std::int64_t frame) {
            const float* const found = given_.found + 2 * frame * given_.points;
            displacement_.record(frame, [&](std::int64_t k, std::int64_t c) { return found[2 * k + c] - given_.start[2 * k + c]; });
        });
        const FitFrames<float> outer = displacement_.fit(1, given_.expected, beyond_.data());
        const Blocks wide = around(outer, threads);
        const std::int64_t blocks = wide->count();
        parallel_for(blocks, threads, [&](std::int64_t block) { fit(outer, (*wide)[block]); });
        parallel_for(frames, threads, [&](std::int64_t frame) {
            const float* const found = given_.found + 2 * frame * given_.points;
            const float* const gradient = beyond_.data() + 4 * frame * given_.points;
            unleaned_.record(frame, [&](std::int64_t k, std::int64_t c) {
                return found[2 * k + c] - given_.start[2 * k + c] - leaning(k, c, gradient + 4 * k);
            });
        });
        const FitFrames<float> inner = unleaned_.fit(kInnerGauge, nullptr, given_.warp);
        const Blocks narrow = around(inner, threads);
        parallel_for(blocks, threads, [&](std::int64_t block) { fit(inner, (*narrow)[block]); });
        for (const std::int64_t point : nowhere_) forget(point);
        const auto extrapolate = FINGERFLOW_PICK(extrapolate);
        parallel_for(frames, threads, [&](std::int64_t frame) {
            float* const gradient = given_.warp + 4 * frame * given_.points;
            extrapolate(gradient, beyond_.data() + 4 * frame * given_.points, given_.points);
            gradient_.record(frame, [&](std::int64_t k, std::int64_t c) { return gradient[4 * k + c]; });
        });
        const FitFrames<float> second = gradient_.fit(1, nullptr, second_.data());
        const auto correct = FINGERFLOW_PICK(correct_block);
        parallel_for(blocks + rest, threads, [&](std::int64_t block) {
            if (block < blocks) {
                const FitBlock<float>& of = (*wide)[block];
                fit(second, of);
                correct(given_, second_.data(), beyond_.data(), of.query, of.queries);
                return;
            }
            const std::int64_t from = (block - blocks) * kFitBlock, left = static_cast<std::int64_t>(nowhere_.size()) - from;
            correct(given_, second_.data(), beyond_.data(), nowhere_.data() + from, static_cast<int>(std::min<std::int64_t>(kFitBlock, left)));
        });
    }

private:
    // Component c of what a displacement gradient adds to the position of point k.
    float leaning(std::int64_t k, std::int64_t c, const float* gradient) const {
        const float* const inverse = given_.inverse_warp + 4 * k;
        const float* const lean = given_.numbers + k * kNumbers + kLean + 4 * c;
        const float xx = 1 + known_or_zero(gradient[0]), xy = known_or_zero(gradient[1]);
        const float yx = known_or_zero(gradient[2]), yy = 1 + known_or_zero(gradient[3]);
        return lean[0] * (xx * inverse[0] + xy * inverse[2] - 1) + lean[1] * (xx * inverse[1] + xy * inverse[3]) +
               lean[2] * (yx * inverse[0] + yy * inverse[2]) + lean[3] * (yx * inverse[1] + yy * inverse[3] - 1);
    }

    using Blocks = FitBlocks<float>::Shared;

    Blocks around(const FitFrames<float>& frames, int threads) const {
        const float* const start = given_.start;
        return FitBlocks<float>::around(start, given_.points, start, given_.points, static_cast<double>(frames.radius), threads);
    }

    static void fit(const FitFrames<float>& frames, const FitBlock<float>& block) {
        fit_block(frames, block, static_cast<float*>(workspace(sizeof(float) * size(fit_memory(frames)))));
    }

    // A point without a position has no neighbours: its results are NaN.
    void forget(std::int64_t point) {
        constexpr float unknown = std::numeric_limits<float>::quiet_NaN();
        for (std::int64_t k = point; k < given_.frames * given_.points; k += given_.points) {
            std::fill_n(given_.expected + 2 * k, 2, unknown);
            std::fill_n(given_.warp + 4 * k, 4, unknown);
            std::fill_n(beyond_.data() + 4 * k, 4, unknown);
            std::fill_n(second_.data() + 8 * k, 8, unknown);
        }
    }

    const fingerflow_deformation given_;
    SelfFit displacement_, unleaned_, gradient_;
    std::vector<float> second_, beyond_;
    std::vector<std::int64_t> nowhere_;
};

}  // namespace
}  // namespace fingerflow

void fingerflow_correct_points(const fingerflow_deformation* given, int threads) {
    if (given->frames > 0 && given->points > 0) fingerflow::Correction(*given).run(threads);
}

#endif
