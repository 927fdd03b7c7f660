// Lucas-Kanade on correlation tables of cubic splines, one point after the other; see fingerflow/ops/tracking.py, windows.py and
// correlation_table.py for the equations. Sums run in another order than there, so results differ by rounding.
#include "tracking_points.h"

#include <math.h>

#include <cstddef>

#include "floats.h"
#include "patches.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

constexpr int kReach = 1;                     // px the estimate may move within one table
constexpr int kPositions = 2 * kReach + 3;    // integer positions in a table, each way
constexpr float kMostGain = 8.0f;             // contrast of an image over that of the template
constexpr float kLeap = 4.0f;                 // px that a first step may lead, out of its table
constexpr int kRounds = 5;                    // tables a point may use up
constexpr int kSteps = 9;                     // on one table
// px; after a smaller step of Gauss and Newton, which leaves about a fifth of the error, Newton's own steps are safe; after a
// smaller one of those, which squares the error, nothing is left to gain.
constexpr float kNewtonNear = 0.05f, kSettled = 1e-3f;
constexpr float kSettledGaussNewton = 1e-5f;
constexpr float kConverged = 1e-2f;           // px; an exact Newton step of that length leaves some 1e-5
constexpr int kReturnSteps = 6;               // of Newton on the way back of a deformed window
constexpr float kTextureToNoise = 2.0f;
constexpr float kTiny = 1.17549435e-38f;  // the least normal number
constexpr float kValueNoise = 0.0907f, kGradientNoise = 0.0488f;

enum Status : unsigned char {
    kTracked = 0, kNotFinite, kLeftFrame, kNoTexture, kNotConverged, kMismatch, kForwardBackward
};

struct Vector {
    float x, y;
};
struct Matrix {
    float xx, xy, yx, yy;
};

bool is_finite(float value) { return value - value == 0.0f; }
bool is_finite(const Vector& value) { return is_finite(value.x) && is_finite(value.y); }

bool is_finite(const Matrix& m) { return is_finite(m.xx) && is_finite(m.xy) && is_finite(m.yx) && is_finite(m.yy); }

float length(const Vector& v) { return sqrtf(v.x * v.x + v.y * v.y); }
Vector operator-(const Vector& a, const Vector& b) { return {a.x - b.x, a.y - b.y}; }
Vector operator*(const Matrix& m, const Vector& v) { return {m.xx * v.x + m.xy * v.y, m.yx * v.x + m.yy * v.y}; }

Matrix inverse(const Matrix& m) {
    const float determinant = m.xx * m.yy - m.xy * m.yx;
    return {m.yy / determinant, -m.xy / determinant, -m.yx / determinant, m.xx / determinant};
}

// What is not a number becomes `low`: nothing else is ever made an index.
float clamped(float value, float low, float high) { return value > low ? (value < high ? value : high) : low; }
float finite_or_zero(float value) { return is_finite(value) ? value : 0.0f; }

