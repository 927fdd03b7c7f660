// Medians over ellipses of the current picture: places in an ellipse, led back to where they come from, fields there.
#include <algorithm>
#include <cmath>
#include <exception>
#include <limits>
#include <vector>

#include "area_medians_block.h"
#include "interface.h"
#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
namespace {

std::size_t size(std::int64_t count) { return static_cast<std::size_t>(count); }

// For each of a row whether it is known (1), the number of the nearest known one, the first of two; -1 if none is.
void nearest_known(const unsigned char* known, std::int32_t count, std::int32_t* nearest) {
    std::int32_t last = -1;
    for (std::int32_t k = 0; k < count; ++k) {
        if (known[k]) last = k;
        nearest[k] = last;
    }
    std::int32_t next = -1;
    for (std::int32_t k = count - 1; k >= 0; --k) {
        if (known[k]) next = k;
        if (nearest[k] < 0 || (next >= 0 && next - k < k - nearest[k])) nearest[k] = next;
    }
}

// The median of numbers, at least one: of those in the bin of many that holds it.
double median(const double* numbers, std::int64_t count) {
    constexpr int kBins = 512;
    const auto [least, greatest] = std::minmax_element(numbers, numbers + count);
    const double low = *least, scale = kBins / (*greatest - low);
    // Not more than the last bin's number, also where rounding or a range of nothing says so.
    const auto bin = [=](double number) {
        const double place = (number - low) * scale;
        return place < kBins ? static_cast<int>(place) : kBins - 1;
    };
    std::int64_t counts[kBins] = {};
    for (std::int64_t k = 0; k < count; ++k) ++counts[bin(numbers[k])];
    const auto of_rank = [&](std::int64_t rank) {
        int of = 0;
        for (; rank >= counts[of]; ++of) rank -= counts[of];
        std::vector<double> there;
        there.reserve(size(counts[of]));
        for (std::int64_t k = 0; k < count; ++k)
            if (bin(numbers[k]) == of) there.push_back(numbers[k]);
        std::nth_element(there.begin(), there.begin() + rank, there.end());
        return there[size(rank)];
    };
    const double upper = of_rank(count / 2);
    return count % 2 == 1 ? upper : (of_rank(count / 2 - 1) + upper) / 2;
}

class Frame {
public:
    Frame(const fingerflow_area_medians& given, std::int64_t number)
        : given_(given),
          fields_(given.fields + number * given.field_count * nodes()),
          displacement_(given.displacement + 2 * number * nodes()),
          ellipse_(given.ellipses + 7 * number),
          medians_(given.medians + number * given.field_count) {}

    void run() {
        std::fill_n(medians_, given_.field_count, std::numeric_limits<double>::quiet_NaN());
        if (!std::all_of(ellipse_, ellipse_ + 7, [](double number) { return std::isfinite(number); })) return;
        room_ = static_cast<std::int64_t>(ellipse_[6]) + 2;  // as many if it is odd, and one is written behind the last
        leading_ = static_cast<double*>(workspace(sizeof(double) * size(2 * nodes() + given_.field_count * room_)));
        values_ = leading_ + 2 * nodes();
        if (!extend()) return;
        counts_.assign(size(given_.field_count), 0);
        read();
        for (std::int64_t field = 0; field < given_.field_count; ++field) {
            const std::int64_t count = counts_[size(field)];
            if (count > 0 && static_cast<double>(count) >= given_.least_share * static_cast<double>(places_))
                medians_[field] = median(values_ + field * room_, count);
        }
    }

private:
    std::int64_t nodes() const { return given_.rows * given_.columns; }

