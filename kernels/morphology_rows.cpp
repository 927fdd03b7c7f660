// build: each instruction set
// Dilation of some rows of a mask: each line is widened pixel by pixel, and each width is ORed into the lines that the
// element's row of that half width reaches.
// Layout: one pixel a lane, bytes of 0 or 1; a ring of 2 radius + 1 result lines, then two lines with background at
// both ends.
#include "morphology_rows.h"

#include <string.h>

#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {

void dilate_rows(const Frames& masks, std::int64_t frame, std::int64_t top, std::int64_t bottom, const Element& element,
                 unsigned char* lines, unsigned char* result) {
    const std::int64_t width = masks.width, radius = element.radius, count = 2 * radius + 1, pitch = width + 2 * radius;
    const auto* const mask = static_cast<const unsigned char*>(masks.data) + frame * masks.frame_stride;
    result += frame * masks.height * width;
    const auto invert = static_cast<unsigned char>(element.of_background);
    unsigned char* widened = lines + count * pitch;
    unsigned char* wider = widened + pitch;
    const auto sum_of = [&](std::int64_t y) { return lines + (y - top + count) % count * pitch; };

    for (std::int64_t y = top - radius; y < bottom + radius; ++y) {
        memset(sum_of(y + radius), 0, static_cast<std::size_t>(width));
        if (y >= 0 && y < masks.height) {
            // The line of the mask with background at both ends.
            const unsigned char* FINGERFLOW_RESTRICT row = mask + y * masks.row_stride;
            memset(widened, 0, static_cast<std::size_t>(pitch));
            for (std::int64_t x = 0; x < width; ++x) widened[radius + x] = static_cast<unsigned char>((row[x] != 0) ^ invert);
            std::int64_t reached = 0;
            for (std::int64_t dy = radius; dy >= 0; --dy) {  // rows of an element grow towards its middle
                const std::int64_t wanted = element.half_widths[radius - dy];
                for (; reached < wanted; ++reached) {
                    unsigned char* FINGERFLOW_RESTRICT to = wider;
                    const unsigned char* FINGERFLOW_RESTRICT from = widened;
                    to[0] = from[0];
                    to[pitch - 1] = from[pitch - 1];
                    to[0] |= from[1];
                    to[pitch - 1] |= from[pitch - 2];
                    for (std::int64_t x = 1; x < pitch - 1; ++x) to[x] = static_cast<unsigned char>(from[x - 1] | from[x] | from[x + 1]);
                    unsigned char* const swapped = widened;
                    widened = wider;
                    wider = swapped;
                }
                for (int side = 0; side < (dy == 0 ? 1 : 2); ++side) {
                    const std::int64_t at = side == 0 ? y + dy : y - dy;
                    if (at < top || at >= bottom) continue;
                    unsigned char* FINGERFLOW_RESTRICT sum = sum_of(at);
                    const unsigned char* FINGERFLOW_RESTRICT from = widened + radius;
                    for (std::int64_t x = 0; x < width; ++x) sum[x] = static_cast<unsigned char>(sum[x] | from[x]);
                }
            }
        }
        const std::int64_t done = y - radius;
        if (done < top) continue;
        const unsigned char* FINGERFLOW_RESTRICT sum = sum_of(done);
        unsigned char* FINGERFLOW_RESTRICT out = result + done * width;
        for (std::int64_t x = 0; x < width; ++x) out[x] = static_cast<unsigned char>(sum[x] ^ invert);
    }
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
