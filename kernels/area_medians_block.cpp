// build: each instruction set, fused
// Fits at kAreaBlock positions of an ellipse at once, and their sensitivities (area_medians.cpp).
// Weighted least squares with w = (1 - r^2)^2 give the gradient G of the displacement by current position. The
// displacement gradient is H = G (I - G)^-1; the fields are its divergence, curl and strain.
// Layout: one position a lane, arrays [quantity][kAreaBlock]; points are arrays x, y, u, v that all lanes share.
// Sensitivities of a point are kAreaShares floats, two components a field.
#include "area_medians_block.h"

#include <math.h>

#include "floats.h"
#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

constexpr int kSums = 13;  // count, w, w times x, y, xx, xy, yy, u, v, ux, uy, vx, vy, with x and y relative to the position

void sum(const AreaPoints& points, const AreaFits& fits, float (&to)[kSums][kAreaBlock]) {
    for (int first = 0; first < kAreaBlock; first += kFloats) {
        const Floats place_x = load(fits.x + first), place_y = load(fits.y + first);
        Floats sums[kSums] = {};
        for (std::int64_t k = 0; k < points.count; ++k) {
            const Floats x = points.x[k] - place_x, y = points.y[k] - place_y;
            const Floats closeness = positive(1.0f - (x * x + y * y));
            const Floats w = closeness * closeness, wx = w * x, wy = w * y;
            const float u = points.u[k], v = points.v[k];
            sums[0] += is_positive(closeness);
            sums[1] += w;
            sums[2] += wx;
            sums[3] += wy;
            sums[4] += wx * x;
            sums[5] += wx * y;
            sums[6] += wy * y;
            sums[7] += w * u;
            sums[8] += w * v;
            sums[9] += wx * u;
            sums[10] += wy * u;
            sums[11] += wx * v;
            sums[12] += wy * v;
        }
        for (int s = 0; s < kSums; ++s) store(to[s] + first, sums[s]);
    }
}

// Derivatives of the fields by the gradient, [field][component][direction].
void sensitivity(std::int64_t measure, const float (&gradient)[4][kAreaBlock],
                 float (&to)[kAreaFields][2][2][kAreaBlock]) {
    for (int q = 0; q < kAreaBlock; ++q) {
        const float forward[2][2] = {{1 + gradient[0][q], gradient[1][q]}, {gradient[2][q], 1 + gradient[3][q]}};
        const float identity[2][2] = {{1, 0}, {0, 1}};
        to[0][0][0][q] = to[0][1][1][q] = 1;
        to[0][0][1][q] = to[0][1][0][q] = 0;
        to[1][0][0][q] = to[1][1][1][q] = 0;
        to[1][0][1][q] = -1;
        to[1][1][0][q] = 1;
        for (int c = 0; c < 2; ++c) {
            const float* const direct = measure == 2 ? identity[c] : forward[c];
            const float* const mixed = measure == 0 ? forward[c] : identity[c];
            to[2][c][0][q] = direct[0];
            to[2][c][1][q] = 0;
            to[3][c][0][q] = 0;
            to[3][c][1][q] = direct[1];
            to[4][c][0][q] = mixed[1] / 2;
            to[4][c][1][q] = mixed[0] / 2;
        }
    }
}

// Weight of each point at a position times its offset from the centroid, (count) each.
void moments(const AreaPoints& points, float x, float y, float center_x, float center_y,
             float* FINGERFLOW_RESTRICT along_x, float* FINGERFLOW_RESTRICT along_y) {
    const float *const point_x = points.x, *const point_y = points.y;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t k = 0; k < points.count; ++k) {
        const float dx = point_x[k] - x, dy = point_y[k] - y, left = 1 - (dx * dx + dy * dy);
        const float closeness = left > 0 ? left : 0.0f, w = closeness * closeness;
        along_x[k] = w * (point_x[k] - center_x);
        along_y[k] = w * (point_y[k] - center_y);
    }
}

}  // namespace

void fit_area(const AreaSettings& settings, const AreaPoints& points, AreaFits& fits) {
    float sums[kSums][kAreaBlock];
    sum(points, fits, sums);
    const float per_length = 1 / settings.radius, narrow = settings.least_spread * settings.least_spread;
    const float farthest = settings.farthest * settings.farthest;
    FINGERFLOW_INDEPENDENT
    for (int q = 0; q < kAreaBlock; ++q) {
        const bool enough = sums[0][q] >= settings.minimum_points;
        const float share = 1 / (enough ? sums[1][q] : 1.0f), x = sums[2][q] * share, y = sums[3][q] * share;
        const float xx = sums[4][q] * share - x * x, xy = sums[5][q] * share - x * y, yy = sums[6][q] * share - y * y;
        const float u = sums[7][q] * share, v = sums[8][q] * share;
        const float ux = sums[9][q] * share - u * x, uy = sums[10][q] * share - u * y;
        const float vx = sums[11][q] * share - v * x, vy = sums[12][q] * share - v * y;
        const float half = (xx - yy) / 2, narrowest = (xx + yy) / 2 - sqrtf(half * half + xy * xy);
        const bool wide = enough && narrowest >= narrow && x * x + y * y < farthest;
        const float scale = 1 / (wide ? xx * yy - xy * xy : 1.0f);
        const float a = yy * scale, b = -xy * scale, d = xx * scale;
        const float gxx = (ux * a + uy * b) * per_length, gxy = (ux * b + uy * d) * per_length;
        const float gyx = (vx * a + vy * b) * per_length, gyy = (vx * b + vy * d) * per_length;
        // G (I - G)^-1 = (I - G)^-1 - I, without cancellation where G is small.
        const float ratio = (1 - gxx) * (1 - gyy) - gxy * gyx, lost = gxx * gyy - gxy * gyx;
        const bool known = wide && ratio > settings.least_ratio;
        const float grown = 1 / (known ? ratio : 1.0f);
        const float hxx = (gxx - lost) * grown, hxy = gxy * grown, hyx = gyx * grown, hyy = (gyy - lost) * grown;
        const float squared = settings.measure == 2 ? 0.0f : 0.5f, mixed = settings.measure == 0 ? 0.5f : 0.0f;
        fits.known[q] = known ? 1.0f : 0.0f;
        fits.center_x[q] = x + fits.x[q];
        fits.center_y[q] = y + fits.y[q];
        fits.share[q] = share;
        fits.inverse[0][q] = a;
        fits.inverse[1][q] = b;
        fits.inverse[2][q] = d;
        fits.gradient[0][q] = hxx;
        fits.gradient[1][q] = hxy;
        fits.gradient[2][q] = hyx;
        fits.gradient[3][q] = hyy;
        fits.fields[0][q] = hxx + hyy;
        fits.fields[1][q] = hyx - hxy;
        fits.fields[2][q] = hxx + squared * (hxx * hxx + hyx * hyx);
        fits.fields[3][q] = hyy + squared * (hxy * hxy + hyy * hyy);
        fits.fields[4][q] = (hxy + hyx) / 2 + mixed * (hxx * hxy + hyx * hyy);
    }
}

