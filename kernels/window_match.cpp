// build: each instruction set, fused
// Windows of a frame compared with those of the key frame, and the shifts by which most of their samples match
// (fingerflow/tracker/window_match.py).
// Layout: windows (windows, samples) of floats, those around each of them (4, windows, samples). Comparisons have several
// samples a vector, behind the last one zeros; fits are of few windows, one after the other.
#include <math.h>
#include <cstddef>
#include <cstring>

#include "floats.h"
#include "instruction_sets.h"
#include "interface.h"
#include "parallel.h"
#include "tracking_limits.h"
#include "workspace.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

constexpr int kUnknowns = 4;

float total(const Floats& value) {
    float result = 0;
    for (int k = 0; k < kFloats; ++k) result += value[k];
    return result;
}

// Writes a window minus its mean to a row, of which zeros lie behind the window.
void centre(const float* window, int samples, float* row) {
    std::memcpy(row, window, static_cast<std::size_t>(samples) * sizeof(float));
    Floats sum = all(0);
    for (int k = 0; k < samples; k += kFloats) sum += load(row + k);
    const float mean = total(sum) / static_cast<float>(samples);
    for (int k = 0; k < samples; ++k) row[k] -= mean;
}

// The number of this rank, from 0 on, of numbers that are not negative. Their bits grow with them: those of the greatest
// bound below which at most `rank` numbers lie are found one by one.
float ranked(const float* numbers, int count, int rank) {
    std::int32_t found = 0;
    for (std::int32_t bit = 1 << 30; bit != 0; bit /= 2) {
        int below = 0;
        for (int k = 0; k < count; ++k) {
            std::int32_t bits;
            std::memcpy(&bits, numbers + k, sizeof bits);
            below += bits < (found | bit) ? 1 : 0;
        }
        if (below <= rank) found |= bit;
    }
    float result;
    std::memcpy(&result, &found, sizeof result);
    return result;
}

// Least-squares fit of gain a, offset b and shift d of one window: a then + b = now + slope . d. The shift is the last of
// the unknowns, so that elimination of the others leaves its information matrix.
struct ShiftFit {
    double equations[kUnknowns][kUnknowns + 1] = {}, unknowns[kUnknowns] = {}, information[3] = {};

    // Columns (5, samples): by each unknown, and what they sum up to.
    void solve(const double* columns, const double* weights, int samples) {
        double sums[kUnknowns][kUnknowns + 1] = {};
        for (int k = 0; k < samples; ++k)
            for (int i = 0; i < kUnknowns; ++i) {
                const double weighted = weights[k] * columns[i * samples + k];
                for (int j = i; j <= kUnknowns; ++j) sums[i][j] += weighted * columns[j * samples + k];
            }
        for (int i = 0; i < kUnknowns; ++i)
            for (int j = 0; j <= kUnknowns; ++j) equations[i][j] = sums[i < j ? i : j][i < j ? j : i];
        double trace = 0;
        for (int i = 0; i < kUnknowns; ++i) trace += equations[i][i];
        for (int i = 0; i < kUnknowns; ++i) equations[i][i] += 1e-12 * trace + kLeastVariance;
        for (int pivot = 0; pivot < kUnknowns; ++pivot) {
            if (pivot == 2) {
                information[0] = equations[2][2];
                information[1] = equations[2][3];
                information[2] = equations[3][3];
            }
            for (int i = pivot + 1; i < kUnknowns; ++i) {
                const double factor = equations[i][pivot] / equations[pivot][pivot];
                for (int j = pivot; j <= kUnknowns; ++j) equations[i][j] -= factor * equations[pivot][j];
            }
        }
        for (int i = kUnknowns - 1; i >= 0; --i) {
            unknowns[i] = equations[i][kUnknowns];
            for (int j = i + 1; j < kUnknowns; ++j) unknowns[i] -= equations[i][j] * unknowns[j];
            unknowns[i] /= equations[i][i];
        }
    }

    // Tukey's biweight of the residuals, by their standard deviation, which is returned.
    double weigh(const double* columns, int samples, double noise, double* weights, float* far) const {
        for (int k = 0; k < samples; ++k) {
            weights[k] = columns[kUnknowns * samples + k];
            for (int j = 0; j < kUnknowns; ++j) weights[k] -= columns[j * samples + k] * unknowns[j];
            far[k] = static_cast<float>(fabs(weights[k]));
        }
        const double middle = (static_cast<double>(ranked(far, samples, (samples - 1) / 2)) + ranked(far, samples, samples / 2)) / 2;
        const double spread = kMad * middle > noise ? kMad * middle : noise;
        for (int k = 0; k < samples; ++k) {
            const double share = weights[k] / (kTukey * spread), near = 1 - share * share;
            weights[k] = near > 0 ? near * near : 0;
        }
        return spread;
    }
};