// Weights of the four taps around a position, the first one before its floor, and their derivatives.
constexpr int kOrder = 3, kTaps = kOrder + 1;
template <class Number>
void cubic_taps(Number fraction, Number* value, Number* slope) {
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

// The rows of a window lie as far apart as those of the patch that a table is built from, so that one index runs over
// both: zeros end each row of the window.
struct Layout {
    int window, stride, span;  // span: a row in whole vectors
    explicit Layout(int window) : window(window), stride(window + kPositions - 1), span(whole_floats(window)) {}
    int values() const { return whole_floats(window * stride); }
    int buffer() const { return values() + span + kFloats; }  // a warped row is written in whole vectors
    int patch() const { return stride * stride; }
    int patch_buffer() const { return patch() + 2 * kPatchBlock; }
    int rows() const { return whole_floats(window * stride + kOrder) + kFloats; }
    int wide() const { return patch_span(2 * stride); }  // side of what a warped window may reach over in one patch
    int wide_buffer() const { return wide() * wide() + 2 * kPatchBlock; }
    int lines() const { return (wide() + 2) * wide(); }
};

struct Window {
    float* value;
    float* along_x;
    float* along_y;
};

struct Equations {
    float mean;       // of the template
    Matrix hessian;   // sum of g g^T
    Vector constant;  // sum of g T
};

struct Match {
    Vector place;
    bool inside;
    float step;
};

// Coefficients around a whole position, as far as a table needs them.
struct Patch {
    float* values;
    Vector center;
    bool filled;
};

class Tracker {
public:
    Tracker(const TrackedPair& pair, float* memory) : pair_(pair), layout_(pair.window), last_(pair.window - layout_.span + kFloats) {
        const auto take = [&](int count) {
            float* piece = memory;
            memory += whole_floats(count);
            for (int k = 0; k < whole_floats(count); ++k) piece[k] = 0.0f;
            return piece;
        };
        template_ = {take(layout_.buffer()), take(layout_.buffer()), take(layout_.buffer())};
        matched_ = {take(layout_.buffer()), take(layout_.buffer()), take(layout_.buffer())};
        for (Patch& patch : patches_) patch = {take(layout_.patch_buffer()), {0, 0}, false};
        rows_ = take(layout_.rows());
        row_slopes_ = take(layout_.rows());
        inside_ = reinterpret_cast<std::int32_t*>(take(layout_.values()));
        for (int k = 0; k < layout_.values(); ++k) inside_[k] = 0;
        for (int r = 0; r < layout_.window; ++r)
            for (int c = 0; c < layout_.window; ++c) inside_[r * layout_.stride + c] = -1;
        if (pair.warp != nullptr) {
            wide_ = memory;
            memory += whole_floats(layout_.wide_buffer());
        }
        lines_ = memory;
    }

    static std::int64_t floats(int window) {
        const Layout layout(window);
        return 6 * whole_floats(layout.buffer()) + 2 * whole_floats(layout.patch_buffer()) + 2 * whole_floats(layout.rows()) +
               layout.values() + whole_floats(layout.wide_buffer()) + layout.lines();
    }

    void track(std::int64_t point) {
        const auto at = [&](const float* values) { return Vector{values[2 * point], values[2 * point + 1]}; };
        const Vector start = at(pair_.start), guess = at(pair_.guess);
        const bool warped = pair_.warp != nullptr;
        Matrix warp{1, 0, 0, 1};
        if (warped) {
            const float* w = pair_.warp + 4 * point;
            warp = {w[0], w[1], w[2], w[3]};
        }
        const Matrix inverse_warp = inverse(warp);
        const bool given = is_finite(start) && is_finite(guess) && is_finite(warp) && is_finite(inverse_warp);
        if (!given) return write(point, {NAN, NAN}, NAN, {NAN, NAN, NAN, NAN}, kNotFinite);

        image_ = pair_.image_index[point];
        patches_[0].filled = patches_[1].filled = false;
        level_ = pixel(start);
        if (warped) sample_warped(0, start, inverse_warp, template_);
        else sample(0, start, template_);
        if (pair_.gain_offset) take_out_gain_and_offset(template_);
        const Equations forward = equations(template_);
        const Matrix& hessian = forward.hessian;
        bool converged = false;
        const Vector found = solve(1, guess, template_, forward, &converged);

        // In the current image windows are squares; only the template is deformed.
        sample(1, found, matched_);
        const float matched_mean = total(matched_.value) / samples();
        float variance, unexplained;
        compare(forward.mean, matched_mean, pair_.noise[point], &variance, &unexplained);
        float error = NAN;
        if (converged) {
            if (pair_.gain_offset) take_out_gain_and_offset(matched_);
            const bool searched = pair_.back_guess != nullptr;
            if (warped) error = return_warped(start, searched ? at(pair_.back_guess) : start, inverse_warp);
            else if (searched) error = return_by_table(start, at(pair_.back_guess));
            else error = return_straight(start, found - guess);
        }

        const float middle = (hessian.xx + hessian.yy) / 2, apart = (hessian.xx - hessian.yy) / 2;
        const float spread = sqrtf(apart * apart + hessian.xy * hessian.xy);
        const float noise = pair_.noise[point] * pair_.noise[point];
        const float noise_energy = samples() * (noise < pair_.rounding ? pair_.rounding : noise) * kGradientNoise;
        const float least = kTextureToNoise * noise_energy, rounded = 1e-4f * middle;
        const bool textured = middle - spread > (least > rounded ? least : rounded);

        Status status = kTracked;
        if (!(is_finite(forward.mean) && is_finite(matched_mean))) status = kNotFinite;
        else if (!(contains(start) && contains(found))) status = kLeftFrame;
        else if (!textured) status = kNoTexture;
        else if (!converged) status = kNotConverged;
        else if (!(unexplained <= pair_.mismatch_limit)) status = kMismatch;
        else if (!(error <= pair_.forward_backward_limit)) status = kForwardBackward;

        const Matrix inverted = inverse(hessian);
        const float scale = status == kTracked ? 2 * variance : NAN;
        const Matrix covariance{scale * inverted.xx, scale * inverted.xy, scale * inverted.yx, scale * inverted.yy};
        write(point, status == kTracked ? found : Vector{NAN, NAN}, error, covariance, status);
    }

private:
    // Distance from the start at which the way back of the matched window ends, which begins as far from there as the way
    // there did; NaN where it ends nowhere.
    float return_straight(Vector start, Vector moved) {
        if (fabsf(moved.x) < kReach && fabsf(moved.y) < kReach) {
            // The template holds the image at the start: where one step from there is all that is left, no table is needed.
            const float left = length(newton_step());
            if (left < kConverged) return left;
        }
        return return_by_table(start, {start.x + moved.x, start.y + moved.y});
    }

    // The same from a guess.
    float return_by_table(Vector start, Vector guess) {
        bool converged = false;
        const Vector back = solve(0, guess, matched_, equations(matched_), &converged);
        return converged ? length(back - start) : NAN;
    }

    // The same by Newton's steps in the image deformed like the template, which is still there from the way there.
    float return_warped(Vector start, Vector place, const Matrix& inverse_warp) {
        bool sampled = place.x == start.x && place.y == start.y;
        for (int iteration = 0; iteration < kReturnSteps; ++iteration, sampled = false) {
            if (!sampled) sample_warped(0, place, inverse_warp, template_);
            const Vector whole = newton_step(), step{clamped(whole.x, -1, 1), clamped(whole.y, -1, 1)};
            if (!is_finite(whole)) return NAN;
            place = place - inverse_warp * step;
            if (length(step) < kConverged) return length(place - start);
        }
        return NAN;
    }

    // From where the template was taken towards where it equals the matched window, weighted by that one's gradient.
    Vector newton_step() const {
        Floats of[whole_floats(6)] = {};
        for (int k = 0; k < layout_.values(); k += kFloats) {
            const Floats x = load(matched_.along_x + k), y = load(matched_.along_y + k);
            const Floats slope_x = load(template_.along_x + k), slope_y = load(template_.along_y + k);
            const Floats difference = load(template_.value + k) - load(matched_.value + k);
            of[0] += x * slope_x;
            of[1] += x * slope_y;
            of[2] += y * slope_x;
            of[3] += y * slope_y;
            of[4] += x * difference;
            of[5] += y * difference;
        }
        float sum_of[whole_floats(6)];
        sums(of, sum_of);
        return inverse({sum_of[0], sum_of[1], sum_of[2], sum_of[3]}) * Vector{sum_of[4], sum_of[5]};
    }

    void write(std::int64_t point, Vector place, float error, Matrix covariance, Status status) {
        pair_.points[2 * point] = place.x;
        pair_.points[2 * point + 1] = place.y;
        pair_.error[point] = error;
        float* c = pair_.covariance + 4 * point;
        c[0] = covariance.xx;
        c[1] = covariance.xy;
        c[2] = covariance.yx;
        c[3] = covariance.yy;
        pair_.status[point] = status;
    }

    float samples() const { return static_cast<float>(layout_.window * layout_.window); }

    bool contains(Vector place) const {
        const float half = static_cast<float>(layout_.window / 2);
        return place.x >= half && place.y >= half && place.x <= static_cast<float>(pair_.images[0].width - 1) - half &&
               place.y <= static_cast<float>(pair_.images[0].height - 1) - half;
    }

    // However far outside the frame, what is cut there is its border.
    std::int64_t column(float x) const {
        const float far = static_cast<float>(2 * layout_.stride);
        return static_cast<std::int64_t>(clamped(x, -far, static_cast<float>(pair_.images[0].width) + far));
    }
    std::int64_t row(float y) const {
        const float far = static_cast<float>(2 * layout_.stride);
        return static_cast<std::int64_t>(clamped(y, -far, static_cast<float>(pair_.images[0].height) + far));
    }

    // The grey level of the first image at a place. Taken off everywhere, it leaves float32 sums that do not cancel.
    float pixel(Vector place) const {
        const Frames& frames = pair_.images[0];
        const std::int64_t x = nearest(column(rintf(place.x)), frames.width), y = nearest(row(rintf(place.y)), frames.height);
        const auto read = [&](const auto* data) {
            return static_cast<float>(data[image_ * frames.frame_stride + y * frames.row_stride + x]);
        };
        FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, read)
    }

    void cut(int which, const Rectangle& where, float* to, int stride) {
        const Frames& frames = pair_.images[which];
        const auto from = [&](const auto* data) {
            cut_patch(data + image_ * frames.frame_stride, frames, where, level_, lines_, to, stride);
        };
        FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, from)
    }

    void cut_taps(int which, const Rectangle& where, float* to) const {
        const Frames& frames = pair_.images[which];
        const auto from = [&](const auto* data) {
            cut_anywhere(data + image_ * frames.frame_stride, frames, where, level_, to, kTaps);
        };
        FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, from)
    }

    // The patch of an image around a whole position.
    const float* patch(int which, Vector center) {
        Patch& kept = patches_[which];
        if (!kept.filled || kept.center.x != center.x || kept.center.y != center.y) {
            const float first = static_cast<float>(layout_.window / 2 + kReach + 1);
            kept.center = center;
            kept.filled = true;
            cut(which, {column(center.x - first), row(center.y - first), layout_.stride, layout_.stride}, kept.values, layout_.stride);
            for (int k = 0; k < kPatchBlock; ++k) kept.values[layout_.patch() + k] = 0.0f;
        }
        return kept.values;
    }

    // The spline and its gradient on the window around a place.
    void sample(int which, Vector place, const Window& to) {
        Vector center = patches_[which].center;
        const bool near = patches_[which].filled && fabsf(place.x - center.x) <= kReach && fabsf(place.y - center.y) <= kReach;
        if (!near) center = {rintf(place.x), rintf(place.y)};
        const float* values = patch(which, center);
        const Vector shift{place.x - center.x, place.y - center.y};
        const Vector whole{shift.x < 0 ? -1.0f : 0.0f, shift.y < 0 ? -1.0f : 0.0f};
        float across[kTaps], across_slope[kTaps], down[kTaps], down_slope[kTaps];
        cubic_taps(shift.x - whole.x, across, across_slope);
        cubic_taps(shift.y - whole.y, down, down_slope);
        const int stride = layout_.stride;
        values += (static_cast<int>(whole.y) + kReach) * stride + static_cast<int>(whole.x) + kReach;
        // All rows first, then the columns: what was stored a moment ago cannot be loaded in other pieces at once.
        float *const rows = rows_, *const row_slopes = row_slopes_;  // members would be read again after every store
        for (int k = 0, end = layout_.rows() - kFloats; k < end; k += kFloats) {
            Floats value = all(0), slope = all(0);
            FINGERFLOW_UNROLL
            for (int i = 0; i < kTaps; ++i) {
                const Floats tap = held(load(values + k + i * stride));
                value += tap * all(down[i]);
                slope += tap * all(down_slope[i]);
            }
            store(rows + k, value);
            store(row_slopes + k, slope);
        }
        const Window out = to;
        const std::int32_t* const inside = inside_;
        for (int k = 0, end = layout_.values(); k < end; k += kFloats) {
            Floats value = all(0), along_x = all(0), along_y = all(0);
            FINGERFLOW_UNROLL
            for (int i = 0; i < kTaps; ++i) {
                const Floats tap = held(load(rows + k + i));
                value += tap * all(across[i]);
                along_x += tap * all(across_slope[i]);
                along_y += load(row_slopes + k + i) * all(across[i]);
            }
            store(out.value + k, kept(value, inside + k));
            store(out.along_x + k, kept(along_x, inside + k));
            store(out.along_y + k, kept(along_y, inside + k));
        }
    }

    // The same with samples at place + A w.
    void sample_warped(int which, Vector place, const Matrix& warp, const Window& to) {
        constexpr float kLast = 2;
        // Kept where all taps exist; a window that reaches beyond the frame is no result, whatever is sampled there.
        const float right = static_cast<float>(pair_.images[0].width - 1) - kLast, bottom = static_cast<float>(pair_.images[0].height - 1) - kLast;
        const auto outermost = static_cast<float>(layout_.window / 2);
        const float away_x = outermost * (fabsf(warp.xx) + fabsf(warp.xy)), away_y = outermost * (fabsf(warp.yx) + fabsf(warp.yy));
        const Range x_range = range(place.x, away_x, right), y_range = range(place.y, away_y, bottom);
        const Rectangle where{x_range.first, y_range.first, y_range.count, x_range.count};
        const int stride = patch_span(where.columns);
        const bool in_one_piece = where.rows <= layout_.wide() && stride <= layout_.wide();
        if (in_one_piece) cut(which, where, wide_, stride);
#if defined(FINGERFLOW_LOOKUP)
        // Wholly inside, and no row of the window so steep or so stretched that a vector of its samples needs taps from more
        // than five rows, or from more than two vectors of one.
        const bool inside = place.x - away_x >= 2 && place.y - away_y >= 2 && place.x + away_x <= right - 1 && place.y + away_y <= bottom - 1;
        constexpr float kApart = kFloats - 1;
        const bool gentle = warp.xx > 0 && warp.xx * kApart < 2 * kFloats - kTaps - 1 && fabsf(warp.yx) * kApart < 1;
        if (in_one_piece && inside && gentle)
            return sample_gently(where, stride, place, warp, to);
#endif
        sample_anywhere(which, in_one_piece, where, stride, {right, bottom}, place, warp, to);
    }

