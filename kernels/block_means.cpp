// Means of subsampled frames over blocks and over lines (fingerflow/tracker/block_means.py).
// One pixel of `along` of every `down`-th line is read, beginning at along / 2 and down / 2. These samples are divided
// into rows x columns blocks that cover all of them; neighbouring blocks share samples where counts do not divide. Samples
// of every `every`-th line that is read are returned, too.
// For `strip_differences` lines are read in strips of 18, of which the first begin at multiples of 16, and of each line some
// 20 pixels, along rows and along columns.
// Layout: results are contiguous, blocks (batch, rows, columns), lines (batch, lines read), pixels (batch, lines, samples). Sums of integer pixels
// are exact, those of floats are doubles.
#include <algorithm>
#include <cfloat>
#include <cmath>
#include <numeric>
#include <type_traits>
#include <vector>

#include "interface.h"
#include "parallel.h"
#include "pixels.h"
#include "prefetch.h"

namespace fingerflow {
namespace {

// A range of samples.
struct Piece {
    std::int64_t first, end;
    std::int64_t size() const { return end - first; }
};

// Divides `count` samples into `pieces` ranges that cover them all; neighbours share one where counts do not divide.
std::vector<Piece> cut(std::int64_t count, std::int64_t pieces) {
    std::vector<Piece> result;
    for (std::int64_t piece = 0; piece < pieces; ++piece)
        result.push_back({piece * count / pieces, ((piece + 1) * count + pieces - 1) / pieces});
    return result;
}

struct Sampled {
    std::int64_t read, across, row_stride, down, along, every;
    std::vector<Piece> rows, columns;
};

// Reads one pixel of `along` of a row. The usual step 4 has its own loop, which the compiler vectorizes.
template <class Pixel, class Number>
void read_line(const Pixel* row, std::int64_t along, std::vector<Number>& to) {
    const auto count = static_cast<std::int64_t>(to.size());
    Number* const numbers = to.data();
    if (along == 4)
        for (std::int64_t x = 0; x < count; ++x) numbers[x] = row[x * 4];
    else
        for (std::int64_t x = 0; x < count; ++x) numbers[x] = row[x * along];
}

template <class Pixel>
void means_of(const Pixel* frame, const Sampled& given, float* blocks, float* lines, float* pixels) {
    constexpr bool whole = std::is_integral_v<Pixel>;
    using Sum = std::conditional_t<whole, std::int64_t, double>;
    // A line has a few hundred samples: 32 bits hold a sum of 16-bit values.
    using Number = std::conditional_t<whole && sizeof(Pixel) <= 2, std::uint32_t, Sum>;
    const auto mean = [](Sum sum, std::int64_t count) {
        return static_cast<float>(static_cast<double>(sum) / static_cast<double>(count));
    };
    std::vector<Number> numbers(size(given.across)), sums;
    sums.reserve(size(given.read) * given.columns.size());
    for (std::int64_t line = 0; line < given.read; ++line) {
        const Pixel* const row = frame + (given.down / 2 + line * given.down) * given.row_stride + given.along / 2;
        // Hardware does not prefetch lines so far apart.
        const auto* const next = reinterpret_cast<const char*>(row + (line + 1 < given.read ? given.down * given.row_stride : 0));
        for (std::int64_t byte = 0; byte < given.across * given.along * static_cast<std::int64_t>(sizeof(Pixel)); byte += 64)
            FINGERFLOW_PREFETCH(next + byte);
        read_line(row, given.along, numbers);
        if (line % given.every == given.every / 2)
            pixels = std::transform(numbers.begin(), numbers.end(), pixels, [](Number number) { return static_cast<float>(number); });
        lines[line] = mean(std::accumulate(numbers.begin(), numbers.end(), Number(0)), given.across);
        for (const Piece& piece : given.columns)
            sums.push_back(std::accumulate(numbers.begin() + piece.first, numbers.begin() + piece.end, Number(0)));
    }
    const std::size_t columns = given.columns.size();
    for (const Piece& piece : given.rows)
        for (std::size_t column = 0; column < columns; ++column) {
            Sum sum = 0;
            for (std::int64_t line = piece.first; line < piece.end; ++line)
                sum += sums[size(line) * columns + column];
            *blocks++ = mean(sum, piece.size() * given.columns[column].size());
        }
}

constexpr std::int64_t kPeriod = 16, kStrip = kPeriod + 2;

// Pixels that are not finite count as 0, like those of `_strips`.
template <class Pixel>
float pixel_value(Pixel pixel) {
    if constexpr (std::is_floating_point_v<Pixel>) return std::isfinite(pixel) ? static_cast<float>(pixel) : 0.0f;
    return static_cast<float>(pixel);
}

// Mean squared differences (kPeriod) of pixels `apart` lines apart, at the places of strips of lines.
template <class Pixel>
void differences_across(const Pixel* frame, std::int64_t lines, std::int64_t pixels, std::int64_t line_stride, std::int64_t pixel_stride,
                        std::int64_t apart, float* squares) {
    const std::int64_t step = std::max<std::int64_t>(1, pixels / 20), read = (pixels + step - 1) / step;
    const std::int64_t between = kPeriod * (lines / (8 * kPeriod) | 1), last = std::max<std::int64_t>(lines - kPeriod - 1, 1);
    const std::int64_t strips = (last + between - 1) / between;
    std::vector<float> values(size(strips * kStrip * read));
    float* to = values.data();
    double sum = 0;
    for (std::int64_t line = 0; line < strips * kStrip; ++line) {
        const Pixel* const from = frame + (line / kStrip * between + line % kStrip) % lines * line_stride;
        for (std::int64_t k = 0; k < read; ++k) sum += *to++ = pixel_value(from[k * step * pixel_stride]);
    }
    const float mean = std::max(static_cast<float>(sum / static_cast<double>(values.size())), FLT_MIN);
    for (float& value : values) value = std::min(std::max(value / mean, 0.5f), 1.5f);
    for (std::int64_t place = 0; place < kPeriod; ++place) {
        float total = 0, most = 0;
        for (std::int64_t strip = 0; strip < strips; ++strip) {
            const float* const one = values.data() + (strip * kStrip + place) * read;
            float square = 0;
            for (std::int64_t k = 0; k < read; ++k) square += (one[apart * read + k] - one[k]) * (one[apart * read + k] - one[k]);
            square /= static_cast<float>(read);
            total += square;
            most = std::max(most, square);
        }
        squares[place] = (total - most) / static_cast<float>(std::max<std::int64_t>(strips - 1, 1));
    }
}

}  // namespace
}  // namespace fingerflow

