// Sums of few neighbours, row by row, which the compiler makes vectors of.
#include "dense_region_cells.h"

#include <math.h>
#include <string.h>

#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

constexpr std::int64_t kSides = 16;  // sums side by side, for vectors

template <class Word>
void add_bytes(const unsigned char* FINGERFLOW_RESTRICT line, std::int64_t cells, std::int32_t* FINGERFLOW_RESTRICT counts) {
    // The highest byte of a product with 0x0101... is the sum of all bytes.
    constexpr Word ones = static_cast<Word>(~static_cast<Word>(0)) / 255;
    constexpr int highest = 8 * (static_cast<int>(sizeof(Word)) - 1);
    for (std::int64_t x = 0; x < cells; ++x) {
        Word word;
        memcpy(&word, line + x * static_cast<std::int64_t>(sizeof(Word)), sizeof word);
        counts[x] = static_cast<std::int32_t>(static_cast<Word>(word * ones) >> highest);
    }
}

// One box mean: numbers `step` apart, `reach` to both sides in whole and the next in part.
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

inline float part_of(float density, float inverse, float limit) {
    const float part = (density - limit) * inverse + 0.5f;
    return part < 0.0f ? 0.0f : part > 1.0f ? 1.0f : part;
}

double sum_of(const float* sums) {
    double sum = 0;
    for (std::int64_t k = 0; k < kSides; ++k) sum += static_cast<double>(sums[k]);
    return sum;
}

}  // namespace

void count_cells(const unsigned char* mask, std::int64_t rows, std::int64_t columns, int side, const CellPlane& plane,
                 unsigned char* FINGERFLOW_RESTRICT line, std::int32_t* counts) {
    memset(line + columns, 0, 64);
    for (std::int64_t row = 0; row < plane.height; ++row) {
        const std::int64_t top = row * side, bottom = top + side < rows ? top + side : rows;
        memcpy(line, mask + top * columns, static_cast<std::size_t>(columns));
        for (std::int64_t y = top + 1; y < bottom; ++y) {
            const unsigned char* FINGERFLOW_RESTRICT next = mask + y * columns;
            for (std::int64_t x = 0; x < columns; ++x) line[x] = static_cast<unsigned char>(line[x] + next[x]);
        }
        std::int32_t* const to = counts + row * plane.pitch;
        if (side == 4) add_bytes<std::uint32_t>(line, plane.width, to);
        else if (side == 8) add_bytes<std::uint64_t>(line, plane.width, to);
        else if (side == 2) add_bytes<std::uint16_t>(line, plane.width, to);
        else add_bytes<std::uint8_t>(line, plane.width, to);
    }
}

void scale_cells(const CellPlane& plane, const std::int32_t* counts, float factor, float* cells) {
    for (std::int64_t y = 0; y < plane.height; ++y) {
        const std::int32_t* FINGERFLOW_RESTRICT from = counts + y * plane.pitch;
        float* FINGERFLOW_RESTRICT to = cells + y * plane.pitch;
        for (std::int64_t x = 0; x < plane.width; ++x) to[x] = factor * static_cast<float>(from[x]);
    }
}

void smooth_cells(const CellPlane& plane, float width, float* cells, float* other) {
    // In whole up to `reach`, the next in part.
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
        const float* FINGERFLOW_RESTRICT row = density + y * plane.pitch;
        float* FINGERFLOW_RESTRICT to = inverse + y * plane.pitch;
        for (std::int64_t x = 0; x < plane.width; ++x) {
            const float across = row[x + 1] - row[x - 1], down = row[x + plane.pitch] - row[x - plane.pitch];
            to[x] = 1.0f / sqrtf((across * across + down * down) / 4 + 1e-12f);
        }
    }
}

