// Fields at points in frames, and their medians over the contact, in one call: local fits, the fields and their deviations,
// sharpened displacements, medians over the area (fingerflow/graphs/fields_graph.py has the equations).
// Layout: gradients are ux, uy, vx, vy of a point, their covariances 4 x 4; points apart are left out of the fits.
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "interface.h"
#include "parallel.h"
#include "strain.h"

namespace fingerflow {
namespace {

constexpr float kUnknown = std::numeric_limits<float>::quiet_NaN();

struct Buffers {
    explicit Buffers(const fingerflow_frame_fields& given)
        : total(size(given.batch * given.point_count)), rest(2 * total), value(2 * total), gradient(4 * total), offset(total),
          ellipses(size(6 * given.batch)), counts(total) {
        if (given.covariance != nullptr) spread.resize(16 * total), noise.resize(4 * total);
        if (given.apart != nullptr) fields.resize(5 * total), deviations.resize(given.covariance == nullptr ? 0 : 5 * total);
    }

    std::size_t total;
    std::vector<float> rest, value, gradient, offset, ellipses, spread, noise, fields, deviations;
    std::vector<std::int64_t> counts;
};

bool all_finite(const float* numbers, int count) {
    return std::all_of(numbers, numbers + count, [](float number) { return std::isfinite(number); });
}

// Divergence, curl, exx, eyy and exy of a gradient g, and, with its covariance, the standard deviations of the first `count`.
void derive(std::int64_t measure, const float* g, const float* covariance, float* fields, float* deviations, int count) {
    const float ux = g[0], uy = g[1], vx = g[2], vy = g[3];
    const float squared = squared_factor(measure), mixed = mixed_factor(measure);
    const auto strain = FINGERFLOW_ISA::strain_of(squared, mixed, ux, uy, vx, vy);
    fields[0] = ux + vy;
    fields[1] = vx - uy;
    fields[2] = strain.xx, fields[3] = strain.yy, fields[4] = strain.xy;
    if (covariance == nullptr) return;
    const float direct = 2 * squared, both = 2 * mixed;  // 1 where products of gradients count
    const float by_gradient[5][4] = {{1, 0, 0, 1},
                                     {0, -1, 1, 0},
                                     {1 + direct * ux, 0, direct * vx, 0},
                                     {0, direct * uy, 0, 1 + direct * vy},
                                     {both * uy / 2, (1 + both * ux) / 2, (1 + both * vy) / 2, both * vx / 2}};
    for (int field = 0; field < count; ++field) {
        const float* const s = by_gradient[field];
        float variance = 0;
        for (int i = 0; i < 4; ++i)
            for (int j = 0; j < 4; ++j) variance += s[i] * s[j] * covariance[4 * i + j];
        // What rounding made negative counts as zero; unknown stays unknown.
        deviations[field] = variance < 0 ? 0.0f : std::sqrt(variance);
    }
}

// What follows from the fit at point k, counted over all frames.
void finish(const fingerflow_frame_fields& given, Buffers& of, std::size_t k) {
    const float* const covariance = given.covariance == nullptr ? nullptr : given.covariance + 4 * k;
    const float *gradient = of.gradient.data() + 4 * k, *spread = covariance == nullptr ? nullptr : of.spread.data() + 16 * k;
    if (!all_finite(of.rest.data() + 2 * k, 2) || (covariance != nullptr && !all_finite(covariance, 4))) {
        std::fill_n(of.gradient.data() + 4 * k, 4, kUnknown);
        if (covariance != nullptr) std::fill_n(of.spread.data() + 16 * k, 16, kUnknown);
    }
    if (given.apart != nullptr && given.apart[k]) {
        const float *const own = given.apart_gradient + 4 * k, *const its = given.apart_covariance == nullptr ? spread : given.apart_covariance + 16 * k;
        derive(given.measure, own, covariance == nullptr ? nullptr : its, of.fields.data() + 5 * k, of.deviations.data() + (covariance == nullptr ? 0 : 5 * k), 5);
        // A lost point has no gradient.
        if (all_finite(given.displacement + 2 * k, 2)) gradient = own, spread = covariance == nullptr ? nullptr : its;
    }
    float fields[5], deviations[2];
    derive(given.measure, gradient, spread, fields, deviations, 2);
    given.divergence[k] = fields[0];
    given.curl[k] = fields[1];
    std::copy(fields + 2, fields + 5, given.strain + 3 * k);
    given.shear[2 * k] = gradient[0] - gradient[3];
    given.shear[2 * k + 1] = gradient[1] + gradient[2];
    if (covariance != nullptr) {
        given.divergence_std[k] = deviations[0];
        given.curl_std[k] = deviations[1];
        for (int c = 0; c < 4; ++c) of.noise[4 * k + c] = given.sharpened_noise * covariance[c];
    }
    for (std::size_t c = 2 * k; c < 2 * k + 2; ++c) {
        const float added = given.sharpened * (of.rest[c] - of.value[c]);
        of.rest[c] = given.displacement[c] + (std::isfinite(added) ? added : 0.0f);
    }
}

}  // namespace
}  // namespace fingerflow

void fingerflow_fields_of_frames(const fingerflow_frame_fields* given, int threads) {
    using namespace fingerflow;
    const std::int64_t batch = given->batch, count = given->point_count, each = given->covariance == nullptr ? 0 : 4;
    Buffers of(*given);
    for (std::size_t k = 0; k < 2 * of.total; ++k)
        of.rest[k] = given->apart != nullptr && given->apart[k / 2] ? kUnknown : given->displacement[k];
    const fingerflow_local_fit fit{given->reference, of.rest.data(), given->reference, given->covariance,
                                   1, batch, 1, batch, batch, count, count, 2, each, given->minimum_points,
                                   of.value.data(), of.gradient.data(), each == 0 ? nullptr : of.spread.data(),
                                   of.counts.data(), of.offset.data()};
    fingerflow_local_gradients(&fit, given->radius, given->least_spread * given->radius, 0, threads);
    parallel_for(batch, threads, [&](std::int64_t frame) {
        for (std::int64_t k = frame * count; k < (frame + 1) * count; ++k) finish(*given, of, size(k));
        float* const ellipse = of.ellipses.data() + 6 * frame;
        std::copy_n(given->center + 2 * frame, 2, ellipse);
        std::copy_n(given->semi_axes + 2 * frame, 2, ellipse + 2);
        ellipse[4] = std::cos(given->angle[frame]);
        ellipse[5] = std::sin(given->angle[frame]);
    });
    const bool apart = given->apart != nullptr;
    const fingerflow_area_medians medians{given->reference, of.rest.data(), of.ellipses.data(), each == 0 ? nullptr : of.noise.data(),
                                          given->lattice, given->apart, apart ? of.fields.data() : nullptr,
                                          apart && each != 0 ? of.deviations.data() : nullptr, given->medians, given->deviations,
                                          given->shares, batch, 1, count, given->positions, given->measure, given->minimum_points,
                                          given->radius, given->least_spread, given->farthest, given->least_ratio,
                                          given->least_share, given->reach, given->even, given->same_place};
    fingerflow_medians_over_area(&medians, threads);
}
