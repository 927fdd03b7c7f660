// build: each instruction set
// Medians of size x size windows (fingerflow/ops/filters/median.py), by networks of minima and maxima: compiled ones
// (median_networks.h, written by generate_median.py) for small windows, for others a table of steps
// (fingerflow/kernels/median_rows.py). Frames are divided into bands of rows that threads share.
// A network works on planes with one value for each tile of up to 8 x 2 px; it goes down a strip of the band, one row
// of tiles after the other, and keeps of each plane only the rows that later steps read.
// Layout: one tile a lane. Lines of the frame, of 8 or 16 bit, are padded by half a window and, for tiles of two columns,
// split into even and odd columns. Workspace: rings of kept rows, scratch slots, one line, the prepared lines. A band and
// its kept planes fit into a second-level cache, and its rows are a multiple of 8.
#include <cstring>

#include "instruction_sets.h"
#include "interface.h"
#include "lanes.h"
#include "pixel_lanes.h"
#include "pixels.h"

namespace fingerflow {

struct MedianBand {
    std::int64_t height, width, row_stride;  // of the frame
    std::int64_t top, bottom;                // rows from `top` to before `bottom`
};

struct MedianKind {
    int pixel_bytes, size;
    const std::uint16_t* table;  // of an interpreted network, else null
};

namespace FINGERFLOW_ISA {
namespace {

// Distance between slots in bytes: an odd number of cache lines, so that slots spread over all sets of a cache.
constexpr long kSlotBytes = 704;

// Limits for windows of up to 31 x 31.
constexpr long kMostLines = 96, kMostPlanes = 6000;

#include "median_networks.h"

// Constants of a network (fingerflow/kernels/median_rows.py).
struct Shape {
    long half, rows, columns;      // half the window; tile size in pixels
    long reach, warm_up, lines;    // tiles read to the right; rows of tiles computed ahead; frame lines read
    const std::uint16_t* outputs;  // scratch slots of the medians
    long kept_slots, scratch_slots;
    long slot_bytes;  // between the beginnings of two slots
    long strip;       // tiles filtered from left to right at a time

