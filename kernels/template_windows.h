// Samples of a frame's spline and its slopes on the window around a point, straight or deformed.
#pragma once

#include <math.h>

#include <cstddef>
#include <cstdint>
#if defined(__AVX2__)
#include <immintrin.h>
#endif

#include "floats.h"
#include "patches.h"
#include "shared_limits.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {

#if defined(__AVX2__) && (defined(__GNUC__) || defined(__clang__))
#define FINGERFLOW_LOOKUP
// Elements at `index` of the concatenation of two vectors.
inline Floats looked_up(Floats low, Floats high, Integers index) {
#if defined(__AVX512F__)
    return (Floats)_mm512_permutex2var_ps((__m512)low, (__m512i)index, (__m512)high);
#else
    const __m256 of_low = _mm256_permutevar8x32_ps((__m256)low, (__m256i)index);
    const __m256 of_high = _mm256_permutevar8x32_ps((__m256)high, (__m256i)index);
    return (Floats)_mm256_blendv_ps(of_low, of_high, (__m256)_mm256_slli_epi32((__m256i)index, 28));  // bit 3 selects the vector
#endif
}
#endif

struct Vector {
    float x, y;
};
struct Matrix {
    float xx, xy, yx, yy;
};

inline bool is_finite(float value) { return value - value == 0.0f; }
inline bool is_finite(const Vector& value) { return is_finite(value.x) && is_finite(value.y); }
inline bool is_finite(const Matrix& m) { return is_finite(m.xx) && is_finite(m.xy) && is_finite(m.yx) && is_finite(m.yy); }
inline float length(const Vector& v) { return sqrtf(v.x * v.x + v.y * v.y); }
inline Vector operator+(const Vector& a, const Vector& b) { return {a.x + b.x, a.y + b.y}; }
inline Vector operator*(const Matrix& m, const Vector& v) { return {m.xx * v.x + m.xy * v.y, m.yx * v.x + m.yy * v.y}; }
inline Matrix operator*(const Matrix& a, const Matrix& b) {
    return {a.xx * b.xx + a.xy * b.yx, a.xx * b.xy + a.xy * b.yy, a.yx * b.xx + a.yy * b.yx, a.yx * b.xy + a.yy * b.yy};
}

// Clamps to [low, high]; NaN becomes `low`, so that the result can be an index.
inline float clamped(float value, float low, float high) { return value > low ? (value < high ? value : high) : low; }

// px of coefficients around a window, for sampling up to a pixel off an integer position.
constexpr int kMargin = 2;

// B-spline weights of the four taps around a position, the first one before its floor, and their derivatives.
constexpr int kOrder = 3, kTaps = kOrder + 1;
template <class Number>
inline void cubic_taps(Number fraction, Number* value, Number* slope) {
    const Number rest = 1.0f - fraction, square = fraction * fraction, rest_square = rest * rest;
    value[0] = rest_square * rest * (1.0f / 6);
    value[1] = square * (fraction * 0.5f - 1.0f) + 2.0f / 3;
    value[2] = rest_square * (rest * 0.5f - 1.0f) + 2.0f / 3;
    value[3] = square * fraction * (1.0f / 6);
    slope[0] = rest_square * -0.5f;
    slope[1] = fraction * (fraction * 1.5f - 2.0f);
    slope[2] = rest * (2.0f - rest * 1.5f);
    slope[3] = square * 0.5f;
}

// Whether the window of n px around a position lies in the frame, to kSlack.
inline bool contains(Vector place, const Frames& frames, int n) {
    const float least = static_cast<float>(n / 2) - kSlack;
    return place.x >= least && place.y >= least && place.x <= static_cast<float>(frames.width - 1) - least &&
           place.y <= static_cast<float>(frames.height - 1) - least;
}

// Whether all floats of rows `stride` apart are finite.
inline bool all_finite(const float* from, int rows, int columns, int stride) {
    Floats nothing = all(0);
    const int whole = columns / kFloats * kFloats;
    const Beginning rest(columns - whole);
    for (int r = 0; r < rows; ++r, from += stride) {
        for (int c = 0; c < whole; c += kFloats) nothing += load(from + c) * 0.0f;
        if (whole < columns) nothing += rest.of(load(from + whole)) * 0.0f;
    }
    float of[kFloats];
    store(of, nothing);
    bool finite = true;
    for (int k = 0; k < kFloats; ++k) finite = finite && of[k] == 0.0f;
    return finite;
}

// A coordinate as an integer, clamped to 2 `reach` beyond the border.
inline std::int64_t pixel_of(float place, std::int64_t count, int reach) {
    const float far = static_cast<float>(2 * reach);
    return static_cast<std::int64_t>(clamped(place, -far, static_cast<float>(count) + far));
}

