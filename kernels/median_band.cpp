// build: each instruction set
// Medians by the generated networks: down strips of a band, one row of tiles after the other.
#include "median_band.h"

#include <cstring>

#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

// Between the beginnings of two slots. An odd number of cache lines, so that slots fall into all sets of a cache.
constexpr long kSlotBytes = 704;

// Enough for windows of 31 x 31.
constexpr long kMostLines = 96, kMostPlanes = 6000;

#include "median_networks.h"

// What leads a network down a frame; see fingerflow/kernels/median_rows.py.
struct Shape {
    long half, rows, columns;      // of the window; of a tile, in pixels
    long reach, warm_up, lines;    // tiles read to the right; rows of tiles done ahead; lines of the frame read
    const std::uint16_t* outputs;  // scratch slots of the medians
    long kept_slots, scratch_slots;
    long slot_bytes;  // between the beginnings of two slots
    long strip;       // tiles filtered from left to right at a time

    template <class Pixel>
    long stride() const {
        return slot_bytes / static_cast<long>(sizeof(Pixel));
    }
    template <class Pixel>
    long pitch(long width) const {  // of a prepared line
        return whole_lanes<Pixel>((width + columns - 1) / columns + reach + kLanes<Pixel>);
    }
};

template <class Pixel, class Network>
Shape compiled_shape() {
    // The slots in use stay in a first-level cache of 32 KiB. A strip reads a few tiles more than it writes, so that wide
    // ones are better as far as they fit.
    constexpr long slots = Network::kAges * Network::kRingSlots + Network::kScratchSlots;
    constexpr long fitting = 28 * 1024 / kVectorBytes / slots, most = kSlotBytes / kVectorBytes;
    constexpr long vectors = fitting < 1 ? 1 : fitting < most ? fitting : most;
    Shape shape{};
    shape.half = Network::kSize / 2;
    shape.rows = Network::kTileRows;
    shape.columns = Network::kTileColumns;
    shape.reach = Network::kReachRight;
    shape.warm_up = Network::kWarmUp;
    shape.lines = Network::kLines;
    shape.outputs = Network::kOutputSlots;
    shape.kept_slots = Network::kAges * Network::kRingSlots;
    shape.scratch_slots = Network::kScratchSlots;
    shape.slot_bytes = kSlotBytes;
    shape.strip = vectors * kLanes<Pixel> - Network::kReachRight;
    return shape;
}

struct Step {
    std::uint16_t kind, minimum, maximum, left, right, columns;
};

// A network that was not compiled, as `median_table` writes it.
struct Table {
    Shape shape;
    const std::uint16_t* kept_rows;
    long kept_planes;
    const Step* steps;
    long ahead, count;
};

template <class Pixel>
Table read_table(const std::uint16_t* numbers, int size, long width) {
    Table table{};
    Shape& shape = table.shape;
    shape.half = size / 2;
    shape.rows = numbers[0];
    shape.columns = numbers[1];
    shape.reach = numbers[2];
    table.kept_planes = numbers[3];
    shape.scratch_slots = numbers[4];
    shape.warm_up = numbers[5];
    shape.lines = numbers[6];
    table.ahead = numbers[7];
    table.count = numbers[8];
    shape.outputs = numbers + 9;
    table.kept_rows = shape.outputs + shape.rows * shape.columns;
    for (long plane = 0; plane < table.kept_planes; ++plane) shape.kept_slots += table.kept_rows[plane];
    table.steps = reinterpret_cast<const Step*>(table.kept_rows + table.kept_planes);
    // Whole lines where they are not too long, since each step takes its time to begin.
    const long most = 16, wanted = shape.pitch<Pixel>(width) / kLanes<Pixel>, vectors = wanted < most ? wanted : most;
    shape.slot_bytes = (vectors | 1) * kVectorBytes;
    shape.strip = vectors * kLanes<Pixel> - shape.reach;
    return table;
}

