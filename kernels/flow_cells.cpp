// Dense flow between pixels and cells of 2 x 2 px (fingerflow/ops/flow/dense_flow.py): templates (values, gradients and
// structure tensors) and residuals of a flow.
// Residual of a pixel: warped - offset - gain * value, gain and offset fitted by least squares over the image.
// Layout: planes of floats, row-major, `channels` planes an image; a cell plane has ceil(height / 2) x ceil(width / 2)
// numbers. Threads share rows; sums are kept per row and added in order, so that they do not depend on their number.
#include <cmath>

#include "flow_cells_rows.h"
#include "flow_course.h"
#include "flow_pieces.h"
#include "interface.h"

namespace fingerflow {
namespace {

// The sum of one of `stride` sums of each row.
double added(const double* rows, std::int64_t height, std::int64_t stride, std::int64_t number) {
    double sum = 0;
    for (std::int64_t y = 0; y < height; ++y) sum += rows[y * stride + number];
    return sum;
}

// Residuals of one image: interpolates the flow to the pixels, warps, fits gain and offset, averages over cells.
void left_of(const fingerflow_flow_left_of& given, std::int64_t image, int threads) {
    const std::int64_t height = given.height, width = given.width, area = height * width;
    const std::int64_t rows = (height + 1) / 2, columns = (width + 1) / 2, cells = rows * columns;
    const FlowPicture picture{given.value + area * image, given.gradient + 2 * area * image, given.gradient + 2 * area * image + area,
                              given.inside + area * image, height, width};
    const FlowCells flow{given.flow + 2 * cells * image, given.known + cells * image, 2, rows, columns};
    const FlowPlane plane = flow_whole_plane(flow, threads);
    auto* const memory = static_cast<float*>(workspace<Keeper::kCaller>(static_cast<std::size_t>(2 * area) * sizeof(float)));
    float *const warped = memory, *const seen = memory + area;
    auto* const sums = static_cast<double*>(workspace<Keeper::kSums>(static_cast<std::size_t>(5 * height) * sizeof(double)));
    for_rows(height, width, 2 * width + 3 * (columns + 2), threads, [&](std::int64_t y, float* line) {
        float *const u = line, *const v = line + width, *const to = warped + y * width;
        float* const both[2] = {u, v};
        FINGERFLOW_PICK(flow_finer_row)(flow, &plane, width, y, both, line + 2 * width);
        FINGERFLOW_PICK(flow_warp_row)(given.coefficients + area * image, height, width, u, v, to, y);
        double* const row = sums + 5 * y;
        for (int k = 0; k < 5; ++k) row[k] = 0;
        FINGERFLOW_PICK(flow_seen_row)(picture, u, v, to, seen + y * width, given.margin, y, row);
    });
    const double count = added(sums, height, 5, 0), some = count > 1 ? count : 1;
    const float means[2] = {static_cast<float>(added(sums, height, 5, 1) / some), static_cast<float>(added(sums, height, 5, 2) / some)};
    for_rows(height, width, 1, threads, [&](std::int64_t y, float*) {
        FINGERFLOW_PICK(flow_light_row)(picture, warped + y * width, seen + y * width, means, y, sums + 5 * y + 3);
    });
    const double energy = added(sums, height, 5, 3), fitted = added(sums, height, 5, 4) / (energy > 1e-12 ? energy : 1e-12);
    const double most = given.most_gain;
    // Gain 1 where the fit is below 1 / most_gain, as for an image unrelated to the first, whose gain may be negative.
    const float gain = static_cast<float>(fitted > 1 / most ? (fitted < most ? fitted : most) : 1.0);
    const float offset = means[1] - gain * means[0];
    given.gain[image] = gain;
    float* const data = given.data + 2 * cells * image;
    for_rows(rows, 4 * columns, 4 * width, threads, [&](std::int64_t y, float* line) {
        const std::int64_t at = y * columns;
        float* const to[4] = {data + at, data + cells + at, given.squares + cells * image + at, given.seen + cells * image + at};
        FINGERFLOW_PICK(flow_left_row)(picture, warped, seen, gain, offset, y, to, line);
    });
}

}  // namespace
}  // namespace fingerflow

void fingerflow_flow_template(const fingerflow_flow_template_of* given, int threads) {
    using namespace fingerflow;
    const std::int64_t height = given->height, width = given->width, area = height * width;
    const std::int64_t rows = (height + 1) / 2, columns = (width + 1) / 2, cells = rows * columns;
    auto* const memory = static_cast<float*>(workspace<Keeper::kCaller>(static_cast<std::size_t>(area + width) * sizeof(float)));
    float *const clean = memory, *const zeros = memory + area;
    for (std::int64_t x = 0; x < width; ++x) zeros[x] = 0.0f;
    for (std::int64_t image = 0; image < given->batch; ++image) {
        const float* const coefficients = given->coefficients + area * image;
        float *const value = given->value + area * image, *const inside = given->inside + area * image;
        float *const slope_x = given->gradient + 2 * area * image, *const slope_y = slope_x + area;
        for_rows(height, width, 1, threads,
                 [&](std::int64_t y, float*) { FINGERFLOW_PICK(flow_clean_row)(coefficients + y * width, width, clean + y * width); });
        for_rows(height, width, 4 * width + 8, threads, [&](std::int64_t y, float* line) {
            const std::int64_t at = y * width;
            FINGERFLOW_PICK(flow_warp_row)(clean, height, width, zeros, zeros, value + at, y);
            FINGERFLOW_PICK(flow_slopes_row)
            (coefficients, clean, given->mask + area * image + at, given->margin, height, width, y, slope_x + at, slope_y + at, inside + at, line);
        });
        const FlowPicture picture{value, slope_x, slope_y, inside, height, width};
        float *const tensor = given->tensor + 3 * cells * image, *const down = given->down + (rows - 1) * columns * image;
        for_rows(rows, 4 * columns, 3 * width, threads, [&](std::int64_t y, float* line) {
            const std::int64_t at = y * columns;
            float* const to[3] = {tensor + at, tensor + cells + at, tensor + 2 * cells + at};
            FINGERFLOW_PICK(flow_tensor_row)
            (picture, y, to, given->known + cells * image + at, given->right + rows * (columns - 1) * image + y * (columns - 1),
             y + 1 < rows ? down + at : nullptr, line);
        });
    }
}

void fingerflow_flow_left(const fingerflow_flow_left_of* given, int threads) {
    for (std::int64_t image = 0; image < given->batch; ++image) fingerflow::left_of(*given, image, threads);
}
