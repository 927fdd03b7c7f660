// Moments of masks and the ellipses with the same second moments (fingerflow/ops/contact/ellipse.py).
// Semi-axes 2 sqrt(m + s) and 2 sqrt(m - s) with m = (xx + yy) / 2 and s = hypot((xx - yy) / 2, xy) of the central
// second moments; angle atan2(2 xy, xx - yy) / 2.
// Layout: masks are bytes, sums (batch, 6) int64 and exact, ellipses (batch, 6) doubles: x, y, major, minor, angle,
// area.
#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <vector>

#include "ellipse_rows.h"
#include "interface.h"
#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
namespace {

Moments operator+(const Moments& a, const Moments& b) {
    return {a.number + b.number, a.x + b.x, a.y + b.y, a.xx + b.xx, a.xy + b.xy, a.yy + b.yy};
}

std::vector<Moments> moments_of(const unsigned char* masks, std::int64_t batch, std::int64_t height, std::int64_t width,
                                std::int64_t frame_stride, std::int64_t row_stride, int threads) {
    const std::int64_t rows = std::max<std::int64_t>(64, (height * batch + threads - 1) / threads);
    const std::int64_t pieces = (height + rows - 1) / rows;
    std::vector<Moments> some(static_cast<std::size_t>(batch * pieces)), sums(static_cast<std::size_t>(batch), Moments{});
    const auto add = FINGERFLOW_PICK(moments_of_rows);
    parallel_for(batch * pieces, threads, [&](std::int64_t piece) {
        const std::int64_t frame = piece / pieces, top = piece % pieces * rows;
        const auto columns = static_cast<std::int32_t*>(workspace(static_cast<std::size_t>(4 * width)));
        some[static_cast<std::size_t>(piece)] =
            add(masks + frame * frame_stride, width, row_stride, top, std::min(height, top + rows), columns);
    });
    for (std::int64_t piece = 0; piece < batch * pieces; ++piece) {
        Moments& sum = sums[static_cast<std::size_t>(piece / pieces)];
        sum = sum + some[static_cast<std::size_t>(piece)];
    }
    return sums;
}

}  // namespace
}  // namespace fingerflow

void fingerflow_mask_moments(const unsigned char* masks, std::int64_t* moments, std::int64_t batch, std::int64_t height,
                             std::int64_t width, std::int64_t frame_stride, std::int64_t row_stride, int threads) {
    for (const fingerflow::Moments& m : fingerflow::moments_of(masks, batch, height, width, frame_stride, row_stride, threads))
        for (const std::int64_t sum : {m.number, m.x, m.y, m.xx, m.xy, m.yy}) *moments++ = sum;
}

void fingerflow_fit_ellipse(const unsigned char* masks, double* ellipses, std::int64_t batch, std::int64_t height,
                            std::int64_t width, std::int64_t frame_stride, std::int64_t row_stride, int threads) {
    for (const fingerflow::Moments& m : fingerflow::moments_of(masks, batch, height, width, frame_stride, row_stride, threads)) {
        // Moments about the pixel nearest to the centre, in integers, so that none of their digits cancel.
        const auto area = static_cast<double>(m.number);
        const double center_x = static_cast<double>(m.x) / area, center_y = static_cast<double>(m.y) / area;
        const std::int64_t near_x = m.number == 0 ? 0 : std::llrint(center_x), near_y = m.number == 0 ? 0 : std::llrint(center_y);
        const double dx = static_cast<double>(m.x - m.number * near_x) / area;
        const double dy = static_cast<double>(m.y - m.number * near_y) / area;
        const double xx = static_cast<double>(m.xx - near_x * (2 * m.x - m.number * near_x)) / area - dx * dx;
        const double yy = static_cast<double>(m.yy - near_y * (2 * m.y - m.number * near_y)) / area - dy * dy;
        const double xy = static_cast<double>(m.xy - near_x * m.y - near_y * (m.x - m.number * near_x)) / area - dx * dy;
        const double middle = (xx + yy) / 2, spread = std::hypot((xx - yy) / 2, xy);
        const double minor = middle - spread;
        const double angle = std::atan2(2 * xy, xx - yy) / 2;
        for (const double number : {center_x, center_y, 2 * std::sqrt(middle + spread), 2 * std::sqrt(minor < 0 ? 0 : minor), angle, area})
            *ellipses++ = number;
    }
}
