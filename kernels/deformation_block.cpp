// build: each instruction set, fused
// Correction of kDeformedPoints points for the deformation that their templates do not know (deformation.cpp).
// E = F F_0^-1 - I, with F the local warp and F_0 that of the template. Position: x - lean E - (area - 1) / 24
// laplacian u. Noise of the fit: max(noise - e' Q e / freedom, min(noise, template noise)), which scales the
// covariance.
// Layout: one point a lane; `Columns` transposes [point][component] to [component][point] and back.
#include "deformation_block.h"

#include <math.h>

#include "lanes.h"
#include "tracking_limits.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

constexpr int kMany = kDeformedPoints;
constexpr float kTiny = 1e-20f;

// Components of all points of a block, component by component.
template <int kComponents>
struct Columns {
    float of[kComponents][kMany];

    void read(const float* from, std::int64_t stride, const std::int64_t* point, int count) {
        for (int q = 0; q < kMany; ++q) {
            const float* const numbers = from + point[q < count ? q : 0] * stride;
            for (int k = 0; k < kComponents; ++k) of[k][q] = numbers[k];
        }
    }
    void write(float* to, const std::int64_t* point, int count) const {
        for (int q = 0; q < count; ++q)
            for (int k = 0; k < kComponents; ++k) to[point[q] * kComponents + k] = of[k][q];
    }
};

inline float known_or_zero(float value) { return value - value == 0.0f ? value : 0.0f; }
// NaN where either is NaN.
inline float lesser(float a, float b) { return a < b || a != a ? a : b; }
inline float greater(float a, float b) { return a > b || a != a ? a : b; }

// Template statistics of a block's points.
struct Statistics {
    Columns<4> inverse_warp;
    Columns<8> lean;
    Columns<10> bending;
    Columns<1> unit, noise;
};

}  // namespace

void correct_block(const fingerflow_deformation& given, const float* second, const std::int64_t* point, int count) {
    Statistics of;
    of.inverse_warp.read(given.inverse_warp, 4, point, count);
    of.lean.read(given.numbers + kLean, kNumbers, point, count);
    of.bending.read(given.numbers + kBending, kNumbers, point, count);
    of.unit.read(given.numbers + kCovarianceXx, kNumbers, point, count);
    of.noise.read(given.numbers + kNoise, kNumbers, point, count);
    Columns<2> start;
    start.read(given.start, 2, point, count);
    const auto area = static_cast<float>(given.window * given.window), half = static_cast<float>(given.window / 2);
    const float bulging = (area - 1) / 24, freedom = 1 / ((area - 4) * kValueNoise);
    for (std::int64_t frame = 0; frame < given.frames; ++frame) {
        const std::int64_t first = frame * given.points;
        Columns<2> place, expected;
        Columns<4> warp, covariance;
        Columns<8> bend;
        Columns<1> shift;
        place.read(given.found + 2 * first, 2, point, count);
        expected.read(given.expected + 2 * first, 2, point, count);
        warp.read(given.warp + 4 * first, 4, point, count);
        covariance.read(given.covariance + 4 * first, 4, point, count);
        bend.read(second + 8 * first, 8, point, count);
        FINGERFLOW_INDEPENDENT
        for (int q = 0; q < kMany; ++q) {
            const float xx = 1 + known_or_zero(warp.of[0][q]), xy = known_or_zero(warp.of[1][q]);
            const float yx = known_or_zero(warp.of[2][q]), yy = 1 + known_or_zero(warp.of[3][q]);
            warp.of[0][q] = xx;
            warp.of[1][q] = xy;
            warp.of[2][q] = yx;
            warp.of[3][q] = yy;
            // E = F F_0^-1 - I.
            const float(&inverse)[4][kMany] = of.inverse_warp.of;
            const float unknown[] = {xx * inverse[0][q] + xy * inverse[2][q] - 1, xx * inverse[1][q] + xy * inverse[3][q],
                                     yx * inverse[0][q] + yy * inverse[2][q], yx * inverse[1][q] + yy * inverse[3][q] - 1};
            float x = place.of[0][q] - bulging * known_or_zero(bend.of[0][q] + bend.of[3][q]);
            float y = place.of[1][q] - bulging * known_or_zero(bend.of[4][q] + bend.of[7][q]);
            float squares = 0;
            for (int k = 0; k < 4; ++k) {
                x -= of.lean.of[k][q] * unknown[k];
                y -= of.lean.of[4 + k][q] * unknown[k];
                squares += unknown[k] * unknown[k];
            }
            place.of[0][q] = x;
            place.of[1][q] = y;
            shift.of[0][q] = half * sqrtf(squares);
            // Unmodelled deformation adds e'Qe to the residual, which would otherwise count as noise.
            float bending = 0;
            for (int i = 0, pair = 0; i < 4; ++i)
                for (int j = i; j < 4; ++j, ++pair) bending += of.bending.of[pair][q] * (unknown[i] * unknown[j]);
            const float noise = covariance.of[0][q] / of.unit.of[0][q];
            const float remaining = greater(noise - bending * freedom, lesser(noise, of.noise.of[0][q]));
            const float share = remaining / greater(noise, kTiny);
            for (int k = 0; k < 4; ++k) covariance.of[k][q] *= share;
            for (int k = 0; k < 2; ++k) expected.of[k][q] += start.of[k][q];
        }
        place.write(given.corrected + 2 * first, point, count);
        expected.write(given.expected + 2 * first, point, count);
        warp.write(given.warp + 4 * first, point, count);
        covariance.write(given.remaining + 4 * first, point, count);
        shift.write(given.shift + first, point, count);
    }
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
