// build: each instruction set, fused
// Row loops of apparent_contact.cpp: counts, box means, inverse slopes 1 / |grad density|, parts of cells, outline,
// filling and moments. part = clamp((density - limit) / |grad density| + 1/2, 0, 1).
// Layout: a CellPlane is row-major with `pitch` floats a row; a lane holds one cell, neighbours of a row lie in
// neighbouring lanes. Loops run over whole vectors, since cells behind the last of a row are zero.
#include "apparent_contact_cells.h"

#include <math.h>
#include <string.h>

#include "floats.h"
#include "lanes.h"

namespace fingerflow {
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

CellShare share_above(const CellPlane& plane, const float* density, const float* inverse, const float* counts, float limit) {
    Sum parts, covered;
    for (std::int64_t y = 0; y < plane.height; ++y) {
        for (std::int64_t x = 0; x < plane.width; x += kFloats) {
            const std::int64_t at = y * plane.pitch + x;
            const Floats part = part_of(load(density + at), load(inverse + at), limit);
            parts.add(part);
            covered.add(is_positive(part) * load(counts + at));
        }
        parts.row(y);
        covered.row(y);
    }
    return {parts.total(), covered.total()};
}

void parts_above(const CellPlane& plane, const float* density, const float* inverse, float limit, float* parts) {
    for (std::int64_t y = 0; y < plane.height; ++y)
        for (std::int64_t x = 0; x < plane.width; x += kFloats) {
            const std::int64_t at = y * plane.pitch + x;
            store(parts + at, part_of(load(density + at), load(inverse + at), limit));
        }
}

BorderLevel border_level(const CellPlane& plane, const float* density, const float* inverse, const float* own, float limit) {
    Sum sums, weights;
    for (std::int64_t y = 0; y < plane.height; ++y) {
        for (std::int64_t x = 0; x < plane.width; x += kFloats) {
            const std::int64_t at = y * plane.pitch + x;
            const Floats part = part_of(load(density + at), load(inverse + at), limit), weight = part * (1.0f - part);
            weights.add(weight);
            sums.add(weight * load(own + at));
        }
        weights.row(y);
        sums.row(y);
    }
    return {sums.total(), weights.total()};
}

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

void fill_row(const CellPlane& plane, std::int64_t y, const Outline& outline, float* FINGERFLOW_RESTRICT filled) {
    const float down = static_cast<float>(y + 1), up = static_cast<float>(plane.height - y);
    const float *FINGERFLOW_RESTRICT lowest = outline.down, *FINGERFLOW_RESTRICT highest = outline.up;
    // From the first outlined cell of the row to the last.
    const auto end = static_cast<std::int64_t>(outline.right[y]);
    for (std::int64_t x = plane.width - static_cast<std::int64_t>(outline.left[y]); x < end; ++x)
        filled[x] = (down <= lowest[x]) & (up <= highest[x]) ? 1.0f : 0.0f;
}

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
