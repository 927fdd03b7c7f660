// Positions corrected for the deformation of the skin (fingerflow/ops/tracking/deformation.py). A local linear fit to
// the displacements gives the warp F = I + grad u at each point, a second fit to these gradients gives u's second
// derivatives; correct_block subtracts their effect on a template's position.
// Layout: points are their own queries, in blocks of kFitBlock, one a lane. A record of a point and frame is 1 (usable)
// or 0 and its values less their mean; `second_` is (frames, points, 4 gradient components, 2 directions).
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "deformation_block.h"
#include "interface.h"
#include "local_fit_block.h"
#include "local_fit_cloud.h"
#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
namespace {

static_assert(kDeformedPoints == kFitBlock, "points are corrected in the blocks in which they are fitted");

// A local linear fit of `components` values at the points themselves, in all frames.
class SelfFit {
public:
    SelfFit(const fingerflow_deformation& given, std::int64_t components)
        : points_(given.points),
          components_(components),
          records_(size(given.frames * given.points * (1 + components))),
          levels_(size(given.frames * components)),
          same_usable_(size(given.frames)),
          frames_{given.frames,
                  given.points,
                  given.points,
                  components,
                  0,
                  given.minimum_points,
                  static_cast<float>(given.radius),
                  static_cast<float>(given.least_spread),
                  records_.data(),
                  levels_.data(),
                  same_usable_.data(),
                  false,
                  nullptr,
                  nullptr,
                  nullptr,
                  nullptr,
                  nullptr} {}

    // Records the values of one frame; value_of(point, component) is not finite where it is unknown.
    template <class ValueOf>
    void record(std::int64_t frame, const ValueOf& value_of) {
        std::vector<double> sums(size(components_));
        std::int64_t usable = 0;
        float* const records = records_.data() + frame * points_ * (1 + components_);
        for (std::int64_t k = 0; k < points_; ++k) {
            float* const to = records + k * (1 + components_);
            for (std::int64_t c = 0; c < components_; ++c) to[1 + c] = value_of(k, c);
            to[0] = finite(to + 1, components_) ? 1.0f : 0.0f;
            if (to[0] == 0) std::fill_n(to + 1, components_, 0.0f);
            usable += to[0] != 0;
            for (std::int64_t c = 0; c < components_; ++c) sums[size(c)] += static_cast<double>(to[1 + c]);
        }
        // Subtracting the mean does not change the slope of the plane and keeps its significant digits.
        for (std::int64_t c = 0; c < components_; ++c)
            levels_[size(frame * components_ + c)] = static_cast<float>(sums[size(c)] / static_cast<double>(std::max<std::int64_t>(usable, 1)));
        const float* const level = levels_.data() + frame * components_;
        for (float* to = records; to < records + points_ * (1 + components_); to += 1 + components_)
            for (std::int64_t c = 0; c < components_; ++c) to[1 + c] -= to[0] * level[c];
    }

    // The arguments of the fit, once all frames are recorded; `value` may be null.
    FitFrames<float> fit(float* value, float* gradient) {
        for (std::int64_t frame = 1; frame < frames_.count; ++frame) {
            const std::int64_t fields = 1 + components_;
            const float *here = records_.data() + frame * points_ * fields, *before = here - points_ * fields;
            bool same = true;
            for (std::int64_t k = 0; same && k < points_ * fields; k += fields) same = here[k] == before[k];
            same_usable_[size(frame)] = same;
        }
        FitFrames<float> frames = frames_;
        frames.value = value;
        frames.gradient = gradient;
        return frames;
    }

private:
    const std::int64_t points_, components_;
    std::vector<float> records_, levels_;
    std::vector<unsigned char> same_usable_;
    const FitFrames<float> frames_;
};

class Correction {
public:
    explicit Correction(const fingerflow_deformation& given)
        : given_(given),
          cloud_(given.start, given.points, given.start, given.points),
          displacement_(given, 2),
          gradient_(given, 4),
          second_(size(8 * given.frames * given.points)) {
        for (std::int64_t k = 0; k < given.points; ++k)
            if (!finite(given.start + 2 * k, 2)) nowhere_.push_back(k);
    }

    void run(int threads) {
        const std::int64_t frames = given_.frames, blocks = fit_blocks_of(cloud_);
        const auto rest = static_cast<std::int64_t>(nowhere_.size() + kFitBlock - 1) / kFitBlock;
        parallel_for(frames, threads, [&](std::int64_t frame) {
            const float* const found = given_.found + 2 * frame * given_.points;
            displacement_.record(frame, [&](std::int64_t k, std::int64_t c) { return found[2 * k + c] - given_.start[2 * k + c]; });
        });
        const FitFrames<float> first = displacement_.fit(given_.expected, given_.warp);
        parallel_for(blocks, threads, [&](std::int64_t block) { fit(first, block); });
        for (const std::int64_t point : nowhere_) forget(point);
        parallel_for(frames, threads, [&](std::int64_t frame) {
            const float* const gradient = given_.warp + 4 * frame * given_.points;
            gradient_.record(frame, [&](std::int64_t k, std::int64_t c) { return gradient[4 * k + c]; });
        });
        const FitFrames<float> second = gradient_.fit(nullptr, second_.data());
        const auto correct = FINGERFLOW_PICK(correct_block);
        parallel_for(blocks + rest, threads, [&](std::int64_t block) {
            if (block < blocks) {
                const FitBlock<float> of = fit(second, block);
                correct(given_, second_.data(), of.query, of.queries);
                return;
            }
            const std::int64_t from = (block - blocks) * kFitBlock, left = static_cast<std::int64_t>(nowhere_.size()) - from;
            correct(given_, second_.data(), nowhere_.data() + from, static_cast<int>(std::min<std::int64_t>(kFitBlock, left)));
        });
    }

private:
    FitBlock<float> fit(const FitFrames<float>& frames, std::int64_t number) {
        const std::int64_t points = given_.points;
        const auto memory = static_cast<unsigned char*>(workspace(size(8 * points + 4 * (2 * points + fit_memory(frames)))));
        const auto point = reinterpret_cast<std::int64_t*>(memory);
        const auto x = reinterpret_cast<float*>(point + points), y = x + points;
        const FitBlock<float> block = fit_block_of(cloud_, number, given_.radius, point, x, y);
        fit_block(frames, block, y + points);
        return block;
    }

    // A point without a position has no neighbours: its results are NaN.
    void forget(std::int64_t point) {
        constexpr float unknown = std::numeric_limits<float>::quiet_NaN();
        for (std::int64_t k = point; k < given_.frames * given_.points; k += given_.points) {
            std::fill_n(given_.expected + 2 * k, 2, unknown);
            std::fill_n(given_.warp + 4 * k, 4, unknown);
            std::fill_n(second_.data() + 8 * k, 8, unknown);
        }
    }

    const fingerflow_deformation given_;
    const Cloud<float> cloud_;
    SelfFit displacement_, gradient_;
    std::vector<float> second_;
    std::vector<std::int64_t> nowhere_;
};

}  // namespace
}  // namespace fingerflow

void fingerflow_correct_points(const fingerflow_deformation* given, int threads) {
    if (given->frames > 0 && given->points > 0) fingerflow::Correction(*given).run(threads);
}
