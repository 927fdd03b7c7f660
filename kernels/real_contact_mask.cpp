// build: each instruction set
// Real-contact mask: a lit pixel touches where most of a size x size window lies below black + limit * light
// (fingerflow/ops/contact/real_contact_mask.py).
// Layout: results are bytes, contiguous (batch, height, width). A piece is some rows of all frames, so that the light
// of the empty glass is read once for all of them. One pixel a lane, bytes of 0 or 1 in rings of `size` lines; column sums
// add the line below and subtract the line above the window, and a byte holds 15 x 15. With AVX-512, uint8 frames and 3 x 3
// windows, a pixel is one bit and 64 are counted at a time by full adders.
#include <string.h>
#include <cstddef>
#if defined(__AVX512BW__)
#include <immintrin.h>
#endif

#include "instruction_sets.h"
#include "interface.h"
#include "lanes.h"
#include "pixels.h"

namespace fingerflow {

// Bytes of memory: lines of bytes of one frame, or lines of bits of all frames.
inline std::size_t real_contact_mask_memory(const Frames& frames, int size) {
    const std::int64_t bytes = (2 * size + 2) * (frames.width + size + 64), words = (frames.width + 63) / 64 + 2;
    const std::int64_t bits = 8 * words * (6 * frames.batch + 2);
    return static_cast<std::size_t>(bytes > bits ? bytes : bits);
}

namespace FINGERFLOW_ISA {
namespace {

// Writes which pixels lie below black + share * light, and which are lit.
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
// Masks of up to 64 pixels (`left` exist): lit ones below black + share * light, and lit ones.
struct Compared {
    std::uint64_t below = 0, has = 0;
    Compared(const std::uint8_t* row, const float* light, const float* black, float share, std::int64_t left) {
        const __m512 factor = _mm512_set1_ps(share), zero = _mm512_setzero_ps();
        for (int at = 0; at < 64 && at < left; at += 16) {
            const auto some = static_cast<__mmask16>(left - at >= 16 ? 0xffff : (1 << (left - at)) - 1);
            const __m512 counts = _mm512_cvtepi32_ps(_mm512_cvtepu8_epi32(_mm_maskz_loadu_epi8(some, row + at)));
            const __m512 given = _mm512_maskz_loadu_ps(some, light + at);
            const __m512 limit = _mm512_add_ps(_mm512_mul_ps(factor, given), _mm512_maskz_loadu_ps(some, black + at));
            const __mmask16 lit = _mm512_cmp_ps_mask(given, zero, _CMP_GT_OQ);
            has |= static_cast<std::uint64_t>(lit) << at;
            below |= static_cast<std::uint64_t>(_mm512_mask_cmp_ps_mask(lit, counts, limit, _CMP_LT_OQ)) << at;
        }
    }
};

// `compare` for whole vectors of 64 pixels; returns the number of pixels done.
std::int64_t compare_bytes(const std::uint8_t* row, const float* light, const float* black, float share,
                           std::int64_t width, unsigned char* line, unsigned char* lit) {
    const __m512i one = _mm512_set1_epi8(1);
    std::int64_t x = 0;
    for (; x + 64 <= width; x += 64) {
        const Compared found(row + x, light + x, black + x, share, 64);
        _mm512_storeu_si512(lit + x, _mm512_maskz_mov_epi8(found.has, one));
        _mm512_storeu_si512(line + x, _mm512_maskz_mov_epi8(found.below, one));
    }
    return x;
}

// Windows of 3 x 3 of bytes as bits: full adders sum 64 pixels at a time. The lines of bits of all frames fit into the
// first cache together with light and black.
class Bits {
public:
    Bits(const fingerflow_lit_frames& lit, const float* shares, unsigned char* memory)
        : frames_(lit.frames), lit_(lit), shares_(shares), words_((frames_.width + 63) / 64), pitch_(words_ + 2),
          lines_(reinterpret_cast<std::uint64_t*>(memory)), ones_(lines_ + 6 * frames_.batch * pitch_ + 1), twos_(ones_ + pitch_) {}

    void rows(std::int64_t top, std::int64_t bottom, unsigned char* result) const {
        for (std::int64_t y = top - 1; y <= bottom; ++y)
            for (std::int64_t frame = 0; frame < frames_.batch; ++frame) {
                compare(frame, y);
                if (y > top) count(frame, y - 1, result + (frame * frames_.height + y - 1) * frames_.width);
            }
    }

private:
    // Lines to prefetch ahead: hardware does not prefetch beyond the end of a line of a frame.
    static constexpr std::int64_t kAhead = 2;

    std::uint64_t* line(std::int64_t frame, std::int64_t y, std::int64_t kind) const {
        return lines_ + ((2 * frame + kind) * 3 + (y + 3) % 3) * pitch_;
    }

