// build: each instruction set, fused
// Search by normalised cross-correlation in half resolution, forwards and back (fingerflow/ops/tracking/search.py), one
// point after the other: the displacement of highest sum(T P) / sqrt(sum (P - mean P)^2), refined by parabolas through its
// neighbours. Of scores equal to kSearchTie the one nearest to the guess is taken. A window returns if the search back
// ends within `limit` px of its start.
// Layout: images of half resolution are floats (batch, height / 2, width / 2), in pieces of 16 points. Template T and
// patch P, less their means, are rows of whole vectors followed by zeros; a lane holds one column of the template, and
// kRows displacements down share each load of the patch.
#include <math.h>
#include <cstddef>

#include "floats.h"
#include "instruction_sets.h"
#include "interface.h"
#include "shared_limits.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

constexpr int kRows = 8;  // displacements down at a time, for which each vector of the patch is loaded once
constexpr float kTiny = 1.17549435e-38f;  // the smallest normal number

bool is_finite(float value) { return value - value == 0.0f; }

struct Layout {
    int size, span, side, width, stride;  // side of the patch; floats a row of the template (width) and of the patch (stride)
    Layout(int size, int reach)
        : size(size), span(2 * reach + 1), side(size + span - 1), width(whole_floats(size)), stride(whole_floats(side) + kFloats) {}
    int spans() const { return (span + kRows - 1) / kRows * kRows; }
    int template_floats() const { return (size + 2 * kRows) * width; }
    int patch_floats() const { return side * stride + kFloats; }
    int scores() const { return whole_floats(spans() * span); }
};

class Searcher {
public:
    Searcher(const fingerflow_search& search, void* memory) : search_(search), layout_(search.size, search.reach) {
        double* const doubles = static_cast<double*>(memory);
        sums_ = doubles;
        squares_ = doubles + layout_.stride;
        float* floats = reinterpret_cast<float*>(doubles + 2 * layout_.stride);
        const auto take = [&](int count) {
            float* const piece = floats;
            floats += count;
            for (int k = 0; k < count; ++k) piece[k] = 0.0f;
            return piece;
        };
        template_ = take(layout_.template_floats());
        patch_ = take(layout_.patch_floats());
        products_ = take(layout_.scores());
        deviations_ = take(layout_.scores());
    }

    static std::int64_t bytes(int size, int reach) {
        const Layout layout(size, reach);
        const std::int64_t floats = layout.template_floats() + layout.patch_floats() + 2 * layout.scores();
        return 16 * layout.stride + 4 * floats;
    }

    void search(std::int64_t point) {
        const float* const place = search_.points + 2 * point;
        const float* const guess = search_.guess + 2 * point;
        float* const found = search_.found + 2 * point;
        found[0] = guess[0];
        found[1] = guess[1];
        if (!(is_finite(place[0]) && is_finite(place[1]) && is_finite(guess[0]) && is_finite(guess[1]))) return;
        // Pixel i of the half-resolution image is centred at 2 i + 1/2 px of the full one.
        const float start[] = {rintf((place[0] - 0.5f) / 2), rintf((place[1] - 0.5f) / 2)};
        const float center[] = {rintf((guess[0] - 0.5f) / 2), rintf((guess[1] - 0.5f) / 2)};
        const std::int64_t image = search_.image_index[point] * search_.height * search_.width;
        const int size = layout_.size, span = layout_.span;
        const int half = size / 2;
        cut(search_.templates + image, start, half, size, template_ + kRows * layout_.width, layout_.width);
        cut(search_.images + image, center, half + search_.reach, layout_.side, patch_, layout_.stride);
        correlate();
        measure();

        float most = 0;
        for (int row = 0; row < span; ++row)
            for (int column = 0; column < span; ++column) {
                const float deviation = deviations_[row * span + column];
                if (deviation > most) most = deviation;
            }
        // Windows without contrast are excluded; their scores would be rounding errors.
        const float least = 1e-3f * most + kTiny;
        float highest = -INFINITY;
        for (int k = 0; k < span * span; ++k) {
            products_[k] = deviations_[k] > least ? products_[k] / sqrtf(deviations_[k]) : -INFINITY;
            if (products_[k] > highest) highest = products_[k];
        }
        if (!(highest > 0)) return;
        const float as_high = highest - kSearchTie * highest;
        int best = -1, nearest_away = 0;
        for (int k = 0; k < span * span; ++k) {
            if (products_[k] < as_high) continue;
            const int down = k / span - search_.reach, across = k % span - search_.reach, away = down * down + across * across;
            if (best < 0 || away < nearest_away) {
                best = k;
                nearest_away = away;
            }
        }
        const float peak = products_[best];
        const int row = best / span, column = best % span;
        const int left = column > 0 ? best - 1 : best, right = column < span - 1 ? best + 1 : best;
        const int above = row > 0 ? best - span : best, below = row < span - 1 ? best + span : best;
        const auto reach = static_cast<float>(search_.reach);
        const float moved_x = static_cast<float>(column) - reach + vertex(products_[left], peak, products_[right]);
        const float moved_y = static_cast<float>(row) - reach + vertex(products_[above], peak, products_[below]);
        // The displacement of the template's central pixel, added to the point.
        found[0] = place[0] + 2 * (center[0] + moved_x - start[0]);
        found[1] = place[1] + 2 * (center[1] + moved_y - start[1]);
    }

private:
    // Position of the maximum of the parabola through three scores, clamped to [-1/2, 1/2]; 0 where they are equal to
    // kSearchTie.
    static float vertex(float before, float peak, float after) {
        const float curvature = before - 2 * peak + after;
        const float at = curvature < -kSearchTie * peak ? (before - after) / (2 * curvature) : 0.0f;
        return !is_finite(at) ? 0.0f : at < -0.5f ? -0.5f : at > 0.5f ? 0.5f : at;
    }

