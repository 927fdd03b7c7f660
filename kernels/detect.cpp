// build: each instruction set
// Points worth tracking in one frame (fingerflow/graphs/detect.py): local maxima of the smaller eigenvalue of the
// structure tensor, chosen by adaptive non-maximal suppression: those that are the strongest in the largest squares.
// A response must exceed quality * strongest and noise * (variance of the frame's noise). A corner's rank is the
// distance in px (Chebyshev) to the nearest stronger one less `beside`, plus response / strongest.
// Slopes: central differences, smoothed by [1 2 1] / 4 across them. Their products xx, xy, yy are averaged over 5 x 5
// px; the response is the smaller eigenvalue, (xx + yy) / 2 - sqrt(((xx - yy) / 2)^2 + xy^2), or 0 where that is not
// above 0. The order of the sums is that of the portable form: responses agree with it bit for bit.
// Layout: one pixel a lane; responses and peaks of pieces of kRows rows in the thread's workspace (DetectPart), responses
// with a border of zeros around the part, products in a ring of five rows; corners sorted by response in linked lists of
// cells of kCell px.
#include <math.h>
#include <cstring>

#include "instruction_sets.h"
#include "interface.h"
#include "lanes.h"
#include "pixels.h"

namespace fingerflow {

constexpr std::int64_t kTensorReach = 2;                 // px from the middle of the structure tensor's 5 x 5 square
constexpr std::int64_t kDetectReach = kTensorReach + 1;  // px from a response to the farthest pixel that it depends on

// Rows `top` to before `bottom` and columns `left` to before `right` of an image. Responses nearer than `edge` px to
// the frame's border are 0; `edge` is at least kDetectReach.
struct DetectPart {
    Frames frame;
    const unsigned char* mask;
    std::int64_t mask_row_stride, edge, top, bottom, left, right;
    // Responses have one more row above and below, and one more column to the left.
    std::int64_t rows() const { return bottom - top; }
    std::int64_t columns() const { return right - left; }
    std::int64_t stride() const { return columns() + 2 + 2 * kDetectReach; }
    std::int64_t response_floats() const { return (rows() + 2) * stride(); }
    std::int64_t floats() const { return response_floats() + (3 * (2 * kTensorReach + 1) + 3 + 3) * stride(); }
};

namespace FINGERFLOW_ISA {
namespace {

constexpr std::int64_t kSquare = 2 * kTensorReach + 1;

// The sum of five floats, `step` apart.
inline float sum_of_five(const float* first, std::int64_t step) {
    return first[0] + ((first[step] + first[2 * step]) + (first[3 * step] + first[4 * step]));
}

// Products xx, xy, yy of the slopes of a row, at columns from `first` on.
template <class Pixel>
void write_products(const Pixel* row, std::int64_t row_stride, std::int64_t first, std::int64_t count, float* memory, float* const (&to)[3]) {
    const Pixel* FINGERFLOW_RESTRICT const above = row - row_stride + first;
    const Pixel* FINGERFLOW_RESTRICT const here = row + first;
    const Pixel* FINGERFLOW_RESTRICT const below = row + row_stride + first;
    float* FINGERFLOW_RESTRICT const smooth = memory + 1;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = -1; x < count + 1; ++x)
        smooth[x] = (static_cast<float>(above[x]) + 2 * static_cast<float>(here[x]) + static_cast<float>(below[x])) / 4;
    float* FINGERFLOW_RESTRICT const xx = to[0];
    float* FINGERFLOW_RESTRICT const xy = to[1];
    float* FINGERFLOW_RESTRICT const yy = to[2];
    const auto smoothed = [](const Pixel* at) {
        return (static_cast<float>(at[-1]) + 2 * static_cast<float>(at[0]) + static_cast<float>(at[1])) / 4;
    };
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < count; ++x) {
        const float slope_x = (smooth[x + 1] - smooth[x - 1]) / 2, slope_y = (smoothed(below + x) - smoothed(above + x)) / 2;
        xx[x] = slope_x * slope_x;
        xy[x] = slope_x * slope_y;
        yy[x] = slope_y * slope_y;
    }
}

void respond(const float* const (&sums)[3], std::int64_t count, float* FINGERFLOW_RESTRICT to) {
    constexpr float kPixels = kSquare * kSquare;
    const float* FINGERFLOW_RESTRICT const sum_xx = sums[0];
    const float* FINGERFLOW_RESTRICT const sum_xy = sums[1];
    const float* FINGERFLOW_RESTRICT const sum_yy = sums[2];
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < count; ++x) {
        const float xx = sum_of_five(sum_xx + x, 1) / kPixels, xy = sum_of_five(sum_xy + x, 1) / kPixels;
        const float yy = sum_of_five(sum_yy + x, 1) / kPixels, half = (xx - yy) / 2;
        const float smaller = (xx + yy) / 2 - sqrtf(half * half + xy * xy);
        to[x] = smaller - smaller == 0 && smaller > 0 ? smaller : 0;
    }
}

