// Points shared out to threads, a few at a time.
#include <algorithm>
#include <exception>

#include "interface.h"
#include "parallel.h"
#include "tracking_points.h"
#include "workspace.h"

int fingerflow_track_points(const fingerflow_image* previous, const fingerflow_image* current, std::int64_t height,
                            std::int64_t width, const std::int64_t* image_index, const float* noise, const float* start, const float* guess,
                            const float* back_guess, const float* warp, std::int64_t count, int window, int gain_offset,
                            float rounding, float forward_backward_limit, float mismatch_limit,
                            float* points, float* error, float* covariance, unsigned char* status, int threads) try {
    using namespace fingerflow;
    const auto frames = [&](const fingerflow_image& image) {
        return Frames{image.data, image.count, height, width, image.image_stride, image.row_stride, static_cast<PixelKind>(image.kind)};
    };
    const TrackedPair pair{{frames(*previous), frames(*current)}, image_index, noise, start, guess, back_guess, warp, window,
                           gain_offset, rounding, forward_backward_limit, mismatch_limit, points, error, covariance,
                           status};
    const std::int64_t at_a_time = 16;
    const auto bytes = static_cast<std::size_t>(FINGERFLOW_PICK(tracking_workspace_bytes)(window));
    const auto track = FINGERFLOW_PICK(track_points);
    parallel_for((count + at_a_time - 1) / at_a_time, threads, [&](std::int64_t piece) {
        track(pair, piece * at_a_time, std::min(count, (piece + 1) * at_a_time), workspace(bytes));
    });
    return 0;
} catch (const std::exception&) {
    return 1;
}
