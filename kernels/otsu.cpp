// Histograms of frames (fingerflow/ops/contact/otsu.py).
// Layout: counts (batch, bins) int64. A piece of rows has counters (bins, kSides) of 32 bit in the thread's workspace, and
// adds them to the counts of its frame: integers, so that the order does not matter.
#include <algorithm>
#include <limits>
#include <mutex>

#include "interface.h"
#include "parallel.h"
#include "pixels.h"
#include "workspace.h"

namespace fingerflow {
namespace {

// Neighbouring pixels are often equal, and incrementing one counter twice waits for its store: four of each bin in turns,
// side by side, so that a load needs no sum.
constexpr std::int64_t kSides = 4;

// Adds weight(x) to a counter of bin(x) for each pixel of a line. Both are copies, whose pointers stay in registers.
template <class Bin, class Weight>
void count_line(Bin bin, Weight weight, std::int64_t width, std::uint32_t* counters) {
    std::int64_t x = 0;
    for (; x + kSides <= width; x += kSides)
        for (std::int64_t side = 0; side < kSides; ++side) counters[kSides * bin(x + side) + side] += weight(x + side);
    for (; x < width; ++x) counters[kSides * bin(x)] += weight(x);
}

// Counts the pixels of a line inside the mask, or all if it is null.
template <class Pixel>
void count_pixels(const Pixel* row, const unsigned char* mask, const std::uint16_t* bins, std::int64_t width,
                  std::uint32_t* counters) {
    const auto by = [=](auto bin) {
        if (mask == nullptr) count_line(bin, [](std::int64_t) { return 1; }, width, counters);
        else count_line(bin, [=](std::int64_t x) { return mask[x] != 0; }, width, counters);
    };
    if (bins == nullptr) by([=](std::int64_t x) { return row[x]; });
    else by([=](std::int64_t x) { return bins[row[x]]; });
}

}  // namespace
}  // namespace fingerflow

void fingerflow_histogram(const fingerflow_frames* frames, const unsigned char* mask, std::int64_t masks,
                          std::int64_t mask_stride, std::int64_t mask_row_stride, const std::uint16_t* bins,
                          std::int64_t count, std::int64_t* counts, int threads) {
    using namespace fingerflow;
    const fingerflow_frames of = *frames;
    const std::int64_t batch = of.batch, height = of.height, width = of.width;
    std::fill_n(counts, batch * count, 0);
    if (batch * height * width == 0) return;
    // Threads share the rows of few frames, in pieces that take longer than the addition of their histograms and do not
    // overflow 32 bit.
    const std::int64_t pieces = std::max<std::int64_t>(1, std::min((threads + batch - 1) / batch, height * width / (16 * count)));
    const std::int64_t most = std::max<std::int64_t>(1, std::numeric_limits<std::uint32_t>::max() / width);
    const std::int64_t rows = std::min((height + pieces - 1) / pieces, most);
    std::mutex adding;
    for_bands(batch, height, rows, threads, [&](std::int64_t frame, std::int64_t top, std::int64_t bottom) {
        auto* const counters = static_cast<std::uint32_t*>(workspace(static_cast<std::size_t>(4 * kSides * count)));
        std::fill_n(counters, kSides * count, 0);
        for (std::int64_t y = top; y < bottom; ++y) {
            const std::int64_t at = frame * of.frame_stride + y * of.row_stride;
            const unsigned char* const wanted =
                mask == nullptr ? nullptr : mask + (masks == 1 ? 0 : frame) * mask_stride + y * mask_row_stride;
            if (of.kind == kUint8) count_pixels(static_cast<const std::uint8_t*>(of.data) + at, wanted, bins, width, counters);
            else count_pixels(static_cast<const std::uint16_t*>(of.data) + at, wanted, bins, width, counters);
        }
        std::unique_lock<std::mutex> alone(adding, std::defer_lock);
        if (rows < height) alone.lock();
        for (std::int64_t bin = 0; bin < count; ++bin)
            for (std::int64_t side = 0; side < kSides; ++side) counts[frame * count + bin] += counters[kSides * bin + side];
    });
}
