// Medians by the generated networks: down strips of a band, one row of tiles after the other.
#include "median_band.h"

#include <cstring>

#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

// Between the beginnings of two slots. An odd number of cache lines, so that slots fall into all sets of a cache.
constexpr long kSlotBytes = 704;

#include "median_networks.h"

// How many tiles are filtered from left to right at a time: their slots stay in a first-level cache of 32 KiB. Each time
// a few more are read than written, so that many are better.
template <class Pixel, class Network>
constexpr long strip_tiles() {
    constexpr long fitting = 28 * 1024 / kVectorBytes / Network::kSlots, most = kSlotBytes / kVectorBytes;
    constexpr long vectors = fitting < 1 ? 1 : fitting < most ? fitting : most;
    return vectors * kLanes<Pixel> - Network::kReachRight;
}

// Tiles of a line of the band, with what is read beyond the last one.
template <class Pixel, class Network>
constexpr long line_tiles(long width) {
    const long tiles = (width + Network::kTileColumns - 1) / Network::kTileColumns;
    return whole_lanes<Pixel>(tiles + Network::kReachRight + kLanes<Pixel>);
}

template <class Pixel>
struct Pair;  // two neighbouring pixels in one word, the left one in its lower half
template <>
struct Pair<std::uint8_t> {
    using Word = std::uint16_t;
};
template <>
struct Pair<std::uint16_t> {
    using Word = std::uint32_t;
};

template <class Pixel, class Word>
void split_pairs(const Word* FINGERFLOW_RESTRICT pairs, long count, Pixel* FINGERFLOW_RESTRICT left,
                 Pixel* FINGERFLOW_RESTRICT right) {
    const long end = whole_lanes<Pixel>(count);
    FINGERFLOW_INDEPENDENT
    for (long x = 0; x < end; ++x) {
        left[x] = static_cast<Pixel>(pairs[x]);
        right[x] = static_cast<Pixel>(pairs[x] >> 8 * sizeof(Pixel));
    }
}

template <class Pixel, class Word>
void join_pairs(const Pixel* FINGERFLOW_RESTRICT left, const Pixel* FINGERFLOW_RESTRICT right, long count,
                Word* FINGERFLOW_RESTRICT pairs) {
    const long end = whole_lanes<Pixel>(count);
    FINGERFLOW_INDEPENDENT
    for (long x = 0; x < end; ++x)
        pairs[x] = static_cast<Word>(left[x] | static_cast<Word>(right[x]) << 8 * sizeof(Pixel));
}

// `count` pixels of a row of the frame from half a window left of it on; beyond the frame the nearest pixel counts.
template <class Pixel>
void pad_line(const Pixel* row, long width, long half, long count, Pixel* line) {
    for (long x = 0; x < half; ++x) line[x] = row[0];
    std::memcpy(line + half, row, static_cast<std::size_t>(width) * sizeof(Pixel));
    for (long x = half + width; x < count; ++x) line[x] = row[width - 1];
}