CellShare share_above(const CellPlane& plane, const float* density, const float* inverse, const std::int32_t* counts, float limit) {
    CellShare share{0, 0};
    for (std::int64_t y = 0; y < plane.height; ++y) {
        const std::int64_t at = y * plane.pitch;
        const float *const row = density + at, *const by = inverse + at;
        const std::int32_t* const covered = counts + at;
        float parts[kSides] = {};
        std::int32_t sums[kSides] = {};
        // Behind the last cell of a row lie zeros: no density, and no slope, so that nothing is inside.
        for (std::int64_t first = 0; first < plane.width; first += kSides)
            for (std::int64_t k = 0; k < kSides; ++k) {
                const std::int64_t x = first + k;
                const float part = x < plane.width ? part_of(row[x], by[x], limit) : 0.0f;
                parts[k] += part;
                sums[k] += part > 0.0f ? covered[x] : 0;
            }
        share.parts += sum_of(parts);
        for (std::int64_t k = 0; k < kSides; ++k) share.covered += sums[k];
    }
    return share;
}

void parts_above(const CellPlane& plane, const float* density, const float* inverse, float limit, float* parts) {
    for (std::int64_t y = 0; y < plane.height; ++y) {
        const float *FINGERFLOW_RESTRICT row = density + y * plane.pitch, *FINGERFLOW_RESTRICT by = inverse + y * plane.pitch;
        float* FINGERFLOW_RESTRICT to = parts + y * plane.pitch;
        for (std::int64_t x = 0; x < plane.width; ++x) to[x] = part_of(row[x], by[x], limit);
    }
}

BorderLevel border_level(const CellPlane& plane, const float* density, const float* inverse, const float* own, float limit) {
    BorderLevel level{0, 0};
    for (std::int64_t y = 0; y < plane.height; ++y) {
        const std::int64_t at = y * plane.pitch;
        const float *const row = density + at, *const by = inverse + at, *const from = own + at;
        float sums[kSides] = {}, weights[kSides] = {};
        for (std::int64_t first = 0; first < plane.width; first += kSides)
            for (std::int64_t k = 0; k < kSides; ++k) {
                const std::int64_t x = first + k;
                const float part = x < plane.width ? part_of(row[x], by[x], limit) : 0.0f, weight = part * (1 - part);
                weights[k] += weight;
                sums[k] += weight * from[x];
            }
        level.density += sum_of(sums);
        level.weight += sum_of(weights);
    }
    return level;
}

void above_limit(const CellPlane& plane, const float* density, float limit, std::int32_t* inside) {
    for (std::int64_t y = 0; y < plane.height; ++y) {
        const float* FINGERFLOW_RESTRICT from = density + y * plane.pitch;
        std::int32_t* FINGERFLOW_RESTRICT to = inside + y * plane.pitch;
        for (std::int64_t x = 0; x < plane.width; ++x) to[x] = from[x] > limit ? 1 : 0;
    }
}

void cover_row(const CellPlane& plane, std::int64_t y, const float* density, const float* inverse,
               const std::int32_t* inside, const std::int32_t* filled, const std::int32_t* near, float limit,
               float* FINGERFLOW_RESTRICT coverage, float* FINGERFLOW_RESTRICT excess) {
    const std::int64_t at = y * plane.pitch;
    const float *const row = density + at, *const steep = inverse + at;
    const std::int32_t *const in = inside + at, *const full = filled + at, *const by = near + at;
    for (std::int64_t x = 0; x < plane.width; ++x) {
        const float beside = static_cast<float>(by[x]);
        const float part = part_of(row[x], steep[x], limit) * beside;
        const float hole = full[x] > in[x] ? 1.0f : 0.0f;
        coverage[x] = part > hole ? part : hole;
        const float over = row[x] * beside - limit, filling = (2 * hole - 1) * limit;
        excess[x] = over > filling ? over : filling;
    }
}

RowMoments row_moments(const float* coverage, std::int64_t width) {
    float mass[kSides] = {}, first[kSides] = {}, second[kSides] = {};
    for (std::int64_t begin = 0; begin < width; begin += kSides)
        for (std::int64_t k = 0; k < kSides; ++k) {
            const float part = begin + k < width ? coverage[begin + k] : 0.0f, x = static_cast<float>(begin + k);
            mass[k] += part;
            first[k] += part * x;
            second[k] += part * x * x;
        }
    return {sum_of(mass), sum_of(first), sum_of(second)};
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