// Mean squared differences of neighbouring pixels of frames along lines, then across them, as
void fingerflow_strip_differences(const fingerflow_frames* frames /* 1 x 1 */, std::int64_t apart /* from 1 to 2 */, float* squares /* (batch, 32) */,
    int threads) {
    using namespace fingerflow;
    parallel_for(frames->batch, threads, [&](std::int64_t frame) {
        const auto find = [&](const auto* data) {
            data += frame * frames->frame_stride;
            differences_across(data, frames->width, frames->height, 1, frames->row_stride, apart, squares + 2 * kPeriod * frame);
            differences_across(data, frames->height, frames->width, frames->row_stride, 1, apart, squares + 2 * kPeriod * frame + kPeriod);
        };
        FINGERFLOW_FOR_PIXEL(frames->kind, frames->data, find)
    });
}

// Means of frames over blocks, and over lines (batch, lines that are read), and pixels of some of these lines, as
void fingerflow_block_means(const fingerflow_frames* frames, std::int64_t down /* from 1 */, std::int64_t along /* from 1 */, std::int64_t rows,
    std::int64_t columns, std::int64_t every /* from 1 */, float* blocks /* (batch, rows, columns) */,
    float* lines /* (batch, (height - down / 2 + down - 1) / down) */,
    float* pixels /* (batch, ((height - down / 2 + down - 1) / down - every / 2 + every - 1) / every, (width - along / 2 + along - 1) / along) */, int threads) {
    using namespace fingerflow;
    const auto read = [](std::int64_t side, std::int64_t step) { return (side - step / 2 + step - 1) / step; };
    const std::int64_t lines_read = read(frames->height, down), across = read(frames->width, along), kept = read(lines_read, every);
    const Sampled given{lines_read, across, frames->row_stride, down, along, every, cut(lines_read, rows), cut(across, columns)};
    parallel_for(frames->batch, threads, [&](std::int64_t frame) {
        const auto find = [&](const auto* data) {
            means_of(data + frame * frames->frame_stride, given, blocks + frame * rows * columns, lines + frame * given.read, pixels + frame * kept * across);
        };
        FINGERFLOW_FOR_PIXEL(frames->kind, frames->data, find)
    });
}
