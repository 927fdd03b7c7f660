// The path from camera counts to what touches: each step the twin of its own op, without a way through Python between.
#include <algorithm>
#include <cmath>
#include <exception>
#include <vector>

#include "interface.h"
#include "parallel.h"

int fingerflow_contact_classes(const fingerflow_images* images, float minimum, float low, float levels_per_unit, int size,
                               const std::uint16_t* table, unsigned char* valid, unsigned char* smooth,
                               unsigned char* touching, double* classes, int threads) try {
    const std::int64_t batch = images->batch, height = images->height, width = images->width;
    const std::int64_t pixels = height * width;
    unsigned char* const levels = touching;  // until it is known what touches
    int failed = fingerflow_light_lost(images, minimum, low, levels_per_unit, nullptr, levels, valid, threads);
    if (failed != 0) return failed;
    if (size == 1) std::copy(levels, levels + batch * pixels, smooth);
    else failed = fingerflow_median(levels, smooth, batch, height, width, pixels, width, 1, size, table, threads);
    if (failed != 0) return failed;

    constexpr int kBins = 256;
    std::vector<std::int64_t> counts(static_cast<std::size_t>(batch * kBins));
    failed = fingerflow_histogram(smooth, batch, height, width, pixels, width, 0, valid, batch, pixels, width, nullptr,
                                  kBins, counts.data(), threads);
    if (failed != 0) return failed;
    double* const fractions = classes + batch;
    fingerflow_otsu_classes(counts.data(), batch, -1, 255, classes, fractions, fractions + 2 * batch, fractions + 4 * batch,
                            fractions + 6 * batch);

    const std::int64_t rows = 64, pieces = (height + rows - 1) / rows;
    fingerflow::parallel_for(batch * pieces, threads, [&](std::int64_t piece) {
        const std::int64_t frame = piece / pieces, top = piece % pieces * rows;
        // Bytes may lie anywhere: what the loop uses is its own.
        const std::int64_t begin = frame * pixels + top * width, count = (std::min(height, top + rows) - top) * width;
        const unsigned char* const from = smooth + begin;
        unsigned char* const to = touching + begin;
        // Above NaN lies nothing, as above the highest level.
        const auto limit = static_cast<unsigned char>(std::isnan(classes[frame]) ? kBins - 1 : classes[frame]);
        for (std::int64_t k = 0; k < count; ++k) to[k] = from[k] > limit;
    });
    return 0;
} catch (const std::exception&) {
    return 1;
}
