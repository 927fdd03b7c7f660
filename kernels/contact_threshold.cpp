// build: each instruction set
// Contact threshold: the intensity loss at the edges of ridges (fingerflow/ops/contact/contact_threshold.py).
// loss = 1 - (frame - black) / light as a level of 8 bit, level = 255 - 204 (frame - black) / light, rounded and clamped to
// 0..255; level 51 is a loss of 0 and stands where a pixel is not lit. Otsu's threshold of the median-filtered levels gives
// the contact region, and the pairs of neighbouring pixels in it give the threshold.
// Layout: byte planes of one frame (levels, medians, masks) in the thread's workspace, where they stay in a cache;
// subsampled ones are (rows_, columns_). One pixel a lane. Numbers are float where the portable form has floats, so that
// both choose the same of several almost equal levels.
#include <float.h>
#include <math.h>

#include "instruction_sets.h"
#include "interface.h"
#include "lanes.h"
#include "pixels.h"

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

int median_of_three(int one, int two, int three) { return std::max(std::min(one, two), std::min(std::max(one, two), three)); }

}  // namespace

// Adds the pairs of a line with their right and lower neighbours to {sum of weighted levels, twice; weights; count}. A weight
// is the cube of the difference. `own` are the levels of the line, which has levels `above` and `below` it.
void add_pairs(const unsigned char* above, const unsigned char* own, const unsigned char* below, const unsigned char* lit_own,
               const unsigned char* lit_below, const unsigned char* inside, std::int64_t width, std::int64_t* sums) {
    std::int64_t weighted = 0, weights = 0, count = 0;
    const auto add = [&](int first, int second, int counted) {
        const int difference = first - second, size = difference < 0 ? -difference : difference;
        const int cube = size * size * size * counted;
        weighted += static_cast<std::int64_t>(cube) * (first + second);
        weights += cube;
        count += counted;
    };
    const auto add_below = [&](std::int64_t left, std::int64_t x, std::int64_t right) {
        add(median_of_three(own[left], own[x], own[right]), median_of_three(below[left], below[x], below[right]),
            inside[x] & lit_own[x] & lit_below[x]);
    };
    const auto add_right = [&](std::int64_t x) {
        add(median_of_three(above[x], own[x], below[x]), median_of_three(above[x + 1], own[x + 1], below[x + 1]),
            inside[x] & lit_own[x] & lit_own[x + 1]);
    };
    const std::int64_t last = width - 1;
    for (std::int64_t x = 0; x < last; ++x) add_right(x);
    for (std::int64_t x = 1; x < last; ++x) add_below(x - 1, x, x + 1);
    add_below(0, 0, std::min<std::int64_t>(1, last));
    if (last > 0) add_below(last - 1, last, last);
    sums[0] += weighted;
    sums[1] += weights;
    sums[2] += count;
}

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

#include <algorithm>
#include <cmath>
#include <limits>

#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
FINGERFLOW_OTHER_SETS(levels_of_line)
FINGERFLOW_OTHER_SETS(add_pairs)
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr float kLow = -0.25f, kScale = 204;  // loss of level 0, and levels per unit of loss
constexpr float kLeastLoss = 0.05f, kNoiseRatio = 6;
constexpr float kLeastSteepness = 0.08f;
constexpr int kLevels = 256;

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
        const std::int64_t plane = whole(pixels), line = whole(width_), cells = whole(4 * down_ * across_);
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
        count(counts);
        const float brightness = std::isfinite(gain) ? gain : 1.0f;
        const auto share = [&](float level) { return 1 - (1 - (level / kScale + kLow)) / brightness; };
        const Classes classes = classes_of(counts);
        const float least = std::max(kNoiseRatio * classes.deviation / kScale, kLeastLoss);
        const float contrast = classes.upper - classes.lower;
        if (!std::isfinite(classes.threshold) || !(share(classes.upper) > kLeastLoss && contrast > least * kScale)) return kNaN;
        find_region(1 - ((classes.threshold + 0.5f) / kScale + kLow));
        std::int64_t sums[3] = {0, 0, 0};  // levels of the pairs, twice and weighted; weights; number of pairs
        add_edges(sums);
        const float weighted = static_cast<float>(sums[0]) / 2, weights = static_cast<float>(sums[1]);
        const bool steep = weights > std::pow(kLeastSteepness * contrast, 3.0f) * static_cast<float>(sums[2]);
        const float level = steep ? weighted / weights : (classes.upper + classes.lower) / 2;
        const float threshold = share(level);
        return threshold > kLeastLoss && threshold < 1 ? threshold : kNaN;
    }

