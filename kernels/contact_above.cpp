// From frames to what touches by a given threshold: some rows of light at a time, which stay in a cache.
#include <algorithm>
#include <exception>
#include <vector>

#include "illumination.h"
#include "interface.h"
#include "median_above_rows.h"
#include "parallel.h"
#include "workspace.h"

int fingerflow_contact_above(const fingerflow_images* images, float minimum, const double* thresholds, int size,
                             unsigned char* touching, int threads) try {
    using namespace fingerflow;
    const std::int64_t batch = images->batch, height = images->height, width = images->width, half = size / 2;
    if (batch * height * width == 0) return 0;
    const Illumination given = illumination_of(*images, minimum, 0.0f, 1.0f);
    const std::vector<float> least = least_lights(given, threads);
    const std::int64_t rows = std::max<std::int64_t>(32, 4 * size), pieces = (height + rows - 1) / rows;
    const auto lose = FINGERFLOW_PICK(light_lost_rows);
    const auto count = FINGERFLOW_PICK(median_above_rows);
    parallel_for(batch * pieces, threads, [&](std::int64_t piece) {
        const std::int64_t frame = piece / pieces, top = piece % pieces * rows, bottom = std::min(height, top + rows);
        // Windows reach beyond these rows, but not beyond the frame.
        const std::int64_t first = std::max<std::int64_t>(0, top - half), last = std::min(height, bottom + half);
        const std::int64_t pixels = (last - first) * width;
        const auto memory = static_cast<unsigned char*>(
            workspace(static_cast<std::size_t>(4 * pixels + 24 * width + pixels + (size + 2) * (width + size + 64))));
        const auto signal = reinterpret_cast<float*>(memory), lines = signal + pixels;
        unsigned char* const valid = memory + 4 * pixels + 24 * width;
        const float limit = least[least.size() == 1 ? 0 : static_cast<std::size_t>(frame)];
        lose(given, frame, first, last, limit, lines, {signal, nullptr, valid});
        unsigned char* const result = touching + (frame * height + first) * width;
        count({signal, 1, last - first, width, pixels, width, kFloat32}, 0, top - first, bottom - first, size,
              thresholds[frame], valid + pixels, result);
        const std::int64_t begin = (top - first) * width, end = (bottom - first) * width;
        for (std::int64_t k = begin; k < end; ++k) result[k] = static_cast<unsigned char>(result[k] & valid[k]);
    });
    return 0;
} catch (const std::exception&) {
    return 1;
}
