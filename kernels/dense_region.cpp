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

constexpr double kLeastShare = 0.2, kLeastLevel = 0.25;

// The part of a plane that a box covers, and what lies up to `margin` around it.
Box grown(const Box& box, std::int64_t margin, std::int64_t height, std::int64_t width) {
    return {std::max<std::int64_t>(0, box.top - margin), std::min(height, box.bottom + margin),
            std::max<std::int64_t>(0, box.left - margin), std::min(width, box.right + margin)};
}

// One frame, or the part of it that matters, its rows in bands that threads share.
class Region {
public:
    Region(const Plane& plane, const unsigned char* mask, unsigned char* region, std::int64_t row_stride,
           std::int64_t region_stride, int threads)
        : plane_(plane), mask_(mask), region_(region), row_stride_(row_stride), region_stride_(region_stride), threads_(threads) {
        const std::int64_t most_bands = std::min<std::int64_t>(threads, (plane.height + least_rows() - 1) / least_rows());
        share_rows();
        const auto side = static_cast<double>(2 * plane.radius + 1);
        full_ = side * side * side * side * side * side;
        const std::int64_t pixels = (4 * plane.height * plane.pitch + 63) / 64 * 64;
        band_bytes_ = FINGERFLOW_PICK(smoothing_bytes)(plane);
        density_ = static_cast<std::int32_t*>(workspace(static_cast<std::size_t>(pixels + most_bands * band_bytes_)));
        memory_ = reinterpret_cast<unsigned char*>(density_) + pixels;
    }

    void find() {
        const auto smooth = FINGERFLOW_PICK(density_rows);
        over_bands([&](std::int64_t band, std::int64_t top, std::int64_t bottom) {
            smooth(plane_, mask_, row_stride_, top, bottom, memory_ + band * band_bytes_, density_);
        });
        if (!narrow_down()) return;
        std::int32_t limit = limit_of(kLeastLevel);
        for (int round = 0; round < 2; ++round) limit = limit_of(share_above(limit) * 0.5);
        const double level = border_level(limit);
        for (int round = 0; round < 2; ++round) limit = limit_of(share_above(limit) * level);
        const auto write = FINGERFLOW_PICK(write_denser);
        over_bands([&](std::int64_t, std::int64_t top, std::int64_t bottom) {
            write(plane_, density_, limit, top, bottom, region_, region_stride_);
        });
        fill_holes(region_, plane_.height, plane_.width, region_stride_);
        keep_largest(region_, plane_.height, plane_.width, region_stride_);
    }

private:
    // A band is smoothed with lines of three radii above and below it: it should not be lower than those.
    std::int64_t least_rows() const { return std::max<std::int64_t>(32, 6 * plane_.radius); }

    void share_rows() {
        rows_ = std::max(least_rows(), (plane_.height + threads_ - 1) / threads_);
        bands_ = (plane_.height + rows_ - 1) / rows_;
    }

    // No region has pixels less dense than the least level of the least share. Around the others a region's own density
    // is wanted one pixel beyond it, and depends on no other sums than those one radius further away. False: no pixels.
    bool narrow_down() {
        const Box dense = FINGERFLOW_PICK(denser_box)(plane_, density_, limit_of(kLeastShare * kLeastLevel), memory_);
        if (dense.bottom == 0) return false;
        const Box box = grown(dense, plane_.radius + 1, plane_.height, plane_.width);
        plane_.height = box.bottom - box.top;
        plane_.width = box.right - box.left;
        density_ += box.top * plane_.pitch + box.left;
        mask_ += box.top * row_stride_ + box.left;
        region_ += box.top * region_stride_ + box.left;
        share_rows();
        return true;
    }

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
        return clamped(static_cast<double>(sum.covered) / static_cast<double>(std::max<std::int64_t>(sum.all, 1)), kLeastShare, 1.0);
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
        return clamped(static_cast<double>(sum.density) / pixels, kLeastLevel, 0.5);
    }

    Plane plane_;
    const unsigned char* mask_;
    unsigned char* region_;
    const std::int64_t row_stride_, region_stride_;
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
    const auto box_of = FINGERFLOW_PICK(covered_box);
    const auto find = [&](std::int64_t frame) {
        const unsigned char* const mask = masks + frame * frame_stride;
        unsigned char* const region = regions + frame * height * width;
        std::fill_n(region, height * width, 0);
        const Box covered = box_of(mask, height, width, row_stride, static_cast<unsigned char*>(workspace(static_cast<std::size_t>(width))));
        if (covered.bottom == 0) return;
        // A region reaches less than three radii beyond the mask. Further away all is empty, as beyond the frame.
        const Box box = grown(covered, 4 * radius, height, width);
        const Plane plane{box.bottom - box.top, box.right - box.left, radius, box.right - box.left};
        Region(plane, mask + box.top * row_stride + box.left, region + box.top * width + box.left, row_stride, width,
               by_frames ? 1 : threads).find();
    };
    if (by_frames) parallel_for(batch, threads, find);
    else
        for (std::int64_t frame = 0; frame < batch; ++frame) find(frame);
    return 0;
} catch (const std::exception&) {
    return 1;
}
