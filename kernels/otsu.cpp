// Histograms of frames, and Otsu's threshold from them (fingerflow/ops/contact/otsu.py): the bin that maximises
// (moment total - all below)^2 / (below (total - below)).
// Layout: counts (batch, bins) int64. Each piece of rows has kSides interleaved histograms of 32 bit with one bin more,
// which takes the pixels outside the mask; they are added up at the end.
#include <algorithm>
#include <cstring>
#include <limits>
#include <vector>

#include "interface.h"
#include "parallel.h"
#include "pixels.h"
#include "workspace.h"

namespace fingerflow {
namespace {

struct Counted {
    Frames frames, mask;        // mask.data is null where every pixel counts; a batch of one serves all frames
    const std::uint16_t* bins;  // of each level, or null where a level is its own bin
    std::int64_t count;         // of bins
};

// Neighbouring pixels are often equal, and incrementing one counter twice waits for its store: four histograms in
// turns.
constexpr std::int64_t kSides = 4;

// Bin of each pixel of a line; `count` for pixels outside the mask.
template <class Pixel, class Place>
void bins_of(const Pixel* row, const unsigned char* mask, const Counted& given, Place* places) {
    const std::int64_t width = given.frames.width;
    const auto none = static_cast<Place>(given.count);
    if (given.bins == nullptr)
        for (std::int64_t x = 0; x < width; ++x) places[x] = row[x];
    else
        for (std::int64_t x = 0; x < width; ++x) places[x] = given.bins[row[x]];
    if (mask != nullptr)
        for (std::int64_t x = 0; x < width; ++x) places[x] = mask[x] != 0 ? places[x] : none;
}

// Counts the bins of one line.
template <class Place>
void count_line(const Place* places, std::int64_t width, std::uint32_t* const* sides) {
    std::int64_t x = 0;
    for (; x + kSides <= width; x += kSides)
        for (std::int64_t side = 0; side < kSides; ++side) ++sides[side][places[x + side]];
    for (; x < width; ++x) ++sides[0][places[x]];
}

// Counts eight bytes, read by one load.
void count_eight(const std::uint8_t* pixels, std::uint32_t* const* sides) {
    std::uint64_t eight;
    std::memcpy(&eight, pixels, sizeof eight);
    std::uint32_t *const first = sides[0], *const second = sides[1], *const third = sides[2], *const fourth = sides[3];
    ++first[eight & 255];
    ++second[eight >> 8 & 255];
    ++third[eight >> 16 & 255];
    ++fourth[eight >> 24 & 255];
    ++first[eight >> 32 & 255];
    ++second[eight >> 40 & 255];
    ++third[eight >> 48 & 255];
    ++fourth[eight >> 56];
}

// Counts the pixels of a line inside the mask, or all if it is null.
void count_line(const std::uint8_t* row, const unsigned char* mask, std::int64_t width, std::int64_t none,
                std::uint32_t* const* sides) {
    std::int64_t x = 0;
    const auto count_some = [&](std::int64_t end) {
        for (; x < end; ++x) ++sides[x % kSides][mask == nullptr || mask[x] != 0 ? row[x] : none];
    };
    while (x + 8 <= width) {
        std::uint64_t wanted = 0x0101010101010101;
        if (mask != nullptr) std::memcpy(&wanted, mask + x, sizeof wanted);
        if (wanted != 0 && wanted != 0x0101010101010101) {
            count_some(x + 8);
        } else {
            if (wanted != 0) count_eight(row + x, sides);
            x += 8;
        }
    }
    count_some(width);
}

// Counts some rows into `sums` (kSides, count + 1), which must be zero.
template <class Place, class Pixel>
void count_rows(const Pixel* frame, const unsigned char* mask, const Counted& given, std::int64_t rows, Place* places,
                std::uint32_t* sums) {
    const std::int64_t width = given.frames.width;
    std::uint32_t* sides[kSides];
    for (std::int64_t side = 0; side < kSides; ++side) sides[side] = sums + side * (given.count + 1);
    for (std::int64_t y = 0; y < rows; ++y) {
        const Pixel* const row = frame + y * given.frames.row_stride;
        const unsigned char* const wanted = mask == nullptr ? nullptr : mask + y * given.mask.row_stride;
        if constexpr (sizeof(Pixel) == 1)
            if (given.bins == nullptr) {
                count_line(row, wanted, width, given.count, sides);
                continue;
            }
        bins_of(row, wanted, given, places);
        count_line(places, width, sides);
    }
}

template <class Pixel>
void count_pixels(const Pixel* frame, const unsigned char* mask, const Counted& given, std::int64_t rows, void* places,
                  std::uint32_t* sums) {
    if (given.count < 1 << 16) count_rows(frame, mask, given, rows, static_cast<std::uint16_t*>(places), sums);
    else count_rows(frame, mask, given, rows, static_cast<std::uint32_t*>(places), sums);
}

void count_piece(const Counted& given, std::int64_t frame, std::int64_t top, std::int64_t rows, void* places,
                 std::uint32_t* sums) {
    const auto* mask = static_cast<const unsigned char*>(given.mask.data);
    if (mask != nullptr)
        mask += (given.mask.batch == 1 ? 0 : frame) * given.mask.frame_stride + top * given.mask.row_stride;
    const std::int64_t at = frame * given.frames.frame_stride + top * given.frames.row_stride;
    if (given.frames.kind == kUint8)
        count_pixels(static_cast<const std::uint8_t*>(given.frames.data) + at, mask, given, rows, places, sums);
    else
        count_pixels(static_cast<const std::uint16_t*>(given.frames.data) + at, mask, given, rows, places, sums);
}

}  // namespace
}  // namespace fingerflow