template <class Pixel>
void run_steps(const Step* steps, long count, Pixel* const* planes, long tiles) {
    using L = Lanes<Pixel>;
    const long end = whole_lanes<Pixel>(tiles);
    for (const Step* step = steps; step != steps + count; ++step) {
        const Pixel* FINGERFLOW_RESTRICT left = planes[step->left];
        const Pixel* FINGERFLOW_RESTRICT right = planes[step->right] + step->columns;
        Pixel* FINGERFLOW_RESTRICT minimum = planes[step->minimum];
        Pixel* FINGERFLOW_RESTRICT maximum = planes[step->maximum];
        if (step->kind == 1) {
            FINGERFLOW_INDEPENDENT
            for (long x = 0; x < end; x += L::kStep) L::store(minimum + x, L::lesser(L::load(left + x), L::load(right + x)));
        } else if (step->kind == 2) {
            FINGERFLOW_INDEPENDENT
            for (long x = 0; x < end; x += L::kStep) L::store(maximum + x, L::greater(L::load(left + x), L::load(right + x)));
        } else {
            FINGERFLOW_INDEPENDENT
            for (long x = 0; x < end; x += L::kStep) {
                const auto a = L::load(left + x), b = L::load(right + x);
                L::store(minimum + x, L::lesser(a, b));
                L::store(maximum + x, L::greater(a, b));
            }
        }
    }
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

// Calls run(n, lines, slots, tiles) for the row of tiles n of every strip; `slots` begins with what is kept.
template <class Pixel, class Run>
void filter(const Shape& shape, const Pixel* frame, Pixel* medians, const MedianBand& band, Pixel* workspace, Run run) {
    const long rows = shape.rows, columns = shape.columns, width = band.width;
    const long stride = shape.stride<Pixel>(), pitch = shape.pitch<Pixel>(width);
    const long tiles = (width + columns - 1) / columns;
    Pixel* const slots = workspace;
    Pixel* const scratch = slots + shape.kept_slots * stride;
    Pixel* const line = scratch + shape.scratch_slots * stride;
    Pixel* const prepared = line + columns * pitch;
    auto* const pairs = reinterpret_cast<typename Pair<Pixel>::Word*>(line);

    // Every line that the band's windows cover, its even and odd columns apart.
    const long first = band.top - shape.half, tile_rows = (band.bottom - band.top + rows - 1) / rows;
    for (long n = 0; n < (tile_rows + shape.warm_up) * rows; ++n) {
        const long y = first + n < 0 ? 0 : first + n >= band.height ? band.height - 1 : first + n;
        Pixel* const target = prepared + n * columns * pitch;
        const long count = columns * (tiles + shape.reach);
        pad_line(frame + y * band.row_stride, width, shape.half, count, columns == 1 ? target : line);
        if (columns == 2) split_pairs(pairs, count / 2, target, target + pitch);
    }

    const long strips = (tiles + shape.strip - 1) / shape.strip;
    const long strip = (tiles + strips - 1) / strips;
    const Pixel* lines[kMostLines];
    for (long left = 0; left < tiles; left += strip) {
        const long count = strip < tiles - left ? strip : tiles - left;
        const long pixels = count * columns < width - left * columns ? count * columns : width - left * columns;
        for (long n = -shape.warm_up; n < tile_rows; ++n) {
            // What a row above the first one reads before the band's lines begin is never used.
            for (long l = 0; l < shape.lines * columns; ++l) {
                const long at = n * rows * columns + l;
                lines[l] = prepared + (at < 0 ? 0 : at) * pitch + left;
            }
            run(n, lines, slots, count);
            for (long r = 0; n >= 0 && r < rows && band.top + n * rows + r < band.bottom; ++r) {
                const std::uint16_t* const outputs = shape.outputs + r * columns;
                const Pixel* const even = scratch + outputs[0] * stride;
                if (columns == 2) join_pairs(even, scratch + outputs[1] * stride, count, pairs);
                std::memcpy(medians + (band.top + n * rows + r) * width + left * columns, columns == 1 ? even : line,
                            static_cast<std::size_t>(pixels) * sizeof(Pixel));
            }
        }
    }
}

template <class Pixel, class Network>
void filter_by_network(const Pixel* frame, Pixel* medians, const MedianBand& band, Pixel* workspace) {
    constexpr long ages = Network::kAges, ring_size = Network::kRingSlots * Network::kStride;
    filter(compiled_shape<Pixel, Network>(), frame, medians, band, workspace,
           [=](long n, const Pixel* const* lines, Pixel* slots, long tiles) {
               Pixel* ring[ages];
               for (long age = 0; age < ages; ++age)
                   ring[age] = slots + (n + Network::kWarmUp + ages - age) % ages * ring_size;
               Network::run(lines, ring, slots + ages * ring_size, tiles, n < 0);
           });
}

template <class Pixel>
void filter_by_table(const Table& table, const Pixel* frame, Pixel* medians, const MedianBand& band, Pixel* workspace) {
    const Shape& shape = table.shape;
    const long stride = shape.stride<Pixel>();
    Pixel* planes[kMostPlanes];
    filter(shape, frame, medians, band, workspace,
           [&](long n, const Pixel* const* lines, Pixel* slots, long tiles) {
               Pixel** plane = planes;
               for (long l = 0; l < shape.lines * shape.columns; ++l) *plane++ = const_cast<Pixel*>(lines[l]);
               for (long p = 0; p < table.kept_planes; ++p) {
                   const long depth = table.kept_rows[p];
                   for (long age = 0; age < depth; ++age)
                       *plane++ = slots + (n + shape.warm_up + depth - age) % depth * stride;
                   slots += depth * stride;
               }
               for (long slot = 0; slot < shape.scratch_slots; ++slot) *plane++ = slots + slot * stride;
               run_steps(table.steps, n < 0 ? table.ahead : table.count, planes, tiles + shape.reach);
           });
}

// Calls use(pixel, network) with a pixel of the type and the compiled network of the size; false where there is none.
template <class Use>
bool with_network(int pixel_bytes, int size, Use use) {
    const auto of_pixel = [&](auto pixel) {
        using Pixel = decltype(pixel);
        switch (size) {
#define FINGERFLOW_CASE(n) case n: use(pixel, MedianNetwork##n<Pixel>{}); return true;
            FINGERFLOW_MEDIAN_SIZES(FINGERFLOW_CASE)
            default: return false;
        }
    };
    return pixel_bytes == 1 ? of_pixel(std::uint8_t{}) : of_pixel(std::uint16_t{});
}

template <class Pixel>
std::int64_t bytes_for(const Shape& shape, std::int64_t rows, std::int64_t width) {
    const std::int64_t lines = rows + (shape.warm_up + 1) * shape.rows + 1;
    return (shape.kept_slots + shape.scratch_slots) * shape.slot_bytes + lines * shape.columns * shape.pitch<Pixel>(width) * sizeof(Pixel) + 2 * kVectorBytes;
}

}  // namespace

