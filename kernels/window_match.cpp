// Shifts by which most samples of windows of a frame match those of the key frame (fingerflow/tracker/window_match.py).
// Layout: windows (windows, samples) of floats, those around each of them (4, windows, samples); few, one after the other.
#include <algorithm>
#include <cmath>
#include <vector>

#include "interface.h"
#include "parallel.h"
#include "shared_limits.h"

namespace fingerflow {
namespace {

constexpr int kUnknowns = 4;

// Least-squares fits of gain a, offset b and shift d of one window, a then + b = now + slope . d, reweighted by residuals.
// The shift is the last of the unknowns, so that elimination of the others leaves its information matrix.
struct ShiftFit {
    std::size_t samples;
    std::vector<double> columns[kUnknowns + 1];  // by the unknowns, and what they sum up to
    std::vector<double> far;                     // magnitudes of the residuals
    double unknowns[kUnknowns], information[2][2];

    explicit ShiftFit(std::size_t samples) : samples(samples), far(samples) {
        for (auto& column : columns) column.resize(samples);
    }

    void solve(const double* weights) {
        double equations[kUnknowns][kUnknowns + 1] = {}, trace = 0;
        for (std::size_t k = 0; k < samples; ++k)
            for (int i = 0; i < kUnknowns; ++i) {
                const double weighted = weights[k] * columns[i][k];
                for (int j = i; j <= kUnknowns; ++j) equations[i][j] += weighted * columns[j][k];
            }
        for (int i = 0; i < kUnknowns; ++i) {
            trace += equations[i][i];
            for (int j = 0; j < i; ++j) equations[i][j] = equations[j][i];
        }
        for (int i = 0; i < kUnknowns; ++i) equations[i][i] += 1e-12 * trace + kLeastVariance;
        for (int pivot = 0; pivot < kUnknowns; ++pivot) {
            if (pivot == 2)
                for (int i : {0, 1}) std::copy_n(equations[2 + i] + 2, 2, information[i]);
            for (int i = 0; i < kUnknowns; ++i) {
                const double factor = i == pivot ? 0 : equations[i][pivot] / equations[pivot][pivot];
                for (int j = pivot; j <= kUnknowns; ++j) equations[i][j] -= factor * equations[pivot][j];
            }
        }
        for (int i = 0; i < kUnknowns; ++i) unknowns[i] = equations[i][kUnknowns] / equations[i][i];
    }

    // Sets Tukey's biweight of the residuals; returns their standard deviation, by the median of the magnitudes.
    double weigh(double noise, double* weights) {
        for (std::size_t k = 0; k < samples; ++k) {
            weights[k] = columns[kUnknowns][k];
            for (int j = 0; j < kUnknowns; ++j) weights[k] -= columns[j][k] * unknowns[j];
            far[k] = std::abs(weights[k]);
        }
        const auto middle = far.begin() + static_cast<std::ptrdiff_t>(samples / 2);
        std::nth_element(far.begin(), middle, far.end());
        const double below = samples % 2 == 0 ? *std::max_element(far.begin(), middle) : *middle;
        const double spread = std::max(kMad * (below + *middle) / 2, noise);
        for (std::size_t k = 0; k < samples; ++k) {
            const double share = weights[k] / (kTukey * spread), near = std::max(1 - share * share, 0.0);
            weights[k] = near * near;
        }
        return spread;
    }
};

void shift(const fingerflow_window_shifts& all, std::int64_t window, ShiftFit& fit) {
    const std::int64_t samples = all.samples, size = all.windows * samples, first = window * samples;
    const float* const around = all.around + first;
    double *const found = all.shift + 2 * window, *const weights = all.weight + first;
    bool finite = true;
    for (std::int64_t k = 0; k < samples; ++k) {
        const double of[] = {-all.then[first + k], -1, around[k] - around[size + k], around[2 * size + k] - around[3 * size + k], -all.now[first + k]};
        for (int j = 0; j <= kUnknowns; ++j) {
            fit.columns[j][static_cast<std::size_t>(k)] = of[j];
            finite = finite && std::isfinite(of[j]);
        }
    }
    all.deviations[window] = all.largest[window] = 0;
    double spread = 0;
    for (int round = 0; finite && round < kWeightRounds; ++round) {
        fit.solve(weights);
        spread = fit.weigh(all.noise, weights);
    }
    for (int k : {0, 1}) found[k] = finite ? found[k] + std::clamp(fit.unknowns[2 + k], -1.0, 1.0) : 0;
    if (!finite) return;
    const auto& of = fit.information;
    all.deviations[window] = std::sqrt(of[0][0] * found[0] * found[0] + 2 * of[0][1] * found[0] * found[1] + of[1][1] * found[1] * found[1]) / spread;
    all.largest[window] = *std::max_element(fit.far.begin(), fit.far.end()) / spread;
}

}  // namespace
}  // namespace fingerflow

void fingerflow_shift_windows(const fingerflow_window_shifts* given, int threads) {
    using namespace fingerflow;
    for_ranges(given->windows, 8, threads, [&](std::int64_t first, std::int64_t last) {
        ShiftFit fit(static_cast<std::size_t>(given->samples));
        for (std::int64_t window = first; window < last; ++window) shift(*given, window, fit);
    });
}
