// Lucas-Kanade on correlation tables of cubic splines, one point after the other; see fingerflow/ops/tracking.py, windows.py and
// correlation_table.py for the equations. Sums run in another order than there, so results differ by rounding.
#include "tracking_points.h"

#include <math.h>

#include "floats.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

constexpr int kReach = 1;                     // px the estimate may move within one table
constexpr int kPositions = 2 * kReach + 3;    // integer positions in a table, each way
constexpr int kRowsAtATime = 8;               // of a window, sampled together
constexpr int kRounds = 5;                    // tables a point may use up
constexpr int kGaussNewtonSteps = 6, kNewtonSteps = 3;
constexpr float kSettled = 1e-5f;             // px; a smaller step changes no result
constexpr float kConverged = 1e-2f;           // px
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
// both: four columns of zeros end each row of the window. Rows are written in whole vectors, one after the other; what a
// vector writes too much the next row replaces.
struct Layout {
    int window, stride, span;  // span: a row in whole vectors
    explicit Layout(int window) : window(window), stride(window + kPositions - 1), span(whole_floats(window)) {}
    int values() const { return whole_floats(window * stride); }
    int buffer() const { return values() + span + kFloats; }
    int patch() const { return stride * stride; }
    int patch_end() const { return whole_floats(kPositions) + span + 2 * kFloats; }  // zeros behind the patch
    int row() const { return whole_floats(window + kOrder) + kFloats; }
};

struct Window {
    float* value;
    float* along_x;
    float* along_y;
};

struct Equations {
    float mean;       // of the template
    Matrix hessian;   // sum of g g^T
    Vector constant;  // sum of g (T - mean)
};

struct Match {
    Vector place;
    bool inside;
    float step;
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
        reference_ = take(layout_.buffer());
        patch_ = take(layout_.patch() + layout_.patch_end());
        rows_ = take(kRowsAtATime * 2 * layout_.row());
    }

    static std::int64_t floats(int window) {
        const Layout layout(window);
        return 7 * whole_floats(layout.buffer()) + whole_floats(layout.patch() + layout.patch_end()) +
               kRowsAtATime * 2 * layout.row();
    }

    void track(std::int64_t point) {
        const auto at = [&](const float* values) { return Vector{values[2 * point], values[2 * point + 1]}; };
        const Vector start = at(pair_.start), guess = at(pair_.guess);
        Matrix warp{1, 0, 0, 1};
        if (pair_.warp != nullptr) {
            const float* w = pair_.warp + 4 * point;
            warp = {w[0], w[1], w[2], w[3]};
        }
        image_ = pair_.image_index[point] * pair_.height * pair_.width;
        const Matrix inverse_warp = inverse(warp);
        const bool given = is_finite(start) && is_finite(guess) && is_finite(warp) && is_finite(inverse_warp);
        if (!given) return write(point, {NAN, NAN}, NAN, {NAN, NAN, NAN, NAN}, kNotFinite);

        sample(0, start, pair_.warp == nullptr ? nullptr : &inverse_warp, template_);
        const float* reference = template_.value;
        if (pair_.warp != nullptr) {
            const Window plain{reference_, matched_.along_x, matched_.along_y};
            sample(0, start, nullptr, plain);
            reference = reference_;
        }
        const Equations forward = equations(template_);
        const Matrix& hessian = forward.hessian;
        bool converged = false;
        const Vector found = solve(1, guess, template_, forward, &converged);

        sample(1, found, pair_.warp == nullptr ? nullptr : &warp, matched_);
        const Equations backward = equations(matched_);
        float variance, unexplained;
        const float samples = static_cast<float>(pair_.window * pair_.window);
        const float mean = pair_.warp == nullptr ? forward.mean : total(reference) / samples;
        compare(reference, matched_.value, mean, backward.mean, pair_.noise[point], &variance, &unexplained);
        const bool finite = is_finite(forward.mean) && is_finite(backward.mean);
        const Vector back_guess = pair_.back_guess != nullptr
                                      ? at(pair_.back_guess)
                                      : Vector{found.x - (guess.x - start.x), found.y - (guess.y - start.y)};
        bool back_converged = false;
        const Vector back = solve(0, back_guess, matched_, backward, &back_converged);
        const float away_x = back.x - start.x, away_y = back.y - start.y;
        const float error = back_converged ? sqrtf(away_x * away_x + away_y * away_y) : INFINITY;

        const float middle = (hessian.xx + hessian.yy) / 2, apart = (hessian.xx - hessian.yy) / 2;
        const float spread = sqrtf(apart * apart + hessian.xy * hessian.xy);
        const float noise = pair_.noise[point] * pair_.noise[point];
        const float noise_energy = samples * (noise < pair_.rounding ? pair_.rounding : noise) * kGradientNoise;
        const float least = kTextureToNoise * noise_energy, rounded = 1e-4f * middle;
        const bool textured = middle - spread > (least > rounded ? least : rounded);

        Status status = kTracked;
        if (!finite) status = kNotFinite;
        else if (!(contains(start) && contains(found))) status = kLeftFrame;
        else if (!textured) status = kNoTexture;
        else if (!converged) status = kNotConverged;
        else if (!(unexplained <= pair_.mismatch_limit)) status = kMismatch;
        else if (!(error <= pair_.forward_backward_limit)) status = kForwardBackward;

        const Matrix inverted = inverse(hessian);
        const float scale = status == kTracked ? 2 * variance : NAN;
        const Matrix covariance{scale * inverted.xx, scale * inverted.xy, scale * inverted.yx, scale * inverted.yy};
        write(point, status == kTracked ? found : Vector{NAN, NAN}, is_finite(error) ? error : NAN, covariance, status);
    }