// Writes the coefficients, less `level`, of a square of `side` px that begins `before` px before an integer position.
inline void cut_around(const Frames& frames, std::int64_t image, Vector center, int before, int side, float level, float* lines, float* to,
                       int stride) {
    const auto first = static_cast<float>(before);
    const Rectangle where{pixel_of(center.x - first, frames.width, side), pixel_of(center.y - first, frames.height, side), side, side};
    const auto from = [&](const auto* data) { cut_patch(data + image * frames.frame_stride, frames, where, level, lines, to, stride); };
    if (frames.kind == kFloat32) {
        cut_patch(static_cast<const float*>(frames.data) + image * frames.frame_stride, frames, where, level, lines, to, stride);
        // Padding behind a row is read and multiplied by 0, so it must be finite.
        for (int r = 0; r < side; ++r)
            for (int c = side; c < stride; ++c) to[r * stride + c] = 0.0f;
        return;
    }
    FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, from)
}

// A sampled window; rows are whole vectors, `row` floats apart, padded with zeros.
struct Sampled {
    float* value;
    float* along_x;
    float* along_y;
    int row;
};

class WindowSampler {
public:
    // `memory` has space for floats(window) floats.
    WindowSampler(int window, float* memory) : window_(window), rest_(window % kFloats) {
        const auto take = [&](int count) {
            float* piece = memory;
            memory += whole_floats(count);
            return piece;
        };
        wide_ = take(wide_buffer(window));
        rows_ = take(whole_floats(window) + kFloats);
        values_ = take(side(window) * whole_floats(window));
        slopes_ = take(side(window) * whole_floats(window));
        lines_ = memory;
    }

    static int floats(int window) {
        return whole_floats(wide_buffer(window)) + 2 * whole_floats(whole_floats(window) + kFloats) + 2 * side(window) * whole_floats(window) +
               (wide(window) + 2) * wide(window) + kFloats;
    }

    // The grey level subtracted from the samples, so that float32 sums do not cancel.
    float level() const { return level_; }

    // Whether all pixels read for the last window are finite; for a straight one the whole patch around its integer
    // pixel, as in the portable form, which multiplies matrices.
    bool finite() const { return finite_; }

    // Samples a window at place + w.
    void sample_straight(const Frames& frames, std::int64_t image, Vector place, const Sampled& to) {
        level_ = pixel(frames, image, place);
        to_ = to;
        const Vector center{rintf(place.x), rintf(place.y)}, shift{place.x - center.x, place.y - center.y};
        const Vector whole{shift.x < 0 ? -1.0f : 0.0f, shift.y < 0 ? -1.0f : 0.0f};
        float across[kTaps], across_slope[kTaps], down[kTaps], down_slope[kTaps];
        cubic_taps(shift.x - whole.x, across, across_slope);
        cubic_taps(shift.y - whole.y, down, down_slope);
        const int n = window_, span = whole_floats(n), stride = patch_span(side(n));
        cut_around(frames, image, center, n / 2 + kMargin, n + 2 * kMargin, level_, lines_, wide_, stride);
        finite_ = frames.kind != kFloat32 || all_finite(wide_, side(n), side(n), stride);
        const float* from = wide_ + (static_cast<int>(whole.y) + 1) * stride + static_cast<int>(whole.x) + 1;
        for (int r = 0; r < n + kTaps - 1; ++r, from += stride)
            for (int c = 0; c < span; c += kFloats) {
                Floats value = all(0), slope = all(0);
                FINGERFLOW_UNROLL
                for (int i = 0; i < kTaps; ++i) {
                    const Floats tap = held(load(from + c + i));
                    value += tap * all(across[i]);
                    slope += tap * all(across_slope[i]);
                }
                store(values_ + r * span + c, value);
                store(slopes_ + r * span + c, slope);
            }
        for (int r = 0; r < n; ++r)
            for (int c = 0; c < span; c += kFloats) {
                Floats value = all(0), along_x = all(0), along_y = all(0);
                FINGERFLOW_UNROLL
                for (int i = 0; i < kTaps; ++i) {
                    const Floats line = load(values_ + (r + i) * span + c);
                    value += line * all(down[i]);
                    along_y += line * all(down_slope[i]);
                    along_x += load(slopes_ + (r + i) * span + c) * all(down[i]);
                }
                write_samples(r, c, value, along_x, along_y);
            }
    }

