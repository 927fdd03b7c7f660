// Mean absolute response of frames to the noise mask [1 -2 1]' [1 -2 1] (fingerflow/ops/filters/noise.py), from which
// follows the standard deviation of white noise. Every fourth row of a high frame is read.
// Layout: pieces of 32 read rows; sums and counts of pieces are added in order, so that threads do not change the
// result.
#include <algorithm>
#include <vector>

#include "interface.h"
#include "noise_rows.h"
#include "parallel.h"
#include "workspace.h"

void fingerflow_mean_response(const void* frames, double* means, std::int64_t batch, std::int64_t height,
                              std::int64_t width, std::int64_t frame_stride, std::int64_t row_stride, int kind,
                              int threads) {
    using namespace fingerflow;
    const Frames given{frames, batch, height, width, frame_stride, row_stride, static_cast<PixelKind>(kind)};
    const std::int64_t step = std::max<std::int64_t>(1, std::min<std::int64_t>(4, height / 64));
    const std::int64_t rows = 32 * step, pieces = (height - 2 + rows - 1) / rows;
    const auto respond = FINGERFLOW_PICK(noise_rows);
    std::vector<Responses> found(static_cast<std::size_t>(batch * pieces), Responses{0, 0});
    parallel_for(batch * pieces, threads, [&](std::int64_t piece) {
        const std::int64_t top = 1 + piece % pieces * rows;
        const auto line = static_cast<float*>(workspace(static_cast<std::size_t>(4 * width)));
        respond(given, piece / pieces, top, std::min(height - 1, top + rows), step, line, &found[static_cast<std::size_t>(piece)]);
    });
    for (std::int64_t frame = 0; frame < batch; ++frame) {
        double sum = 0;
        std::int64_t count = 0;
        for (std::int64_t piece = frame * pieces; piece < (frame + 1) * pieces; ++piece) {
            sum += found[static_cast<std::size_t>(piece)].sum;
            count += found[static_cast<std::size_t>(piece)].count;
        }
        means[frame] = sum / static_cast<double>(count);  // NaN if no response is finite
    }
}