private:
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

    bool contains(Vector place) const {
        const float half = static_cast<float>(pair_.window / 2);
        return place.x >= half && place.y >= half && place.x <= static_cast<float>(pair_.width - 1) - half &&
               place.y <= static_cast<float>(pair_.height - 1) - half;
    }

    // Rows x columns of coefficients from (x, y) on, less `level`; beyond the border they repeat it.
    void cut(int which, Vector corner, int rows, int columns, float level) {
        const float* image = pair_.coefficients[which] + image_;
        const float far = static_cast<float>(columns + rows);
        // However far outside, what is cut is the border.
        const auto x = static_cast<std::int64_t>(clamped(corner.x, -far, static_cast<float>(pair_.width) + far));
        const auto y = static_cast<std::int64_t>(clamped(corner.y, -far, static_cast<float>(pair_.height) + far));
        const int span = whole_floats(columns);
        for (int r = 0; r < rows; ++r) {
            std::int64_t row = y + r;
            row = row < 0 ? 0 : row >= pair_.height ? pair_.height - 1 : row;
            const float* line = image + row * pair_.width;
            float* to = patch_ + r * layout_.stride;
            // Behind the last column more is read than needed, but nothing behind the last row.
            if (x >= 0 && x + columns <= pair_.width && (row + 1 < pair_.height || x + span <= pair_.width)) {
                for (int c = 0; c < span; c += kFloats) store(to + c, load(line + x + c) - all(level));
            } else {
                for (int c = 0; c < columns; ++c) {
                    std::int64_t column = x + c;
                    column = column < 0 ? 0 : column >= pair_.width ? pair_.width - 1 : column;
                    to[c] = line[column] - level;
                }
            }
        }
        for (int c = 0; c < layout_.patch_end(); ++c) patch_[layout_.patch() + c] = 0.0f;
    }

    // The spline and its gradient on the window around a place; with a warp A samples lie at place + A w.
    void sample(int which, Vector place, const Matrix* warp, const Window& to) {
        if (warp != nullptr) return sample_warped(which, place, *warp, to);
        const int n = layout_.window;
        const float whole_x = floorf(place.x), whole_y = floorf(place.y);
        float across[kTaps], across_slope[kTaps], down[kTaps], down_slope[kTaps];
        cubic_taps(place.x - whole_x, across, across_slope);
        cubic_taps(place.y - whole_y, down, down_slope);
        const float first = static_cast<float>(n / 2 + 1);
        cut(which, {whole_x - first, whole_y - first}, n + kOrder, n + kOrder, 0.0f);
        const int stride = layout_.stride, columns = whole_floats(n + kOrder), apart = layout_.row();
        // Some rows first, then their columns: what was stored a moment ago cannot be loaded in other pieces at once.
        for (int begin = 0; begin < n; begin += kRowsAtATime) {
            const int end = begin + kRowsAtATime < n ? begin + kRowsAtATime : n;
            for (int r = begin; r < end; ++r) {
                const float* line = patch_ + r * stride;
                float* row = rows_ + (r - begin) * 2 * apart;
                for (int c = 0; c < columns; c += kFloats) {
                    Floats value = load(line + c) * all(down[0]), slope = load(line + c) * all(down_slope[0]);
                    for (int k = 1; k < kTaps; ++k) {
                        const Floats tap = held(load(line + k * stride + c));
                        value += tap * all(down[k]);
                        slope += tap * all(down_slope[k]);
                    }
                    store(row + c, value);
                    store(row + apart + c, slope);
                }
            }
            for (int r = begin; r < end; ++r) {
                const float* row = rows_ + (r - begin) * 2 * apart;
                for (int c = 0; c < layout_.span; c += kFloats) {
                    Floats value = all(0), along_x = all(0), along_y = all(0);
                    for (int k = 0; k < kTaps; ++k) {
                        const Floats tap = held(load(row + c + k));
                        value += tap * all(across[k]);
                        along_x += tap * all(across_slope[k]);
                        along_y += load(row + apart + c + k) * all(across[k]);
                    }
                    write(to, r, c, value, along_x, along_y);
                }
            }
        }
    }

    void sample_warped(int which, Vector place, const Matrix& warp, const Window& to) {
        constexpr float kFirst = -1, kLast = 2;
        const float* image = pair_.coefficients[which] + image_;
        const int n = layout_.window, width = static_cast<int>(pair_.width);
        // Kept where all taps exist; a window that reaches beyond the frame is no result, whatever is sampled there.
        const float right = static_cast<float>(pair_.width - 1) - kLast, bottom = static_cast<float>(pair_.height - 1) - kLast;
        float columns[kFloats];
        for (int k = 0; k < kFloats; ++k) columns[k] = static_cast<float>(k - n / 2);
        for (int r = 0; r < n; ++r) {
            const float down = static_cast<float>(r - n / 2);
            for (int c = 0; c < layout_.span; c += kFloats) {
                const Floats along = load(columns) + all(static_cast<float>(c));
                const Split x = split(all(place.x + warp.xy * down) + all(warp.xx) * along, -kFirst, right);
                const Split y = split(all(place.y + warp.yy * down) + all(warp.yx) * along, -kFirst, bottom);
                std::int32_t index[kFloats];
                for (int k = 0; k < kFloats; ++k) index[k] = (y.whole[k] - 1) * width + (x.whole[k] - 1);
                Floats across[kTaps], across_slope[kTaps], below[kTaps], below_slope[kTaps];
                cubic_taps(x.fraction, across, across_slope);
                cubic_taps(y.fraction, below, below_slope);
                // First down the columns, four at a time as they lie in memory, for one sample after the other; then
                // across, for all samples at once.
                float down_weights[kTaps][kFloats], down_slopes[kTaps][kFloats];
                for (int i = 0; i < kTaps; ++i) {
                    store(down_weights[i], below[i]);
                    store(down_slopes[i], below_slope[i]);
                }
                float values[kFloats][kTaps], slopes[kFloats][kTaps];
                for (int k = 0; k < kFloats; ++k) {
                    const float* taps = image + index[k];
                    const Floats4 first = load4(taps), second = load4(taps + width), third = load4(taps + 2 * width),
                                  fourth = load4(taps + 3 * width);
                    const Floats4 sampled = first * down_weights[0][k] + second * down_weights[1][k] +
                                            third * down_weights[2][k] + fourth * down_weights[3][k];
                    const Floats4 sloped = first * down_slopes[0][k] + second * down_slopes[1][k] +
                                           third * down_slopes[2][k] + fourth * down_slopes[3][k];
                    std::memcpy(values[k], &sampled, sizeof sampled);
                    std::memcpy(slopes[k], &sloped, sizeof sloped);
                }
                Floats value = all(0), along_x = all(0), along_y = all(0);
                for (int j = 0; j < kTaps; ++j) {
                    float column[kFloats], column_slope[kFloats];
                    for (int k = 0; k < kFloats; ++k) {
                        column[k] = values[k][j];
                        column_slope[k] = slopes[k][j];
                    }
                    value += load(column) * across[j];
                    along_x += load(column) * across_slope[j];
                    along_y += load(column_slope) * across[j];
                }
                // Chain rule: d/dw = A^T d/dx.
                write(to, r, c, value, all(warp.xx) * along_x + all(warp.yx) * along_y,
                      all(warp.xy) * along_x + all(warp.yy) * along_y);
            }
        }
    }

    // A vector of samples; behind the last column come zeros, for sums run over whole vectors.
    void write(const Window& to, int row, int column, Floats value, Floats along_x, Floats along_y) {
        const int place = row * layout_.stride + column;
        if (column + kFloats > layout_.window) {
            value = last_.of(value);
            along_x = last_.of(along_x);
            along_y = last_.of(along_y);
        }
        store(to.value + place, value);
        store(to.along_x + place, along_x);
        store(to.along_y + place, along_y);
    }

    float total(const float* values) const {
        Floats result = all(0);
        for (int k = 0; k < layout_.values(); k += kFloats) result += load(values + k);
        return sum(result);
    }

    // What the equations need of a template, after a change of gain and offset was taken out of its gradient.
    Equations equations(const Window& window) {
        Equations of{};
        of.mean = total(window.value) / static_cast<float>(layout_.window * layout_.window);
        if (pair_.gain_offset) take_out_gain_and_offset(window, of.mean);
        Floats xx = all(0), xy = all(0), yy = all(0), constant_x = all(0), constant_y = all(0);
        for (int k = 0; k < layout_.values(); k += kFloats) {
            // Behind the last column the gradient is zero, whatever the value less its mean is.
            const Floats x = load(window.along_x + k), y = load(window.along_y + k);
            const Floats value = load(window.value + k) - all(of.mean);
            xx += x * x;
            xy += x * y;
            yy += y * y;
            constant_x += value * x;
            constant_y += value * y;
        }
        of.hessian = {sum(xx), sum(xy), sum(xy), sum(yy)};
        of.constant = {sum(constant_x), sum(constant_y)};
        return of;
    }

    void take_out_gain_and_offset(const Window& window, float mean) {
        const int n = layout_.window;
        const float samples = static_cast<float>(n * n);
        const float mean_x = total(window.along_x) / samples, mean_y = total(window.along_y) / samples;
        float energy = 0, share_x = 0, share_y = 0;
        for (int r = 0; r < n; ++r)
            for (int c = 0; c < n; ++c) {
                const int k = r * layout_.stride + c;
                const float centred = window.value[k] - mean;
                energy += centred * centred;
                share_x += (window.along_x[k] - mean_x) * centred;
                share_y += (window.along_y[k] - mean_y) * centred;
            }
        if (energy < kTiny) energy = kTiny;
        for (int r = 0; r < n; ++r)
            for (int c = 0; c < n; ++c) {
                const int k = r * layout_.stride + c;
                const float centred = window.value[k] - mean;
                window.along_x[k] -= mean_x + share_x / energy * centred;
                window.along_y[k] -= mean_y + share_y / energy * centred;
            }
    }

    // C[k] = sum_w g(w) c[k + w] for the integer positions k of a table.
    void build_table(const Window& window, float (*table)[kPositions][kPositions]) {
        for (int down = 0; down < kPositions; ++down) {
            Floats along_x[kPositions], along_y[kPositions];
            FINGERFLOW_UNROLL
            for (int k = 0; k < kPositions; ++k) along_x[k] = along_y[k] = all(0);
            const float* patch = patch_ + down * layout_.stride;
            for (int place = 0; place < layout_.values(); place += kFloats) {
                const Floats gx = load(window.along_x + place), gy = load(window.along_y + place);
                FINGERFLOW_UNROLL
                for (int k = 0; k < kPositions; ++k) {
                    const Floats sample = held(load(patch + place + k));
                    along_x[k] += gx * sample;
                    along_y[k] += gy * sample;
                }
            }
            FINGERFLOW_UNROLL
            for (int k = 0; k < kPositions; ++k) {
                table[0][down][k] = sum(along_x[k]);
                table[1][down][k] = sum(along_y[k]);
            }
        }
    }

    // The root of b(y) = 0 near `shift`, within the reach of a table.
    void solve_table(const float (*table)[kPositions][kPositions], Vector constant, const Matrix& inverse_hessian,
                     Vector* shift, float* step) const {
        *step = 0;
        for (int iteration = 0; iteration < kGaussNewtonSteps + kNewtonSteps; ++iteration) {
            // The table's index of the first tap; at the upper end of the reach the last tap weighs nothing.
            const float whole_x = clamped(floorf(shift->x), -kReach, kReach - 1);
            const float whole_y = clamped(floorf(shift->y), -kReach, kReach - 1);
            const int first_x = static_cast<int>(whole_x) + kReach;
            const int first_y = static_cast<int>(whole_y) + kReach;
            float across[kTaps], across_slope[kTaps], down[kTaps], down_slope[kTaps];
            cubic_taps(shift->x - whole_x, across, across_slope);
            cubic_taps(shift->y - whole_y, down, down_slope);
            float residual[2], slope_x[2], slope_y[2];
            for (int component = 0; component < 2; ++component) {
                float value = 0, along_x = 0, along_y = 0;
                for (int i = 0; i < kTaps; ++i) {
                    const float* line = table[component][first_y + i] + first_x;
                    float row = 0, row_slope = 0;
                    for (int j = 0; j < kTaps; ++j) {
                        row += across[j] * line[j];
                        row_slope += across_slope[j] * line[j];
                    }
                    value += down[i] * row;
                    along_x += down[i] * row_slope;
                    along_y += down_slope[i] * row;
                }
                residual[component] = value - (component == 0 ? constant.x : constant.y);
                slope_x[component] = along_x;
                slope_y[component] = along_y;
            }
            Vector move;
            if (iteration < kGaussNewtonSteps) {
                move = {inverse_hessian.xx * residual[0] + inverse_hessian.xy * residual[1],
                        inverse_hessian.yx * residual[0] + inverse_hessian.yy * residual[1]};
            } else {
                const float determinant = slope_x[0] * slope_y[1] - slope_x[1] * slope_y[0];
                move = {(residual[0] * slope_y[1] - residual[1] * slope_y[0]) / determinant,
                        (slope_x[0] * residual[1] - slope_x[1] * residual[0]) / determinant};
                // Far from the root, or on the kinks of order 1, Newton may leap: never further than a pixel.
                move = {clamped(finite_or_zero(move.x), -1, 1), clamped(finite_or_zero(move.y), -1, 1)};
            }
            const Vector moved{clamped(shift->x - move.x, -kReach, kReach), clamped(shift->y - move.y, -kReach, kReach)};
            const float step_x = shift->x - moved.x, step_y = shift->y - moved.y;
            *shift = moved;
            *step = sqrtf(step_x * step_x + step_y * step_y);
            if (*step < kSettled) break;
        }
    }

    Vector solve(int which, Vector guess, const Window& window, const Equations& of, bool* converged) {
        const int n = layout_.window;
        Matrix inverted = inverse(of.hessian);
        inverted = {finite_or_zero(inverted.xx), finite_or_zero(inverted.xy), finite_or_zero(inverted.yx), finite_or_zero(inverted.yy)};
        Match match{guess, false, INFINITY};
        for (int round = 0; round < kRounds && !match.inside && is_finite(match.place); ++round) {
            const Vector center{rintf(match.place.x), rintf(match.place.y)};
            const float first = static_cast<float>(n / 2 + kReach + 1);
            cut(which, {center.x - first, center.y - first}, layout_.stride, layout_.stride, of.mean);
            float table[2][kPositions][kPositions];
            build_table(window, table);
            float all_of_it = 0;
            for (int k = 0; k < 2 * kPositions * kPositions; ++k) all_of_it += (&table[0][0][0])[k];
            if (!is_finite(all_of_it)) {  // a bad pixel within reach
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

    void compare(const float* reference, const float* matched, float mean_a, float mean_b, float noise, float* variance,
                 float* unexplained) const {
        const float samples = static_cast<float>(layout_.window * layout_.window);
        Floats squares_of = all(0), a_a = all(0), b_b = all(0), a_b = all(0);
        for (int r = 0; r < layout_.window; ++r)
            for (int c = 0; c < layout_.span; c += kFloats) {
                const Floats a = load(reference + r * layout_.stride + c), b = load(matched + r * layout_.stride + c);
                Floats difference = b - a, above_a = a - all(mean_a), above_b = b - all(mean_b);
                if (c + kFloats > layout_.window) {
                    difference = last_.of(difference);
                    above_a = last_.of(above_a);
                    above_b = last_.of(above_b);
                }
                squares_of += difference * difference;
                a_a += above_a * above_a;
                b_b += above_b * above_b;
                a_b += above_a * above_b;
            }
        const float aa = sum(a_a), bb = sum(b_b), ab = sum(a_b);
        float squares = sum(squares_of);
        if (pair_.gain_offset) squares = bb - ab * ab / (aa < kTiny ? kTiny : aa);
        *variance = squares / (samples - 4) / (2 * kValueNoise);
        if (*variance < pair_.rounding) *variance = pair_.rounding;
        const float noise_energy = samples * noise * noise * kValueNoise;
        const float left_a = aa - noise_energy, left_b = bb - noise_energy;
        const float energy = (left_a < 0 ? 0 : left_a) * (left_b < 0 ? 0 : left_b);
        *unexplained = 1 - ab * (ab < 0 ? 0 : ab) / energy;
    }

    const TrackedPair& pair_;
    const Layout layout_;
    const Beginning last_;  // columns of a row's last vector
    std::int64_t image_ = 0;  // where the point's image begins
    Window template_{}, matched_{};
    float* reference_ = nullptr;
    float* patch_ = nullptr;
    float* rows_ = nullptr;
};

}  // namespace

std::int64_t tracking_workspace_bytes(int window) { return 4 * Tracker::floats(window); }

void track_points(const TrackedPair& pair, std::int64_t first, std::int64_t last, void* workspace) {
    Tracker tracker(pair, static_cast<float*>(workspace));
    for (std::int64_t point = first; point < last; ++point) tracker.track(point);
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
