// Connected components of masks: filled holes and the largest component (fingerflow/ops/contact/components.py).
// Runs of equal pixels of each row are joined to touching runs of the row above by union-find: parts of the mask touch
// across corners (8-connected), the background does not (4-connected).
// Layout: masks are bytes, row-major, 0 for background; a Run holds a row and its first and last column, and runs lie
// in reading order. The root of a component is its first run.
#include "components.h"

#include <algorithm>
#include <cstring>
#include <vector>

#include "interface.h"
#include "parallel.h"

namespace fingerflow {
namespace {

struct Run {
    std::int64_t row, first, last;  // pixels of the row
    std::size_t above;              // parent in the union-find tree; a root is its own parent
};

// The first column from x on whose pixel is set (or clear, by `set`); `width` if there is none.
std::int64_t next(const unsigned char* row, std::int64_t x, std::int64_t width, bool set) {
    const std::uint64_t others = set ? 0 : 0x0101010101010101;  // eight pixels to skip
    for (std::uint64_t eight; x + 8 <= width; x += 8) {
        std::memcpy(&eight, row + x, sizeof eight);
        if (eight != others) break;
    }
    while (x < width && (row[x] != 0) != set) ++x;
    return x;
}

std::size_t root_of(std::vector<Run>& runs, std::size_t run) {
    while (runs[run].above != run) {
        runs[run].above = runs[runs[run].above].above;
        run = runs[run].above;
    }
    return run;
}

void join(std::vector<Run>& runs, std::size_t one, std::size_t other) {
    one = root_of(runs, one);
    other = root_of(runs, other);
    runs[std::max(one, other)].above = std::min(one, other);
}

// Runs of set (or clear) pixels in reading order, joined to runs of the row above up to `reach` px to the side.
std::vector<Run> joined_runs(const unsigned char* mask, std::int64_t height, std::int64_t width, std::int64_t row_stride,
                             bool set, std::int64_t reach) {
    std::vector<Run> runs;
    std::size_t upper = 0;  // the first run of the row above that may touch the next one
    for (std::int64_t y = 0; y < height; ++y) {
        const unsigned char* const row = mask + y * row_stride;
        const std::size_t begin = runs.size();
        for (std::int64_t x = next(row, 0, width, set); x < width; x = next(row, x, width, set)) {
            const std::int64_t end = next(row, x, width, !set);
            const std::size_t run = runs.size();
            runs.push_back({y, x, end - 1, run});
            while (upper < begin && runs[upper].last + reach < x) ++upper;
            for (std::size_t above = upper; above < begin && runs[above].first < end + reach; ++above) join(runs, above, run);
            x = end;
        }
        upper = begin;
    }
    return runs;
}

void paint(unsigned char* row, const Run& run, unsigned char value) { std::fill(row + run.first, row + run.last + 1, value); }

// A copy of each mask, changed by `change`.
template <class Change>
void changed(const unsigned char* masks, unsigned char* results, std::int64_t batch, std::int64_t height,
             std::int64_t width, std::int64_t frame_stride, std::int64_t row_stride, int threads, Change change) {
    parallel_for(batch, threads, [&](std::int64_t frame) {
        unsigned char* const result = results + frame * height * width;
        for (std::int64_t y = 0; y < height; ++y)
            std::copy_n(masks + frame * frame_stride + y * row_stride, width, result + y * width);
        change(result, height, width, width);
    });
}

}  // namespace

void fill_holes(unsigned char* mask, std::int64_t height, std::int64_t width, std::int64_t row_stride) {
    std::vector<Run> runs = joined_runs(mask, height, width, row_stride, false, 0);
    std::vector<bool> outside(runs.size());
    for (std::size_t k = 0; k < runs.size(); ++k) {
        const Run& run = runs[k];
        if (run.row == 0 || run.row == height - 1 || run.first == 0 || run.last == width - 1) outside[root_of(runs, k)] = true;
    }
    for (std::size_t k = 0; k < runs.size(); ++k)
        if (!outside[root_of(runs, k)])
            paint(mask + runs[k].row * row_stride, runs[k], 1);
}

void keep_largest(unsigned char* mask, std::int64_t height, std::int64_t width, std::int64_t row_stride) {
    std::vector<Run> runs = joined_runs(mask, height, width, row_stride, true, 1);
    if (runs.empty()) return;
    std::vector<std::int64_t> area(runs.size());
    for (std::size_t k = 0; k < runs.size(); ++k) area[root_of(runs, k)] += runs[k].last - runs[k].first + 1;
    const auto largest = static_cast<std::size_t>(std::max_element(area.begin(), area.end()) - area.begin());
    for (std::size_t k = 0; k < runs.size(); ++k)
        if (root_of(runs, k) != largest)
            paint(mask + runs[k].row * row_stride, runs[k], 0);
}

}  // namespace fingerflow

void fingerflow_fill_holes(const unsigned char* masks, unsigned char* filled, std::int64_t batch, std::int64_t height,
                           std::int64_t width, std::int64_t frame_stride, std::int64_t row_stride, int threads) {
    return fingerflow::changed(masks, filled, batch, height, width, frame_stride, row_stride, threads, fingerflow::fill_holes);
}

void fingerflow_largest_component(const unsigned char* masks, unsigned char* largest, std::int64_t batch, std::int64_t height,
                                  std::int64_t width, std::int64_t frame_stride, std::int64_t row_stride, int threads) {
    return fingerflow::changed(masks, largest, batch, height, width, frame_stride, row_stride, threads, fingerflow::keep_largest);
}