void add_shares(const AreaSettings& settings, const AreaPoints& points, const AreaFits& fits, const AreaBeside& beside,
                float* memory, float* shares, float (&total)[kAreaFields]) {
    float by_gradient[kAreaFields][2][2][kAreaBlock], share[kAreaFields][kAreaBlock], any[kAreaBlock] = {};
    sensitivity(settings.measure, fits.gradient, by_gradient);
    const float own[2][2] = {{beside.xx, beside.xy}, {beside.xy, beside.yy}};
    const float even = beside.even / (settings.radius * settings.radius), reach = beside.reach * beside.reach;
    for (int field = 0; field < kAreaFields; ++field) {
        FINGERFLOW_INDEPENDENT
        for (int q = 0; q < kAreaBlock; ++q) {
            float variance = 0;
            for (int c = 0; c < 2; ++c)
                for (int e = 0; e < 2; ++e) {
                    const float cx = by_gradient[field][c][0][q], cy = by_gradient[field][c][1][q];
                    const float ex = by_gradient[field][e][0][q], ey = by_gradient[field][e][1][q];
                    variance += own[c][e] * (cx * ex * fits.inverse[0][q] + (cx * ey + cy * ex) * fits.inverse[1][q] +
                                             cy * ey * fits.inverse[2][q]);
                }
            variance *= even * fits.share[q] * reach;
            const float away = fits.fields[field][q] - beside.median[field];
            const float left = 1 - away * away / (variance > 1e-30f ? variance : 1e-30f);
            share[field][q] = left > 0 ? left * left * fits.known[q] : 0.0f;
        }
        for (int q = 0; q < kAreaBlock; ++q) {
            total[field] += share[field][q];
            any[q] += share[field][q];
        }
    }
    alignas(64) float along_x[kAreaBlock][kAreaShares] = {}, along_y[kAreaBlock][kAreaShares] = {};
    int positions = 0;  // with a weight above 0
    for (int q = 0; q < kAreaBlock; ++q) {
        if (!(any[q] > 0)) continue;
        // Change of a field by a displacement (1, 0) or (0, 1) of a point of weight 1 at (x, y) from the centroid.
        const float forward[2][2] = {{1 + fits.gradient[0][q], fits.gradient[1][q]},
                                     {fits.gradient[2][q], 1 + fits.gradient[3][q]}};
        const float a = fits.inverse[0][q], b = fits.inverse[1][q], d = fits.inverse[2][q];
        for (int field = 0; field < kAreaFields; ++field) {
            const float scale = share[field][q] * fits.share[q];
            for (int c = 0; c < 2; ++c) {
                const float sx = by_gradient[field][c][0][q], sy = by_gradient[field][c][1][q];
                const float x = sx * forward[0][0] + sy * forward[0][1], y = sx * forward[1][0] + sy * forward[1][1];
                along_x[positions][2 * field + c] = scale * (x * a + y * b);
                along_y[positions][2 * field + c] = scale * (x * b + y * d);
            }
        }
        float* const weighted = memory + 2 * positions * points.count;
        moments(points, fits.x[q], fits.y[q], fits.center_x[q], fits.center_y[q], weighted, weighted + points.count);
        ++positions;
    }
    // Two points at a time, so that additions of one sum do not wait for each other.
    for (std::int64_t k = 0; k < points.count; k += 2) {
        const std::int64_t next = k + 1 < points.count ? 1 : 0;
        for (int first = 0; first < kAreaShares; first += kFloats) {
            Floats sums[2][2] = {};
            const float* weighted = memory + k;
            for (int n = 0; n < positions; ++n, weighted += 2 * points.count) {
                const Floats x = load(along_x[n] + first), y = load(along_y[n] + first);
                sums[0][0] += x * weighted[0];
                sums[0][1] += y * weighted[points.count];
                sums[1][0] += x * weighted[next];
                sums[1][1] += y * weighted[points.count + next];
            }
            for (std::int64_t n = 0; n <= next; ++n) {
                float* const to = shares + points.number[k + n] * kAreaShares + first;
                store(to, load(to) + (sums[n][0] + sums[n][1]));
            }
        }
    }
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
