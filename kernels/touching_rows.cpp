// Columns of a window counted by adding the line below it and taking off the one above; a byte holds 15 x 15.
#include "touching_rows.h"

#include <string.h>

#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

// Which pixels lie below black + share * light, and which are lit.
template <class Pixel>
void compare(const Pixel* FINGERFLOW_RESTRICT row, const float* FINGERFLOW_RESTRICT light,
             const float* FINGERFLOW_RESTRICT black, float share, std::int64_t begin, std::int64_t width,
             unsigned char* FINGERFLOW_RESTRICT line, unsigned char* FINGERFLOW_RESTRICT lit) {
    for (std::int64_t x = begin; x < width; ++x) {
        const bool has = light[x] > 0.0f;
        lit[x] = has;
        line[x] = static_cast<unsigned char>(has & (static_cast<float>(row[x]) < share * light[x] + black[x]));
    }
}

#ifdef __AVX512BW__
// 64 bytes at a time, compared in four vectors of floats.
std::int64_t compare_bytes(const std::uint8_t* row, const float* light, const float* black, float share,
                           std::int64_t width, unsigned char* line, unsigned char* lit) {
    const __m512 factor = _mm512_set1_ps(share), zero = _mm512_setzero_ps();
    const __m512i one = _mm512_set1_epi8(1);
    std::int64_t x = 0;
    for (; x + 64 <= width; x += 64) {
        __mmask64 has = 0, below = 0;
        for (int part = 0; part < 4; ++part) {
            const std::int64_t at = x + 16 * part;
            const __m512 counts = _mm512_cvtepi32_ps(_mm512_cvtepu8_epi32(_mm_loadu_si128(reinterpret_cast<const __m128i*>(row + at))));
            const __m512 given = _mm512_loadu_ps(light + at);
            const __m512 limit = _mm512_add_ps(_mm512_mul_ps(factor, given), _mm512_loadu_ps(black + at));
            has |= static_cast<__mmask64>(_mm512_cmp_ps_mask(given, zero, _CMP_GT_OQ)) << (16 * part);
            below |= static_cast<__mmask64>(_mm512_cmp_ps_mask(counts, limit, _CMP_LT_OQ)) << (16 * part);
        }
        _mm512_storeu_si512(lit + x, _mm512_maskz_mov_epi8(has, one));
        _mm512_storeu_si512(line + x, _mm512_maskz_mov_epi8(has & below, one));
    }
    return x;
}
#else
std::int64_t compare_bytes(const std::uint8_t*, const float*, const float*, float, std::int64_t, unsigned char*, unsigned char*) {
    return 0;
}
#endif

template <class Pixel>
std::int64_t compare_bytes(const Pixel*, const float*, const float*, float, std::int64_t, unsigned char*, unsigned char*) {
    return 0;
}

template <class Pixel>
void rows(const Pixel* frame, const Frames& frames, const float* light, const float* black, std::int64_t top,
          std::int64_t bottom, int size, float share, unsigned char* lines, unsigned char* result) {
    const std::int64_t width = frames.width, pitch = width + size + 64;
    const int half = size / 2;
    unsigned char* FINGERFLOW_RESTRICT columns = lines + 2 * size * pitch;
    unsigned char* FINGERFLOW_RESTRICT sums = columns + pitch;
    const std::int64_t padded = width + 2 * half;
    memset(columns, 0, static_cast<std::size_t>(pitch));
    for (std::int64_t y = top - half; y < bottom + half; ++y) {
        const std::int64_t place = (y - top + half) % size;
        unsigned char* FINGERFLOW_RESTRICT line = lines + place * pitch;
        unsigned char* const lit = lines + (size + place) * pitch;
        if (y >= top + half + 1)
            for (std::int64_t x = 0; x < padded; ++x) columns[x] = static_cast<unsigned char>(columns[x] - line[x]);
        const std::int64_t inside = y < 0 ? 0 : y >= frames.height ? frames.height - 1 : y;
        const Pixel* const row = frame + inside * frames.row_stride;
        const float *const given = light + inside * width, *const dark = black + inside * width;
        const std::int64_t done = compare_bytes(row, given, dark, share, width, line + half, lit);
        compare(row, given, dark, share, done, width, line + half, lit);
        memset(line, line[half], static_cast<std::size_t>(half));
        memset(line + half + width, line[half + width - 1], static_cast<std::size_t>(half));
        for (std::int64_t x = 0; x < padded; ++x) columns[x] = static_cast<unsigned char>(columns[x] + line[x]);
        if (y < top + half) continue;
        unsigned char* FINGERFLOW_RESTRICT out = result + (y - half) * width;
        const unsigned char* FINGERFLOW_RESTRICT own = lines + (size + (y - half - top + half) % size) * pitch;
        const auto most = static_cast<unsigned char>(size * size / 2);
        if (size == 3) {
            for (std::int64_t x = 0; x < width; ++x) {
                const auto sum = static_cast<unsigned char>(columns[x] + columns[x + 1] + columns[x + 2]);
                out[x] = static_cast<unsigned char>((sum > most) & own[x]);
            }
            continue;
        }
        memcpy(sums, columns, static_cast<std::size_t>(width));
        for (int k = 1; k < size; ++k)
            for (std::int64_t x = 0; x < width; ++x) sums[x] = static_cast<unsigned char>(sums[x] + columns[x + k]);
        for (std::int64_t x = 0; x < width; ++x) out[x] = static_cast<unsigned char>((sums[x] > most) & own[x]);
    }
}

}  // namespace

void touching_rows(const Frames& frames, const Lit& lit, std::int64_t frame, std::int64_t top, std::int64_t bottom,
                   int size, float share, unsigned char* lines, unsigned char* result) {
    const std::int64_t pixels = frames.height * frames.width;
    const float* const light = lit.light + (lit.lights == 1 ? 0 : frame) * pixels;
    const float* const black = lit.black + (lit.blacks == 1 ? 0 : frame) * pixels;
    const auto find = [&](const auto* data) {
        rows(data + frame * frames.frame_stride, frames, light, black, top, bottom, size, share, lines, result + frame * pixels);
    };
    FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, find)
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