    template <class Pixel>
    long stride() const {
        return slot_bytes / static_cast<long>(sizeof(Pixel));
    }
    template <class Pixel>
    long pitch(long width) const {  // pixels between prepared lines
        return whole_lanes<Pixel>((width + columns - 1) / columns + reach + kLanes<Pixel>);
    }
};

template <class Pixel, class Network>
Shape compiled_shape() {
    // The slots in use stay in a first-level cache of 32 KiB. Since a strip reads a few tiles more than it writes, it
    // is as wide as fits.
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

// An interpreted network, from the table that `median_table` writes.
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
    // Strips of up to 16 vectors, since each interpreted step has a fixed cost.
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

// Copies `count` pixels of a row, beginning half a window left of it; beyond the frame the edge pixel is repeated.
template <class Pixel>
void pad_line(const Pixel* row, long width, long half, long count, Pixel* line) {
    for (long x = 0; x < half; ++x) line[x] = row[0];
    std::memcpy(line + half, row, static_cast<std::size_t>(width) * sizeof(Pixel));
    for (long x = half + width; x < count; ++x) line[x] = row[width - 1];
}

// Runs a network over a row of tiles, which is the nth of its strip; `slots` begins with the kept rows.
template <class Pixel>
using Run = void(const Table* table, long n, const Pixel* const* lines, Pixel* slots, long tiles);

// Calls `run` for each row of tiles of each strip.
template <class Pixel>
void filter(const Shape& shape, const Pixel* frame, Pixel* medians, const MedianBand& band, Pixel* workspace,
            Run<Pixel>* run, const Table* table) {
    const long rows = shape.rows, columns = shape.columns, width = band.width;
    const long stride = shape.stride<Pixel>(), pitch = shape.pitch<Pixel>(width);
    const long tiles = (width + columns - 1) / columns;
    Pixel* const slots = workspace;
    Pixel* const scratch = slots + shape.kept_slots * stride;
    Pixel* const line = scratch + shape.scratch_slots * stride;
    Pixel* const prepared = line + columns * pitch;
    auto* const pairs = reinterpret_cast<typename Pair<Pixel>::Word*>(line);

    // Prepares every line that the band's windows cover.
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
            // Values that warm-up rows read before the first line are never used: any line serves.
            for (long l = 0; l < shape.lines * columns; ++l) {
                const long at = n * rows * columns + l;
                lines[l] = prepared + (at < 0 ? 0 : at) * pitch + left;
            }
            run(table, n, lines, slots, count);
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
void run_network(const Table*, long n, const Pixel* const* lines, Pixel* slots, long tiles) {
    constexpr long ages = Network::kAges, ring_size = Network::kRingSlots * Network::kStride;
    Pixel* ring[ages];
    for (long age = 0; age < ages; ++age) ring[age] = slots + (n + Network::kWarmUp + ages - age) % ages * ring_size;
    Network::run(lines, ring, slots + ages * ring_size, tiles, n < 0);
}

template <class Pixel>
void run_table(const Table* table, long n, const Pixel* const* lines, Pixel* slots, long tiles) {
    const Shape& shape = table->shape;
    const long stride = shape.stride<Pixel>();
    Pixel* planes[kMostPlanes];
    Pixel** plane = planes;
    for (long l = 0; l < shape.lines * shape.columns; ++l) *plane++ = const_cast<Pixel*>(lines[l]);
    for (long p = 0; p < table->kept_planes; ++p) {
        const long depth = table->kept_rows[p];
        for (long age = 0; age < depth; ++age) *plane++ = slots + (n + shape.warm_up + depth - age) % depth * stride;
        slots += depth * stride;
    }
    for (long slot = 0; slot < shape.scratch_slots; ++slot) *plane++ = slots + slot * stride;
    run_steps(table->steps, n < 0 ? table->ahead : table->count, planes, tiles + shape.reach);
}

// Calls use(pixel, network) with the pixel type and the compiled network of a size; false if there is none.
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

// Bytes of the workspace, aligned to 64, for `rows` rows; 0 if the size has no compiled network and no table.
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

// `frame` and `medians` point to the whole frame; `medians` is contiguous.
void median_band(const MedianKind& kind, const void* frame, void* medians, const MedianBand& band, void* workspace) {
    const auto by_table = [&](auto pixel) {
        using Pixel = decltype(pixel);
        const Table table = read_table<Pixel>(kind.table, kind.size, band.width);
        filter(table.shape, static_cast<const Pixel*>(frame), static_cast<Pixel*>(medians), band,
               static_cast<Pixel*>(workspace), run_table<Pixel>, &table);
    };
    if (kind.table != nullptr) {
        if (kind.pixel_bytes == 1) by_table(std::uint8_t{});
        else by_table(std::uint16_t{});
        return;
    }
    with_network(kind.pixel_bytes, kind.size, [&](auto pixel, auto network) {
        using Pixel = decltype(pixel);
        using Network = decltype(network);
        filter(compiled_shape<Pixel, Network>(), static_cast<const Pixel*>(frame), static_cast<Pixel*>(medians), band,
               static_cast<Pixel*>(workspace), run_network<Pixel, Network>, nullptr);
    });
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow

#if FINGERFLOW_ONCE

#include <algorithm>
#include <stdexcept>

#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
FINGERFLOW_OTHER_SETS(median_workspace_bytes)
FINGERFLOW_OTHER_SETS(median_band)
}  // namespace fingerflow

void fingerflow_median(const fingerflow_frames* frames, void* medians, int size, const std::uint16_t* table, int threads) {
    using namespace fingerflow;
    const std::int64_t batch = frames->batch, height = frames->height, width = frames->width;
    if (batch * height * width == 0) return;

    // Bands fit into a second-level cache and occupy all threads, but have at least four windows of rows, since each
    // band also reads half a window above and below it.
    const MedianKind kind{frames->kind == kUint8 ? 1 : 2, size, table};
    const std::int64_t cached = std::max<std::int64_t>(1, (256 * 1024) / (width * kind.pixel_bytes));
    const std::int64_t shared = (height * batch + threads - 1) / threads;
    const std::int64_t most = std::max<std::int64_t>(4 * size, std::min(cached, shared));
    const std::int64_t bands = (height + most - 1) / most;
    const std::int64_t rows = ((height + bands - 1) / bands + 7) / 8 * 8;

    const auto bytes = static_cast<std::size_t>(FINGERFLOW_PICK(median_workspace_bytes)(kind, rows, width));
    if (bytes == 0) throw std::invalid_argument("the library holds no median of this size, and was given no table of it");
    for_bands(batch, height, rows, threads, [&](std::int64_t frame, std::int64_t top, std::int64_t bottom) {
        const MedianBand band{height, width, frames->row_stride, top, bottom};
        FINGERFLOW_PICK(median_band)(kind, static_cast<const char*>(frames->data) + frame * frames->frame_stride * kind.pixel_bytes,
                                     static_cast<char*>(medians) + frame * height * width * kind.pixel_bytes, band, workspace(bytes));
    });
}

#endif