    // Fills leading_ with the displacement in steps of the grid, from the nearest known node where it is not known.
    bool extend() {
        const auto rows = static_cast<std::int32_t>(given_.rows), columns = static_cast<std::int32_t>(given_.columns);
        const float *const x = displacement_, *const y = x + nodes();
        std::vector<unsigned char> known(size(nodes())), in_row(size(rows));
        double sum_x = 0, sum_y = 0;
        std::int64_t count = 0;
        for (std::int64_t row = 0, k = 0; row < rows; ++row) {
            for (std::int64_t column = 0; column < columns; ++column, ++k) {
                const bool here = std::isfinite(x[k]) && std::isfinite(y[k]);
                known[size(k)] = here;
                in_row[size(row)] |= here;
                sum_x += here ? x[k] / given_.step : 0;
                sum_y += here ? y[k] / given_.step : 0;
                count += here;
            }
        }
        if (count == 0) return false;
        mean_x_ = sum_x / static_cast<double>(count);
        mean_y_ = sum_y / static_cast<double>(count);
        std::vector<std::int32_t> nearest_row(size(rows)), nearest(size(columns));
        nearest_known(in_row.data(), rows, nearest_row.data());
        for (std::int64_t row = 0; row < rows; ++row) {
            const std::int64_t from = std::int64_t{nearest_row[size(row)]} * columns, to = row * columns;
            nearest_known(known.data() + from, columns, nearest.data());
            for (std::int32_t column = 0; column < columns; ++column) {
                const std::int64_t node = from + nearest[size(column)];
                leading_[to + column] = x[node] / given_.step;
                leading_[nodes() + to + column] = y[node] / given_.step;
            }
        }
        return true;
    }

    // Values of the fields at all places of the ellipse where they are known.
    void read() {
        const LeadingGrid grid{leading_,
                               leading_ + nodes(),
                               static_cast<std::int32_t>(given_.rows),
                               static_cast<std::int32_t>(given_.columns),
                               mean_x_,
                               mean_y_,
                               static_cast<int>(given_.newton_steps),
                               given_.settled,
                               given_.least_ratio};
        const double center_x = ellipse_[0], center_y = ellipse_[1], major = ellipse_[2], minor = ellipse_[3];
        const double cosine = ellipse_[4], sine = ellipse_[5], half = std::floor(ellipse_[6] / 2);
        Places some;
        int filled = 0;
        for (double number = -half; number <= half; ++number) {
            const double right = number / (half + 0.5), turns = number * given_.turn;
            const double down = 2 * (turns - std::floor(turns + 0.5));
            if (right * right + down * down > 1) continue;
            const double along = right * major, across = down * minor;
            some.wanted_x[filled] = (center_x + (along * cosine - across * sine) - given_.origin_x) / given_.step;
            some.wanted_y[filled] = (center_y + (along * sine + across * cosine) - given_.origin_y) / given_.step;
            if (++filled < kPlaces) continue;
            read(grid, some, filled);
            filled = 0;
        }
        if (filled == 0) return;
        for (int q = filled; q < kPlaces; ++q) {
            some.wanted_x[q] = some.wanted_x[0];
            some.wanted_y[q] = some.wanted_y[0];
        }
        read(grid, some, filled);
    }

    void read(const LeadingGrid& grid, Places& some, int filled) {
        FINGERFLOW_PICK(lead_back)(grid, some);
        places_ += filled;
        for (std::int64_t field = 0; field < given_.field_count; ++field) {
            double here[kPlaces];
            FINGERFLOW_PICK(read_field)(grid, fields_ + field * nodes(), some, here);
            double* const values = values_ + field * room_;
            std::int64_t count = counts_[size(field)];
            for (int q = 0; q < filled; ++q) {
                values[count] = here[q];
                count += (some.found[q] != 0) & std::isfinite(here[q]);
            }
            counts_[size(field)] = count;
        }
    }

    const fingerflow_area_medians& given_;
    const float *const fields_, *const displacement_;
    const double* const ellipse_;
    double* const medians_;
    std::int64_t room_ = 0;
    double *leading_ = nullptr, *values_ = nullptr;
    double mean_x_ = 0, mean_y_ = 0;
    std::vector<std::int64_t> counts_;
    std::int64_t places_ = 0;
};

}  // namespace
}  // namespace fingerflow

int fingerflow_medians_over_area(const fingerflow_area_medians* given, int threads) try {
    fingerflow::parallel_for(given->batch, threads, [&](std::int64_t frame) { fingerflow::Frame(*given, frame).run(); });
    return 0;
} catch (const std::exception&) {
    return 1;
}