    // Samples a window at place + A w, slopes with respect to w.
    void sample_warped(const Frames& frames, std::int64_t image, Vector place, const Matrix& warp, const Sampled& to) {
        level_ = pixel(frames, image, place);
        to_ = to;
        frames_ = &frames;
        image_ = image;
        sample_somewhere(place, warp);
        finite_ = frames.kind != kFloat32 || all_finite(to.value, window_, window_, to.row);
    }

private:
    static int side(int window) { return window + 2 * kMargin; }
    static int wide(int window) { return patch_span(2 * side(window)); }  // side of the largest patch of a warped window
    static int wide_buffer(int window) { return wide(window) * wide(window) + 2 * kPatchBlock; }

    static float pixel(const Frames& frames, std::int64_t image, Vector place) {
        const std::int64_t x = nearest(pixel_of(rintf(place.x), frames.width, 1), frames.width);
        const std::int64_t y = nearest(pixel_of(rintf(place.y), frames.height, 1), frames.height);
        const auto read = [&](const auto* data) { return static_cast<float>(data[image * frames.frame_stride + y * frames.row_stride + x]); };
        FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, read)
    }

    void cut(const Rectangle& where, float* to, int stride) {
        const auto from = [&](const auto* data) {
            cut_patch(data + image_ * frames_->frame_stride, *frames_, where, level_, lines_, to, stride);
        };
        FINGERFLOW_FOR_PIXEL(frames_->kind, frames_->data, from)
    }

    void cut_taps(const Rectangle& where, float* to) const {
        const auto from = [&](const auto* data) {
            cut_anywhere(data + image_ * frames_->frame_stride, *frames_, where, level_, to, kTaps);
        };
        FINGERFLOW_FOR_PIXEL(frames_->kind, frames_->data, from)
    }

    void sample_somewhere(Vector place, const Matrix& warp) {
        constexpr float kLast = 2;
        // Clamped to where all taps exist; a window that reaches beyond the frame is not used, whatever its samples.
        const float right = static_cast<float>((*frames_).width - 1) - kLast, bottom = static_cast<float>((*frames_).height - 1) - kLast;
        const auto outermost = static_cast<float>(window_ / 2);
        const float away_x = outermost * (fabsf(warp.xx) + fabsf(warp.xy)), away_y = outermost * (fabsf(warp.yx) + fabsf(warp.yy));
        const Range x_range = range(place.x, away_x, right), y_range = range(place.y, away_y, bottom);
        const Rectangle where{x_range.first, y_range.first, y_range.count, x_range.count};
        const int stride = patch_span(where.columns);
        const bool in_one_piece = where.rows <= wide(window_) && stride <= wide(window_);
        if (in_one_piece) cut(where, wide_, stride);
#if defined(FINGERFLOW_LOOKUP)
        // Fully inside, and rows of the window neither so steep nor so stretched that a vector of samples needs taps
        // from more than five rows or from more than two vectors of a row.
        const bool inside = place.x - away_x >= 2 && place.y - away_y >= 2 && place.x + away_x <= right - 1 && place.y + away_y <= bottom - 1;
        constexpr float kApart = kFloats - 1;
        const bool gentle = warp.xx > 0 && warp.xx * kApart < 2 * kFloats - kTaps - 1 && fabsf(warp.yx) * kApart < 1;
        // sample_gently weights foreign rows by 0, so they must be finite.
        if (in_one_piece && inside && gentle && (frames_->kind != kFloat32 || all_finite(wide_, where.rows, where.columns, stride)))
            return sample_gently(where, stride, place, warp);
#endif
        sample_anywhere(in_one_piece, where, stride, {right, bottom}, place, warp);
    }

