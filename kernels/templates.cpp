// Subsets (templates) prepared, and registered in frames (fingerflow/ops/tracking/templates.py): points are divided
// into pieces that threads share. The equations are in templates_points.cpp.
// Layout: samples (P, 3, n, n) hold values, gx and gy of a template, template statistics (P, 32). Points are processed
// in bands of kBandPx rows, then by column, since windows of neighbours overlap and share cache lines.
#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "interface.h"
#include "parallel.h"
#include "templates_points.h"
#include "workspace.h"

namespace {

constexpr std::int64_t kAtATime = 16;
constexpr float kBandPx = 16;

fingerflow::Frames frames_of(const fingerflow_image& image, std::int64_t height, std::int64_t width) {
    return {image.data, image.count, height, width, image.image_stride, image.row_stride, static_cast<fingerflow::PixelKind>(image.kind)};
}

// Order of positions (count, 2): by image, then by band of rows, then by column.
std::vector<std::int64_t> in_bands(const float* places, std::int64_t count, std::int64_t points_an_image, std::int64_t height) {
    std::vector<std::pair<std::pair<std::int64_t, float>, std::int64_t>> keys;
    keys.reserve(static_cast<std::size_t>(count));
    const float last = static_cast<float>(height) / kBandPx;
    const std::int64_t bands = static_cast<std::int64_t>(last) + 1;
    for (std::int64_t k = 0; k < count; ++k) {
        const float x = places[2 * k], band = places[2 * k + 1] / kBandPx;
        const std::int64_t row = band > 0 ? static_cast<std::int64_t>(std::min(band, last)) : 0;  // 0 for NaN
        keys.push_back({{k / points_an_image * bands + row, x > 0 ? x : 0.0f}, k});
    }
    std::sort(keys.begin(), keys.end());
    std::vector<std::int64_t> order;
    order.reserve(keys.size());
    for (const auto& key : keys) order.push_back(key.second);
    return order;
}

// Calls work(first, last, workspace) for pieces of kAtATime points.
template <class Work>
void share_out(const Work& work, std::int64_t count, int window, int threads) {
    using namespace fingerflow;
    const auto bytes = static_cast<std::size_t>(FINGERFLOW_PICK(templates_workspace_bytes)(window));
    parallel_for((count + kAtATime - 1) / kAtATime, threads, [&](std::int64_t piece) {
        work(piece * kAtATime, std::min(count, (piece + 1) * kAtATime), workspace(bytes));
    });
}

}  // namespace

void fingerflow_prepare_templates(const fingerflow_image* image, std::int64_t height, std::int64_t width, std::int64_t points,
                                  float* start, const float* inverse_warp, const float* variance, int window, int gain_offset,
                                  float rounding, float* samples, float* numbers, int threads) {
    using namespace fingerflow;
    const std::vector<std::int64_t> order = in_bands(start, image->count * points, points, height);
    const TemplatesToPrepare work{frames_of(*image, height, width), order.data(), points, window, gain_offset, rounding, start, inverse_warp,
                                  variance, samples, numbers};
    const auto some = [&](auto... piece) { FINGERFLOW_PICK(prepare_templates)(work, piece...); };
    share_out(some, image->count * points, window, threads);
}

void fingerflow_find_templates(const fingerflow_image* frames, std::int64_t height, std::int64_t width, std::int64_t batch,
                               std::int64_t points, std::int64_t steps, int window, int rounds, const float* start, const float* samples,
                               const float* numbers, const float* variance, float* place, float* speed,
                               float rounding, float forward_backward_limit, float mismatch_limit, float* found, float* error,
                               float* covariance, unsigned char* status, float* estimate, int threads) {
    using namespace fingerflow;
    const std::vector<std::int64_t> order = in_bands(place, batch * points, points, height);
    const TemplatesToFind work{frames_of(*frames, height, width), order.data(), batch, points, steps, window, rounds, start, samples,
                               numbers, variance, place, speed, rounding, forward_backward_limit, mismatch_limit, found, error,
                               covariance, status, estimate};
    const auto some = [&](auto... piece) { FINGERFLOW_PICK(find_templates)(work, piece...); };
    share_out(some, batch * points, window, threads);
}

void fingerflow_find_pairs(const void* previous, const void* current, std::int64_t batch, std::int64_t height, std::int64_t width,
                           std::int64_t frame_stride, std::int64_t row_stride, int kind, std::int64_t points, float* start,
                           const float* inverse_warp, const float* variance, int window, int gain_offset, int rounds, float* place,
                           float* speed, float rounding, float forward_backward_limit, float mismatch_limit, float* numbers, float* found,
                           float* error, float* covariance, unsigned char* status, float* estimate, int threads) {
    using namespace fingerflow;
    const Frames image{previous, batch, height, width, frame_stride, row_stride, static_cast<PixelKind>(kind)};
    Frames frames = image;
    frames.data = current;
    const std::vector<std::int64_t> order = in_bands(start, batch * points, points, height);
    const TemplatesToPrepare ones{image, order.data(), points, window, gain_offset, rounding, start, inverse_warp, variance, nullptr, numbers};
    const TemplatesToFind others{frames, order.data(), batch, points, 1, window, rounds, start, nullptr, numbers, variance, place, speed,
                                 rounding, forward_backward_limit, mismatch_limit, found, error, covariance, status, estimate};
    const auto some = [&](auto... piece) { FINGERFLOW_PICK(find_pairs)(ones, others, piece...); };
    share_out(some, batch * points, window, threads);
}
