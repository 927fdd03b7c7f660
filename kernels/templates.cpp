// build: each instruction set, fused
// Subsets (templates) of points prepared, and registered in frames by Lucas-Kanade steps
// (fingerflow/ops/tracking/templates.py).
// g is the template's gradient without its parts along a constant and along the values T; a step from a guess, where
// the frame has the values M, is -(sum g g')^-1 sum g (M - T) / gain with gain = sum T M / sum T T.
// Layout: samples (P, 3, n, n) hold values, gx and gy of a template, template statistics (P, 32). One column of a window a
// lane; rows of a window begin at whole vectors, with at least kPadding zeros behind its n samples. Points are processed
// in bands of kBandPx rows, then by column, since windows of neighbours overlap and share cache lines. Sums run in another
// order than in the portable form, so results differ by rounding.
#include <math.h>
#include <cstddef>
#include <cstring>

#include "floats.h"
#include "instruction_sets.h"
#include "interface.h"
#include "lanes.h"
#include "patches.h"
#include "pixels.h"
#include "shared_limits.h"
#include "template_windows.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

constexpr float kTiny = 1e-20f;
Vector pair(const float* all, std::int64_t k) { return {all[2 * k], all[2 * k + 1]}; }

// --- preparation
// --------------------------------------------------------------------------------------------------------

// Floats between rows of a template: whole vectors, with at least kPadding zeros behind the samples.
constexpr int kPadding = 4;  // twice the reach of a pixel's weights in a sample
constexpr int row_of(int n) { return whole_floats(n + kPadding); }

class Preparer {
public:
    Preparer(const fingerflow_prepared_templates& all, float* memory) : all_(all), n_(all.window), row_(row_of(n_)), sampler_(n_, memory) {
        memory += WindowSampler::floats(n_);
        const auto take = [&](int rows) {
            float* piece = memory;
            memory += rows * row_;
            for (int k = 0; k < rows * row_; ++k) piece[k] = 0.0f;
            return piece;
        };
        for (float*& one : of_) one = take(n_);
        for (float*& one : slope_) one = take(n_);
        for (float*& one : padded_) one = take(n_ + 1) + row_;
        for (float*& one : lines_) one = take(n_ + 2 * kPadding);
        right_ = take(n_);
        down_ = take(n_);
        inside_ = reinterpret_cast<std::int32_t*>(take(n_));
        for (int r = 0; r < n_; ++r)
            for (int c = 0; c < n_; ++c) {
                right_[r * row_ + c] = static_cast<float>(c - n_ / 2);
                down_[r * row_ + c] = static_cast<float>(r - n_ / 2);
                inside_[r * row_ + c] = -1;
            }
    }

    static std::int64_t floats(int n) { return WindowSampler::floats(n) + row_of(n) * (10 * n + 2 + 2 * (n + 2 * kPadding)); }

    // Values, gx and gy of the last point, n rows of row_of(n) floats.
    const float* const* samples() const { return of_; }

    // Prepares a template; returns false, with start NaN and statistics 0, where the point is not finite.
    bool prepare(std::int64_t point) {
        const std::int64_t image = point / all_.points;
        const Vector start = pair(all_.start, point);
        Matrix inverse_warp{1, 0, 0, 1};
        if (all_.inverse_warp != nullptr) {
            const float* w = all_.inverse_warp + 4 * point;
            inverse_warp = {w[0], w[1], w[2], w[3]};
        }
        float* const numbers = all_.numbers + point * kNumbers;
        if (!is_finite(start) || !is_finite(inverse_warp)) {
            for (int k = 0; k < kNumbers; ++k) numbers[k] = 0.0f;
            all_.start[2 * point] = all_.start[2 * point + 1] = NAN;
            return false;
        }
        const Sampled sampled{of_[0], slope_[0], slope_[1], row_};
        if (all_.inverse_warp == nullptr) sampler_.sample_straight(all_.image, image, start, sampled);
        else sampler_.sample_warped(all_.image, image, start, inverse_warp, sampled);
        if (!sampler_.finite()) of_[0][0] = NAN;  // which the mean spreads to all values
        numbers[kLevel] = sampler_.level() + take_mean();
        project();
        measure(all_.variance[image], numbers);
        numbers[kInside] = contains(start, all_.image, n_) ? 1.0f : 0.0f;
        numbers[kGain] = all_.gain_offset ? 1.0f : 0.0f;
        return true;
    }

private:
    float count() const { return static_cast<float>(n_ * n_); }
    int steps() const { return n_ * row_; }

