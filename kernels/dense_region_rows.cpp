// Box sums along a line by doubling, three at once; then down the lines by adding the line that enters each box and
// taking off the one that leaves it, three at once too. Sums beyond the frame count as nothing.
#include "dense_region_rows.h"

#include <string.h>

#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

using Narrow = std::uint16_t;  // (2 * 17 + 1)^3 at most
using Sum = std::int32_t;

// Sums of 2 radius + 1 neighbours: from[0] lies `radius` left of to[0]; `from` is used up.
void box_line(Narrow* from, std::int64_t width, std::int64_t side, Narrow* FINGERFLOW_RESTRICT to) {
    const std::int64_t count = whole_lanes<Narrow>(static_cast<long>(width));
    const std::int64_t reach = whole_lanes<Narrow>(static_cast<long>(width + side - 1));
    std::int64_t start = 0;
    for (std::int64_t span = 1;; span *= 2) {  // from[x] holds the sum of `span` values
        const Narrow* const part = from + start;
        if ((side & span) != 0) {
            if (start == 0) memcpy(to, part, static_cast<std::size_t>(count) * sizeof(Narrow));
            else
                for (std::int64_t x = 0; x < count; ++x) to[x] = static_cast<Narrow>(to[x] + part[x]);
            start += span;
        }
        if (2 * span > side) return;
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = 0; x < reach; ++x) from[x] = static_cast<Narrow>(from[x] + from[x + span]);
    }
}

// What is kept while the boxes move down.
struct Memory {
    Narrow *line, *other;        // padded lines
    Narrow* entered;             // lines summed along, `side` + 1 of them
    Sum *once, *twice, *thrice; // sums of the boxes where they stand
    Sum *first, *second;        // the last `side` lines of the first and the second sum
    Sum* row;                   // a line of results that nobody keeps
    unsigned char *columns, *near;
    std::int64_t pitch, narrow_pitch, bytes;

    Memory(const Plane& plane, void* at) {
        const std::int64_t side = 2 * plane.radius + 1;
        pitch = whole_lanes<Narrow>(static_cast<long>(plane.width));
        narrow_pitch = whole_lanes<Narrow>(static_cast<long>(plane.width + 2 * plane.radius)) + kLanes<Narrow>;
        auto* bytes_at = static_cast<unsigned char*>(at);
        bytes = 0;
        const auto take = [&](std::int64_t count) {
            unsigned char* const taken = bytes_at == nullptr ? nullptr : bytes_at + bytes;
            bytes += (count + 63) / 64 * 64;
            return taken;
        };
        const auto wide = [&](std::int64_t lines) { return reinterpret_cast<Sum*>(take(lines * pitch * 4)); };
        line = reinterpret_cast<Narrow*>(take(narrow_pitch * 2));
        other = reinterpret_cast<Narrow*>(take(narrow_pitch * 2));
        entered = reinterpret_cast<Narrow*>(take((side + 1) * pitch * 2));
        once = wide(1);
        twice = wide(1);
        thrice = wide(1);
        first = wide(side);
        second = wide(side);
        row = wide(1);
        columns = take(pitch + 128) + 64;
        near = take(pitch + 64);
    }
};

// Whether a row covers anything, its pixels added to what other rows cover.
bool add_row(const unsigned char* FINGERFLOW_RESTRICT row, std::int64_t width, unsigned char* FINGERFLOW_RESTRICT columns) {
    unsigned char any = 0;
    for (std::int64_t x = 0; x < width; ++x) {
        any = static_cast<unsigned char>(any | row[x]);
        columns[x] = static_cast<unsigned char>(columns[x] | row[x]);
    }
    return any != 0;
}

bool add_row(Sum limit, const Sum* FINGERFLOW_RESTRICT row, std::int64_t width, unsigned char* FINGERFLOW_RESTRICT columns) {
    unsigned char any = 0;
    for (std::int64_t x = 0; x < width; ++x) {
        const auto denser = static_cast<unsigned char>(row[x] > limit);
        any = static_cast<unsigned char>(any | denser);
        columns[x] = static_cast<unsigned char>(columns[x] | denser);
    }
    return any != 0;
}

// add(y) tells whether row y covers anything.
template <class Add>
Box box_of(std::int64_t height, std::int64_t width, unsigned char* columns, const Add& add) {
    memset(columns, 0, static_cast<std::size_t>(width));
    Box box{height, 0, 0, width};
    for (std::int64_t y = 0; y < height; ++y) {
        if (!add(y)) continue;
        box.top = y < box.top ? y : box.top;
        box.bottom = y + 1;
    }
    if (box.bottom == 0) return {0, 0, 0, 0};
    while (columns[box.left] == 0) ++box.left;
    while (columns[box.right - 1] == 0) --box.right;
    return box;
}

