// Points worth tracking in one frame (fingerflow/graphs/detect.py): local maxima of the smaller eigenvalue of the
// structure tensor, chosen by adaptive non-maximal suppression: those that are the strongest in the largest squares.
// A response must exceed quality * strongest and noise * (variance of the frame's noise). A corner's rank is the
// distance in px (Chebyshev) to the nearest stronger one less `beside`, plus response / strongest.
// Layout: responses and peaks of pieces of kRows rows in the thread's workspace (DetectPart); corners sorted by
// response in linked lists of cells of kCell px.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

#include "detect_rows.h"
#include "interface.h"
#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
namespace {

constexpr std::int64_t kRows = 32;  // of a piece

struct Maximum {
    float response;
    std::int32_t x, y;
};

std::size_t size(std::int64_t count) { return static_cast<std::size_t>(count); }

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
        fingerflow_mean_response(given_.frame, &response, 1, given_.height, given_.width, 0, given_.row_stride, static_cast<int>(given_.kind), threads);
        const auto deviation = static_cast<float>(kDeviationOfResponse * response);
        return deviation * deviation + (given_.kind == kFloat32 ? 0.0f : kRounding);
    }

    // Bounding box of the mask.
    static DetectPart bounds(const fingerflow_detection& given) {
        const Frames frame{given.frame, 1, given.height, given.width, 0, given.row_stride, static_cast<PixelKind>(given.kind)};
        DetectPart part{frame, given.mask, given.mask_row_stride, given.border, given.height, 0, given.width, 0};
        for (std::int64_t y = 0; y < given.height; ++y) {
            const unsigned char* const row = given.mask + y * given.mask_row_stride;
            const void* const any = std::memchr(row, 1, size(given.width));
            if (any == nullptr) continue;
            part.top = std::min(part.top, y);
            part.bottom = y + 1;
            std::int64_t last = given.width;
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