    // Subtracts the mean from the values and returns it.
    float take_mean() {
        Floats sum[kFloats] = {};
        for (int k = 0; k < steps(); k += kFloats) sum[0] += load(of_[0] + k);
        const float mean = folded<kFloats>(sum)[0] / count();
        for (int k = 0; k < steps(); k += kFloats) store(of_[0] + k, kept(load(of_[0] + k) - all(mean), inside_ + k));
        return mean;
    }

    // Projects the gradient: removes its parts along a constant and along the values.
    void project() {
        Floats of[whole_floats(5)] = {};
        for (int k = 0; k < steps(); k += kFloats) {
            const Floats value = load(of_[0] + k), x = load(slope_[0] + k), y = load(slope_[1] + k);
            of[0] += value * value;
            of[1] += value * x;
            of[2] += value * y;
            of[3] += x;
            of[4] += y;
        }
        float sum_of[whole_floats(5)];
        sums(of, sum_of);
        energy_ = sum_of[0];
        const bool free = all_.gain_offset != 0;
        const float some = energy_ < kTiny ? kTiny : energy_;
        for (int i = 0; i < 2; ++i) {
            const float mean = free ? sum_of[3 + i] / count() : 0.0f, share = free ? sum_of[1 + i] / some : 0.0f;
            for (int k = 0; k < steps(); k += kFloats)
                store(of_[1 + i] + k, kept(load(slope_[i] + k) - all(mean) - load(of_[0] + k) * all(share), inside_ + k));
        }
    }

    void measure(float variance, float* numbers) {
        Floats of[whole_floats(13)] = {};
        for (int k = 0; k < steps(); k += kFloats) {
            const Floats value = load(of_[0] + k), x = load(of_[1] + k), y = load(of_[2] + k);
            const Floats slope_x = load(slope_[0] + k), slope_y = load(slope_[1] + k), right = load(right_ + k), down = load(down_ + k);
            of[0] += x * x;
            of[1] += x * y;
            of[2] += y * y;
            of[3] += x * value;
            of[4] += y * value;
            const Floats bent[4] = {slope_x * right, slope_x * down, slope_y * right, slope_y * down};
            FINGERFLOW_UNROLL
            for (int i = 0; i < 4; ++i) {
                of[5 + i] += x * bent[i];
                of[9 + i] += y * bent[i];
            }
        }
        float sum_of[whole_floats(13)];
        sums(of, sum_of);
        const float xx = sum_of[0], xy = sum_of[1], yy = sum_of[2];
        const float determinant = xx * yy - xy * xy;
        const bool regular = determinant > kTiny;
        const float mean = (xx + yy) / 2, half = (xx - yy) / 2, smaller = mean - sqrtf(half * half + xy * xy);
        const float floor = (variance < all_.rounding ? all_.rounding : variance) * (kTextureToNoise * count() * kGradientNoise);
        const float least = floor > kLeastTexture * mean ? floor : kLeastTexture * mean;
        const Matrix inverse = regular ? Matrix{yy / determinant, -xy / determinant, -xy / determinant, xx / determinant} : Matrix{0, 0, 0, 0};
        numbers[kInverseXx] = inverse.xx;
        numbers[kInverseXy] = inverse.xy;
        numbers[kInverseYy] = inverse.yy;
        numbers[kEnergy] = energy_;
        numbers[kConstantX] = sum_of[3];
        numbers[kConstantY] = sum_of[4];
        numbers[kNoise] = variance;
        numbers[kTextured] = regular && smaller > least ? 1.0f : 0.0f;
        for (int i = 0; i < 4; ++i) {
            const Vector lean = inverse * Vector{sum_of[5 + i], sum_of[9 + i]};
            numbers[kLean + i] = lean.x;
            numbers[kLean + 4 + i] = lean.y;
        }
        bend(sum_of + 5, numbers);
        const Matrix spread = inverse * (energy_of_pixels() * inverse);
        numbers[kCovarianceXx] = spread.xx;
        numbers[kCovarianceXy] = spread.xy;
        numbers[kCovarianceYy] = spread.yy;
    }