void fingerflow_histogram(const void* frames, std::int64_t batch, std::int64_t height, std::int64_t width,
                          std::int64_t frame_stride, std::int64_t row_stride, int kind, const unsigned char* mask,
                          std::int64_t masks, std::int64_t mask_stride, std::int64_t mask_row_stride,
                          const std::uint16_t* bins, std::int64_t count, std::int64_t* counts, int threads) {
    using namespace fingerflow;
    const Counted given{{frames, batch, height, width, frame_stride, row_stride, static_cast<PixelKind>(kind)},
                        {mask, masks, height, width, mask_stride, mask_row_stride, kUint8},
                        bins, count};
    std::fill(counts, counts + batch * count, 0);
    if (height * width == 0) return;

    // Pieces are large enough that adding their histograms costs little, and small enough that no 32-bit count
    // overflows.
    const std::int64_t least = std::max<std::int64_t>(1, 16 * count / width);
    const std::int64_t most = std::max<std::int64_t>(1, (std::int64_t{1} << 31) / width);
    const std::int64_t shared = (height * batch + threads - 1) / threads;
    const std::int64_t rows = std::min({height, most, std::max(least, shared)});
    const std::int64_t pieces = (height + rows - 1) / rows, size = kSides * (count + 1);
    std::vector<std::uint32_t> sums(static_cast<std::size_t>(batch * pieces * size));
    parallel_for(batch * pieces, threads, [&](std::int64_t piece) {
        const std::int64_t top = piece % pieces * rows;
        void* const places = workspace(static_cast<std::size_t>(4 * width));
        count_piece(given, piece / pieces, top, std::min(rows, height - top), places, sums.data() + piece * size);
    });
    for (std::int64_t piece = 0; piece < batch * pieces; ++piece)
        for (std::int64_t side = 0; side < kSides; ++side)
            for (std::int64_t bin = 0; bin < count; ++bin)
                counts[piece / pieces * count + bin] += sums[static_cast<std::size_t>(piece * size + side * (count + 1) + bin)];
}

void fingerflow_otsu_threshold(const std::int64_t* counts, std::int64_t batch, double low, double high, double* thresholds) {
    constexpr int kBins = 256;
    for (std::int64_t frame = 0; frame < batch; ++frame, counts += kBins) {
        double total = 0, all = 0;
        for (int bin = 0; bin < kBins; ++bin) {
            total += static_cast<double>(counts[bin]);
            all += static_cast<double>(counts[bin]) * bin;
        }
        double below = 0, moment = 0, best = -1;
        int last = -1;
        bool split = false;
        for (int bin = 0; bin < kBins; ++bin) {
            below += static_cast<double>(counts[bin]);
            moment += static_cast<double>(counts[bin]) * bin;
            const double product = below * (total - below), difference = moment * total - all * below;
            const double between = difference * difference / (product < 1 ? 1 : product);
            split = split || product > 0;
            if (between > best) {
                best = between;
                last = bin;
            }
        }
        thresholds[frame] = split ? low + (last + 1) * ((high - low) / kBins) : std::numeric_limits<double>::quiet_NaN();
    }
}