#if defined(FINGERFLOW_LOOKUP)
    // Samples a gently deformed window from the cut patch: a vector of samples needs at most five rows of taps, each
    // loaded once as two vectors from which the taps are selected in registers.
    void sample_gently(const Rectangle& where, int stride, Vector place, Matrix warp) const {
        const int n = window_, half = n / 2;
        Integers number;
        for (int k = 0; k < kFloats; ++k) number[k] = k;
        const Floats numbers = __builtin_convertvector(number, Floats);
        const bool falling = warp.yx < 0;
        const int before_x = static_cast<int>(where.x) + 1, before_y = static_cast<int>(where.y) + 1;
        const float* const patch = wide_;
        for (int r = 0; r < n; ++r) {
            const float down = static_cast<float>(r - half);
            const Vector row{place.x + warp.xy * down, place.y + warp.yy * down};
            for (int c = 0; c < n; c += kFloats) {
                // Lanes behind the last column repeat it.
                Floats along = numbers + static_cast<float>(c - half);
                along = along < static_cast<float>(half) ? along : all(static_cast<float>(half));
                const Floats x = all(warp.xx) * along + all(row.x), y = all(warp.yx) * along + all(row.y);
                const Integers whole_x = __builtin_convertvector(x, Integers), whole_y = __builtin_convertvector(y, Integers);
                Floats across[kTaps], across_slope[kTaps], below[kTaps], below_slope[kTaps];
                cubic_taps(x - __builtin_convertvector(whole_x, Floats), across, across_slope);
                cubic_taps(y - __builtin_convertvector(whole_y, Floats), below, below_slope);
                const int left = whole_x[0], top = falling ? whole_y[kFloats - 1] : whole_y[0];
                const int lowest = falling ? whole_y[0] : whole_y[kFloats - 1];
                const Integers index = whole_x - left;
                const float* taps = patch + (top - before_y) * stride + left - before_x;
                Floats value = all(0), along_x = all(0), along_y = all(0);
                const auto add_taps = [&](const Floats (&tap)[kTaps], const Floats& weight, const Floats& weight_slope) {
                    Floats row_value = tap[0] * across[0], row_slope = tap[0] * across_slope[0];
                    FINGERFLOW_UNROLL
                    for (int j = 1; j < kTaps; ++j) {
                        row_value += tap[j] * across[j];
                        row_slope += tap[j] * across_slope[j];
                    }
                    value += row_value * weight;
                    along_x += row_slope * weight;
                    along_y += row_value * weight_slope;
                };
                const auto add_rows = [&](const auto& add_row) {
                    if (top == lowest) {
                        FINGERFLOW_UNROLL
                        for (int i = 0; i < kTaps; ++i) add_row(i, below[i], below_slope[i]);
                    } else {
                        // A sample one row lower has its first tap one row later.
                        const Integers lower = whole_y > top;
                        add_row(0, lower ? all(0) : below[0], lower ? all(0) : below_slope[0]);
                        FINGERFLOW_UNROLL
                        for (int i = 1; i < kTaps; ++i)
                            add_row(i, lower ? below[i - 1] : below[i], lower ? below_slope[i - 1] : below_slope[i]);
                        add_row(kTaps, lower ? below[kTaps - 1] : all(0), lower ? below_slope[kTaps - 1] : all(0));
                    }
                };
                // In a slightly deformed window the taps of a vector are contiguous, apart from one step by a pixel:
                // then each tap is in one of two loads.
                const Integers ahead = index - __builtin_convertvector(along - static_cast<float>(c - half), Integers);
                const int first = warp.xx < 1 ? ahead[kFloats - 1] : 0;
                int others = 0;  // nonzero if another step occurs
                for (int k = 0; k < kFloats; ++k) others |= (ahead[k] - first) & ~1;
                if (others == 0) {
                    const Integers later = ahead > first;
                    const float* const beside = taps + first;
                    add_rows([&](int i, const Floats& weight, const Floats& weight_slope) {
                        Floats here = load(beside + i * stride), tap[kTaps];
                        FINGERFLOW_UNROLL
                        for (int j = 0; j < kTaps; ++j) {
                            const Floats next = load(beside + i * stride + j + 1);
                            tap[j] = later ? next : here;
                            here = next;
                        }
                        add_taps(tap, weight, weight_slope);
                    });
                } else {
                    add_rows([&](int i, const Floats& weight, const Floats& weight_slope) {
                        const Floats low = load(taps + i * stride), high = load(taps + i * stride + kFloats);
                        Floats tap[kTaps];
                        FINGERFLOW_UNROLL
                        for (int j = 0; j < kTaps; ++j) tap[j] = looked_up(low, high, index + j);
                        add_taps(tap, weight, weight_slope);
                    });
                }
                write_warped(r, c, warp, value, along_x, along_y);
            }
        }
    }