    // Clamps the middle of a square of `side` px outside an image, where the square has the pixels of the border alone, so
    // that it can be converted to an integer.
    static std::int64_t within(float place, std::int64_t count, int side) {
        const auto far = static_cast<float>(count + side);
        return static_cast<std::int64_t>(place > -far ? (place < far ? place : far) : -far);
    }
    static std::int64_t nearest(std::int64_t place, std::int64_t count) { return place < 0 ? 0 : place >= count ? count - 1 : place; }

    // Copies a square around a position, less its mean; values that are not finite become 0. A square of one value becomes
    // 0 throughout, not what rounding leaves of it.
    void cut(const float* image, const float* center, int half, int side, float* to, int stride) const {
        const std::int64_t width = search_.width, height = search_.height;
        const std::int64_t x = within(center[0], width, side) - half, y = within(center[1], height, side) - half;
        float total = 0, least = INFINITY, most = -INFINITY;
        for (int r = 0; r < side; ++r) {
            const float* FINGERFLOW_RESTRICT const line = image + nearest(y + r, height) * width;
            float* FINGERFLOW_RESTRICT const row = to + r * stride;
            if (x >= 0 && x + side <= width) std::memcpy(row, line + x, static_cast<std::size_t>(side) * sizeof(float));
            else for (int c = 0; c < side; ++c) row[c] = line[nearest(x + c, width)];
            for (int c = 0; c < side; ++c) {
                row[c] = is_finite(row[c]) ? row[c] : 0.0f;
                least = row[c] < least ? row[c] : least;
                most = row[c] > most ? row[c] : most;
            }
            Floats sum[kFloats] = {};
            for (int c = 0; c < side; c += kFloats) sum[0] += load(row + c);  // zeros follow the last column
            total += folded<kFloats>(sum)[0];
        }
        const float mean = least < most ? total / static_cast<float>(side * side) : least;
        for (int r = 0; r < side; ++r)
            for (int c = 0; c < side; ++c) to[r * stride + c] -= mean;
    }

    // Correlates template and patch for all displacements.
    void correlate() {
        const int span = layout_.span, width = layout_.width;
        for (int top = 0; top < span; top += kRows)
            for (int left = 0; left < span; ++left) {
                Floats product[kRows];
                FINGERFLOW_UNROLL
                for (int k = 0; k < kRows; ++k) product[k] = all(0);
                const int end = layout_.size + kRows - 1 < layout_.side - top ? layout_.size + kRows - 1 : layout_.side - top;
                for (int r = 0; r < end; ++r)
                    for (int c = 0; c < width; c += kFloats) {
                        const Floats pixels = held(load(patch_ + (top + r) * layout_.stride + left + c));
                        // Rows of zeros lie above and below the template.
                        const float* const line = template_ + (kRows + r) * width + c;
                        FINGERFLOW_UNROLL
                        for (int k = 0; k < kRows; ++k) product[k] += pixels * load(line - k * width);
                    }
                Floats padded[whole_floats(kRows)] = {};
                for (int k = 0; k < kRows; ++k) padded[k] = product[k];
                float summed[whole_floats(kRows)];
                sums(padded, summed);
                for (int k = 0; k < kRows; ++k) products_[(top + k) * span + left] = summed[k];
            }
    }

