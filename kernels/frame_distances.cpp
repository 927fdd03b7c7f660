// build: each instruction set, fused
// Mean absolute differences of sampled pixels of pairs of frames (fingerflow/tracker/frame_distances.py).
// Layout: frames (pairs, lines, pixels) of floats; distances (pairs, bands + 1), those of the bands of lines and of all.
#include <math.h>

#include "floats.h"
#include "instruction_sets.h"
#include "interface.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {

void distances_of_pair(const float* now, const float* before, std::int64_t lines, std::int64_t pixels, std::int64_t bands, float most,
                       float* distances) {
    float all_lines = 0;
    for (std::int64_t band = 0; band < bands; ++band) {
        const std::int64_t first = band * lines / bands, end = (band + 1) * lines / bands;
        float sum = 0;
        for (std::int64_t line = first; line < end; ++line) {
            const float *const one = now + line * pixels, *const other = before + line * pixels;
            Floats apart = all(0);
            std::int64_t k = 0;
            for (; k + kFloats <= pixels; k += kFloats) {
                const Floats change = load(one + k) - load(other + k);
                apart += lesser(greater(change, change * -1.0f), all(most));
            }
            for (int lane = 0; lane < kFloats; ++lane) sum += apart[lane];
            for (; k < pixels; ++k) sum += fabsf(one[k] - other[k]) < most ? fabsf(one[k] - other[k]) : most;
        }
        all_lines += sum;
        distances[band] = sum / static_cast<float>((end - first) * pixels);
    }
    distances[bands] = all_lines / static_cast<float>(lines * pixels);
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow

#if FINGERFLOW_ONCE

#include "parallel.h"

namespace fingerflow {
FINGERFLOW_OTHER_SETS(distances_of_pair)
}  // namespace fingerflow

// Mean absolute differences of pairs of sampled frames (pairs, lines, pixels), contiguous, each difference limited to `most`:
void fingerflow_frame_distances(const float* now /* (pairs, lines, pixels) */, const float* before /* (pairs, lines, pixels) */, std::int64_t pairs,
    std::int64_t lines, std::int64_t pixels /* from 1 */, std::int64_t bands /* from 1 where bands <= lines */, float most,
    float* distances /* (pairs, bands + 1) */, int threads) {
    using namespace fingerflow;
    parallel_for(pairs, threads, [&](std::int64_t pair) {
        const std::int64_t first = pair * lines * pixels;
        FINGERFLOW_PICK(distances_of_pair)(now + first, before + first, lines, pixels, bands, most, distances + pair * (bands + 1));
    });
}

#endif
