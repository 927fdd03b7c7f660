// Columns of a window counted by adding the line below it and taking off the one above; a byte holds 15 x 15.
#include "median_above_rows.h"

#include <math.h>
#include <string.h>

#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

// The largest number of the pixels' type that is not above the threshold; any pixel is above it or not as it is above
// the threshold itself.
struct Limit {
    float real;
    std::int32_t whole;
    explicit Limit(double threshold) {
        // A NaN is exceeded nowhere.
        real = threshold == threshold ? static_cast<float>(threshold) : HUGE_VALF;
        if (static_cast<double>(real) > threshold) real = nextafterf(real, -HUGE_VALF);
        const double below = floor(threshold);
        whole = !(below < 2147483647.0) ? 2147483647 : below < -2147483648.0 ? -2147483647 - 1 : static_cast<std::int32_t>(below);
    }
    bool exceeded_by(float value) const { return value > real; }
    bool exceeded_by(std::int32_t value) const { return value > whole; }
};

template <class Pixel>
void above_line(const Pixel* FINGERFLOW_RESTRICT row, std::int64_t width, int half, const Limit& limit,
                unsigned char* FINGERFLOW_RESTRICT line) {
    const Limit own = limit;
    for (std::int64_t x = 0; x < width; ++x) line[half + x] = own.exceeded_by(row[x]);
    memset(line, line[half], static_cast<std::size_t>(half));
    memset(line + half + width, line[half + width - 1], static_cast<std::size_t>(half));
}

template <class Pixel>
void rows(const Pixel* frame, const Frames& frames, std::int64_t top, std::int64_t bottom, int size, const Limit& limit,
          unsigned char* lines, unsigned char* result) {
    const std::int64_t width = frames.width, pitch = width + size + 64;
    const int half = size / 2;
    unsigned char* FINGERFLOW_RESTRICT columns = lines + size * pitch;
    unsigned char* FINGERFLOW_RESTRICT sums = columns + pitch;
    const std::int64_t padded = width + 2 * half;
    memset(columns, 0, static_cast<std::size_t>(pitch));
    for (std::int64_t y = top - half; y < bottom + half; ++y) {
        unsigned char* FINGERFLOW_RESTRICT line = lines + (y - top + half) % size * pitch;
        const bool full = y >= top + half + 1;
        if (full)
            for (std::int64_t x = 0; x < padded; ++x) columns[x] = static_cast<unsigned char>(columns[x] - line[x]);
        const std::int64_t inside = y < 0 ? 0 : y >= frames.height ? frames.height - 1 : y;
        above_line(frame + inside * frames.row_stride, width, half, limit, line);
        for (std::int64_t x = 0; x < padded; ++x) columns[x] = static_cast<unsigned char>(columns[x] + line[x]);
        if (y < top + half) continue;
        memcpy(sums, columns, static_cast<std::size_t>(width));
        for (int k = 1; k < size; ++k)
            for (std::int64_t x = 0; x < width; ++x) sums[x] = static_cast<unsigned char>(sums[x] + columns[x + k]);
        unsigned char* FINGERFLOW_RESTRICT out = result + (y - half) * width;
        const auto most = static_cast<unsigned char>(size * size / 2);
        for (std::int64_t x = 0; x < width; ++x) out[x] = sums[x] > most;
    }
}

}  // namespace

void median_above_rows(const Frames& frames, std::int64_t frame, std::int64_t top, std::int64_t bottom, int size,
                       double threshold, unsigned char* lines, unsigned char* result) {
    const Limit limit(threshold);
    const auto count = [&](const auto* data) {
        rows(data + frame * frames.frame_stride, frames, top, bottom, size, limit, lines,
             result + frame * frames.height * frames.width);
    };
    FINGERFLOW_FOR_PIXEL(frames.kind, frames.data, count)
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
