// build: each instruction set, fused
// Deformed windows image(place + warp w) at the grid points w, sampled by Keys' cubic convolution for subset verification
// (fingerflow/ops/tracking/window_correlation.py), 32 windows a piece.
// Layout: places (windows, 2), warp (windows, 2, 2), results (windows, side, side) floats. One sample a lane; taps are
// weighted down the columns sample by sample, four pixels of a row at a time as they lie in memory, then across for all
// lanes at once.
#include <math.h>
#include <cstddef>
#include <cstring>
#if defined(__AVX2__)
#include <smmintrin.h>
#endif

#include "floats.h"
#include "instruction_sets.h"
#include "interface.h"
#include "lanes.h"
#include "pixels.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

constexpr int kTaps = 4;
constexpr float kKeys = -0.75f;  // Keys' parameter a, as in torch's bicubic sampling

int side_of(int reach, int step) { return 2 * reach / step + 1; }

// Weights of the taps at -1, 0, 1 and 2 for fractions in [0, 1].
void taps_of(const Floats& fraction, Floats* weights) {
    const Floats rest = 1.0f - fraction;
    weights[0] = fraction * rest * rest * kKeys;
    weights[1] = (fraction * (kKeys + 2.0f) - (kKeys + 3.0f)) * fraction * fraction + 1.0f;
    weights[2] = (rest * (kKeys + 2.0f) - (kKeys + 3.0f)) * rest * rest + 1.0f;
    weights[3] = rest * fraction * fraction * kKeys;
}

template <class Pixel>
Floats4 four(const Pixel* from) {
#if defined(__GNUC__) || defined(__clang__)
    typedef Pixel Pixels __attribute__((vector_size(4 * sizeof(Pixel))));
    Pixels value;
    std::memcpy(&value, from, sizeof value);
    return __builtin_convertvector(value, Floats4);
#else
    const float values[] = {static_cast<float>(from[0]), static_cast<float>(from[1]), static_cast<float>(from[2]), static_cast<float>(from[3])};
    return load4(values);
#endif
}

#if defined(__AVX2__) && (defined(__GNUC__) || defined(__clang__))
// Compilers would convert the bytes one by one.
Floats4 four(const std::uint8_t* from) {
    int bytes;
    std::memcpy(&bytes, from, sizeof bytes);
    return (Floats4)_mm_cvtepi32_ps(_mm_cvtepu8_epi32(_mm_cvtsi32_si128(bytes)));
}
#endif

class Sampler {
public:
    Sampler(const fingerflow_sampled_windows& all, float* memory)
        : all_(all), side_(side_of(all.reach, all.step)), samples_(side_ * side_), right_(memory), down_(memory + whole_floats(samples_)) {
        // The last vector is padded with the last sample.
        for (int k = 0; k < whole_floats(samples_); ++k) {
            const int sample = k < samples_ ? k : samples_ - 1;
            right_[k] = static_cast<float>(sample % side_ * all.step - all.reach);
            down_[k] = static_cast<float>(sample / side_ * all.step - all.reach);
        }
    }

    template <class Pixel>
    void sample(const Pixel* images, std::int64_t window) const {
        float* const found = all_.found + window * samples_;
        if (!is_inside(window)) {
            for (int k = 0; k < samples_; ++k) found[k] = NAN;
            return;
        }
        const Frames& frames = all_.images;
        const Pixel* const image = images + all_.image_index[window] * frames.frame_stride;
        const std::int64_t row = frames.row_stride;
        const float *const place = all_.places + 2 * window, *const warp = all_.warp + 4 * window;
        // Between these pixels all taps exist.
        const float last_x = static_cast<float>(frames.width - 3), last_y = static_cast<float>(frames.height - 3);
        for (int first = 0; first < samples_; first += kFloats) {
            const Floats right = load(right_ + first), down = load(down_ + first);
            const Split x = split(right * warp[0] + down * warp[1] + place[0], 1, last_x);
            const Split y = split(right * warp[2] + down * warp[3] + place[1], 1, last_y);
            Floats across[kTaps], below[kTaps];
            taps_of(x.fraction, across);
            taps_of(y.fraction, below);
            float weights[kTaps][kFloats], columns[kFloats][kTaps];
            for (int i = 0; i < kTaps; ++i) store(weights[i], below[i]);
            for (int k = 0; k < kFloats; ++k) {
                const Pixel* const from = image + (y.whole[k] - 1) * row + x.whole[k] - 1;
                const Floats4 sum = four(from) * weights[0][k] + four(from + row) * weights[1][k] + four(from + 2 * row) * weights[2][k] +
                                    four(from + 3 * row) * weights[3][k];
                std::memcpy(columns[k], &sum, sizeof sum);
            }
            Floats value = all(0);
            for (int j = 0; j < kTaps; ++j) {
                float column[kFloats];
                for (int k = 0; k < kFloats; ++k) column[k] = columns[k][j];
                value += load(column) * across[j];
            }
            float values[kFloats];
            store(values, value);
            const int count = samples_ - first < kFloats ? samples_ - first : kFloats;
            std::memcpy(found + first, values, static_cast<std::size_t>(count) * sizeof(float));
        }
    }

private:
    // Whether the four corners of a deformed window lie in the image less a border of one pixel; false for NaN.
    bool is_inside(std::int64_t window) const {
        const float *const place = all_.places + 2 * window, *const warp = all_.warp + 4 * window;
        const float most_x = static_cast<float>(all_.images.width - 2), most_y = static_cast<float>(all_.images.height - 2);
        const float last = static_cast<float>((side_ - 1) * all_.step - all_.reach), first = static_cast<float>(-all_.reach);
        bool inside = true;
        for (int corner = 0; corner < 4; ++corner) {
            const float right = corner % 2 == 0 ? first : last, down = corner < 2 ? first : last;
            const float x = place[0] + (warp[0] * right + warp[1] * down), y = place[1] + (warp[2] * right + warp[3] * down);
            inside = inside && x >= 1 && x <= most_x && y >= 1 && y <= most_y;
        }
        return inside;
    }

    const fingerflow_sampled_windows& all_;
    const int side_, samples_;
    float *const right_, *const down_;  // offsets of the samples from the centre in px, padded to whole vectors
};

}  // namespace

std::int64_t windows_workspace_bytes(int reach, int step) {
    const int side = side_of(reach, step);
    return 2 * static_cast<std::int64_t>(sizeof(float)) * whole_floats(side * side);
}

void sample_windows(const fingerflow_sampled_windows& windows, std::int64_t first, std::int64_t last, void* workspace) {
    const Sampler sampler(windows, static_cast<float*>(workspace));
    const auto sample = [&](const auto* images) {
        for (std::int64_t window = first; window < last; ++window) sampler.sample(images, window);
    };
    FINGERFLOW_FOR_PIXEL(windows.images.kind, windows.images.data, sample)
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow

#if FINGERFLOW_ONCE

#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
FINGERFLOW_OTHER_SETS(windows_workspace_bytes)
FINGERFLOW_OTHER_SETS(sample_windows)
}  // namespace fingerflow

void fingerflow_sample_windows(const fingerflow_sampled_windows* given, int threads) {
    using namespace fingerflow;
    const auto bytes = static_cast<std::size_t>(FINGERFLOW_PICK(windows_workspace_bytes)(given->reach, given->step));
    for_ranges(given->windows, 32, threads, [&](std::int64_t first, std::int64_t last) {
        FINGERFLOW_PICK(sample_windows)(*given, first, last, workspace(bytes));
    });
}

#endif