    // Quadratic form Q of the residual energy that a displacement gradient leaves: products of its four modes (slope
    // times window coordinate), less the parts that gain, offset and a shift fit. `pushing`: the eight sums of gx, gy
    // times the modes.
    void bend(const float* pushing, float* numbers) const {
        Floats of[whole_floats(18)] = {};
        for (int k = 0; k < steps(); k += kFloats) {
            const Floats value = load(of_[0] + k), slope_x = load(slope_[0] + k), slope_y = load(slope_[1] + k);
            const Floats right = load(right_ + k), down = load(down_ + k);
            const Floats bent[4] = {slope_x * right, slope_x * down, slope_y * right, slope_y * down};
            int at = 0;
            FINGERFLOW_UNROLL
            for (int i = 0; i < 4; ++i) {
                of[10 + i] += bent[i];
                of[14 + i] += bent[i] * value;
                FINGERFLOW_UNROLL
                for (int j = i; j < 4; ++j) of[at++] += bent[i] * bent[j];
            }
        }
        float sum_of[whole_floats(18)];
        sums(of, sum_of);
        const float* const mean = sum_of + 10;
        const float* const like = sum_of + 14;
        const bool free = all_.gain_offset != 0;
        const float some = energy_ < kTiny ? kTiny : energy_;
        int at = 0;
        for (int i = 0; i < 4; ++i)
            for (int j = i; j < 4; ++j, ++at) {
                const float taken = free ? mean[i] * mean[j] / count() + like[i] * like[j] / some : 0.0f;
                const float shifted = pushing[i] * numbers[kLean + j] + pushing[4 + i] * numbers[kLean + 4 + j];
                numbers[kBending + at] = (i == j ? 1.0f : 2.0f) * (sum_of[at] - taken - shifted);
            }
    }

    // Sums of products of gx and gy expressed as weights of the pixels: [1 4 1] / 6 of the spline at integer positions
    // times [1 2 1] / 4 of its coefficients, along each axis.
    Matrix energy_of_pixels() {
        const Floats outer = all(1.0f / 24), inner = all(6.0f / 24), middle = all(10.0f / 24);
        const auto spread = [&](const float* from, int step) {
            return (load(from) + load(from - 4 * step)) * outer + (load(from - step) + load(from - 3 * step)) * inner + load(from - 2 * step) * middle;
        };
        for (int i = 0; i < 2; ++i) {
            // A line shifted by up to four samples reads the zeros behind it.
            for (int k = 0; k < steps(); k += kFloats) store(padded_[i] + k, load(of_[1 + i] + k));
            float* const lines = lines_[i] + kPadding * row_;
            for (int k = 0; k < steps(); k += kFloats) store(lines + k, spread(padded_[i] + k, 1));
        }
        Floats of[whole_floats(3)] = {};
        for (int k = 0; k < (n_ + kPadding) * row_; k += kFloats) {
            const Floats x = spread(lines_[0] + kPadding * row_ + k, row_), y = spread(lines_[1] + kPadding * row_ + k, row_);
            of[0] += x * x;
            of[1] += x * y;
            of[2] += y * y;
        }
        float sum_of[whole_floats(3)];
        sums(of, sum_of);
        return {sum_of[0], sum_of[1], sum_of[1], sum_of[2]};
    }

    const fingerflow_prepared_templates& all_;
    const int n_, row_;
    WindowSampler sampler_;
    float* of_[3]{};      // values, gx, gy
    float* slope_[2]{};   // gradient before the projection
    float* padded_[2]{};  // gx, gy
    float* lines_[2]{};
    float* right_ = nullptr;
    float* down_ = nullptr;
    std::int32_t* inside_ = nullptr;  // -1 where a float of the window is a sample, 0 where it is padding
    float energy_ = 0;
};

// --- search
// -------------------------------------------------------------------------------------------------------------

struct Look {
    Vector found, estimate;
    float error, scale;
    TrackStatus status;
};