template <class Pixel>
void write_responses(const DetectPart& part, const Pixel* pixels, float* memory) {
    const std::int64_t edge = part.edge, stride = part.stride();
    const auto from = [&](std::int64_t first) { return first - 1 > edge ? first - 1 : edge; };
    const auto to = [&](std::int64_t last, std::int64_t end) { return last + 1 < end - edge ? last + 1 : end - edge; };
    const std::int64_t top = from(part.top), bottom = to(part.bottom, part.frame.height);
    const std::int64_t left = from(part.left), right = to(part.right, part.frame.width);
    for (std::int64_t k = 0; k < part.response_floats(); ++k) memory[k] = 0;
    if (top >= bottom || left >= right) return;
    float* const lines = memory + part.response_floats();
    float* const sums[] = {lines, lines + stride, lines + 2 * stride};
    float* const smooth = lines + 3 * stride;
    float* const products = lines + 4 * stride;
    const std::int64_t first = left - kTensorReach, count = right - left + 2 * kTensorReach;
    const auto product = [&](std::int64_t row, int k) { return products + (3 * ((row + kSquare) % kSquare) + k) * stride; };
    const auto enter = [&](std::int64_t row) {
        float* const of_row[] = {product(row, 0), product(row, 1), product(row, 2)};
        write_products(pixels + row * part.frame.row_stride, part.frame.row_stride, first, count, smooth, of_row);
    };
    for (std::int64_t row = top - kTensorReach; row < top + kTensorReach; ++row) enter(row);
    for (std::int64_t y = top; y < bottom; ++y) {
        enter(y + kTensorReach);
        for (int k = 0; k < 3; ++k) {
            const float* FINGERFLOW_RESTRICT const a = product(y - 2, k);
            const float* FINGERFLOW_RESTRICT const b = product(y - 1, k);
            const float* FINGERFLOW_RESTRICT const c = product(y, k);
            const float* FINGERFLOW_RESTRICT const d = product(y + 1, k);
            const float* FINGERFLOW_RESTRICT const e = product(y + 2, k);
            float* FINGERFLOW_RESTRICT const sum = sums[k];
            FINGERFLOW_INDEPENDENT
            for (std::int64_t x = 0; x < count; ++x) sum[x] = a[x] + ((b[x] + c[x]) + (d[x] + e[x]));
        }
        const float* const of_columns[] = {sums[0], sums[1], sums[2]};
        respond(of_columns, right - left, memory + (y - part.top + 1) * stride + left - part.left + 1);
    }
}

}  // namespace

