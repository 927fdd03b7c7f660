// Deformed windows image(place + warp w), sampled for subset verification, 32 windows a piece
// (fingerflow/ops/tracking/window_correlation.py).
// Layout: places (windows, 2), warp (windows, 2, 2), results (windows, side, side) floats.
#include <algorithm>

#include "interface.h"
#include "parallel.h"
#include "window_correlation_points.h"
#include "workspace.h"

void fingerflow_sample_windows(const fingerflow_image* images, std::int64_t height, std::int64_t width,
                               const std::int64_t* image_index, const float* places, const float* warp, std::int64_t windows,
                               int reach, int step, float* found, int threads) {
    using namespace fingerflow;
    constexpr std::int64_t at_a_time = 32;
    const Frames frames{images->data, images->count, height, width, images->image_stride, images->row_stride,
                        static_cast<PixelKind>(images->kind)};
    const WindowsToSample given{frames, image_index, places, warp, reach, step, found};
    const auto bytes = static_cast<std::size_t>(FINGERFLOW_PICK(windows_workspace_bytes)(reach, step));
    const auto sample = FINGERFLOW_PICK(sample_windows);
    parallel_for((windows + at_a_time - 1) / at_a_time, threads, [&](std::int64_t piece) {
        sample(given, piece * at_a_time, std::min(windows, (piece + 1) * at_a_time), workspace(bytes));
    });
}