class Finder {
public:
    Finder(const fingerflow_found_templates& all, float* memory) : all_(all), n_(all.window), row_(row_of(n_)), stride_(patch_span(n_ + 2 * kMargin)) {
        const auto take = [&](int count) {
            float* piece = memory;
            memory += whole_floats(count);
            for (int k = 0; k < whole_floats(count); ++k) piece[k] = 0.0f;
            return piece;
        };
        for (float*& one : memory_) one = take(n_ * row_);
        patch_ = take((n_ + 2 * kMargin) * stride_ + 2 * kPatchBlock);
        matched_ = take(n_ * row_);
        lines_ = memory;
    }

    static std::int64_t floats(int n) {
        const int stride = patch_span(n + 2 * kMargin), side = n + 2 * kMargin;
        return 4 * n * row_of(n) + whole_floats(side * stride + 2 * kPatchBlock) + (side + 2) * stride;
    }

    // Announces the next point: in a single frame its pixels are prefetched, and its template line by line while this
    // point is found, which saves a third of the time.
    void expect(std::int64_t point) {
        awaited_ = reinterpret_cast<std::uintptr_t>(all_.samples + point * 3 * n_ * n_) - 64;
        for (int k = 0; k < kNumbers; k += 16) FINGERFLOW_PREFETCH(all_.numbers + point * kNumbers + k);
        fetch(point / all_.points, pair(all_.place, point) + pair(all_.speed, point));
    }

    // Follows a point through all frames, with the samples `prepared`, or else those of `all_`.
    void follow(std::int64_t point, const float* const* prepared = nullptr) {
        const std::int64_t count = all_.recordings * all_.points, batch = point / all_.points;
        const Vector start = pair(all_.start, point);
        Vector place = pair(all_.place, point), speed = pair(all_.speed, point);
        if (is_finite(start)) {
            if (prepared == nullptr) begin(point);
            else std::copy(prepared, prepared + 3, samples_);
            numbers_ = all_.numbers + point * kNumbers;
            spread_ = {numbers_[kCovarianceXx], numbers_[kCovarianceXy], numbers_[kCovarianceXy], numbers_[kCovarianceYy]};
        }
        bool seen = true;
        for (std::int64_t step = 0; step < all_.steps; ++step) {
            const Vector guess = place + speed;
            const std::int64_t image = step * all_.recordings + batch;
            Look look = not_given(guess);
            if (step + 1 < all_.steps) fetch(image + all_.recordings, guess);
            if (is_finite(start) && is_finite(guess))
                look = this->look(image, guess);
            write(step * count + point, look);
            const bool tracked = look.status == kTracked;
            if (tracked) {
                // A recovered point may lie off its prediction, which is no velocity.
                if (seen) {
                    speed.x += kSpeedWeight * (look.found.x - place.x - speed.x);
                    speed.y += kSpeedWeight * (look.found.y - place.y - speed.y);
                }
                place = look.found;
            } else {
                place = place + speed;
                speed = {speed.x * (1 - 1 / kSpeedFrames), speed.y * (1 - 1 / kSpeedFrames)};
            }
            seen = tracked;
        }
        std::memcpy(all_.place + 2 * point, &place, sizeof place);
        std::memcpy(all_.speed + 2 * point, &speed, sizeof speed);
    }

private:
    static Look not_given(Vector guess) { return {{NAN, NAN}, is_finite(guess) ? guess : Vector{0, 0}, NAN, NAN, kNotFinite}; }

    void begin(std::int64_t point) {
        const float* from = all_.samples + point * 3 * n_ * n_;
        // Copies rows by whole vectors while these lie within the samples; floats of the next row become 0.
        const float* const end = from + 3 * n_ * n_;
        const int whole = n_ / kFloats * kFloats;
        const Beginning rest(n_ - whole);
        for (int k = 0; k < 3; ++k) {
            samples_[k] = memory_[k];
            for (int r = 0; r < n_; ++r, from += n_) {
                float* const to = memory_[k] + r * row_;
                if (end - from < whole + kFloats) {
                    std::memcpy(to, from, static_cast<std::size_t>(n_) * sizeof(float));
                    continue;
                }
                for (int c = 0; c < whole; c += kFloats) store(to + c, load(from + c));
                store(to + whole, rest.of(load(from + whole)));
            }
        }
    }