void compare(const fingerflow_window_pairs& windows, std::int64_t window, float* then, float* now) {
    const int samples = windows.samples;
    const float count = static_cast<float>(samples);
    centre(windows.then + window * samples, samples, then);
    centre(windows.now + window * samples, samples, now);
    Floats squares_then = all(0), squares_now = all(0), products = all(0), rest = all(0), largest = all(0);
    for (int k = 0; k < samples; k += kFloats) {
        const Floats one = load(then + k), other = load(now + k);
        squares_then += one * one;
        squares_now += other * other;
        products += one * other;
    }
    const float before = total(squares_then) / count, covariance = total(products) / count, slope = covariance / before;
    const float variances = before * (total(squares_now) / count);
    for (int k = 0; k < samples; k += kFloats) {
        const Floats left = load(now + k) - load(then + k) * slope, square = left * left;
        rest += square;
        largest = greater(square, largest);
    }
    float most = 0;
    for (int k = 0; k < kFloats; ++k) most = largest[k] > most ? largest[k] : most;
    windows.correlation[window] = variances > kLeastVariance ? covariance / sqrtf(variances) : NAN;
    windows.residual[window] = sqrtf(total(rest) / count);
    windows.largest[window] = sqrtf(most);
}

void shift(const fingerflow_window_shifts& windows, std::int64_t window, double* columns) {
    const std::int64_t samples = windows.samples, all = windows.windows * samples, first = window * samples;
    const float* const around = windows.around + first;
    double *const found = windows.shift + 2 * window, *const weights = windows.weight + first;
    double nothing = 0;
    for (std::int64_t k = 0; k < samples; ++k) {
        const double of[] = {-windows.then[first + k], -1, around[k] - around[all + k],
                             around[2 * all + k] - around[3 * all + k], -windows.now[first + k]};
        for (int j = 0; j <= kUnknowns; ++j) {
            columns[j * samples + k] = of[j];
            nothing += 0 * of[j];
        }
    }
    if (nothing != 0) {  // a number is NaN or infinite
        found[0] = found[1] = windows.deviations[window] = windows.excluded[window] = 0;
        return;
    }
    ShiftFit fit;
    double spread = 0;
    for (int round = 0; round < kWeightRounds; ++round) {
        fit.solve(columns, weights, windows.samples);
        spread = fit.weigh(columns, windows.samples, windows.noise, weights, reinterpret_cast<float*>(columns + (kUnknowns + 1) * samples));
    }
    for (int k = 0; k < 2; ++k) found[k] += fit.unknowns[2 + k] > 1 ? 1 : fit.unknowns[2 + k] < -1 ? -1 : fit.unknowns[2 + k];
    const double *const of = fit.information, x = found[0], y = found[1];
    windows.deviations[window] = sqrt(of[0] * x * x + 2 * of[1] * x * y + of[2] * y * y) / spread;
    int excluded = 0;
    for (std::int64_t k = 0; k < samples; ++k) excluded += weights[k] < kExcludedWeight ? 1 : 0;
    windows.excluded[window] = static_cast<double>(excluded) / static_cast<double>(samples);
}

}  // namespace

void compare_windows(const fingerflow_window_pairs& windows, std::int64_t first, std::int64_t last, void* workspace) {
    const int padded = whole_floats(windows.samples);
    auto* const rows = static_cast<float*>(workspace);
    std::memset(rows, 0, 2 * static_cast<std::size_t>(padded) * sizeof(float));
    for (std::int64_t window = first; window < last; ++window) compare(windows, window, rows, rows + padded);
}

void shift_windows(const fingerflow_window_shifts& windows, std::int64_t first, std::int64_t last, void* workspace) {
    for (std::int64_t window = first; window < last; ++window) shift(windows, window, static_cast<double*>(workspace));
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow

#if FINGERFLOW_ONCE

namespace fingerflow {
FINGERFLOW_OTHER_SETS(compare_windows)
FINGERFLOW_OTHER_SETS(shift_windows)
}  // namespace fingerflow

void fingerflow_compare_windows(const fingerflow_window_pairs* given, int threads) {
    using namespace fingerflow;
    const auto bytes = 2 * sizeof(float) * (static_cast<std::size_t>(given->samples) + 16);
    for_ranges(given->windows, 64, threads, [&](std::int64_t first, std::int64_t last) {
        FINGERFLOW_PICK(compare_windows)(*given, first, last, workspace(bytes));
    });
}

void fingerflow_shift_windows(const fingerflow_window_shifts* given, int threads) {
    using namespace fingerflow;
    const auto bytes = 6 * sizeof(double) * static_cast<std::size_t>(given->samples);
    for_ranges(given->windows, 8, threads, [&](std::int64_t first, std::int64_t last) {
        FINGERFLOW_PICK(shift_windows)(*given, first, last, workspace(bytes));
    });
}

#endif