    // Sums of squared deviations of all windows of the patch, by running sums in double, since these cancel.
    void measure() {
        const int size = layout_.size, span = layout_.span, side = layout_.side;
        for (int c = 0; c < side; ++c) sums_[c] = squares_[c] = 0;
        for (int r = 0; r < side; ++r) {
            const float* const enters = patch_ + r * layout_.stride;
            for (int c = 0; c < side; ++c) {
                const auto value = static_cast<double>(enters[c]);
                sums_[c] += value;
                squares_[c] += value * value;
            }
            if (r < size - 1) continue;
            double sum = 0, square = 0;
            for (int c = 0; c < side; ++c) {
                sum += sums_[c];
                square += squares_[c];
                if (c < size - 1) continue;
                deviations_[(r - size + 1) * span + c - size + 1] = static_cast<float>(square - sum * sum / (static_cast<double>(size) * size));
                sum -= sums_[c - size + 1];
                square -= squares_[c - size + 1];
            }
            const float* const leaves = enters - (size - 1) * layout_.stride;
            for (int c = 0; c < side; ++c) {
                const auto value = static_cast<double>(leaves[c]);
                sums_[c] -= value;
                squares_[c] -= value * value;
            }
        }
    }

    const fingerflow_search& search_;
    const Layout layout_;
    double* sums_ = nullptr;
    double* squares_ = nullptr;
    float* template_ = nullptr;
    float* patch_ = nullptr;
    float* products_ = nullptr;
    float* deviations_ = nullptr;
};

}  // namespace

// Of a workspace that is aligned to 64.
std::int64_t search_workspace_bytes(int size, int reach) { return Searcher::bytes(size, reach); }

void search_points(const fingerflow_search& search, std::int64_t first, std::int64_t last, void* workspace) {
    Searcher searcher(search, workspace);
    for (std::int64_t point = first; point < last; ++point) searcher.search(point);
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow

#if FINGERFLOW_ONCE

#include <cmath>
#include <vector>

#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
FINGERFLOW_OTHER_SETS(search_workspace_bytes)
FINGERFLOW_OTHER_SETS(search_points)
}  // namespace fingerflow

void fingerflow_search_windows(const fingerflow_search* given, int threads) {
    using namespace fingerflow;
    const auto bytes = static_cast<std::size_t>(FINGERFLOW_PICK(search_workspace_bytes)(given->size, given->reach));
    for_ranges(given->count, 16, threads, [&](std::int64_t first, std::int64_t last) {
        FINGERFLOW_PICK(search_points)(*given, first, last, workspace(bytes));
    });
}

void fingerflow_search_and_return(const fingerflow_search_both_ways* given, int threads) {
    const std::int64_t batch = given->batch, count = given->count, height = given->height / 2, width = given->width / 2;
    if (count == 0) return;
    const auto pixels = static_cast<std::size_t>(batch * height * width);
    std::vector<float> key(pixels), current(pixels), back(static_cast<std::size_t>(2 * count));
    const fingerflow_frames of_key{given->key, batch, given->height, given->width, given->key_stride, given->key_row_stride, given->key_kind};
    const fingerflow_frames of_current{given->current, batch, given->height, given->width, given->current_stride, given->current_row_stride,
                                       given->current_kind};
    fingerflow_halve(&of_key, key.data(), threads);
    fingerflow_halve(&of_current, current.data(), threads);
    const fingerflow_search away{key.data(), current.data(), given->image_index, given->start, given->guess, given->found,
                                  height, width, count, given->size, given->reach};
    fingerflow_search_windows(&away, threads);
    const fingerflow_search home{current.data(), key.data(), given->image_index, given->found, given->start, back.data(),
                                    height, width, count, given->size, given->reach};
    fingerflow_search_windows(&home, threads);
    for (std::int64_t k = 0; k < count; ++k) {
        const float *const end = back.data() + 2 * k, *const start = given->start + 2 * k;
        const float x = end[0] - start[0], y = end[1] - start[1];
        given->returns[k] = std::sqrt(x * x + y * y) <= given->limit;
    }
}

#endif