    void write(std::int64_t place, const Look& look) const {
        const bool tracked = look.status == kTracked;
        const Vector found = tracked ? look.found : Vector{NAN, NAN};
        std::memcpy(all_.found + 2 * place, &found, sizeof found);
        all_.error[place] = look.error;
        float* const c = all_.covariance + 4 * place;
        const float scale = tracked ? look.scale : NAN;
        c[0] = scale * spread_.xx;
        c[1] = scale * spread_.xy;
        c[2] = scale * spread_.yx;
        c[3] = scale * spread_.yy;
        all_.status[place] = static_cast<unsigned char>(look.status);
        std::memcpy(all_.estimate + 2 * place, &look.estimate, sizeof look.estimate);
    }

    // Prefetches the pixels around a point.
    void fetch(std::int64_t image, Vector guess) const {
        if (!is_finite(guess)) return;
        const Frames& frames = all_.frames;
        const int side = n_ + 2 * kMargin + 2;
        const auto half = static_cast<float>(side / 2);
        const std::int64_t left = pixel_of(guess.x - half, frames.width, side), top = pixel_of(guess.y - half, frames.height, side);
        if (left < 0 || top < 0 || left + side > frames.width || top + side > frames.height) return;
        const auto rows = [&](const auto* data) {
            const auto* row = data + image * frames.frame_stride + top * frames.row_stride + left;
            for (int r = 0; r < side; ++r, row += frames.row_stride) {
                FINGERFLOW_PREFETCH(row);
                FINGERFLOW_PREFETCH(row + side - 1);
            }
        };
        FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, rows)
    }

    // Iterates from the guess until a step is short, or `rounds` steps were taken.
    Look look(std::int64_t image, Vector guess) {
        const bool far = all_.steps == 1 && all_.samples != nullptr;  // the next template has yet to be prefetched
        Look result = far ? one_step<true>(image, guess) : one_step<false>(image, guess);
        for (int round = 1; round < all_.rounds && result.status == kNotConverged; ++round) result = one_step<false>(image, result.estimate);
        return result;
    }

    template <bool kFetch>
    Look one_step(std::int64_t image, Vector guess) {
        const Vector center{rintf(guess.x), rintf(guess.y)};
        cut_around(all_.frames, image, center, n_ / 2 + kMargin, n_ + 2 * kMargin, numbers_[kLevel], lines_, patch_, stride_);
        if (!is_finite(numbers_[kLevel]) || (all_.frames.kind == kFloat32 && !all_finite(patch_, n_ + 2 * kMargin, n_ + 2 * kMargin, stride_)))
            return {{NAN, NAN}, guess, NAN, NAN, is_within(guess) ? kNotFinite : kLeftFrame};
        Sums of;
        sample<kFetch>({guess.x - center.x, guess.y - center.y}, &of);
        return judge(image, guess, of);
    }

    // Sums over the window: T M, gx M, gy M, M, M M.
    struct Sums {
        float tm, gx, gy, m, mm;
    };

    template <bool kFetch>
    void sample(Vector shift, Sums* result) {
        const Vector whole{shift.x < 0 ? -1.0f : 0.0f, shift.y < 0 ? -1.0f : 0.0f};
        float across[kTaps], down[kTaps], slope[kTaps];
        cubic_taps(shift.x - whole.x, across, slope);
        cubic_taps(shift.y - whole.y, down, slope);
        const float* corner = patch_ + (static_cast<int>(whole.y) + 1) * stride_ + static_cast<int>(whole.x) + 1;
        Floats of[kSums] = {};
        int block = 0;
        for (; block + kFloats <= n_; block += kFloats) block_sums<false, kFetch>(corner + block, block, across, down, of);
        if (block < n_) block_sums<true, kFetch>(corner + block, block, across, down, of);
        alignas(64) float sum_of[kSums];
        sums(of, sum_of);
        std::memcpy(result, sum_of, sizeof *result);
    }

    // Adds the sums of a block of columns and stores M. Rows interpolated along x stay in registers for the four taps
    // down.
    template <bool kInPart, bool kFetch>
    void block_sums(const float* from, int block, const float* across, const float* down, Floats* of) {
        const int stride = stride_, row = row_, n = n_;
        const Floats along_0 = all(across[0]), along_1 = all(across[1]), along_2 = all(across[2]), along_3 = all(across[3]);
        const Floats down_0 = all(down[0]), down_1 = all(down[1]), down_2 = all(down[2]), down_3 = all(down[3]);
        const auto along = [&](const float* place) {
            return load(place) * along_0 + load(place + 1) * along_1 + load(place + 2) * along_2 + load(place + 3) * along_3;
        };
        Floats with_own = of[0], with_x = of[1], with_y = of[2], sum = of[3], squares = of[4];
        const Beginning inside(kInPart ? n - block : kFloats);
        const float *own = samples_[0] + block, *gx = samples_[1] + block, *gy = samples_[2] + block;
        float* matched = matched_ + block;
        std::uintptr_t awaited = awaited_;
        Floats first = along(from), second = along(from + stride), third = along(from + 2 * stride);
        from += 3 * stride;
        for (int r = 0; r < n; ++r, from += stride, own += row, gx += row, gy += row, matched += row) {
            if constexpr (kFetch)
                for (int k = 0; k < 3; ++k) FINGERFLOW_PREFETCH(awaited += 64);  // beyond the samples, too, which is harmless
            const Floats fourth = along(from);
            Floats m = first * down_0 + second * down_1 + third * down_2 + fourth * down_3;
            if (kInPart) m = inside.of(m);
            store(matched, m);
            with_own += load(own) * m;
            with_x += load(gx) * m;
            with_y += load(gy) * m;
            sum += m;
            squares += m * m;
            first = second;
            second = third;
            third = fourth;
        }
        awaited_ = awaited;
        of[0] = with_own;
        of[1] = with_x;
        of[2] = with_y;
        of[3] = sum;
        of[4] = squares;
    }

    // Sum over the window of D grad D for the residual D = M - gain T - offset: half the difference of D^2 between
    // opposite edges.
    Vector edges(float gain, float offset) const {
        const int last_row = (n_ - 1) * row_;
        Floats down = all(0), right = all(0), left = all(0);
        const auto square = [&](int k) {
            const Floats rest = load(matched_ + k) - load(samples_[0] + k) * all(gain) - all(offset);
            return rest * rest;
        };
        // Padding cancels in the difference of two rows.
        const int last = (n_ - 1) / kFloats * kFloats;
        for (int c = 0; c <= last; c += kFloats) down += square(last_row + c) - square(c);
        for (int k = 0; k <= last_row; k += row_) {
            left += square(k);
            right += square(k + last);
        }
        float total[kFloats], of_left[kFloats], of_right[kFloats];
        store(total, down);
        store(of_left, left);
        store(of_right, right);
        float sum = 0;
        for (int k = 0; k < kFloats; ++k) sum += total[k];
        return {(of_right[n_ - 1 - last] - of_left[0]) / 2, sum / 2};
    }

    // Result of one step from the guess: position, status, error and noise.
    Look judge(std::int64_t image, Vector guess, const Sums& of) const {
        const float samples = static_cast<float>(n_ * n_), energy = numbers_[kEnergy], some_energy = energy < kTiny ? kTiny : energy;
        const bool free = numbers_[kGain] > 0;
        const Matrix inverse{numbers_[kInverseXx], numbers_[kInverseXy], numbers_[kInverseXy], numbers_[kInverseYy]};
        const float gain = free ? of.tm / some_energy : 1.0f, steep = gain > 0 ? (gain > kLeastGain ? gain : kLeastGain) : 1 / kMostGain;
        // The frame's gradient is taken as gain times the template's; the error of this is proportional to the step.
        const Vector missing{of.gx - numbers_[kConstantX], of.gy - numbers_[kConstantY]};
        const Vector last = inverse * Vector{missing.x / steep, missing.y / steep};
        const bool converged = length(last) < kLastStep;  // false for NaN
        Look result;
        result.found = {guess.x - last.x, guess.y - last.y};

        const float bb = of.mm - of.m * of.m / samples;
        const float turn = gain * (last.x * missing.x + last.y * missing.y);
        const float unlike = (bb - of.tm * of.tm / some_energy) - turn;
        const float left = free ? unlike : of.mm - 2 * of.tm + energy - turn;
        const float rounding = all_.rounding;
        float pixel = left / ((samples - 4) * kValueNoise);
        if (pixel < 2 * rounding) pixel = 2 * rounding;
        result.scale = pixel / (gain * gain);

        const float error = length(inverse * edges(gain, free ? of.m / samples : 0.0f)) / (gain * gain);
        const float variance = all_.variance == nullptr ? numbers_[kNoise] : all_.variance[image];
        const float noise_energy = variance * (samples * kValueNoise);
        const float left_key = energy - noise_energy, left_frame = bb - noise_energy;
        const float common = (left_key < 0 ? 0 : left_key) * (left_frame < 0 ? 0 : left_frame);
        const float explained = of.tm > 0 ? (bb - unlike) * energy : 0.0f;
        // A step out of the frame that has not converged goes on.
        if (!is_within(result.found) && (converged || !is_within(guess))) result.status = kLeftFrame;
        else if (!is_finite(of.m)) result.status = kNotFinite;
        else if (!(numbers_[kTextured] > 0)) result.status = kNoTexture;
        else if (!converged) result.status = kNotConverged;
        else if (!(common * (1 - all_.mismatch_limit) <= explained)) result.status = kMismatch;
        else if (!(error <= all_.forward_backward_limit)) result.status = kForwardBackward;
        else result.status = kTracked;
        const bool none = result.status == kNotFinite || result.status == kLeftFrame || result.status == kNoTexture || result.status == kNotConverged;
        result.error = none ? NAN : error;
        result.estimate = guess;
        if (is_finite(last)) result.estimate = {guess.x - clamped(last.x, -kReach, kReach), guess.y - clamped(last.y, -kReach, kReach)};
        return result;
    }

    bool is_within(Vector place) const { return numbers_[kInside] > 0 && contains(place, all_.frames, n_); }

    static constexpr int kSums = whole_floats(5);

    const fingerflow_found_templates& all_;
    const int n_, row_, stride_;
    const float* numbers_ = nullptr;  // template statistics of the point
    std::uintptr_t awaited_ = 0;  // address of the line before the next template's samples that are not yet prefetched
    Matrix spread_{};
    float* memory_[3]{};
    const float* samples_[3]{};
    float* patch_ = nullptr;
    float* matched_ = nullptr;
    float* lines_ = nullptr;
};

}  // namespace