#endif

    // Chain rule: d/dw = A^T d/dx.
    void write_warped(int r, int c, const Matrix& warp, Floats value, Floats x, Floats y) const {
        write_samples(r, c, value, all(warp.xx) * x + all(warp.yx) * y, all(warp.xy) * x + all(warp.yy) * y);
    }

    void write_samples(int r, int c, Floats value, Floats along_x, Floats along_y) const {
        const int place = r * to_.row + c;
        const bool whole = c + kFloats <= window_;
        store(to_.value + place, whole ? value : rest_.of(value));
        store(to_.along_x + place, whole ? along_x : rest_.of(along_x));
        store(to_.along_y + place, whole ? along_y : rest_.of(along_y));
    }

    // Samples any window: positions are clamped to where all taps exist; taps come from the cut patch or from the
    // frame.
    void sample_anywhere(bool in_one_piece, const Rectangle& where, int stride, Vector last, Vector place, const Matrix& warp) {
        constexpr float kFirst = 1;
        const int n = window_, half = n / 2;
        float* const columns = rows_;  // those behind the last repeat it
        for (int k = 0; k < whole_floats(window_); ++k) columns[k] = static_cast<float>(k < n ? k - half : half);
        for (int r = 0; r < n; ++r) {
            const float down = static_cast<float>(r - half);
            for (int c = 0; c < whole_floats(window_); c += kFloats) {
                const Floats along = load(columns + c);
                const Split x = split(all(place.x + warp.xy * down) + all(warp.xx) * along, kFirst, last.x);
                const Split y = split(all(place.y + warp.yy * down) + all(warp.yx) * along, kFirst, last.y);
                Samples at{};
                if (in_one_piece) {
                    interpolate(x, y, [&](int k) {
                        return wide_ + (y.whole[k] - 1 - static_cast<int>(where.y)) * stride + x.whole[k] - 1 - static_cast<int>(where.x);
                    }, stride, &at);
                } else {
                    float around[kTaps * kTaps];
                    interpolate(x, y, [&](int k) {
                        cut_taps({x.whole[k] - 1, y.whole[k] - 1, kTaps, kTaps}, around);
                        return around;
                    }, kTaps, &at);
                }
                write_warped(r, c, warp, at.value, at.along_x, at.along_y);
            }
        }
    }

    // Range of pixels that a warped window may read along one axis, within the frame.
    struct Range {
        std::int64_t first;
        int count;
    };
    static Range range(float place, float away, float limit) {
        const float low = place - away, high = place + away;
        if (!(is_finite(low) && is_finite(high))) return {0, static_cast<int>(limit) + kOrder};
        // One pixel more than the taps on either side, for rounding.
        const int begin = static_cast<int>(clamped(floorf(low), 1, limit)) - 2;
        const int end = static_cast<int>(clamped(floorf(high), 1, limit)) + kOrder, border = static_cast<int>(limit) + 2;
        const int from = begin < 0 ? 0 : begin;
        return {from, (end > border ? border : end) - from + 1};
    }

    struct Samples {
        Floats value, along_x, along_y;
    };

    // Spline and slopes at arbitrary positions: taps(k) returns the first tap of sample k, rows `stride` floats apart.
    template <class Taps>
    static void interpolate(const Split& x, const Split& y, const Taps& taps, int stride, Samples* at) {
        Floats across[kTaps], across_slope[kTaps], below[kTaps], below_slope[kTaps];
        cubic_taps(x.fraction, across, across_slope);
        cubic_taps(y.fraction, below, below_slope);
        // First down the columns, four at a time as they lie in memory, sample by sample; then across, for all lanes.
        float down_weights[kTaps][kFloats], down_slopes[kTaps][kFloats];
        for (int i = 0; i < kTaps; ++i) {
            store(down_weights[i], below[i]);
            store(down_slopes[i], below_slope[i]);
        }
        float values[kFloats][kTaps], slopes[kFloats][kTaps];
        for (int k = 0; k < kFloats; ++k) {
            const float* from = taps(k);
            const Floats4 first = load4(from), second = load4(from + stride), third = load4(from + 2 * stride),
                          fourth = load4(from + 3 * stride);
            const Floats4 sampled = first * down_weights[0][k] + second * down_weights[1][k] + third * down_weights[2][k] +
                                    fourth * down_weights[3][k];
            const Floats4 sloped = first * down_slopes[0][k] + second * down_slopes[1][k] + third * down_slopes[2][k] +
                                   fourth * down_slopes[3][k];
            std::memcpy(values[k], &sampled, sizeof sampled);
            std::memcpy(slopes[k], &sloped, sizeof sloped);
        }
        at->value = at->along_x = at->along_y = all(0);
        for (int j = 0; j < kTaps; ++j) {
            float column[kFloats], column_slope[kFloats];
            for (int k = 0; k < kFloats; ++k) {
                column[k] = values[k][j];
                column_slope[k] = slopes[k][j];
            }
            at->value += load(column) * across[j];
            at->along_x += load(column) * across_slope[j];
            at->along_y += load(column_slope) * across[j];
        }
    }

    const int window_;
    const Frames* frames_ = nullptr;
    std::int64_t image_ = 0;
    float level_ = 0;
    bool finite_ = true;
    float* wide_ = nullptr;
    float* rows_ = nullptr;
    float* values_ = nullptr;
    float* slopes_ = nullptr;
    float* lines_ = nullptr;
    Sampled to_{};
    const Beginning rest_;
};

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