template <class Pixel, class Network>
void filter(const Pixel* frame, Pixel* medians, const MedianBand& band, Pixel* workspace) {
    constexpr long rows = Network::kTileRows, columns = Network::kTileColumns, half = Network::kSize / 2;
    constexpr long stride = Network::kStride;
    static_assert(columns == 1 || columns == 2, "wider tiles need another way to split a line");
    const long width = band.width;
    const long tiles = (width + columns - 1) / columns;
    const long pitch = line_tiles<Pixel, Network>(width);
    Pixel* const rings = workspace;
    Pixel* const scratch = rings + Network::kAges * Network::kRingSlots * stride;
    Pixel* const line = scratch + Network::kScratchSlots * stride;
    Pixel* const prepared = line + columns * pitch;
    auto* const pairs = reinterpret_cast<typename Pair<Pixel>::Word*>(line);

    // Every line that the band's windows cover, its even and odd columns apart.
    const long first = band.top - half, tile_rows = (band.bottom - band.top + rows - 1) / rows + Network::kWarmUp;
    for (long n = 0; n < tile_rows * rows; ++n) {
        const long y = first + n < 0 ? 0 : first + n >= band.height ? band.height - 1 : first + n;
        Pixel* const target = prepared + n * columns * pitch;
        const long count = columns * (tiles + Network::kReachRight);
        pad_line(frame + y * band.row_stride, width, half, count, columns == 1 ? target : line);
        if (columns == 2) split_pairs(pairs, count / 2, target, target + pitch);
    }

    const long strips = (tiles + strip_tiles<Pixel, Network>() - 1) / strip_tiles<Pixel, Network>();
    const long strip = (tiles + strips - 1) / strips;
    for (long left = 0; left < tiles; left += strip) {
        const long count = strip < tiles - left ? strip : tiles - left;
        const long pixels = count * columns < width - left * columns ? count * columns : width - left * columns;
        Pixel* ring[Network::kAges];
        for (int age = 0; age < Network::kAges; ++age) ring[age] = rings + age * Network::kRingSlots * stride;
        for (long n = -Network::kWarmUp; n < tile_rows - Network::kWarmUp; ++n) {
            Pixel* const oldest = ring[Network::kAges - 1];
            for (int age = Network::kAges - 1; age > 0; --age) ring[age] = ring[age - 1];
            ring[0] = oldest;
            // What a row above the first one reads before the band's lines begin is never used.
            const Pixel* lines[Network::kLines * columns];
            for (long l = 0; l < Network::kLines * columns; ++l) {
                const long at = n * rows * columns + l;
                lines[l] = prepared + (at < 0 ? 0 : at) * pitch + left;
            }
            Network::run(lines, ring, scratch, count, n < 0);
            for (long r = 0; n >= 0 && r < rows && band.top + n * rows + r < band.bottom; ++r) {
                const int* const slots = Network::kOutputSlots + r * columns;
                const Pixel* const even = scratch + slots[0] * stride;
                if (columns == 2) join_pairs(even, scratch + slots[columns - 1] * stride, count, pairs);
                std::memcpy(medians + (band.top + n * rows + r) * width + left * columns, columns == 1 ? even : line,
                            static_cast<std::size_t>(pixels) * sizeof(Pixel));
            }
        }
    }
}

// Calls use(pixel, network) with a pixel of the type and the network of the size; false where there is none.
template <class Use>
bool with_network(int pixel_bytes, int size, Use use) {
    const auto of_pixel = [&](auto pixel) {
        using Pixel = decltype(pixel);
        switch (size) {
            case 3: use(pixel, MedianNetwork3<Pixel>{}); return true;
            case 5: use(pixel, MedianNetwork5<Pixel>{}); return true;
            case 7: use(pixel, MedianNetwork7<Pixel>{}); return true;
            case 9: use(pixel, MedianNetwork9<Pixel>{}); return true;
            default: return false;
        }
    };
    return pixel_bytes == 1 ? of_pixel(std::uint8_t{}) : of_pixel(std::uint16_t{});
}

}  // namespace

std::int64_t median_workspace_bytes(int pixel_bytes, int size, std::int64_t rows, std::int64_t width) {
    std::int64_t bytes = 0;
    with_network(pixel_bytes, size, [&](auto pixel, auto network) {
        using Pixel = decltype(pixel);
        using Network = decltype(network);
        const long slots = Network::kAges * Network::kRingSlots + Network::kScratchSlots;
        const long lines = rows + (Network::kWarmUp + 1) * Network::kTileRows + 1;
        const long pitch = line_tiles<Pixel, Network>(width);
        bytes = slots * kSlotBytes + lines * Network::kTileColumns * pitch * static_cast<long>(sizeof(Pixel)) + 2 * kVectorBytes;
    });
    return bytes;
}

void median_band(const void* frame, void* medians, int pixel_bytes, int size, const MedianBand& band, void* workspace) {
    with_network(pixel_bytes, size, [&](auto pixel, auto network) {
        using Pixel = decltype(pixel);
        filter<Pixel, decltype(network)>(static_cast<const Pixel*>(frame), static_cast<Pixel*>(medians), band,
                                         static_cast<Pixel*>(workspace));
    });
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