// Of a workspace that is aligned to 64.
std::int64_t templates_workspace_bytes(int window) { return 4 * (Preparer::floats(window) + Finder::floats(window)); }

void prepare_templates(const fingerflow_prepared_templates& all, const std::int64_t* order, std::int64_t first, std::int64_t last, void* workspace) {
    Preparer preparer(all, static_cast<float*>(workspace));
    const int n = all.window;
    for (std::int64_t k = first; k < last; ++k) {
        float* to = all.samples + order[k] * 3 * n * n;
        const bool known = preparer.prepare(order[k]);
        for (int i = 0; i < 3; ++i)
            for (int r = 0; r < n; ++r, to += n) {
                if (known) std::memcpy(to, preparer.samples()[i] + r * row_of(n), static_cast<std::size_t>(n) * sizeof(float));
                else std::memset(to, 0, static_cast<std::size_t>(n) * sizeof(float));
            }
    }
}

void find_templates(const fingerflow_found_templates& all, const std::int64_t* order, std::int64_t first, std::int64_t last, void* workspace) {
    Finder finder(all, static_cast<float*>(workspace));
    for (std::int64_t k = first; k < last; ++k) {
        if (all.steps == 1 && k + 1 < last) finder.expect(order[k + 1]);
        finder.follow(order[k]);
    }
}