#if defined(FINGERFLOW_LOOKUP)
    // The samples of a vector need five rows of taps at most: each is loaded once, in two vectors, and its numbers are picked
    // in registers. The cut patch is where they all are.
    void sample_gently(const Rectangle& where, int stride, Vector place, Matrix warp, Window to) const {
        const int n = layout_.window, half = n / 2;
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
                // Those behind the last column repeat it.
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
                const auto add_row = [&](int i, const Floats& weight, const Floats& weight_slope) {
                    const Floats low = load(taps + i * stride), high = load(taps + i * stride + kFloats);
                    Floats tap = looked_up(low, high, index);
                    Floats row_value = tap * across[0], row_slope = tap * across_slope[0];
                    FINGERFLOW_UNROLL
                    for (int j = 1; j < kTaps; ++j) {
                        tap = looked_up(low, high, index + j);
                        row_value += tap * across[j];
                        row_slope += tap * across_slope[j];
                    }
                    value += row_value * weight;
                    along_x += row_slope * weight;
                    along_y += row_value * weight_slope;
                };
                if (top == lowest) {
                    FINGERFLOW_UNROLL
                    for (int i = 0; i < kTaps; ++i) add_row(i, below[i], below_slope[i]);
                } else {
                    // A sample that lies one row lower has its first tap one row later.
                    const Integers lower = whole_y > top;
                    add_row(0, lower ? all(0) : below[0], lower ? all(0) : below_slope[0]);
                    FINGERFLOW_UNROLL
                    for (int i = 1; i < kTaps; ++i)
                        add_row(i, lower ? below[i - 1] : below[i], lower ? below_slope[i - 1] : below_slope[i]);
                    add_row(kTaps, lower ? below[kTaps - 1] : all(0), lower ? below_slope[kTaps - 1] : all(0));
                }
                write_samples(to, r, c, warp, value, along_x, along_y);
            }
        }
    }
