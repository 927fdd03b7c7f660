#include "illumination.h"

#include <algorithm>
#include <exception>

#include "parallel.h"
#include "workspace.h"

namespace fingerflow {

Illumination illumination_of(const fingerflow_images& images, float minimum, float low, float levels_per_unit) {
    const auto frames_of = [&](const fingerflow_image& image) {
        return Frames{image.data, image.count, images.height, images.width, image.image_stride, image.row_stride,
                      static_cast<PixelKind>(image.kind)};
    };
    return {frames_of(images.frames), frames_of(images.reference), frames_of(images.dark), minimum, low, levels_per_unit};
}

std::vector<float> least_lights(const Illumination& given, int threads) {
    const std::int64_t height = given.frames.height, width = given.frames.width;
    const std::int64_t lights = std::max(given.reference.batch, given.dark.data == nullptr ? 1 : given.dark.batch);
    const std::int64_t step = std::max<std::int64_t>(1, std::min(height, width) / 128);
    const std::int64_t looked_at = ((height + step - 1) / step) * ((width + step - 1) / step);
    std::vector<float> least(static_cast<std::size_t>(lights));
    const auto find = FINGERFLOW_PICK(least_light);
    parallel_for(lights, threads, [&](std::int64_t light) {
        const auto lines = static_cast<float*>(workspace(static_cast<std::size_t>(4 * (2 * width + looked_at + 31))));
        least[static_cast<std::size_t>(light)] = find(given, light, step, lines, lines + 2 * width);
    });
    return least;
}

}  // namespace fingerflow

int fingerflow_light_lost(const fingerflow_images* images, float minimum, float low, float levels_per_unit, float* signal,
                          unsigned char* levels, unsigned char* valid, int threads) try {
    using namespace fingerflow;
    const std::int64_t batch = images->batch, height = images->height, width = images->width;
    if (batch * height * width == 0) return 0;
    const Illumination given = illumination_of(*images, minimum, low, levels_per_unit);
    const std::vector<float> least = least_lights(given, threads);
    const std::int64_t rows = 16, pieces = (height + rows - 1) / rows;
    const auto filter = FINGERFLOW_PICK(light_lost_rows);
    parallel_for(batch * pieces, threads, [&](std::int64_t piece) {
        const std::int64_t frame = piece / pieces, top = piece % pieces * rows, at = (frame * height + top) * width;
        const auto lines = static_cast<float*>(workspace(static_cast<std::size_t>(24 * width)));
        const float limit = least[least.size() == 1 ? 0 : static_cast<std::size_t>(frame)];
        filter(given, frame, top, std::min(height, top + rows), limit, lines,
               {signal == nullptr ? nullptr : signal + at, levels + at, valid + at});
    });
    return 0;
} catch (const std::exception&) {
    return 1;
}