// Prepares and finds templates in one frame, without storing samples.
void find_pairs(const fingerflow_prepared_templates& ones, const fingerflow_found_templates& others, const std::int64_t* order,
                std::int64_t first, std::int64_t last, void* workspace) {
    auto* const memory = static_cast<float*>(workspace);
    Preparer preparer(ones, memory);
    Finder finder(others, memory + Preparer::floats(ones.window));
    for (std::int64_t k = first; k < last; ++k) {
        preparer.prepare(order[k]);
        finder.follow(order[k], preparer.samples());
    }
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow

#if FINGERFLOW_ONCE

#include <algorithm>
#include <utility>
#include <vector>

#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
FINGERFLOW_OTHER_SETS(templates_workspace_bytes)
FINGERFLOW_OTHER_SETS(prepare_templates)
FINGERFLOW_OTHER_SETS(find_templates)
FINGERFLOW_OTHER_SETS(find_pairs)
}  // namespace fingerflow

namespace {

constexpr float kBandPx = 16;

// Order of positions (count, 2): by image, then by band of rows, then by column.
std::vector<std::int64_t> in_bands(const float* places, std::int64_t count, std::int64_t points, std::int64_t height) {
    std::vector<std::pair<std::pair<std::int64_t, float>, std::int64_t>> keys;
    keys.reserve(static_cast<std::size_t>(count));
    const float last = static_cast<float>(height) / kBandPx;
    const std::int64_t bands = static_cast<std::int64_t>(last) + 1;
    for (std::int64_t k = 0; k < count; ++k) {
        const float x = places[2 * k], band = places[2 * k + 1] / kBandPx;
        const std::int64_t row = band > 0 ? static_cast<std::int64_t>(std::min(band, last)) : 0;  // 0 for NaN
        keys.push_back({{k / points * bands + row, x > 0 ? x : 0.0f}, k});
    }
    std::sort(keys.begin(), keys.end());
    std::vector<std::int64_t> order;
    order.reserve(keys.size());
    for (const auto& key : keys) order.push_back(key.second);
    return order;
}

// Calls work(order, first, last, workspace) for pieces of `count` points in bands of a frame's rows.
template <class Work>
void share_out(const Work& work, const float* places, std::int64_t count, std::int64_t points, std::int64_t height, int window, int threads) {
    using namespace fingerflow;
    const std::vector<std::int64_t> order = in_bands(places, count, points, height);
    const auto bytes = static_cast<std::size_t>(FINGERFLOW_PICK(templates_workspace_bytes)(window));
    for_ranges(count, 16, threads, [&](std::int64_t first, std::int64_t last) { work(order.data(), first, last, workspace(bytes)); });
}

}  // namespace

