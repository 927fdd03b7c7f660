// build: each instruction set, fused
// Apparent (gross) contact region of a mask, on cells of `side` px (fingerflow/ops/contact/apparent_contact.py).
// The density of a cell is the share of its pixels that are set, smoothed by three box means of 2 radius + 1 px along
// each axis. A cell belongs to the region with part = clamp((density - limit) / |grad density| + 1/2, 0, 1); `limit` is
// iterated from the shares of set pixels in two bands inside the region's border. The density margin is density - limit at the component,
// +limit in its holes, -limit elsewhere; area, centre and semi-axes follow from the moments of the parts.
// Layout: a CellPlane of floats has one value a cell, one cell a lane, row after row, with a margin of zeros on all sides
// and rows that begin at whole vectors, over which loops run. All planes of one frame lie in the thread's workspace, so
// that they stay in a cache.
#include <math.h>
#include <string.h>
#include <cstring>
#include <initializer_list>

#include "floats.h"
#include "instruction_sets.h"
#include "interface.h"
#include "lanes.h"
#include "shared_limits.h"

namespace fingerflow {

// Plane of `height` x `width` cells: rows begin at whole vectors, `pitch` floats apart, with at least `margin` zeros on
// all sides and zeros behind a row up to a whole vector.
struct CellPlane {
    std::int64_t height, width, margin, pitch;
};
constexpr std::int64_t kCellLanes = 16;  // floats of the longest vector
constexpr std::int64_t kCellBlock = contact::kBlock;  // cells a side of a block of the flood fill

// Weighted sums over cells: parts inside the region, and set pixels of the mask in them.
struct CellShare {
    double parts, covered;
};

// Weighted sum of the density over the region's border, and sum of the weights.
struct BorderLevel {
    double density, weight;
};

// Extent of a region in each column (down, up) (width) and in each row (right, left) (height), counted from the
// opposite end, so that 0 means no cell.
struct Outline {
    float *down, *up, *right, *left;
};

// Moments 1, x, x^2 of a row's coverage, x in cells from the first column.
struct RowMoments {
    double mass, first, second;
};

namespace FINGERFLOW_ISA {
namespace {

constexpr std::int64_t kBand = 16;  // rows after which float sums are added to a double: up to there they are exact for counts

template <class Word>
void add_bytes(const unsigned char* FINGERFLOW_RESTRICT line, std::int64_t cells, float* FINGERFLOW_RESTRICT counts) {
    // The highest byte of a product with 0x0101... is the sum of all bytes.
    constexpr Word ones = static_cast<Word>(~static_cast<Word>(0)) / 255;
    constexpr int highest = 8 * (static_cast<int>(sizeof(Word)) - 1);
    for (std::int64_t x = 0; x < cells; ++x) {
        Word word;
        memcpy(&word, line + x * static_cast<std::int64_t>(sizeof(Word)), sizeof word);
        counts[x] = static_cast<float>(static_cast<std::int32_t>(static_cast<Word>(word * ones) >> highest));
    }
}

// One box mean of values `step` apart: `reach` values on both sides with weight 1, the next one with weight `part`.
void box_row(const float* FINGERFLOW_RESTRICT from, std::int64_t step, std::int64_t reach, float part, float scale,
             std::int64_t width, float* FINGERFLOW_RESTRICT to) {
    if (reach == 1) {
        for (std::int64_t x = 0; x < width; ++x) {
            const float ends = from[x - 2 * step] + from[x + 2 * step];
            to[x] = scale * (from[x] + (from[x - step] + from[x + step]) + part * ends);
        }
        return;
    }
    for (std::int64_t x = 0; x < width; ++x) to[x] = from[x] + part * (from[x - (reach + 1) * step] + from[x + (reach + 1) * step]);
    for (std::int64_t d = 1; d <= reach; ++d)
        for (std::int64_t x = 0; x < width; ++x) to[x] += from[x - d * step] + from[x + d * step];
    for (std::int64_t x = 0; x < width; ++x) to[x] *= scale;
}

// The columns, rounded up to whole vectors.
std::int64_t whole(const CellPlane& plane) { return (plane.width + kCellLanes - 1) / kCellLanes * kCellLanes; }

Floats part_of(Floats density, Floats inverse, float limit) {
    return lesser(positive((density - limit) * inverse + 0.5f), all(1));
}

// A sum of vectors, moved to a double every kBand rows, before float rounding matters.
class Sum {
public:
    void add(Floats values) { floats_ = floats_ + values; }
    // To be called after each row.
    void row(std::int64_t y) {
        if (y % kBand == kBand - 1) settle();
    }
    double total() {
        settle();
        return total_;
    }

private:
    void settle() {
        float numbers[kFloats];
        store(numbers, floats_);
        for (const float number : numbers) total_ += static_cast<double>(number);
        floats_ = all(0);
    }
    Floats floats_ = all(0);
    double total_ = 0;
};

float greatest(Floats values) {
    float numbers[kFloats], result = 0;
    store(numbers, values);
    for (const float number : numbers) result = number > result ? number : result;
    return result;
}

// 0, 1, 2 ...
Floats places() {
    float numbers[kFloats];
    for (int k = 0; k < kFloats; ++k) numbers[k] = static_cast<float>(k);
    return load(numbers);
}

}  // namespace

// Writes the number of set pixels of a mask (rows x columns bytes) in each cell of `side` 1, 2, 4 or 8 px. `line`
// has space for the columns and 64 bytes more; `counts` is a plane.
void count_cells(const unsigned char* mask, std::int64_t rows, std::int64_t columns, int side, const CellPlane& plane,
                 unsigned char* FINGERFLOW_RESTRICT line, float* counts) {
    memset(line + columns, 0, 64);
    for (std::int64_t row = 0; row < plane.height; ++row) {
        const std::int64_t top = row * side, bottom = top + side < rows ? top + side : rows;
        memcpy(line, mask + top * columns, static_cast<std::size_t>(columns));
        for (std::int64_t y = top + 1; y < bottom; ++y) {
            const unsigned char* FINGERFLOW_RESTRICT next = mask + y * columns;
            for (std::int64_t x = 0; x < columns; ++x) line[x] = static_cast<unsigned char>(line[x] + next[x]);
        }
        float* const to = counts + row * plane.pitch;
        for (std::int64_t x = plane.width; x < whole(plane); ++x) to[x] = 0.0f;
        if (side == 4) add_bytes<std::uint32_t>(line, plane.width, to);
        else if (side == 8) add_bytes<std::uint64_t>(line, plane.width, to);
        else if (side == 2) add_bytes<std::uint16_t>(line, plane.width, to);
        else add_bytes<std::uint8_t>(line, plane.width, to);
    }
}

// Writes counts times a factor; returns the sum of the counts.
double scale_cells(const CellPlane& plane, const float* counts, float factor, float* cells) {
    Sum sum;
    for (std::int64_t y = 0; y < plane.height; ++y) {
        for (std::int64_t x = 0; x < plane.width; x += kFloats) {
            const Floats count = load(counts + y * plane.pitch + x);
            store(cells + y * plane.pitch + x, count * factor);
            sum.add(count);
        }
        sum.row(y);
    }
    return sum.total();
}

// Smooths by three box means of `width` cells along each axis, in place; `other` is a plane with zero margins.
void smooth_cells(const CellPlane& plane, float width, float* cells, float* other) {
    // A box of fractional width: weight 1 up to `reach`, weight `part` for the next cell.
    const float half = (width + 1) / 2;
    const auto reach = static_cast<std::int64_t>(half - 1);
    const float part = half - 1 - static_cast<float>(reach), scale = 1 / width;
    float *from = cells, *to = other;
    for (int pass = 0; pass < 6; ++pass) {
        const std::int64_t step = pass < 3 ? plane.pitch : 1;
        for (std::int64_t y = 0; y < plane.height; ++y)
            box_row(from + y * plane.pitch, step, reach, part, scale, plane.width, to + y * plane.pitch);
        float* const used = from;
        from = to;
        to = used;
    }
}

// Writes 1 / |grad density| of each cell; behind a row the value for a gradient of 0.
void inverse_slopes(const CellPlane& plane, const float* density, float* inverse) {
    for (std::int64_t y = 0; y < plane.height; ++y) {
        const std::int64_t width = plane.width;
        const float *FINGERFLOW_RESTRICT row = density + y * plane.pitch, *FINGERFLOW_RESTRICT below = row + plane.pitch;
        const float* FINGERFLOW_RESTRICT above = row - plane.pitch;
        float* FINGERFLOW_RESTRICT to = inverse + y * plane.pitch;
        for (std::int64_t x = 0; x < width; ++x) {
            const float across = row[x + 1] - row[x - 1], down = below[x] - above[x];
            to[x] = 1.0f / sqrtf((across * across + down * down) / 4 + 1e-12f);
        }
        for (std::int64_t x = plane.width; x < whole(plane); ++x) to[x] = 1e6f;
    }
}

// `each` is the share of a cell that a pixel fills.
CellShare share_above(const CellPlane& plane, const float* density, const float* inverse, const float* counts, float each, float limit) {
    Sum parts, covered;
    for (std::int64_t y = 0; y < plane.height; ++y) {
        for (std::int64_t x = 0; x < plane.width; x += kFloats) {
            const std::int64_t at = y * plane.pitch + x;
            const Floats part = part_of(load(density + at), load(inverse + at), limit);
            parts.add(part);
            covered.add(lesser(load(counts + at) * each, part));
        }
        parts.row(y);
        covered.row(y);
    }
    return {parts.total(), covered.total()};
}

// The same with the weights of two bands.
void shares_above(const CellPlane& plane, const float* density, const float* inverse, const float* counts, float each,
                  const float* narrow, const float* wide, float limit, CellShare* near, CellShare* far) {
    Sum near_parts, near_covered, far_parts, far_covered;
    for (std::int64_t y = 0; y < plane.height; ++y) {
        for (std::int64_t x = 0; x < plane.width; x += kFloats) {
            const std::int64_t at = y * plane.pitch + x;
            const Floats part = part_of(load(density + at), load(inverse + at), limit), covered = lesser(load(counts + at) * each, part);
            const Floats first = load(narrow + at), second = load(wide + at);
            near_parts.add(part * first);
            near_covered.add(covered * first);
            far_parts.add(part * second);
            far_covered.add(covered * second);
        }
        for (Sum* const sum : {&near_parts, &near_covered, &far_parts, &far_covered}) sum->row(y);
    }
    *near = {near_parts.total(), near_covered.total()};
    *far = {far_parts.total(), far_covered.total()};
}

// Writes part (1 - part) of a row where some of the 3 x 3 cells lie in the filled region and others do not; cells beyond
// the plane count as their neighbours. `line` has space for two rows with margins.
void border_row(const CellPlane& plane, std::int64_t y, const float* density, const float* inverse, const float* filled, float limit,
                float* FINGERFLOW_RESTRICT line, float* FINGERFLOW_RESTRICT border) {
    const std::int64_t width = plane.width;
    const float *FINGERFLOW_RESTRICT full = filled + y * plane.pitch, *FINGERFLOW_RESTRICT above = y > 0 ? full - plane.pitch : full;
    const float* FINGERFLOW_RESTRICT below = y + 1 < plane.height ? full + plane.pitch : full;
    float* FINGERFLOW_RESTRICT const counts = line;
    for (std::int64_t x = 0; x < width; ++x) counts[x] = above[x] + full[x] + below[x];
    counts[-1] = counts[0];
    counts[width] = counts[width - 1];
    for (std::int64_t x = 0; x < width; ++x) {
        const float count = counts[x - 1] + counts[x] + counts[x + 1];
        float part = (density[y * plane.pitch + x] - limit) * inverse[y * plane.pitch + x] + 0.5f;
        part = part < 0.0f ? 0.0f : part > 1.0f ? 1.0f : part;
        border[x] = (count > 0.0f) & (count < 9.0f) ? part * (1.0f - part) : 0.0f;
    }
    for (std::int64_t x = width; x < whole(plane); ++x) border[x] = 0.0f;
}

// Writes the means of cells over blocks of 2 x 2; cells beyond the plane are 0.
void halve_cells(const CellPlane& plane, const float* cells, const CellPlane& blocks, float* means) {
    for (std::int64_t row = 0; row < blocks.height; ++row) {
        const float* FINGERFLOW_RESTRICT const upper = cells + 2 * row * plane.pitch;
        const float* FINGERFLOW_RESTRICT const lower = 2 * row + 1 < plane.height ? upper + plane.pitch : nullptr;
        float* FINGERFLOW_RESTRICT const to = means + row * blocks.pitch;
        for (std::int64_t x = 0; x < blocks.width; ++x) to[x] = (upper[2 * x] + upper[2 * x + 1]) * 0.25f;
        if (lower != nullptr)
            for (std::int64_t x = 0; x < blocks.width; ++x) to[x] += (lower[2 * x] + lower[2 * x + 1]) * 0.25f;
    }
}

// Writes the value of each block of 2 x 2 cells to its cells.
void spread_blocks(const CellPlane& blocks, const float* values, const CellPlane& plane, float* cells) {
    for (std::int64_t y = 0; y < plane.height; ++y) {
        const float* FINGERFLOW_RESTRICT const from = values + y / 2 * blocks.pitch;
        float* FINGERFLOW_RESTRICT const to = cells + y * plane.pitch;
        for (std::int64_t x = 0; x < blocks.width; ++x) {
            to[2 * x] = from[x];
            to[2 * x + 1] = from[x];
        }
        for (std::int64_t x = plane.width; x < whole(plane); ++x) to[x] = 0.0f;
    }
}

// Writes the part of each cell inside the region.
void parts_above(const CellPlane& plane, const float* density, const float* inverse, float limit, float* parts) {
    for (std::int64_t y = 0; y < plane.height; ++y)
        for (std::int64_t x = 0; x < plane.width; x += kFloats) {
            const std::int64_t at = y * plane.pitch + x;
            store(parts + at, part_of(load(density + at), load(inverse + at), limit));
        }
}

BorderLevel border_level(const CellPlane& plane, const float* own, const float* border) {
    Sum sums, weights;
    for (std::int64_t y = 0; y < plane.height; ++y) {
        for (std::int64_t x = 0; x < plane.width; x += kFloats) {
            const Floats weight = load(border + y * plane.pitch + x);
            weights.add(weight);
            sums.add(weight * load(own + y * plane.pitch + x));
        }
        weights.row(y);
        sums.row(y);
    }
    return {sums.total(), weights.total()};
}

// Writes the greatest density of each block; `line` has space for a row.
void densest_of_blocks(const CellPlane& plane, const float* density, float* line, float* densest) {
    const std::int64_t across = (plane.width + kCellBlock - 1) / kCellBlock;
    for (std::int64_t top = 0; top < plane.height; top += kCellBlock, densest += across) {
        const std::int64_t bottom = top + kCellBlock < plane.height ? top + kCellBlock : plane.height;
        for (std::int64_t x = 0; x < plane.width; x += kFloats) {
            Floats most = all(0);
            for (std::int64_t y = top; y < bottom; ++y) most = greater(most, load(density + y * plane.pitch + x));
            store(line + x, most);
        }
        for (std::int64_t block = 0; block < across; ++block) {
            float most = 0;
            for (const float* cell = line + block * kCellBlock; cell < line + (block + 1) * kCellBlock; ++cell)
                most = *cell > most ? *cell : most;
            densest[block] = most;
        }
    }
}

// Extends an outline, which begins as zeros, by the cells of a row denser than the limit where `among` is 1.
void extend_outline(const CellPlane& plane, std::int64_t y, const float* density, const float* among, float limit,
                    const Outline& outline) {
    const auto down = static_cast<float>(y + 1), up = static_cast<float>(plane.height - y);
    const Floats first = places();
    Floats right = all(0), left = all(0);
    for (std::int64_t x = 0; x < plane.width; x += kFloats) {
        const Floats inside = is_positive(load(density + y * plane.pitch + x) - limit) * load(among + x);
        store(outline.down + x, greater(load(outline.down + x), inside * down));
        store(outline.up + x, greater(load(outline.up + x), inside * up));
        right = greater(right, inside * (first + static_cast<float>(x + 1)));
        left = greater(left, inside * (static_cast<float>(plane.width - x) - first));
    }
    outline.right[y] = greatest(right);
    outline.left[y] = greatest(left);
}

// Writes 1 where outlined cells lie on all four sides of a cell, or at it.
void fill_row(const CellPlane& plane, std::int64_t y, const Outline& outline, float* FINGERFLOW_RESTRICT filled) {
    const float down = static_cast<float>(y + 1), up = static_cast<float>(plane.height - y);
    const float *FINGERFLOW_RESTRICT lowest = outline.down, *FINGERFLOW_RESTRICT highest = outline.up;
    // From the first outlined cell of the row to the last.
    const auto end = static_cast<std::int64_t>(outline.right[y]);
    for (std::int64_t x = plane.width - static_cast<std::int64_t>(outline.left[y]); x < end; ++x)
        filled[x] = (down <= lowest[x]) & (up <= highest[x]) ? 1.0f : 0.0f;
}

// Writes coverage and density margin of a row: parts of cells in the filled region or next to it, 1 in its holes.
// `filled` is 1 in the region; `line` has space for a row with its margins.
void cover_row(const CellPlane& plane, std::int64_t y, const float* density, const float* inverse, const float* filled,
               float limit, float* FINGERFLOW_RESTRICT line, float* FINGERFLOW_RESTRICT coverage,
               float* FINGERFLOW_RESTRICT density_margin) {
    const std::int64_t at = y * plane.pitch;
    const std::int64_t width = plane.width;
    const float *FINGERFLOW_RESTRICT row = density + at, *FINGERFLOW_RESTRICT steep = inverse + at;
    const float *FINGERFLOW_RESTRICT full = filled + at, *FINGERFLOW_RESTRICT above = full - plane.pitch;
    const float* FINGERFLOW_RESTRICT below = full + plane.pitch;
    for (std::int64_t x = -1; x <= width; ++x) {
        const float beside = above[x] > below[x] ? above[x] : below[x];
        line[x] = beside > full[x] ? beside : full[x];
    }
    for (std::int64_t x = 0; x < width; ++x) {
        const float beside = line[x - 1] > line[x + 1] ? line[x - 1] : line[x + 1], near = beside > line[x] ? beside : line[x];
        float part = (row[x] - limit) * steep[x] + 0.5f;
        part = (part < 0.0f ? 0.0f : part > 1.0f ? 1.0f : part) * near;
        const float hole = (full[x] > 0.0f) & (row[x] <= limit) ? 1.0f : 0.0f;
        coverage[x] = part > hole ? part : hole;
        const float over = row[x] * near - limit, filling = (2 * hole - 1) * limit;
        density_margin[x] = over > filling ? over : filling;
    }
}

RowMoments row_moments(const float* coverage, std::int64_t width) {
    Sum mass, first, second;
    const Floats place = places();
    for (std::int64_t begin = 0; begin < width; begin += kFloats) {
        const Floats part = load(coverage + begin), x = place + static_cast<float>(begin);
        mass.add(part);
        first.add(part * x);
        second.add(part * x * x);
    }
    return {mass.total(), first.total(), second.total()};
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow

#if FINGERFLOW_ONCE

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
FINGERFLOW_OTHER_SETS(count_cells)
FINGERFLOW_OTHER_SETS(scale_cells)
FINGERFLOW_OTHER_SETS(smooth_cells)
FINGERFLOW_OTHER_SETS(inverse_slopes)
FINGERFLOW_OTHER_SETS(share_above)
FINGERFLOW_OTHER_SETS(shares_above)
FINGERFLOW_OTHER_SETS(border_row)
FINGERFLOW_OTHER_SETS(halve_cells)
FINGERFLOW_OTHER_SETS(spread_blocks)
FINGERFLOW_OTHER_SETS(parts_above)
FINGERFLOW_OTHER_SETS(border_level)
FINGERFLOW_OTHER_SETS(densest_of_blocks)
FINGERFLOW_OTHER_SETS(extend_outline)
FINGERFLOW_OTHER_SETS(fill_row)
FINGERFLOW_OTHER_SETS(cover_row)
FINGERFLOW_OTHER_SETS(row_moments)
namespace {

constexpr float kLeastLevel = 0.25f;

float clamped(float value, float low, float high) { return std::min(std::max(value, low), high); }

class Finder {
public:
    Finder(const fingerflow_apparent_contacts& given, std::int64_t frame)
        : given_(given), mask_(given.masks + frame * given.height * given.width),
          margin_(given.density_margin + frame * cells_of(given.height, given.side) * cells_of(given.width, given.side)),
          numbers_(given.numbers + 7 * frame), width_(static_cast<float>(2 * given.radius + 1) / static_cast<float>(given.side)),
          each_(1.0f / static_cast<float>(given.side * given.side)) {
        plane_.height = cells_of(given.height, given.side);
        plane_.width = cells_of(given.width, given.side);
        left_ = lay_out(plane_, width_);
        blocks_.height = cells_of(plane_.height, 2);
        blocks_.width = cells_of(plane_.width, 2);
        blocks_left_ = lay_out(blocks_, contact::kWide * width_ / 2);
        outline_floats_ = 2 * plane_.pitch + 2 * whole(plane_.height);
        steps_ = std::max(cells_of(plane_.height, kCellBlock), cells_of(plane_.width, kCellBlock));
    }

    // Sets margin and pitch of a plane that is smoothed by boxes of a width; returns the floats before a row's first cell.
    static std::int64_t lay_out(CellPlane& plane, float width) {
        plane.margin = static_cast<std::int64_t>(width / 2) + 3;
        plane.pitch = 2 * whole(plane.margin) + whole(plane.width);
        return whole(plane.margin);
    }

    void find() {
        const std::int64_t all = (plane_.height + 2 * plane_.margin) * plane_.pitch, line = (given_.width + 127) / 64 * 64;
        const std::int64_t outline = outline_floats_, few = (blocks_.height + 2 * blocks_.margin) * blocks_.pitch;
        auto* const memory =
            static_cast<unsigned char*>(workspace(size(line + 4 * (8 * all + 2 * few + outline + 2 * plane_.pitch))));
        const std::int64_t origin = plane_.margin * plane_.pitch + left_;
        auto* const planes = reinterpret_cast<float*>(memory + line);
        // These planes and the lines are zero in their margins and wherever nothing is written.
        density_ = planes + origin;
        own_ = planes + all + origin;
        other_ = planes + 2 * all + origin;
        filled_ = planes + 3 * all + origin;
        float* const numbers = planes + 4 * all;
        outline_ = {numbers, numbers + plane_.pitch, numbers + 2 * plane_.pitch, numbers + 2 * plane_.pitch + whole(plane_.height)};
        std::memset(planes, 0, size(4 * (4 * all + outline + 2 * plane_.pitch + 2 * few)));
        line_ = numbers + outline + left_;
        among_ = numbers + outline + plane_.pitch;
        block_means_ = among_ + plane_.pitch + blocks_.margin * blocks_.pitch + blocks_left_;
        other_blocks_ = block_means_ + few;
        counts_ = among_ + plane_.pitch + 2 * few + origin;
        inverse_ = counts_ + all;
        narrow_ = inverse_ + all;
        wide_ = narrow_ + all;

        FINGERFLOW_PICK(count_cells)(mask_, given_.height, given_.width, static_cast<int>(given_.side), plane_, memory, counts_);
        crop();
        const double covered = FINGERFLOW_PICK(scale_cells)(plane_, counts_, each_, density_);
        const auto smooth = FINGERFLOW_PICK(smooth_cells);
        smooth(plane_, width_, density_, other_);
        FINGERFLOW_PICK(inverse_slopes)(plane_, density_, inverse_);
        float limit = 0.25f, inner = 1;
        for (int round = 0; round < contact::kFirstRounds; ++round) {
            inner = share_above(limit);
            limit = inner / 2;
        }
        for (int border = 0; border < contact::kBorders; ++border) {
            const float level = level_of(limit);
            if (inner > contact::kSolid) {
                for (int round = 0; round < contact::kRounds; ++round) limit = share_above(limit) * level;
                continue;
            }
            band(contact::kNarrow, narrow_);
            band(contact::kWide, wide_);
            const auto shares_above = FINGERFLOW_PICK(shares_above);
            for (int round = 0; round < contact::kRounds; ++round) {
                CellShare near, far;
                shares_above(plane_, density_, inverse_, counts_, each_, narrow_, wide_, limit, &near, &far);
                const float share = share_of(near) * std::pow(share_of(near) / share_of(far), contact::kThinning);
                limit = clamped(share, contact::kLeastShare, 1.0f) * level;
            }
        }
        fill(limit);
        const float* const coverage = cover(limit);
        measure(coverage, covered);
    }

    // Rounds up to whole vectors.
    static std::int64_t whole(std::int64_t count) { return cells_of(count, kCellLanes) * kCellLanes; }
    static std::int64_t cells_of(std::int64_t pixels, std::int64_t side) { return (pixels + side - 1) / side; }

private:
    static float share_of(const CellShare& share) {
        return clamped(static_cast<float>(share.covered / std::max(share.parts, 1e-3)), contact::kLeastShare, 1.0f);
    }

    // Restricts the planes to the cells around set pixels. Three boxes carry a density over 3 reaches, beyond which it is 0;
    // what counts of the region, denser than a fourth of the share, lies within 2 and is smoothed again within 3.
    void crop() {
        const std::int64_t reach = 4 * static_cast<std::int64_t>(std::ceil(width_ / 2)), height = plane_.height, width = plane_.width;
        std::int64_t top = height, bottom = 0, left = width, right = 0;
        for (std::int64_t y = 0; y < height; ++y) {
            const float* const row = counts_ + y * plane_.pitch;
            std::int64_t first = 0, end = width;
            while (first < width && row[first] <= 0) ++first;
            if (first == width) continue;
            while (row[end - 1] <= 0) --end;
            top = std::min(top, y);
            bottom = y + 1;
            left = std::min(left, first);
            right = std::max(right, end);
        }
        // Corners lie at whole blocks and vectors, or at the end of the view.
        top_ = std::max<std::int64_t>(std::min(top, bottom) - reach, 0) / kCellBlock * kCellBlock;
        left_cells_ = std::max<std::int64_t>(std::min(left, right) - reach, 0) / kCellLanes * kCellLanes;
        plane_.height = std::min(bottom + reach, height) - top_;
        plane_.width = std::min(whole(right + reach), width) - left_cells_;
        blocks_.height = cells_of(plane_.height, 2);
        blocks_.width = cells_of(plane_.width, 2);
        for (float** const cells : {&density_, &own_, &other_, &filled_, &counts_, &inverse_, &narrow_, &wide_})
            *cells += top_ * plane_.pitch + left_cells_;
    }

    float share_above(float limit) const {
        return share_of(FINGERFLOW_PICK(share_above)(plane_, density_, inverse_, counts_, each_, limit));
    }

    // Finds the outer border, left in wide_, and returns the value there of the region itself, smoothed: below one half
    // where the border is convex.
    float level_of(float limit) {
        fill(limit);
        const auto border_row = FINGERFLOW_PICK(border_row);
        for (std::int64_t y = 0; y < plane_.height; ++y)
            border_row(plane_, y, density_, inverse_, filled_, limit, line_, wide_ + y * plane_.pitch);
        FINGERFLOW_PICK(parts_above)(plane_, density_, inverse_, limit, own_);
        FINGERFLOW_PICK(smooth_cells)(plane_, width_, own_, other_);
        const BorderLevel border = FINGERFLOW_PICK(border_level)(plane_, own_, wide_);
        return clamped(static_cast<float>(border.density / std::max(border.weight, 1e-3)), kLeastLevel, 0.5f);
    }

    // Writes weights that fall off from the border in wide_, over boxes of `boxes` widths.
    void band(float boxes, float* weights) {
        FINGERFLOW_PICK(halve_cells)(plane_, wide_, blocks_, block_means_);
        FINGERFLOW_PICK(smooth_cells)(blocks_, std::max(boxes * width_ / 2, 1.0f), block_means_, other_blocks_);
        FINGERFLOW_PICK(spread_blocks)(blocks_, block_means_, plane_, weights);
    }

    // Finds the component around the densest cell, by flood fill over blocks of cells, and fills its outline.
    void fill(float limit) {
        const std::int64_t down = cells_of(plane_.height, kCellBlock), across = cells_of(plane_.width, kCellBlock);
        std::vector<float> densest(size(down * across));
        if (densest.empty()) return;
        FINGERFLOW_PICK(densest_of_blocks)(plane_, density_, among_, densest.data());
        const float most = *std::max_element(densest.begin(), densest.end());
        std::vector<unsigned char> reached(densest.size());
        std::vector<std::int64_t> edge, next;
        for (std::size_t k = 0; k < densest.size(); ++k)
            if (densest[k] > limit && densest[k] >= most) {
                reached[k] = 1;
                edge.push_back(static_cast<std::int64_t>(k));
            }
        for (std::int64_t step = 0; step < steps_ && !edge.empty(); ++step) {
            next.clear();
            for (const std::int64_t block : edge)
                for (std::int64_t y = std::max<std::int64_t>(0, block / across - 1); y < std::min(down, block / across + 2); ++y)
                    for (std::int64_t x = std::max<std::int64_t>(0, block % across - 1); x < std::min(across, block % across + 2); ++x) {
                        const auto at = size(y * across + x);
                        if (densest[at] <= limit || reached[at] != 0) continue;
                        reached[at] = 1;
                        next.push_back(static_cast<std::int64_t>(at));
                    }
            edge.swap(next);
        }
        std::memset(outline_.down, 0, size(4 * outline_floats_));
        std::memset(filled_, 0, size(4 * plane_.height * plane_.pitch));
        const auto extend = FINGERFLOW_PICK(extend_outline);
        for (std::int64_t y = 0; y < plane_.height; ++y) {
            if (y % kCellBlock == 0)
                for (std::int64_t x = 0; x < plane_.width; ++x)
                    among_[x] = reached[size(y / kCellBlock * across + x / kCellBlock)];
            extend(plane_, y, density_, among_, limit, outline_);
        }
        const auto fill = FINGERFLOW_PICK(fill_row);
        for (std::int64_t y = 0; y < plane_.height; ++y) fill(plane_, y, outline_, filled_ + y * plane_.pitch);
    }

    const float* cover(float limit) {
        const auto cover = FINGERFLOW_PICK(cover_row);
        const std::int64_t across = cells_of(given_.width, given_.side);
        std::fill_n(margin_, cells_of(given_.height, given_.side) * across, -limit);
        for (std::int64_t y = 0; y < plane_.height; ++y)
            cover(plane_, y, density_, inverse_, filled_, limit, line_, other_ + y * plane_.pitch, margin_ + (top_ + y) * across + left_cells_);
        return other_;
    }

    void measure(const float* coverage, double covered) {
        double mass = 0, x = 0, y = 0, xx = 0, xy = 0, yy = 0;
        const auto sum = FINGERFLOW_PICK(row_moments);
        for (std::int64_t row = 0; row < plane_.height; ++row) {
            const RowMoments of_row = sum(coverage + row * plane_.pitch, plane_.width);
            const auto at = static_cast<double>(row);
            mass += of_row.mass;
            x += of_row.first;
            xx += of_row.second;
            y += of_row.mass * at;
            yy += of_row.mass * at * at;
            xy += of_row.first * at;
        }
        const auto side = static_cast<double>(given_.side), square = side * side;
        numbers_[0] = static_cast<float>(covered);
        if (mass <= 0.5) {
            numbers_[1] = 0;
            for (int k = 2; k < 7; ++k) numbers_[k] = std::numeric_limits<float>::quiet_NaN();
            return;
        }
        x /= mass;
        y /= mass;
        xx = (xx / mass - x * x) * square + (square - 1) / 12;
        yy = (yy / mass - y * y) * square + (square - 1) / 12;
        xy = (xy / mass - x * y) * square;
        const double middle = (xx + yy) / 2, half = (xx - yy) / 2, spread = std::sqrt(half * half + xy * xy);
        x += static_cast<double>(left_cells_);
        y += static_cast<double>(top_);
        const double results[] = {mass * square, x * side + (side - 1) / 2, y * side + (side - 1) / 2, 2 * std::sqrt(middle + spread),
                                  2 * std::sqrt(std::max(middle - spread, 0.0)), std::atan2(xy, half) / 2};
        for (int k = 0; k < 6; ++k) numbers_[k + 1] = static_cast<float>(results[k]);
    }

    const fingerflow_apparent_contacts& given_;
    const unsigned char* mask_;
    float *margin_, *numbers_;
    const float width_, each_;
    CellPlane plane_, blocks_;          // of cells, and of blocks of 2 x 2 cells
    std::int64_t left_, blocks_left_;  // floats before the first cell of a row
    std::int64_t outline_floats_, steps_;  // steps of the flood fill at most
    std::int64_t top_ = 0, left_cells_ = 0;  // first row and column of the cropped planes
    float *density_, *own_, *other_, *filled_, *counts_, *inverse_, *line_, *among_, *block_means_, *other_blocks_, *narrow_, *wide_;
    Outline outline_;
};

}  // namespace
}  // namespace fingerflow

void fingerflow_apparent_contact(const fingerflow_apparent_contacts* given, int threads) {
    using namespace fingerflow;
    parallel_for(given->batch, threads, [&](std::int64_t frame) { Finder(*given, frame).find(); });
}

#endif
