// Medians by the generated networks: row of tiles by row of tiles down a strip that is narrow enough for the cache.
#include "median_strip.h"

#include <cstring>

#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

// Values between the beginnings of two slots: one for every tile of a strip.
template <class Pixel>
constexpr long kStride = 384 / static_cast<long>(sizeof(Pixel));

#include "median_networks.h"

template <class Pixel, class Network>
constexpr MedianLimits limits_of() {
    constexpr long slots = Network::kAges * Network::kRingSlots + Network::kScratchSlots + 2 * Network::kTileColumns;
    return {(kStride<Pixel> - Network::kReachRight) * Network::kTileColumns, Network::kTileColumns * kLanes<Pixel>,
            (slots * kStride<Pixel> + kLanes<Pixel>)*static_cast<long>(sizeof(Pixel))};
}

// Row y of the frame from column `left` on; beyond the frame the nearest pixel counts.
template <class Pixel>
void padded_line(const Pixel* frame, const MedianStrip& strip, long y, long left, long count, Pixel* line) {
    y = y < 0 ? 0 : y >= strip.height ? strip.height - 1 : y;
    const Pixel* row = frame + y * strip.row_stride;
    long x = 0;
    for (; x < count && left + x < 0; ++x) line[x] = row[0];
    const long inside = strip.width - left < count ? strip.width - left : count;
    if (inside > x) {
        std::memcpy(line + x, row + left + x, static_cast<std::size_t>(inside - x) * sizeof(Pixel));
        x = inside;
    }
    for (; x < count; ++x) line[x] = row[strip.width - 1];
}

template <class Pixel, class Network>
void filter(const Pixel* frame, Pixel* medians, const MedianStrip& strip, Pixel* workspace) {
    constexpr long rows = Network::kTileRows, columns = Network::kTileColumns, half = Network::kSize / 2;
    constexpr long stride = kStride<Pixel>;
    const long width = strip.right - strip.left;
    const long tiles = (width + columns - 1) / columns;
    const long filled = tiles + Network::kReachRight;
    Pixel* ring[Network::kAges];
    for (int age = 0; age < Network::kAges; ++age) ring[age] = workspace + age * Network::kRingSlots * stride;
    Pixel* scratch = workspace + Network::kAges * Network::kRingSlots * stride;
    Pixel* line = scratch + Network::kScratchSlots * stride;

    for (long top = strip.top - Network::kWarmUp * rows; top < strip.bottom; top += rows) {
        Pixel* oldest = ring[Network::kAges - 1];
        for (int age = Network::kAges - 1; age > 0; --age) ring[age] = ring[age - 1];
        ring[0] = oldest;
        for (long r = 0; r < rows; ++r) {
            const long y = top + Network::kInputLeads[r * columns] * rows + r - half;
            Pixel* const target = columns == 1 ? ring[0] + Network::kInputSlots[r] * stride : line;
            padded_line<Pixel>(frame, strip, y, strip.left - half, filled * columns, target);
            for (long c = 0; c < columns && columns > 1; ++c) {
                Pixel* FINGERFLOW_RESTRICT phase = ring[0] + Network::kInputSlots[r * columns + c] * stride;
                const Pixel* FINGERFLOW_RESTRICT from = line + c;
                for (long x = 0; x < filled; ++x) phase[x] = from[x * columns];
            }
        }
        Network::run(ring, scratch, tiles);
        for (long r = 0; r < rows && top >= strip.top && top + r < strip.bottom; ++r) {
            for (long c = 0; c < columns && columns > 1; ++c) {
                const Pixel* FINGERFLOW_RESTRICT phase = scratch + Network::kOutputSlots[r * columns + c] * stride;
                Pixel* FINGERFLOW_RESTRICT to = line + c;
                for (long x = 0; x < tiles; ++x) to[x * columns] = phase[x];
            }
            const Pixel* const source = columns == 1 ? scratch + Network::kOutputSlots[r] * stride : line;
            std::memcpy(medians + (top + r) * strip.width + strip.left, source, static_cast<std::size_t>(width) * sizeof(Pixel));
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

bool median_limits(int pixel_bytes, int size, MedianLimits* limits) {
    return with_network(pixel_bytes, size, [&](auto pixel, auto network) {
        *limits = limits_of<decltype(pixel), decltype(network)>();
    });
}

void median_strip(const void* frame, void* medians, int pixel_bytes, int size, const MedianStrip& strip, void* workspace) {
    with_network(pixel_bytes, size, [&](auto pixel, auto network) {
        using Pixel = decltype(pixel);
        filter<Pixel, decltype(network)>(static_cast<const Pixel*>(frame), static_cast<Pixel*>(medians), strip,
                                         static_cast<Pixel*>(workspace));
    });
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
