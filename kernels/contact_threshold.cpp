// Contact threshold: the intensity loss half-way between ridges and valleys
// (fingerflow/ops/contact/contact_threshold.py). loss = 1 - (frame - black) / light as a level of 8 bit, level = 204
// (loss + 0.25), median-filtered. Otsu's threshold starts two rounds of: contact region below the threshold, then the
// mean of the medians of levels above and below it.
// Layout: byte planes of one frame (levels, medians, masks) in the thread's workspace, where they stay in a cache;
// subsampled ones are (rows_, columns_). Numbers are float where the portable form has floats, so that both choose the
// same of several almost equal levels.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "contact_threshold_rows.h"
#include "interface.h"
#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr float kLow = -0.25f, kScale = 204;  // loss of level 0, and levels per unit of loss
constexpr float kLeastLoss = 0.05f, kNoiseRatio = 6;
constexpr int kRounds = 2, kLevels = 256;

struct Classes {
    float threshold, lower, upper, deviation;
};

// Counts the levels of the pixels inside a mask. Neighbours are often equal, and incrementing one counter twice waits
// for its store: four histograms in turns.
void count_levels(const unsigned char* levels, const unsigned char* mask, std::int64_t pixels, std::int64_t* counts) {
    constexpr int sides = 4;
    std::int64_t of_sides[sides][kLevels] = {};
    for (std::int64_t k = 0; k < pixels; ++k)
        if (mask[k] != 0) ++of_sides[k % sides][levels[k]];
    std::fill_n(counts, kLevels, 0);
    for (const auto& side : of_sides)
        for (int level = 0; level < kLevels; ++level) counts[level] += side[level];
}

// As `otsu_classes` of fingerflow/ops/contact/otsu.py.
Classes classes_of(const std::int64_t* counts) {
    constexpr float centre = (kLevels - 1) / 2.0f, least = 1e-6f, most = 1 - 1e-6f;
    std::int64_t total = 0;
    for (int level = 0; level < kLevels; ++level) total += counts[level];
    const float all = static_cast<float>(std::max<std::int64_t>(1, total));
    float below[kLevels], moment[kLevels], square[kLevels];
    double shares = 0, moments = 0, squares = 0;
    for (int level = 0; level < kLevels; ++level) {
        const float share = static_cast<float>(counts[level]) / all, place = static_cast<float>(level) - centre;
        const float first = share * place;
        below[level] = static_cast<float>(shares += share);
        moment[level] = static_cast<float>(moments += first);
        square[level] = static_cast<float>(squares += first * place);
    }
    float most_between = -1;
    int best = 0;
    bool two = false;
    for (int level = 0; level < kLevels; ++level) {
        const float product = below[level] * (1 - below[level]), offset = moment[level] - moment[kLevels - 1] * below[level];
        const bool apart = product > least;
        const float between = apart ? offset * offset / product : 0.0f;
        if (between > most_between) {
            most_between = between;
            best = level;
            two = apart;
        }
    }
    const float part = std::min(std::max(below[best], least), most);
    const float lower = moment[best] / part, upper = (moment[kLevels - 1] - moment[best]) / (1 - part);
    const float variance = square[best] / part - lower * lower;
    return {two ? static_cast<float>(best) : kNaN, lower + centre, upper + centre, std::sqrt(std::max(variance, 0.0f))};
}

// Median of the levels from `first` to before `end`, interpolated within a level; NaN without any count
// (`median_of_counts` of fingerflow/ops/filters/quantile.py).
float median_of(const std::int64_t* counts, int first, int end) {
    std::int64_t total = 0, reached = 0;
    for (int level = first; level < end; ++level) total += counts[level];
    if (total == 0) return kNaN;
    int level = first;
    while (2 * (reached + counts[level]) < total) reached += counts[level++];
    const float half = static_cast<float>(total) / 2, own = static_cast<float>(std::max<std::int64_t>(1, counts[level]));
    return static_cast<float>(level) - 0.5f + (half - static_cast<float>(reached)) / own;
}

// The mean of the medians above and below a level; NaN if none lies above.
float half_way(const std::int64_t* counts, float level, const Classes& classes) {
    const int split = std::min(std::max(static_cast<int>(std::floor(level)) + 1, 0), kLevels);
    const float ridges = median_of(counts, split, kLevels), valleys = median_of(counts, 0, split);
    // Contact without gaps has no valleys: the level of the empty glass replaces their median.
    return (ridges + (std::isfinite(valleys) ? valleys : classes.lower)) / 2;
}

class Frame {
public:
    Frame(const fingerflow_lit_frames& given, std::int64_t frame, int size, const std::uint16_t* table, std::int64_t radius,
          std::int64_t side, std::int64_t stride, int threads)
        : lit_(given), size_(size), table_(table), radius_(radius), side_(side), stride_(stride), threads_(threads),
          height_(given.height), width_(given.width), rows_((height_ + stride - 1) / stride),
          columns_((width_ + stride - 1) / stride), down_((height_ + side - 1) / side), across_((width_ + side - 1) / side) {
        constexpr std::int64_t bytes[] = {1, 2, 4, 4};  // a pixel of each kind
        const std::int64_t pixels = height_ * width_, before = frame * given.frames.image_stride;
        lit_.frames.data = static_cast<const char*>(given.frames.data) + before * bytes[given.frames.kind];
        lit_.frames.count = 1;
        lit_.light += given.lights == 1 ? 0 : frame * pixels;
        lit_.black += given.blacks == 1 ? 0 : frame * pixels;
        lit_.lights = lit_.blacks = lit_.batch = 1;
        const std::int64_t plane = whole(pixels), line = whole(columns_), cells = whole(4 * down_ * across_);
        auto* memory = static_cast<unsigned char*>(workspace<Keeper::kCaller>(static_cast<std::size_t>(4 * plane + line + cells)));
        levels_ = memory;
        smooth_ = levels_ + plane;
        wanted_ = smooth_ + plane;
        mask_ = wanted_ + plane;
        inside_ = mask_ + plane;
        margin_ = reinterpret_cast<float*>(inside_ + line);
    }