#endif

    // Chain rule: d/dw = A^T d/dx. Behind the last column come zeros, for sums run over whole vectors.
    void write_samples(const Window& to, int r, int c, const Matrix& warp, Floats value, Floats x, Floats y) const {
        Floats along_x = all(warp.xx) * x + all(warp.yx) * y, along_y = all(warp.xy) * x + all(warp.yy) * y;
        if (c + kFloats > layout_.window) {
            value = last_.of(value);
            along_x = last_.of(along_x);
            along_y = last_.of(along_y);
        }
        const int place = r * layout_.stride + c;
        store(to.value + place, value);
        store(to.along_x + place, along_x);
        store(to.along_y + place, along_y);
    }

    // Any window: samples are kept between the first and the last place with all its taps, which come from the cut patch, or
    // from the frame itself.
    void sample_anywhere(int which, bool in_one_piece, const Rectangle& where, int stride, Vector last, Vector place,
                         const Matrix& warp, const Window& to) {
        constexpr float kFirst = 1;
        const int n = layout_.window, half = n / 2;
        float* const columns = rows_;  // those behind the last one repeat it
        for (int k = 0; k < layout_.span; ++k) columns[k] = static_cast<float>(k < n ? k - half : half);
        for (int r = 0; r < n; ++r) {
            const float down = static_cast<float>(r - half);
            for (int c = 0; c < layout_.span; c += kFloats) {
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
                        cut_taps(which, {x.whole[k] - 1, y.whole[k] - 1, kTaps, kTaps}, around);
                        return around;
                    }, kTaps, &at);
                }
                write_samples(to, r, c, warp, at.value, at.along_x, at.along_y);
            }
        }
    }

    // What samples of a warped window along one axis may touch, as far as the frame goes: from `first` on.
    struct Range {
        std::int64_t first;
        int count;
    };
    static Range range(float place, float away, float limit) {
        const float low = place - away, high = place + away;
        if (!(is_finite(low) && is_finite(high))) return {0, static_cast<int>(limit) + kOrder};
        // One pixel more on either side than the taps take, for rounding.
        const int begin = static_cast<int>(clamped(floorf(low), 1, limit)) - 2;
        const int end = static_cast<int>(clamped(floorf(high), 1, limit)) + kOrder, border = static_cast<int>(limit) + 2;
        const int from = begin < 0 ? 0 : begin;
        return {from, (end > border ? border : end) - from + 1};
    }

    struct Samples {
        Floats value, along_x, along_y;
    };

    // The spline at positions whose taps lie anywhere: taps(k) gives the first of sample k, rows `stride` apart.
    template <class Taps>
    static void interpolate(const Split& x, const Split& y, const Taps& taps, int stride, Samples* at) {
        Floats across[kTaps], across_slope[kTaps], below[kTaps], below_slope[kTaps];
        cubic_taps(x.fraction, across, across_slope);
        cubic_taps(y.fraction, below, below_slope);
        // First down the columns, four at a time as they lie in memory, for one sample after the other; then across, for
        // all samples at once.
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

    float total(const float* values) const {
        Floats result[kFloats] = {};
        for (int k = 0; k < layout_.values(); k += kFloats) result[0] += load(values + k);
        return folded<kFloats>(result)[0];
    }

    // What the equations need of a template.
    Equations equations(const Window& window) const {
        Floats of[whole_floats(6)] = {};
        for (int k = 0; k < layout_.values(); k += kFloats) {
            const Floats x = load(window.along_x + k), y = load(window.along_y + k), value = load(window.value + k);
            of[0] += x * x;
            of[1] += x * y;
            of[2] += y * y;
            of[3] += value * x;
            of[4] += value * y;
            of[5] += value;
        }
        float sum_of[whole_floats(6)];
        sums(of, sum_of);
        return {sum_of[5] / samples(), {sum_of[0], sum_of[1], sum_of[1], sum_of[2]}, {sum_of[3], sum_of[4]}};
    }

    // Of a template's gradient, so that the equations hold whatever gain and offset are.
    void take_out_gain_and_offset(const Window& window) {
        const float mean = total(window.value) / samples();
        const float mean_x = total(window.along_x) / samples(), mean_y = total(window.along_y) / samples();
        Floats of[whole_floats(3)] = {};
        for (int k = 0; k < layout_.values(); k += kFloats) {
            const Floats centred = kept(load(window.value + k) - all(mean), inside_ + k);
            of[0] += centred * centred;
            of[1] += (load(window.along_x + k) - all(mean_x)) * centred;
            of[2] += (load(window.along_y + k) - all(mean_y)) * centred;
        }
        float sum_of[whole_floats(3)];
        sums(of, sum_of);
        const float energy = sum_of[0] < kTiny ? kTiny : sum_of[0];
        const float share_x = sum_of[1] / energy, share_y = sum_of[2] / energy;
        for (int k = 0; k < layout_.values(); k += kFloats) {
            const Floats centred = load(window.value + k) - all(mean);
            const Floats x = load(window.along_x + k) - all(mean_x) - all(share_x) * centred;
            const Floats y = load(window.along_y + k) - all(mean_y) - all(share_y) * centred;
            store(window.along_x + k, kept(x, inside_ + k));
            store(window.along_y + k, kept(y, inside_ + k));
        }
    }

    // Some rows of positions of a table.
    template <int rows>
    void multiply_rows(const Window& window, const float* patch, int first, float* table) const {
        Floats along_x[rows][kPositions], along_y[rows][kPositions];
        FINGERFLOW_UNROLL
        for (int down = 0; down < rows; ++down) {
            FINGERFLOW_UNROLL
            for (int k = 0; k < kPositions; ++k) along_x[down][k] = along_y[down][k] = all(0);
        }
        const std::ptrdiff_t stride = layout_.stride;
        const float* from = patch + first * stride;
        const float *gradient_x = window.along_x, *gradient_y = window.along_y;
        for (const float* const end = from + layout_.values(); from < end; from += kFloats, gradient_x += kFloats, gradient_y += kFloats) {
            const Floats gx = load(gradient_x), gy = load(gradient_y);
            FINGERFLOW_UNROLL
            for (int down = 0; down < rows; ++down) {
                FINGERFLOW_UNROLL
                for (int k = 0; k < kPositions; ++k) {
                    const Floats sample = held(load(from + down * stride + k));
                    along_x[down][k] += gx * sample;
                    along_y[down][k] += gy * sample;
                }
            }
        }
        constexpr int kCount = rows * kPositions, kWhole = whole_floats(2 * kCount);
        Floats products[kWhole] = {};
        FINGERFLOW_UNROLL
        for (int down = 0; down < rows; ++down) {
            FINGERFLOW_UNROLL
            for (int k = 0; k < kPositions; ++k) {
                products[down * kPositions + k] = along_x[down][k];
                products[kCount + down * kPositions + k] = along_y[down][k];
            }
        }
        float summed[kWhole];
        sums(products, summed);
        float* const to = table + first * kPositions;
        std::memcpy(to, summed, kCount * sizeof(float));
        std::memcpy(to + kPositions * kPositions, summed + kCount, kCount * sizeof(float));
    }

    // C[k] = sum_w g(w) c[k + w] for the integer positions k of a table: component by component, row by row.
    static constexpr int kTable = 2 * kPositions * kPositions, kTableFloats = whole_floats(kTable);
    void build_table(const Window& window, const float* patch, float* table) const {
        for (int k = kTable; k < kTableFloats; ++k) table[k] = 0;
        // Two rows of positions at a time: as many sums as there are registers.
        static_assert(kPositions == 5, "two pairs of rows and one");
        multiply_rows<2>(window, patch, 0, table);
        multiply_rows<2>(window, patch, 2, table);
        multiply_rows<1>(window, patch, 4, table);
    }

    // The root of b(y) = 0 near `shift`, within the reach of a table.
    static void solve_table(const float* table, Vector constant, Matrix inverse_hessian, Vector* shift, float* step) {
        bool newton = false;
        *step = 0;
        for (int iteration = 0; iteration < kSteps; ++iteration) {
            // The table's index of the first tap; at the upper end of the reach the last tap weighs nothing.
            const float whole_x = clamped(floorf(shift->x), -kReach, kReach - 1);
            const float whole_y = clamped(floorf(shift->y), -kReach, kReach - 1);
            const float* line_x = table + (static_cast<int>(whole_y) + kReach) * kPositions + static_cast<int>(whole_x) + kReach;
            const float* line_y = line_x + kPositions * kPositions;
            float taps[kTaps], slopes[kTaps], down[kTaps], down_slope[kTaps];
            cubic_taps(shift->x - whole_x, taps, slopes);
            cubic_taps(shift->y - whole_y, down, down_slope);
            const Floats4 across = load4(taps), across_slope = load4(slopes);
            Floats4 value_x = load4(line_x) * down[0], value_y = load4(line_y) * down[0];
            Floats4 slope_x = load4(line_x) * down_slope[0], slope_y = load4(line_y) * down_slope[0];
            for (int i = 1; i < kTaps; ++i) {
                value_x = value_x + load4(line_x + i * kPositions) * down[i];
                value_y = value_y + load4(line_y + i * kPositions) * down[i];
                slope_x = slope_x + load4(line_x + i * kPositions) * down_slope[i];
                slope_y = slope_y + load4(line_y + i * kPositions) * down_slope[i];
            }
            const Vector residual{sum(value_x * across) - constant.x, sum(value_y * across) - constant.y};
            Matrix jacobian{};
            if (newton || iteration == 0)
                jacobian = {sum(value_x * across_slope), sum(slope_x * across), sum(value_y * across_slope), sum(slope_y * across)};
            Vector move;
            if (newton) {
                // Far from the root, or on the kinks of order 1, Newton may leap: never further than a pixel.
                const Vector whole = inverse(jacobian) * residual;
                move = {clamped(finite_or_zero(whole.x), -1, 1), clamped(finite_or_zero(whole.y), -1, 1)};
            } else {
                if (iteration == 0) {
                    // An image of more contrast than the template has more slope: steps that do not know of it are too long.
                    const Matrix& h = inverse_hessian;
                    const float gain = clamped((h.xx * jacobian.xx + h.xy * jacobian.yx + h.yx * jacobian.xy + h.yy * jacobian.yy) / 2, 1, kMostGain);
                    inverse_hessian = {h.xx / gain, h.xy / gain, h.yx / gain, h.yy / gain};
                }
                move = inverse_hessian * residual;
            }
            if (iteration == 0 && !(fabsf(shift->x - move.x) <= kReach && fabsf(shift->y - move.y) <= kReach)) {
                // The next table begins where this step leads, not at this one's edge.
                *shift = {shift->x - clamped(move.x, -kLeap, kLeap), shift->y - clamped(move.y, -kLeap, kLeap)};
                *step = kLeap;
                return;
            }
            const Vector moved{clamped(shift->x - move.x, -kReach, kReach), clamped(shift->y - move.y, -kReach, kReach)};
            *step = length(*shift - moved);
            *shift = moved;
            if (*step < (newton ? kSettled : kSettledGaussNewton)) break;
            newton = newton || move.x * move.x + move.y * move.y < kNewtonNear * kNewtonNear;
        }
    }

    Vector solve(int which, Vector guess, const Window& window, const Equations& of, bool* converged) {
        Matrix inverted = inverse(of.hessian);
        inverted = {finite_or_zero(inverted.xx), finite_or_zero(inverted.xy), finite_or_zero(inverted.yx), finite_or_zero(inverted.yy)};
        Match match{guess, false, INFINITY};
        for (int round = 0; round < kRounds && !match.inside && is_finite(match.place); ++round) {
            const Vector center{rintf(match.place.x), rintf(match.place.y)};
            float table[kTableFloats];
            build_table(window, patch(which, center), table);
            Floats all_of_it = all(0);
            for (int k = 0; k < kTableFloats; k += kFloats) all_of_it += load(table + k);
            bool finite = true;
            for (int k = 0; k < kFloats; ++k) finite = finite && is_finite(all_of_it[k]);
            if (!finite) {  // a bad pixel within reach
                match.place = {NAN, NAN};
                break;
            }
            Vector shift{match.place.x - center.x, match.place.y - center.y};
            solve_table(table, of.constant, inverted, &shift, &match.step);
            match.place = {center.x + shift.x, center.y + shift.y};
            match.inside = fabsf(shift.x) < kReach && fabsf(shift.y) < kReach;
        }
        *converged = match.inside && match.step < kConverged;
        return {is_finite(match.place.x) ? match.place.x : guess.x, is_finite(match.place.y) ? match.place.y : guess.y};
    }

    void compare(float mean_a, float mean_b, float noise, float* variance, float* unexplained) const {
        Floats of[whole_floats(4)] = {};
        for (int k = 0; k < layout_.values(); k += kFloats) {
            const Floats a = load(template_.value + k), b = load(matched_.value + k), difference = b - a;
            const Floats above_a = kept(a - all(mean_a), inside_ + k), above_b = kept(b - all(mean_b), inside_ + k);
            of[0] += difference * difference;
            of[1] += above_a * above_a;
            of[2] += above_b * above_b;
            of[3] += above_a * above_b;
        }
        float sum_of[whole_floats(4)];
        sums(of, sum_of);
        const float aa = sum_of[1], bb = sum_of[2], ab = sum_of[3];
        float squares = sum_of[0];
        if (pair_.gain_offset) squares = bb - ab * ab / (aa < kTiny ? kTiny : aa);
        *variance = squares / (samples() - 4) / (2 * kValueNoise);
        if (*variance < pair_.rounding) *variance = pair_.rounding;
        const float noise_energy = samples() * noise * noise * kValueNoise;
        const float left_a = aa - noise_energy, left_b = bb - noise_energy;
        const float energy = (left_a < 0 ? 0 : left_a) * (left_b < 0 ? 0 : left_b);
        *unexplained = 1 - ab * (ab < 0 ? 0 : ab) / energy;
    }

    const TrackedPair& pair_;
    const Layout layout_;
    const Beginning last_;  // columns of a row's last vector
    std::int64_t image_ = 0;  // the point's
    float level_ = 0;
    Window template_{}, matched_{};
    Patch patches_[2]{};
    float* rows_ = nullptr;
    float* row_slopes_ = nullptr;
    std::int32_t* inside_ = nullptr;  // which of a window's values are samples, -1, and which only fill, 0
    float* wide_ = nullptr;
    float* lines_ = nullptr;
};

}  // namespace

std::int64_t tracking_workspace_bytes(int window) { return 4 * Tracker::floats(window); }

void track_points(const TrackedPair& pair, std::int64_t first, std::int64_t last, void* workspace) {
    Tracker tracker(pair, static_cast<float*>(workspace));
    for (std::int64_t point = first; point < last; ++point) tracker.track(point);
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