void fingerflow_prepare_templates(const fingerflow_prepared_templates* given, int threads) {
    using namespace fingerflow;
    const auto some = [&](auto... piece) { FINGERFLOW_PICK(prepare_templates)(*given, piece...); };
    share_out(some, given->start, given->image.batch * given->points, given->points, given->image.height, given->window, threads);
}

void fingerflow_find_templates(const fingerflow_found_templates* given, int threads) {
    using namespace fingerflow;
    const auto some = [&](auto... piece) { FINGERFLOW_PICK(find_templates)(*given, piece...); };
    share_out(some, given->place, given->recordings * given->points, given->points, given->frames.height, given->window, threads);
}

// Both at once, of images and as many others with the same strides, points at rest in place: samples are kept nowhere.
void fingerflow_find_pairs(const fingerflow_frames* previous /* 4 x 4 whole */, const void* current /* previous (batch, 1, height, width) */,
    std::int64_t points, float* start /* (batch, points, 2) updated */, const float* inverse_warp /* (batch, points, 2, 2) optional */,
    const float* variance /* (batch) */, int window /* from 5 to 4095 by 2 */, int gain_offset, int rounds, float* place /* (batch, points, 2) updated */,
    float* speed /* (batch, points, 2) updated optional */, float rounding, float forward_backward_limit, float mismatch_limit,
    float* numbers /* (batch, points, 32) */, float* found /* (batch, points, 2) */, float* error /* (batch, points) */,
    float* covariance /* (batch, points, 2, 2) */, unsigned char* status /* (batch, points) */, float* estimate /* (batch, points, 2) */, int threads) {
    using namespace fingerflow;
    const std::int64_t batch = previous->batch;
    Frames frames = *previous;
    frames.data = current;
    const fingerflow_prepared_templates ones{*previous, start, inverse_warp, variance, nullptr, numbers, points, window, gain_offset, rounding};
    const fingerflow_found_templates others{frames, start, nullptr, numbers, variance, place, speed, found, error, covariance, status, estimate,
                                            batch, points, 1, window, rounds, rounding, forward_backward_limit, mismatch_limit};
    const auto some = [&](auto... piece) { FINGERFLOW_PICK(find_pairs)(ones, others, piece...); };
    share_out(some, start, batch * points, points, previous->height, window, threads);
}

#endif
