// build: each instruction set
// Contact threshold: the intensity loss half-way between ridges and valleys
// (fingerflow/ops/contact/contact_threshold.py). loss = 1 - (frame - black) / light as a level of 8 bit, level = 255 - 204
// (frame - black) / light, rounded and clamped to 0..255, then median-filtered; level 51 is a loss of 0 and stands where a
// pixel is not lit. Otsu's threshold starts two rounds of: contact region below the threshold, then the mean of the medians
// of levels above and below it.
// Layout: byte planes of one frame (levels, medians, masks) in the thread's workspace, where they stay in a cache;
// subsampled ones are (rows_, columns_). One pixel a lane. Numbers are float where the portable form has floats, so that
// both choose the same of several almost equal levels.
#include <float.h>
#include <math.h>
#include <algorithm>
#include <cmath>
#include <limits>

#include "instruction_sets.h"
#include "interface.h"
#include "lanes.h"
#include "parallel.h"
#include "pixels.h"
#include "workspace.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

constexpr float kScale = 204, kNone = 51, kAll = 255;  // levels per unit of loss, level of no loss, highest level
constexpr float kWhole = 8388608;                      // 2^23: adding and subtracting it rounds a smaller number to an integer

// The order of operations is that of the portable form: levels agree bit for bit.
template <bool finite, class Pixel>
void levels_of(const Pixel* FINGERFLOW_RESTRICT row, const float* FINGERFLOW_RESTRICT light,
               const float* FINGERFLOW_RESTRICT black, std::int64_t width, unsigned char* FINGERFLOW_RESTRICT levels,
               unsigned char* FINGERFLOW_RESTRICT lit) {
    for (std::int64_t x = 0; x < width; ++x) {
        const float lamp = light[x];
        const float lost = kAll - (static_cast<float>(row[x]) - black[x]) * (kScale * (1.0f / (lamp > 0 ? lamp : 1.0f)));
        const bool has = (lamp > 0) & (finite || fabsf(lost) <= FLT_MAX);
        const float level = has ? lost : kNone, above = level > 0 ? level : 0.0f, within = above < kAll ? above : kAll;
        levels[x] = static_cast<unsigned char>(static_cast<int>((within + kWhole) - kWhole));
        lit[x] = has;
    }
}

}  // namespace

// Writes the levels of a line and which pixels are lit; `light` and `black` are those of the line.
void levels_of_line(const Frames& frames, std::int64_t y, const float* light, const float* black, unsigned char* levels,
                    unsigned char* lit) {
    const auto find = [&](const auto* data) {
        levels_of<true>(data + y * frames.row_stride, light, black, frames.width, levels, lit);
    };
    switch (frames.kind) {
        case kUint8: return find(static_cast<const std::uint8_t*>(frames.data));
        case kUint16: return find(static_cast<const std::uint16_t*>(frames.data));
        case kInt32: return find(static_cast<const std::int32_t*>(frames.data));
        default:
            return levels_of<false>(static_cast<const float*>(frames.data) + y * frames.row_stride, light, black, frames.width,
                                    levels, lit);
    }
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow

#if FINGERFLOW_ONCE

namespace fingerflow {
FINGERFLOW_OTHER_SETS(levels_of_line)
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr float kLow = -0.25f, kScale = 204;  // loss of level 0, and levels per unit of loss
constexpr float kLeastLoss = 0.05f, kNoiseRatio = 6;
constexpr int kRounds = 2, kLevels = 256;

struct Classes {
    float threshold, lower, upper, deviation;
};

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
          height_(given.frames.height), width_(given.frames.width), rows_((height_ + stride - 1) / stride),
          columns_((width_ + stride - 1) / stride), down_((height_ + side - 1) / side), across_((width_ + side - 1) / side) {
        constexpr std::int64_t bytes[] = {1, 2, 4, 4};  // a pixel of each kind
        const std::int64_t pixels = height_ * width_, before = frame * given.frames.frame_stride;
        lit_.frames.data = static_cast<const char*>(given.frames.data) + before * bytes[given.frames.kind];
        lit_.light += given.lights == 1 ? 0 : frame * pixels;
        lit_.black += given.blacks == 1 ? 0 : frame * pixels;
        lit_.lights = lit_.blacks = lit_.frames.batch = 1;
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
        count(wanted_, counts);
        const float brightness = std::isfinite(gain) ? gain : 1.0f;
        const auto share = [&](float level) { return 1 - (1 - (level / kScale + kLow)) / brightness; };
        const Classes classes = classes_of(counts);
        const float least = std::max(kNoiseRatio * classes.deviation / kScale, kLeastLoss);
        if (!(share(classes.upper) > kLeastLoss && classes.upper - classes.lower > least * kScale)) return kNaN;
        float level = classes.threshold;
        for (int round = 0; round < kRounds; ++round) {
            if (!std::isfinite(level)) return kNaN;
            find_region(1 - ((level + 0.5f) / kScale + kLow));
            count(mask_, counts);
            level = half_way(counts, level, classes);
        }
        const float threshold = share(level);
        return threshold > kLeastLoss && threshold < 1 ? threshold : kNaN;
    }

private:
    static std::int64_t whole(std::int64_t bytes) { return (bytes + 63) / 64 * 64; }

    // Writes median-filtered levels and which of them are lit, of the subsampled pixels, (rows_, columns_).
    void smooth() {
        const std::int64_t half = size_ / 2, rows = std::max<std::int64_t>(16, (height_ + threads_ - 1) / threads_);
        for_ranges(height_, rows, threads_, [&](std::int64_t top, std::int64_t bottom) {
            for (std::int64_t y = top; y < bottom; ++y) {
                const std::int64_t beyond = y % stride_;
                if (beyond > half && beyond + half < stride_) continue;  // no window reads the line
                const std::int64_t at = y * width_;
                FINGERFLOW_PICK(levels_of_line)(lit_.frames, y, lit_.light + at, lit_.black + at, levels_ + at, wanted_ + at);
            }
        });
        const Frames levels{levels_, 1, height_, width_, height_ * width_, width_, kUint8};
        if (size_ == 1) std::swap(levels_, smooth_);
        else fingerflow_median(&levels, smooth_, size_, table_, threads_);
        if (stride_ == 1) return;
        for (unsigned char* const plane : {smooth_, wanted_})
            for (std::int64_t y = 0; y < rows_; ++y)
                for (std::int64_t x = 0; x < columns_; ++x) plane[y * columns_ + x] = plane[y * stride_ * width_ + x * stride_];
    }

    // Counts the medians of levels inside a mask.
    void count(const unsigned char* mask, std::int64_t* counts) const {
        const Frames medians{smooth_, 1, rows_, columns_, rows_ * columns_, columns_, kUint8};
        fingerflow_histogram(&medians, mask, 1, 0, columns_, nullptr, kLevels, counts, threads_);
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
    if (given->frames.batch == 1) return find(0, threads);
    parallel_for(given->frames.batch, threads, [&](std::int64_t frame) { find(frame, 1); });
}

#endif