void widen(const unsigned char* FINGERFLOW_RESTRICT row, std::int64_t width, Narrow* FINGERFLOW_RESTRICT line) {
    for (std::int64_t x = 0; x < width; ++x) line[x] = row[x] != 0;
}

void denser_than(Sum limit, const Sum* FINGERFLOW_RESTRICT row, std::int64_t width, Narrow* FINGERFLOW_RESTRICT line) {
    for (std::int64_t x = 0; x < width; ++x) line[x] = row[x] > limit;
}

void add_denser_than(Sum limit, const Sum* FINGERFLOW_RESTRICT row, std::int64_t width, unsigned char* FINGERFLOW_RESTRICT columns) {
    for (std::int64_t x = 0; x < width; ++x) columns[x] = static_cast<unsigned char>(columns[x] + (row[x] > limit));
}

// Where some of the 3 x 3 neighbours are set, and some are not; `columns` holds how many of three are.
void mixed(const unsigned char* FINGERFLOW_RESTRICT columns, std::int64_t width, unsigned char* FINGERFLOW_RESTRICT near) {
    for (std::int64_t x = 0; x < width; ++x) {
        const auto set = static_cast<unsigned char>(columns[x - 1] + columns[x] + columns[x + 1]);
        near[x] = static_cast<unsigned char>(set - 1) < 8;
    }
}

// The boxes one line further down. What lies beyond the frame is left out of the first and the second sum.
void add_line(const Narrow* FINGERFLOW_RESTRICT entering, const Narrow* FINGERFLOW_RESTRICT leaving,
              Sum* FINGERFLOW_RESTRICT once, Sum* FINGERFLOW_RESTRICT first, bool first_inside,
              Sum* FINGERFLOW_RESTRICT twice, Sum* FINGERFLOW_RESTRICT second, bool second_inside,
              Sum* FINGERFLOW_RESTRICT thrice, std::int64_t count) {
    const Sum keep_first = first_inside ? -1 : 0, keep_second = second_inside ? -1 : 0;
    for (std::int64_t x = 0; x < count; ++x) {
        const Sum a = once[x] + entering[x] - leaving[x];
        const Sum a_inside = a & keep_first;
        const Sum b = twice[x] + a_inside - first[x];
        const Sum b_inside = b & keep_second;
        once[x] = a;
        twice[x] = b;
        thrice[x] += b_inside - second[x];
        first[x] = a_inside;
        second[x] = b_inside;
    }
}

// Calls source(y, line) for every line of the frame that counts, to fill it with 0 and 1, and sink(y, sums) for rows
// from `top` to before `bottom`.
template <class Source, class Sink>
void smooth(const Plane& plane, std::int64_t top, std::int64_t bottom, const Memory& memory, const Source& source,
            const Sink& sink) {
    const std::int64_t width = plane.width, height = plane.height, radius = plane.radius, side = 2 * radius + 1;
    const std::int64_t pitch = memory.pitch;
    memset(memory.entered, 0, static_cast<std::size_t>((side + 1) * pitch) * sizeof(Narrow));
    // The three sums and the lines of two of them lie side by side.
    memset(memory.once, 0, static_cast<std::size_t>((3 + 2 * side) * pitch) * sizeof(Sum));
    std::int64_t slot = 0, wide_slot = 0;
    for (std::int64_t y = top - 3 * radius; y < bottom + 3 * radius; ++y) {
        Narrow* const entering = memory.entered + slot * pitch;
        slot = slot == side ? 0 : slot + 1;
        const Narrow* const leaving = memory.entered + slot * pitch;  // `side` lines older
        if (y < 0 || y >= height) {
            memset(entering, 0, static_cast<std::size_t>(pitch) * sizeof(Narrow));
        } else {
            Narrow *from = memory.line, *to = memory.other;
            for (int box = 0; box < 3; ++box) {
                if (box == 0) source(y, from + radius);
                memset(from, 0, static_cast<std::size_t>(radius) * sizeof(Narrow));
                memset(from + radius + width, 0, static_cast<std::size_t>(memory.narrow_pitch - radius - width) * sizeof(Narrow));
                box_line(from, width, side, box == 2 ? entering : to + radius);
                Narrow* const used = from;
                from = to;
                to = used;
            }
        }
        Sum *const first = memory.first + wide_slot * pitch, *const second = memory.second + wide_slot * pitch;
        wide_slot = wide_slot == side - 1 ? 0 : wide_slot + 1;
        const std::int64_t first_at = y - radius, second_at = y - 2 * radius, at = y - 3 * radius;
        add_line(entering, leaving, memory.once, first, first_at >= 0 && first_at < height, memory.twice, second,
                 second_at >= 0 && second_at < height, memory.thrice, pitch);
        if (at >= top) sink(at, memory.thrice);
    }
}

}  // namespace

