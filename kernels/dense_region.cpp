// The rounds of fingerflow/ops/dense_region.py: the same whole numbers, and the same arithmetic in double between them.
#include <algorithm>
#include <cmath>
#include <exception>
#include <vector>

#include "components.h"
#include "dense_region_rows.h"
#include "interface.h"
#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
namespace {

double clamped(double value, double low, double high) { return std::min(std::max(value, low), high); }

// One frame, its rows in bands that threads share.
class Region {
public:
    Region(const Plane& plane, const unsigned char* mask, std::int64_t row_stride, int threads)
        : plane_(plane), mask_(mask), row_stride_(row_stride), threads_(threads) {
        // A band is smoothed with lines of three radii above and below it.
        const std::int64_t least = std::max<std::int64_t>(32, 6 * plane.radius);
        rows_ = std::max(least, (plane.height + threads - 1) / threads);
        bands_ = (plane.height + rows_ - 1) / rows_;
        const auto side = static_cast<double>(2 * plane.radius + 1);
        full_ = side * side * side * side * side * side;
        const std::int64_t pixels = (4 * plane.height * plane.width + 63) / 64 * 64;
        band_bytes_ = FINGERFLOW_PICK(smoothing_bytes)(plane);
        density_ = static_cast<std::int32_t*>(workspace(static_cast<std::size_t>(pixels + bands_ * band_bytes_)));
        memory_ = reinterpret_cast<unsigned char*>(density_) + pixels;
    }

    void find(unsigned char* region) {
        const auto smooth = FINGERFLOW_PICK(density_rows);
        over_bands([&](std::int64_t band, std::int64_t top, std::int64_t bottom) {
            smooth(plane_, mask_, row_stride_, top, bottom, memory_ + band * band_bytes_, density_);
        });
        std::int32_t limit = limit_of(0.25);
        for (int round = 0; round < 2; ++round) limit = limit_of(share_above(limit) * 0.5);
        const double level = border_level(limit);
        for (int round = 0; round < 2; ++round) limit = limit_of(share_above(limit) * level);
        const auto write = FINGERFLOW_PICK(write_denser);
        over_bands([&](std::int64_t, std::int64_t top, std::int64_t bottom) { write(plane_, density_, limit, top, bottom, region); });
        fill_holes(region, plane_.height, plane_.width);
        keep_largest(region, plane_.height, plane_.width);
    }

private:
    template <class Work>
    void over_bands(Work work) {
        parallel_for(bands_, threads_, [&](std::int64_t band) {
            work(band, band * rows_, std::min(plane_.height, (band + 1) * rows_));
        });
    }

    std::int32_t limit_of(double level) const { return static_cast<std::int32_t>(std::floor(full_ * level)); }

    // Share of the region denser than the limit that the mask covers.
    double share_above(std::int32_t limit) {
        std::vector<DenseCount> counts(static_cast<std::size_t>(bands_));
        const auto count = FINGERFLOW_PICK(count_denser);
        over_bands([&](std::int64_t band, std::int64_t top, std::int64_t bottom) {
            counts[static_cast<std::size_t>(band)] = count(plane_, density_, mask_, row_stride_, top, bottom, limit);
        });
        DenseCount sum{0, 0};
        for (const DenseCount& some : counts) sum = {sum.all + some.all, sum.covered + some.covered};
        return clamped(static_cast<double>(sum.covered) / static_cast<double>(std::max<std::int64_t>(sum.all, 1)), 0.2, 1.0);
    }

    // What the region's own density falls to at its border, as a share of that inside.
    double border_level(std::int32_t limit) {
        std::vector<BorderSum> sums(static_cast<std::size_t>(bands_));
        const auto add = FINGERFLOW_PICK(border_density);
        over_bands([&](std::int64_t band, std::int64_t top, std::int64_t bottom) {
            sums[static_cast<std::size_t>(band)] = add(plane_, density_, limit, top, bottom, memory_ + band * band_bytes_);
        });
        BorderSum sum{0, 0};
        for (const BorderSum& some : sums) sum = {sum.pixels + some.pixels, sum.density + some.density};
        const double pixels = full_ * static_cast<double>(std::max<std::int64_t>(sum.pixels, 1));
        return clamped(static_cast<double>(sum.density) / pixels, 0.25, 0.5);
    }

    const Plane plane_;
    const unsigned char* const mask_;
    const std::int64_t row_stride_;
    const int threads_;
    std::int64_t rows_, bands_, band_bytes_;
    double full_;
    std::int32_t* density_;
    unsigned char* memory_;
};

}  // namespace
}  // namespace fingerflow

int fingerflow_dense_region(const unsigned char* masks, unsigned char* regions, std::int64_t batch, std::int64_t height,
                            std::int64_t width, std::int64_t frame_stride, std::int64_t row_stride, int radius,
                            int threads) try {
    using namespace fingerflow;
    if (batch * height * width == 0) return 0;
    const bool by_frames = batch >= threads;  // a frame a thread: nobody waits for another's rows
    const auto find = [&](std::int64_t frame) {
        Region region({height, width, radius}, masks + frame * frame_stride, row_stride, by_frames ? 1 : threads);
        region.find(regions + frame * height * width);
    };
    if (by_frames) parallel_for(batch, threads, find);
    else
        for (std::int64_t frame = 0; frame < batch; ++frame) find(frame);
    return 0;
} catch (const std::exception&) {
    return 1;
}