    void compare(std::int64_t frame, std::int64_t y) const {
        const std::int64_t inside = y < 0 ? 0 : y >= frames_.height ? frames_.height - 1 : y, width = frames_.width;
        const auto* const row = static_cast<const std::uint8_t*>(frames_.data) + frame * frames_.frame_stride + inside * frames_.row_stride;
        const float* const light = lit_.light + ((lit_.lights == 1 ? 0 : frame) * frames_.height + inside) * width;
        const float* const black = lit_.black + ((lit_.blacks == 1 ? 0 : frame) * frames_.height + inside) * width;
        std::uint64_t *const below = line(frame, y, 0), *const has = line(frame, y, 1);
        const std::int64_t ahead = (y + kAhead < frames_.height ? kAhead : 0) * frames_.row_stride;
        for (std::int64_t word = 0; word < words_; ++word) {
            const std::int64_t at = 64 * word;
            FINGERFLOW_PREFETCH(row + ahead + at);
            const Compared found(row + at, light + at, black + at, shares_[frame], width - at);
            below[word] = found.below;
            has[word] = found.has;
        }
    }

    // Writes 1 where at least five of nine are set and the middle one is lit.
    void count(std::int64_t frame, std::int64_t y, unsigned char* out) const {
        const std::uint64_t *const above = line(frame, y - 1, 0), *const middle = line(frame, y, 0);
        const std::uint64_t *const below = line(frame, y + 1, 0), *const has = line(frame, y, 1);
        // Sum of each column as two bits.
        for (std::int64_t word = 0; word < words_; ++word) {
            const std::uint64_t a = above[word], b = middle[word], c = below[word];
            ones_[word] = a ^ b ^ c;
            twos_[word] = most(a, b, c);
        }
        extend(ones_);
        extend(twos_);
        const __m512i one = _mm512_set1_epi8(1);
        for (std::int64_t word = 0; word < words_; ++word) {
            const Three ones(ones_ + word), twos(twos_ + word);
            // The sum is ones.odd + 2 (ones.most + twos.odd) + 4 twos.most.
            const std::uint64_t two = ones.most ^ twos.odd, four = ones.most & twos.odd, other = twos.most;
            const std::uint64_t five = (four & other) | ((four | other) & (ones.odd | two));
            const std::int64_t left = frames_.width - 64 * word;
            const auto some = static_cast<__mmask64>(left >= 64 ? ~std::uint64_t{0} : (std::uint64_t{1} << left) - 1);
            _mm512_mask_storeu_epi8(out + 64 * word, some, _mm512_maskz_mov_epi8(five & has[word], one));
        }
    }

    // Repeats the first and the last column beyond the border.
    void extend(std::uint64_t* sums) const {
        const std::int64_t last = frames_.width - 1, beyond = frames_.width;
        sums[-1] = sums[0] << 63;
        sums[words_] = 0;
        sums[beyond / 64] |= (sums[last / 64] >> last % 64 & 1) << beyond % 64;
    }

    static std::uint64_t most(std::uint64_t a, std::uint64_t b, std::uint64_t c) { return (a & b) | (c & (a ^ b)); }

    // Sum of a bit and its two neighbours, as two bits.
    struct Three {
        std::uint64_t odd, most;
        explicit Three(const std::uint64_t* words) {
            const std::uint64_t left = words[0] << 1 | words[-1] >> 63, right = words[0] >> 1 | words[1] << 63;
            odd = left ^ words[0] ^ right;
            most = Bits::most(left, words[0], right);
        }
    };

    const Frames& frames_;
    const fingerflow_lit_frames& lit_;
    const float* const shares_;
    const std::int64_t words_, pitch_;
    std::uint64_t *const lines_, *const ones_, *const twos_;
};
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

// Writes some rows of all frames, each with its share. `size` is at most 15; `result` points to the whole batch;
// `memory` has real_contact_mask_memory bytes.
void real_contact_mask_rows(const fingerflow_lit_frames& lit, std::int64_t top, std::int64_t bottom, int size, const float* shares,
                            unsigned char* memory, unsigned char* result) {
    const Frames& frames = lit.frames;
#ifdef __AVX512BW__
    if (frames.kind == kUint8 && size == 3) return Bits(lit, shares, memory).rows(top, bottom, result);
#endif
    const std::int64_t pixels = frames.height * frames.width;
    for (std::int64_t frame = 0; frame < frames.batch; ++frame) {
        const float* const light = lit.light + (lit.lights == 1 ? 0 : frame) * pixels;
        const float* const black = lit.black + (lit.blacks == 1 ? 0 : frame) * pixels;
        const auto find = [&](const auto* data) {
            rows(data + frame * frames.frame_stride, frames, light, black, top, bottom, size, shares[frame], memory,
                 result + frame * pixels);
        };
        [&] { FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, find) }();
    }
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow

#if FINGERFLOW_ONCE

#include <algorithm>

#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
FINGERFLOW_OTHER_SETS(real_contact_mask_rows)
}  // namespace fingerflow

void fingerflow_real_contact_mask(const fingerflow_lit_frames* given, const float* limits, int size,
                                  unsigned char* real_contact_mask, int threads) {
    using namespace fingerflow;
    const Frames& frames = given->frames;
    if (frames.batch * frames.height * frames.width == 0) return;
    const std::int64_t shared = (frames.height + threads - 1) / threads;
    for_ranges(frames.height, std::min<std::int64_t>(std::max(64, 4 * size), shared), threads, [&](std::int64_t top, std::int64_t bottom) {
        auto* const memory = static_cast<unsigned char*>(workspace(real_contact_mask_memory(frames, size)));
        FINGERFLOW_PICK(real_contact_mask_rows)(*given, top, bottom, size, limits, memory, real_contact_mask);
    });
}

#endif