Box covered_box(const unsigned char* mask, std::int64_t height, std::int64_t width, std::int64_t row_stride,
                unsigned char* columns) {
    return box_of(height, width, columns, [&](std::int64_t y) { return add_row(mask + y * row_stride, width, columns); });
}

Box denser_box(const Plane& plane, const std::int32_t* density, std::int32_t limit, unsigned char* columns) {
    return box_of(plane.height, plane.width, columns, [&](std::int64_t y) {
        return add_row(limit, density + y * plane.pitch, plane.width, columns);
    });
}

std::int64_t smoothing_bytes(const Plane& plane) { return Memory(plane, nullptr).bytes; }

void density_rows(const Plane& plane, const unsigned char* mask, std::int64_t row_stride, std::int64_t top,
                  std::int64_t bottom, void* memory, std::int32_t* density) {
    const std::int64_t width = plane.width;
    smooth(
        plane, top, bottom, Memory(plane, memory),
        [&](std::int64_t y, Narrow* line) { widen(mask + y * row_stride, width, line); },
        [&](std::int64_t y, const Sum* sums) { memcpy(density + y * plane.pitch, sums, static_cast<std::size_t>(width) * sizeof(Sum)); });
}

DenseCount count_denser(const Plane& plane, const std::int32_t* density, const unsigned char* mask,
                        std::int64_t row_stride, std::int64_t top, std::int64_t bottom, std::int32_t limit) {
    const std::int64_t width = plane.width;
    DenseCount count{0, 0};
    for (std::int64_t y = top; y < bottom; ++y) {
        const std::int32_t* FINGERFLOW_RESTRICT row = density + y * plane.pitch;
        const unsigned char* FINGERFLOW_RESTRICT covered = mask + y * row_stride;
        std::int32_t all = 0, both = 0;
        for (std::int64_t x = 0; x < width; ++x) {
            const std::int32_t dense = row[x] > limit ? -1 : 0;
            all -= dense;
            both += dense & static_cast<std::int32_t>(covered[x]);
        }
        count.all += all;
        count.covered += both;
    }
    return count;
}

BorderSum border_density(const Plane& plane, const std::int32_t* density, std::int32_t limit, std::int64_t top,
                         std::int64_t bottom, void* memory) {
    const std::int64_t width = plane.width, height = plane.height;
    const Memory kept(plane, memory);
    BorderSum border{0, 0};
    smooth(
        plane, top, bottom, kept,
        [&](std::int64_t y, Narrow* line) { denser_than(limit, density + y * plane.pitch, width, line); },
        [&](std::int64_t y, const Sum* sums) {
            memset(kept.columns - 1, 0, static_cast<std::size_t>(width + 2));  // nothing to both sides of the frame
            for (std::int64_t at = y == 0 ? 0 : y - 1; at < height && at <= y + 1; ++at)
                add_denser_than(limit, density + at * plane.pitch, width, kept.columns);
            mixed(kept.columns, width, kept.near);
            memset(kept.near + width, 0, 8);
            for (std::int64_t x = 0; x < width; x += 8) {
                std::uint64_t eight;
                memcpy(&eight, kept.near + x, sizeof eight);
                for (std::int64_t k = x; eight != 0 && k < x + 8; ++k) {
                    border.pixels += kept.near[k];
                    border.density += kept.near[k] != 0 ? sums[k] : 0;
                }
            }
        });
    return border;
}

void write_denser(const Plane& plane, const std::int32_t* density, std::int32_t limit, std::int64_t top,
                  std::int64_t bottom, unsigned char* region, std::int64_t region_stride) {
    for (std::int64_t y = top; y < bottom; ++y) {
        const std::int32_t* FINGERFLOW_RESTRICT from = density + y * plane.pitch;
        unsigned char* FINGERFLOW_RESTRICT to = region + y * region_stride;
        for (std::int64_t x = 0; x < plane.width; ++x) to[x] = from[x] > limit;
    }
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