std::int64_t median_workspace_bytes(const MedianKind& kind, std::int64_t rows, std::int64_t width) {
    if (kind.table != nullptr)
        return kind.pixel_bytes == 1
                   ? bytes_for<std::uint8_t>(read_table<std::uint8_t>(kind.table, kind.size, width).shape, rows, width)
                   : bytes_for<std::uint16_t>(read_table<std::uint16_t>(kind.table, kind.size, width).shape, rows, width);
    std::int64_t bytes = 0;
    with_network(kind.pixel_bytes, kind.size, [&](auto pixel, auto network) {
        using Pixel = decltype(pixel);
        bytes = bytes_for<Pixel>(compiled_shape<Pixel, decltype(network)>(), rows, width);
    });
    return bytes;
}

void median_band(const MedianKind& kind, const void* frame, void* medians, const MedianBand& band, void* workspace) {
    const auto by_table = [&](auto pixel) {
        using Pixel = decltype(pixel);
        filter_by_table(read_table<Pixel>(kind.table, kind.size, band.width), static_cast<const Pixel*>(frame),
                        static_cast<Pixel*>(medians), band, static_cast<Pixel*>(workspace));
    };
    if (kind.table != nullptr) {
        if (kind.pixel_bytes == 1) by_table(std::uint8_t{});
        else by_table(std::uint16_t{});
        return;
    }
    with_network(kind.pixel_bytes, kind.size, [&](auto pixel, auto network) {
        using Pixel = decltype(pixel);
        filter_by_network<Pixel, decltype(network)>(static_cast<const Pixel*>(frame), static_cast<Pixel*>(medians), band,
                                                    static_cast<Pixel*>(workspace));
    });
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
