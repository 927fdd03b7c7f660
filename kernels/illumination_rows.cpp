// One line at a time: whatever type the images have, the arithmetic is that of fingerflow/ops/illumination.py in float.
#include "illumination_rows.h"

#include <math.h>
#include <string.h>

#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

constexpr float kInfinity = HUGE_VALF, kUnknown = NAN;
constexpr std::int64_t kSides = 32;  // values side by side, for vectors

template <class Pixel>
void convert(const Pixel* FINGERFLOW_RESTRICT from, std::int64_t width, float* FINGERFLOW_RESTRICT to) {
    for (std::int64_t x = 0; x < width; ++x) to[x] = static_cast<float>(from[x]);
}

// Row y of an image, or of the only one, as floats.
void line_of(const Frames& frames, std::int64_t frame, std::int64_t y, float* line) {
    const std::int64_t at = (frames.batch == 1 ? 0 : frame) * frames.frame_stride + y * frames.row_stride;
    const auto row = [&](const auto* data) { convert(data + at, frames.width, line); };
    FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, row)
}

// Light of the empty glass on row y, and the dark counts below it.
void light_of(const Illumination& given, std::int64_t frame, std::int64_t y, float* FINGERFLOW_RESTRICT light,
              float* FINGERFLOW_RESTRICT dark) {
    line_of(given.reference, frame, y, light);
    if (given.dark.data == nullptr) return;
    line_of(given.dark, frame, y, dark);
    for (std::int64_t x = 0; x < given.frames.width; ++x) light[x] -= dark[x];
}

// A number from 0 to 255. Positive floats are ordered as their bits are, and negative ones have negative bits: whole
// numbers have a minimum and a maximum on every processor, floats need not (they may be NaN, this one may not).
inline float clamped(float level) {
    std::int32_t bits;
    memcpy(&bits, &level, sizeof bits);
    constexpr std::int32_t most = 0x437f0000;  // 255
    bits = bits > 0 ? bits : 0;
    bits = bits < most ? bits : most;
    memcpy(&level, &bits, sizeof level);
    return level;
}

std::int64_t count_up_to(const float* values, std::int64_t count, float limit) {
    std::int64_t reached = 0;
    for (std::int64_t begin = 0; begin < count; begin += 1 << 20) {
        const std::int64_t end = begin + (1 << 20) < count ? begin + (1 << 20) : count;
        std::int32_t some = 0;
        for (std::int64_t k = begin; k < end; ++k) some += values[k] <= limit;
        reached += some;
    }
    return reached;
}

// The least value above a limit; infinities fill up the last of the sides.
float least_above(const float* values, std::int64_t count, float limit) {
    float least[kSides];
    for (float& side : least) side = kInfinity;
    for (std::int64_t k = 0; k < count; k += kSides)
        for (std::int64_t side = 0; side < kSides; ++side) {
            const float value = values[k + side] > limit ? values[k + side] : kInfinity;
            least[side] = value < least[side] ? value : least[side];
        }
    for (const float side : least) least[0] = side < least[0] ? side : least[0];
    return least[0];
}

}  // namespace

