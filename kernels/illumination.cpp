#include <algorithm>
#include <exception>
#include <vector>

#include "illumination_rows.h"
#include "interface.h"
#include "parallel.h"
#include "workspace.h"

int fingerflow_light_lost(const void* frames, std::int64_t batch, std::int64_t height, std::int64_t width,
                          std::int64_t frame_stride, std::int64_t row_stride, int kind, const void* reference,
                          std::int64_t references, std::int64_t reference_stride, std::int64_t reference_row_stride,
                          int reference_kind, const void* dark, std::int64_t darks, std::int64_t dark_stride,
                          std::int64_t dark_row_stride, int dark_kind, float minimum, float low, float levels_per_unit,
                          float* signal, unsigned char* levels, unsigned char* valid, int threads) try {
    using namespace fingerflow;
    const Illumination given{
        {frames, batch, height, width, frame_stride, row_stride, static_cast<PixelKind>(kind)},
        {reference, references, height, width, reference_stride, reference_row_stride, static_cast<PixelKind>(reference_kind)},
        {dark, darks, height, width, dark_stride, dark_row_stride, static_cast<PixelKind>(dark_kind)},
        minimum, low, levels_per_unit};
    if (batch * height * width == 0) return 0;

    const std::int64_t lights = std::max(references, dark == nullptr ? 1 : darks);
    const std::int64_t step = std::max<std::int64_t>(1, std::min(height, width) / 128);
    const std::int64_t looked_at = ((height + step - 1) / step) * ((width + step - 1) / step);
    std::vector<float> least(static_cast<std::size_t>(lights));
    const auto find = FINGERFLOW_PICK(least_light);
    parallel_for(lights, threads, [&](std::int64_t light) {
        const auto lines = static_cast<float*>(workspace(static_cast<std::size_t>(4 * (2 * width + looked_at + 31))));
        least[static_cast<std::size_t>(light)] = find(given, light, step, lines, lines + 2 * width);
    });

    const std::int64_t rows = 16, pieces = (height + rows - 1) / rows;
    const auto filter = FINGERFLOW_PICK(light_lost_rows);
    parallel_for(batch * pieces, threads, [&](std::int64_t piece) {
        const std::int64_t frame = piece / pieces, top = piece % pieces * rows;
        const auto lines = static_cast<float*>(workspace(static_cast<std::size_t>(20 * width)));
        const float limit = least[static_cast<std::size_t>(lights == 1 ? 0 : frame)];
        filter(given, frame, top, std::min(height, top + rows), limit, lines, {signal, levels, valid});
    });
    return 0;
} catch (const std::exception&) {
    return 1;
}