// Writes responses (rows + 2, stride) to `memory`, which has space for floats() floats, and to `peaks` (rows,
// columns) 1 where a pixel of the mask has a response above 0 and not below any neighbour's.
void detect_rows(const DetectPart& part, float* memory, unsigned char* peaks) {
    const auto write = [&](const auto* pixels) { write_responses(part, pixels, memory); };
    const auto all = [&] { FINGERFLOW_FOR_PIXEL(part.frame.kind, part.frame.data, write) };
    all();
    const std::int64_t stride = part.stride(), columns = part.columns();
    for (std::int64_t y = 0; y < part.rows(); ++y) {
        const float* FINGERFLOW_RESTRICT const here = memory + (y + 1) * stride + 1;
        const float* FINGERFLOW_RESTRICT const above = here - stride;
        const float* FINGERFLOW_RESTRICT const below = here + stride;
        const unsigned char* FINGERFLOW_RESTRICT const mask = part.mask + (part.top + y) * part.mask_row_stride + part.left;
        unsigned char* FINGERFLOW_RESTRICT const to = peaks + y * columns;
        const auto larger = [](float a, float b) { return a > b ? a : b; };
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = 0; x < columns; ++x) {
            const float before = larger(larger(above[x - 1], here[x - 1]), below[x - 1]);
            const float behind = larger(larger(above[x + 1], here[x + 1]), below[x + 1]);
            const float around = larger(larger(before, behind), larger(above[x], below[x]));
            to[x] = static_cast<unsigned char>((here[x] >= around) & (here[x] > 0) & (mask[x] != 0));
        }
    }
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
FINGERFLOW_OTHER_SETS(detect_rows)
namespace {

constexpr std::int64_t kRows = 32;  // of a piece

struct Maximum {
    float response;
    std::int32_t x, y;
};

// Strongest first; equal ones in reading order.
bool stronger(const Maximum& one, const Maximum& other) {
    if (one.response != other.response) return one.response > other.response;
    return one.y != other.y ? one.y < other.y : one.x < other.x;
}

class Detection {
public:
    explicit Detection(const fingerflow_detection& given) : given_(given), part_(bounds(given)) {}

    void run(int threads) {
        noise_ = given_.noise * variance(threads);
        std::vector<Maximum> corners = maxima(threads);
        std::sort(corners.begin(), corners.end(), stronger);
        std::vector<Ranked> ranked = rank(corners);
        const auto count = std::min(ranked.size(), size(given_.count));
        std::nth_element(ranked.begin(), ranked.begin() + static_cast<std::ptrdiff_t>(count), ranked.end(), [](const Ranked& one, const Ranked& other) {
            return one.rank != other.rank ? one.rank > other.rank : one.number < other.number;
        });
        std::sort(ranked.begin(), ranked.begin() + static_cast<std::ptrdiff_t>(count), [](const Ranked& one, const Ranked& other) { return one.number < other.number; });
        for (std::size_t k = 0; k < size(given_.count); ++k) {
            constexpr float unknown = std::numeric_limits<float>::quiet_NaN();
            const bool found = k < count;
            const Maximum corner = found ? corners[ranked[k].number] : Maximum{};
            given_.points[2 * k] = found ? static_cast<float>(corner.x) : unknown;
            given_.points[2 * k + 1] = found ? static_cast<float>(corner.y) : unknown;
            given_.responses[k] = found ? corner.response : unknown;
        }
    }

private:
    struct Ranked {
        float rank;
        std::size_t number;  // of a corner
    };

    // Variance of white noise (fingerflow/ops/filters/noise.py) and of rounding to integers; NaN where it is unknown.
    float variance(int threads) const {
        constexpr double kDeviationOfResponse = 0.20888568955258338;  // sqrt(pi / 2) / 6
        constexpr float kRounding = 1.0f / 12;
        double response = 0;
        fingerflow_mean_response(&given_.frame, &response, threads);
        const auto deviation = static_cast<float>(kDeviationOfResponse * response);
        return deviation * deviation + (given_.frame.kind == kFloat32 ? 0.0f : kRounding);
    }

    // Bounding box of the mask.
    static DetectPart bounds(const fingerflow_detection& given) {
        const std::int64_t height = given.frame.height, width = given.frame.width;
        DetectPart part{given.frame, given.mask, given.mask_row_stride, given.border, height, 0, width, 0};
        for (std::int64_t y = 0; y < height; ++y) {
            const unsigned char* const row = given.mask + y * given.mask_row_stride;
            const void* const any = std::memchr(row, 1, size(width));
            if (any == nullptr) continue;
            part.top = std::min(part.top, y);
            part.bottom = y + 1;
            std::int64_t last = width;
            while (row[last - 1] == 0) --last;
            part.left = std::min<std::int64_t>(part.left, static_cast<const unsigned char*>(any) - row);
            part.right = std::max(part.right, last);
        }
        return part;
    }