    float threshold(float gain) {
        smooth();
        std::int64_t counts[kLevels];
        count_levels(smooth_, wanted_, rows_ * columns_, counts);
        const float brightness = std::isfinite(gain) ? gain : 1.0f;
        const auto share = [&](float level) { return 1 - (1 - (level / kScale + kLow)) / brightness; };
        const Classes classes = classes_of(counts);
        const float least = std::max(kNoiseRatio * classes.deviation / kScale, kLeastLoss);
        if (!(share(classes.upper) > kLeastLoss && classes.upper - classes.lower > least * kScale)) return kNaN;
        float level = classes.threshold;
        for (int round = 0; round < kRounds; ++round) {
            if (!std::isfinite(level)) return kNaN;
            find_region(1 - ((level + 0.5f) / kScale + kLow));
            count_levels(smooth_, mask_, rows_ * columns_, counts);
            level = half_way(counts, level, classes);
        }
        const float threshold = share(level);
        return threshold > kLeastLoss && threshold < 1 ? threshold : kNaN;
    }

private:
    static std::int64_t whole(std::int64_t bytes) { return (bytes + 63) / 64 * 64; }

    // Writes median-filtered levels and which of them are lit, of the subsampled pixels, (rows_, columns_).
    void smooth() {
        const fingerflow_image& image = lit_.frames;
        const Frames frames{image.data, 1, height_, width_, image.image_stride, image.row_stride, static_cast<PixelKind>(image.kind)};
        const auto find = FINGERFLOW_PICK(levels_of_line);
        const std::int64_t half = size_ / 2, piece_rows = std::max<std::int64_t>(16, (height_ + threads_ - 1) / threads_);
        parallel_for((height_ + piece_rows - 1) / piece_rows, threads_, [&](std::int64_t piece) {
            for (std::int64_t y = piece * piece_rows; y < std::min(height_, (piece + 1) * piece_rows); ++y) {
                const std::int64_t beyond = y % stride_;
                if (beyond > half && beyond + half < stride_) continue;  // no window reads the line
                const std::int64_t at = y * width_;
                find(frames, y, lit_.light + at, lit_.black + at, levels_ + at, wanted_ + at);
            }
        });
        if (size_ == 1)
            std::swap(levels_, smooth_);
        else
            fingerflow_median(levels_, smooth_, 1, height_, width_, height_ * width_, width_, 1, size_, table_, threads_);
        if (stride_ == 1) return;
        for (unsigned char* const plane : {smooth_, wanted_})
            for (std::int64_t y = 0; y < rows_; ++y)
                for (std::int64_t x = 0; x < columns_; ++x) plane[y * columns_ + x] = plane[y * stride_ * width_ + x * stride_];
    }

    // Writes to `mask_` (rows_, columns_) the lit pixels in the contact region of the given limit.
    void find_region(float limit) {
        const float within = std::min(std::max(limit, 0.0f), 1.0f);
        float numbers[7];
        fingerflow_real_contact_mask(&lit_, &within, size_, mask_, threads_);
        const fingerflow_apparent_contacts region{mask_, margin_, numbers, 1, height_, width_, radius_, side_};
        fingerflow_apparent_contact(&region, threads_);
        std::int64_t last = -1;
        for (std::int64_t y = 0; y < rows_; ++y) {
            const std::int64_t row = y * stride_ / side_, at = y * columns_;
            if (row != last)
                for (std::int64_t x = 0; x < columns_; ++x) inside_[x] = margin_[row * across_ + x * stride_ / side_] > 0;
            last = row;
            for (std::int64_t x = 0; x < columns_; ++x) mask_[at + x] = static_cast<unsigned char>(inside_[x] & wanted_[at + x]);
        }
    }

    fingerflow_lit_frames lit_;
    const int size_;
    const std::uint16_t* const table_;
    const std::int64_t radius_, side_, stride_;
    const int threads_;
    const std::int64_t height_, width_, rows_, columns_, down_, across_;
    unsigned char *levels_, *smooth_, *wanted_, *mask_, *inside_;
    float* margin_;
};

}  // namespace
}  // namespace fingerflow

void fingerflow_contact_threshold(const fingerflow_lit_frames* given, const float* gains, int size, const std::uint16_t* table,
                                  std::int64_t radius, std::int64_t side, std::int64_t stride, float* thresholds, int threads) {
    using namespace fingerflow;
    const auto find = [&](std::int64_t frame, int own) {
        thresholds[frame] = Frame(*given, frame, size, table, radius, side, stride, own).threshold(gains[frame]);
    };
    // One thread a frame, or all threads for a single frame.
    if (given->batch == 1) return find(0, threads);
    parallel_for(given->batch, threads, [&](std::int64_t frame) { find(frame, 1); });
}