private:
    static std::int64_t whole(std::int64_t bytes) { return (bytes + 63) / 64 * 64; }

    // Writes the levels and which of them are lit; and the median-filtered levels of the subsampled pixels (rows_, columns_).
    void smooth() {
        const std::int64_t reach = std::max(size_ / 2, 1), rows = std::max<std::int64_t>(16, (height_ + threads_ - 1) / threads_);
        for_ranges(height_, rows, threads_, [&](std::int64_t top, std::int64_t bottom) {
            for (std::int64_t y = top; y < bottom; ++y) {
                const std::int64_t beyond = y % stride_;
                if (beyond > reach && beyond + reach < stride_) continue;  // no window or pair reads the line
                const std::int64_t at = y * width_;
                FINGERFLOW_PICK(levels_of_line)(lit_.frames, y, lit_.light + at, lit_.black + at, levels_ + at, wanted_ + at);
            }
        });
        const Frames levels{levels_, 1, height_, width_, height_ * width_, width_, kUint8};
        if (size_ == 1) std::copy(levels_, levels_ + height_ * width_, smooth_);
        else fingerflow_median(&levels, smooth_, size_, table_, threads_);
        if (stride_ > 1) subsample(smooth_, smooth_);
    }

    void subsample(const unsigned char* plane, unsigned char* result) const {
        for (std::int64_t y = 0; y < rows_; ++y)
            for (std::int64_t x = 0; x < columns_; ++x) result[y * columns_ + x] = plane[y * stride_ * width_ + x * stride_];
    }

    // Counts the lit of the median-filtered levels.
    void count(std::int64_t* counts) const {
        if (stride_ > 1) subsample(wanted_, mask_);
        const Frames medians{smooth_, 1, rows_, columns_, rows_ * columns_, columns_, kUint8};
        fingerflow_histogram(&medians, stride_ > 1 ? mask_ : wanted_, 1, 0, columns_, nullptr, kLevels, counts, threads_);
    }

    // Finds the contact region below a limit; `margin_` is positive in its cells.
    void find_region(float limit) {
        const float within = std::min(std::max(limit, 0.0f), 1.0f);
        float numbers[7];
        fingerflow_real_contact_mask(&lit_, &within, size_, mask_, threads_);
        const fingerflow_apparent_contacts region{mask_, margin_, numbers, 1, height_, width_, radius_, side_};
        fingerflow_apparent_contact(&region, threads_);
    }

    // Adds the pairs of pixels of every `stride_`-th line (`add_pairs`) in the contact region without the cells at its border.
    void add_edges(std::int64_t* sums) {
        std::int64_t last = -1;
        bool any = false;
        for (std::int64_t y = 0; y < height_; y += stride_) {
            if (y / side_ != last) any = find_inner(y / side_);
            last = y / side_;
            if (!any) continue;
            const auto line = [&](const unsigned char* plane, std::int64_t row) {
                return plane + std::min(std::max<std::int64_t>(row, 0), height_ - 1) * width_;
            };
            FINGERFLOW_PICK(add_pairs)(line(levels_, y - 1), line(levels_, y), line(levels_, y + 1), line(wanted_, y),
                                       line(wanted_, y + 1), inside_, width_, sums);
        }
    }

    // Writes to `inside_` which pixels lie in cells of a row that the region surrounds; returns whether any does.
    bool find_inner(std::int64_t row) {
        const std::int64_t top = std::max<std::int64_t>(row - 1, 0), bottom = std::min(row + 1, down_ - 1);
        bool any = false;
        for (std::int64_t x = 0; x < across_; ++x) {
            const std::int64_t left = std::max<std::int64_t>(x - 1, 0), right = std::min(x + 1, across_ - 1);
            bool inner = true;
            for (std::int64_t above = top; above <= bottom; ++above)
                for (std::int64_t beside = left; beside <= right; ++beside) inner &= margin_[above * across_ + beside] > 0;
            std::fill(inside_ + x * side_, inside_ + std::min(width_, (x + 1) * side_), inner);
            any |= inner;
        }
        return any;
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

// Relative intensity losses (batch) at the edges of ridges in contact (fingerflow/ops/contact/contact_threshold.py),
void fingerflow_contact_threshold(const fingerflow_lit_frames* given, const float* gains /* (batch) */, int size /* from 1 to 15 by 2 */,
    const std::uint16_t* table /* (entries) optional */, std::int64_t radius /* from 1 to 255 */,
    std::int64_t side /* among 1 2 4 8 where side <= 2 * radius + 1 */, std::int64_t stride /* from 1 */, float* thresholds /* (batch) */, int threads) {
    using namespace fingerflow;
    const auto find = [&](std::int64_t frame, int own) {
        thresholds[frame] = Frame(*given, frame, size, table, radius, side, stride, own).threshold(gains[frame]);
    };
    // One thread a frame, or all threads for a single frame.
    if (given->frames.batch == 1) return find(0, threads);
    parallel_for(given->frames.batch, threads, [&](std::int64_t frame) { find(frame, 1); });
}

#endif