    // All local maxima above both limits, in reading order.
    std::vector<Maximum> maxima(int threads) const {
        const std::int64_t pieces = part_.bottom > part_.top ? (part_.rows() + kRows - 1) / kRows : 0;
        std::vector<std::vector<Maximum>> found(size(pieces));
        const auto detect = FINGERFLOW_PICK(detect_rows);
        parallel_for(pieces, threads, [&](std::int64_t piece) {
            DetectPart part = part_;
            part.top += piece * kRows;
            part.bottom = std::min(part_.bottom, part.top + kRows);
            const auto memory = static_cast<float*>(workspace(4 * size(part.floats()) + size(part.rows() * part.columns())));
            const auto peaks = reinterpret_cast<unsigned char*>(memory + part.floats());
            detect(part, memory, peaks);
            for (std::int64_t y = 0; y < part.rows(); ++y) {
                const unsigned char *const row = peaks + y * part.columns(), *const end = row + part.columns();
                for (const unsigned char* at = row; (at = static_cast<const unsigned char*>(std::memchr(at, 1, size(end - at)))) != nullptr; ++at) {
                    const std::int64_t x = at - row;
                    found[size(piece)].push_back({memory[(y + 1) * part.stride() + x + 1], static_cast<std::int32_t>(part.left + x), static_cast<std::int32_t>(part.top + y)});
                }
            }
        });
        float strongest = 0;
        for (const std::vector<Maximum>& some : found)
            for (const Maximum& one : some) strongest = std::max(strongest, one.response);
        const float of_strongest = given_.quality * strongest;
        std::vector<Maximum> result;
        for (const std::vector<Maximum>& some : found)
            for (const Maximum& one : some)
                if (one.response > of_strongest && one.response > noise_) result.push_back(one);
        return result;
    }

    // Ranks the corners, strongest first, that have no stronger one within `beside` px.
    std::vector<Ranked> rank(const std::vector<Maximum>& corners) const {
        const std::int64_t across = part_.columns() / kCell + 1, down = part_.bottom > part_.top ? part_.rows() / kCell + 1 : 0;
        std::vector<std::int32_t> first(size(corners.empty() ? 0 : across * down), -1), following(corners.size());
        const auto cell_of = [&](const Maximum& one) { return size((one.y - part_.top) / kCell * across + (one.x - part_.left) / kCell); };
        std::vector<Ranked> result;
        std::size_t known = 0;  // corners before this one are in the cells
        for (std::size_t k = 0; k < corners.size(); ++k) {
            const Maximum& here = corners[k];
            for (; corners[known].response > here.response; ++known) {
                const std::size_t cell = cell_of(corners[known]);
                following[known] = first[cell];
                first[cell] = static_cast<std::int32_t>(known);
            }
            const std::int64_t column = (here.x - part_.left) / kCell, row = (here.y - part_.top) / kCell;
            std::int64_t away = given_.farthest;  // px to the nearest stronger one
            const auto visit = [&](std::int64_t y, std::int64_t x) {
                for (std::int32_t other = first[size(y * across + x)]; other >= 0; other = following[size(other)]) {
                    const Maximum& there = corners[size(other)];
                    away = std::min<std::int64_t>(away, std::max(std::abs(there.x - here.x), std::abs(there.y - here.y)));
                }
            };
            // Ring after ring of cells: corners in ring n are more than (n - 1) kCell px away.
            for (std::int64_t ring = 0; (ring - 1) * kCell < away && away > given_.beside; ++ring) {
                const std::int64_t above = row - ring, below = row + ring, left = column - ring, right = column + ring;
                if (above < 0 && below >= down && left < 0 && right >= across) break;
                for (std::int64_t x = std::max<std::int64_t>(left, 0); x <= std::min(right, across - 1); ++x) {
                    if (above >= 0) visit(above, x);
                    if (below < down && ring > 0) visit(below, x);
                }
                for (std::int64_t y = std::max<std::int64_t>(above + 1, 0); y <= std::min(below - 1, down - 1); ++y) {
                    if (left >= 0) visit(y, left);
                    if (right < across) visit(y, right);
                }
            }
            if (away > given_.beside) result.push_back({static_cast<float>(away - given_.beside) + here.response / corners[0].response, k});
        }
        return result;
    }

    static constexpr std::int64_t kCell = 8;  // px
    const fingerflow_detection given_;
    const DetectPart part_;
    float noise_ = 0;
};

}  // namespace
}  // namespace fingerflow

void fingerflow_detect_points(const fingerflow_detection* given, int threads) { fingerflow::Detection(*given).run(threads); }

#endif