float least_light(const Illumination& given, std::int64_t frame, std::int64_t step, float* lines, float* values) {
    // The quantile as fingerflow/ops/quantile.py finds it, by halving an interval.
    const std::int64_t width = given.frames.width;
    std::int64_t count = 0;
    for (std::int64_t y = 0; y < given.frames.height; y += step) {
        light_of(given, frame, y, lines, lines + width);
        for (std::int64_t x = 0; x < width; x += step) values[count++] = lines[x];
    }
    // What is not finite counts as infinite: above every limit.
    float lows[kSides], highs[kSides];
    std::int32_t finite[kSides] = {};
    for (std::int64_t side = 0; side < kSides; ++side) lows[side] = kInfinity, highs[side] = -kInfinity;
    for (std::int64_t k = count; k % kSides != 0; ++k) values[k] = kInfinity;
    for (std::int64_t k = 0; k < count; k += kSides)
        for (std::int64_t side = 0; side < kSides; ++side) {
            const float value = values[k + side];
            const bool known = value - value == 0.0f;
            const float low = known ? value : kInfinity, high = known ? value : -kInfinity;
            lows[side] = low < lows[side] ? low : lows[side];
            highs[side] = high > highs[side] ? high : highs[side];
            finite[side] += known;
            values[k + side] = low;
        }
    std::int64_t present = 0;
    float lowest = kInfinity, highest = -kInfinity;
    for (std::int64_t side = 0; side < kSides; ++side) {
        lowest = lows[side] < lowest ? lows[side] : lowest;
        highest = highs[side] > highest ? highs[side] : highest;
        present += finite[side];
    }
    if (present == 0) return NAN;
    const double exact = ceil(static_cast<double>(present) * 0.99);
    const auto wanted = static_cast<std::int64_t>(exact < 1 ? 1 : exact);
    // The value sought lies above `low` and not above `high`. When it is the next one above `low`, no more is counted.
    double low = lowest, high = highest;
    float found = kInfinity;
    for (int halving = 0; halving < 24; ++halving) {
        if (halving % 4 == 0 && halving > 4 && found == kInfinity) {
            const float next = least_above(values, count, static_cast<float>(low));
            if (count_up_to(values, count, next) >= wanted) found = next;
        }
        const double middle = low + (high - low) / 2;
        const auto limit = static_cast<float>(middle);
        if (found < kInfinity ? found <= limit : count_up_to(values, count, limit) >= wanted) high = middle;
        else low = middle;
    }
    if (count_up_to(values, count, lowest) >= wanted) high = lowest;
    return given.minimum * static_cast<float>(high);
}

void light_lost_rows(const Illumination& given, std::int64_t frame, std::int64_t top, std::int64_t bottom, float least,
                     float* lines, const LightLost& lost) {
    const std::int64_t width = given.frames.width;
    const float low = given.low, scale = given.levels_per_unit;
    const float dimmest = least < 0.0f ? 0.0f : least;  // a NaN stays, and nothing is lit
    float* FINGERFLOW_RESTRICT passed = lines;
    float* FINGERFLOW_RESTRICT light = lines + width;
    float* FINGERFLOW_RESTRICT dark = lines + 2 * width;
    auto* FINGERFLOW_RESTRICT rounded = reinterpret_cast<std::int32_t*>(lines + 3 * width);
    auto* FINGERFLOW_RESTRICT known_here = reinterpret_cast<std::int32_t*>(lines + 4 * width);
    for (std::int64_t y = top; y < bottom; ++y) {
        light_of(given, frame, y, light, dark);
        line_of(given.frames, frame, y, passed);
        if (given.dark.data != nullptr)
            for (std::int64_t x = 0; x < width; ++x) passed[x] -= dark[x];
        const std::int64_t at = (y - top) * width;
        unsigned char* FINGERFLOW_RESTRICT valid = lost.valid + at;
        float* FINGERFLOW_RESTRICT signal = lost.signal == nullptr ? lines + 5 * width : lost.signal + at;
        // Two loops, each over numbers of one size: vectors of bytes are packed at the end.
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = 0; x < width; ++x) {
            // An infinite light has a finite quotient of 0.
            const bool lit = (light[x] > dimmest) & (light[x] < kInfinity);
            const float quotient = passed[x] / (lit ? light[x] : kUnknown);
            const bool known = fabsf(quotient) < kInfinity;
            const float lost_here = 1.0f - (known ? quotient : 1.0f);
            const float level = clamped((lost_here - low) * scale);
            signal[x] = lost_here;
            known_here[x] = known;
            // Adding 3 * 2^22 rounds to an integer, halves to even, for any compiler and processor.
            rounded[x] = static_cast<std::int32_t>((level + 12582912.0f) - 12582912.0f);
        }
        for (std::int64_t x = 0; x < width; ++x) valid[x] = static_cast<unsigned char>(known_here[x]);
        if (lost.levels == nullptr) continue;
        unsigned char* FINGERFLOW_RESTRICT levels = lost.levels + at;
        for (std::int64_t x = 0; x < width; ++x) levels[x] = static_cast<unsigned char>(rounded[x]);
    }
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
