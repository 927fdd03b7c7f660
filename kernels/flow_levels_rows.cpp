// build: each instruction set, fused
// Row loops of flow_levels.cpp: inverses of diagonal blocks, coarser levels, covariances.
// Covariance from the eigenvalues k of the tensor: density / (4 pi alpha) * (1 - z e^z E1(z)) with z = rho^2 k / alpha.
// Layout: one cell of a row a lane; logarithm, exponential and E1 are polynomials, so that they vectorize.
#include "flow_levels_rows.h"

#include <math.h>
#include <string.h>

#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

// ln x of a normal number above 0, by the series of atanh((m - 1) / (m + 1)) of its mantissa m in [2/3, 4/3); error
// 2e-7.
inline float logarithm(float x) {
    std::int32_t bits;
    memcpy(&bits, &x, sizeof bits);
    const std::int32_t exponent = (bits - 0x3f2aaaab) >> 23;  // of 2/3
    const std::int32_t rest = bits - (exponent << 23);
    float mantissa;
    memcpy(&mantissa, &rest, sizeof mantissa);
    const float s = (mantissa - 1) / (mantissa + 1), z = s * s;
    return static_cast<float>(exponent) * 0.69314718f + 2 * s * (1 + z * (1 / 3.0f + z * (1 / 5.0f + z * (1 / 7.0f + z * (1 / 9.0f)))));
}

// e^x for x in [0, 1], by the Taylor series about 1/2; error 2e-7.
inline float exponential(float x) {
    const float t = x - 0.5f;
    return 1.6487213f * (1 + t * (1 + t * (1 / 2.0f + t * (1 / 6.0f + t * (1 / 24.0f + t * (1 / 120.0f + t * (1 / 720.0f)))))));
}

// 1 - z e^z E1(z) for z > 0, approximated as in fingerflow/ops/flow/flow_covariance.py.
inline float passed(float z) {
    const float small = z < 1 ? z : 1.0f;
    const float series = 0.99999193f + small * (-0.24991055f + small * (0.05519968f + small * (-0.00976004f + small * 0.00107857f)));
    const float below = small * exponential(small) * (series * small - 0.57721566f - logarithm(small));
    const float large = z < 1 ? 1.0f : z < 1e6f ? z : 1e6f;
    const float above = (large * (large + 2.334733f) + 0.250621f) / (large * (large + 3.330657f) + 1.681534f);
    return 1 - (z < 1 ? below : above);
}

}  // namespace

void flow_inverse_row(const FlowLevel& level, const float* zeros, float* inverse, std::int64_t y) {
    const std::int64_t width = level.width, plane = level.height * width, at = y * width;
    const float *FINGERFLOW_RESTRICT xx = level.tensor + at, *FINGERFLOW_RESTRICT xy = xx + plane, *FINGERFLOW_RESTRICT yy = xy + plane;
    const float* FINGERFLOW_RESTRICT right = level.right + y * (width - 1);
    const float *FINGERFLOW_RESTRICT up = y > 0 ? level.down + at - width : zeros, *FINGERFLOW_RESTRICT down = y + 1 < level.height ? level.down + at : zeros;
    float *FINGERFLOW_RESTRICT to_xx = inverse + at, *FINGERFLOW_RESTRICT to_xy = inverse + plane + at, *FINGERFLOW_RESTRICT to_yy = inverse + 2 * plane + at;
    const auto cell = [&](std::int64_t x, float before, float after) {
        const float degree = ((before + after) + up[x]) + down[x];
        const float a = xx[x] + degree, b = xy[x], c = yy[x] + degree, determinant = a * c - b * b;
        const float by = determinant > 1e-6f * ((a + c) * (a + c)) ? 1 / determinant : 0.0f;
        to_xx[x] = c * by;
        to_xy[x] = -b * by;
        to_yy[x] = a * by;
    };
    cell(0, 0.0f, width > 1 ? right[0] : 0.0f);
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 1; x < width - 1; ++x) cell(x, right[x - 1], right[x]);
    if (width > 1) cell(width - 1, right[width - 2], 0.0f);
}

void flow_coarser_row(const FlowLevel& level, const FlowCoarser& coarser, float* memory, std::int64_t y) {
    const std::int64_t width = level.width, plane = level.height * width, area = coarser.height * coarser.width, count = coarser.width;
    const bool two = 2 * y + 1 < level.height;
    const std::int64_t at = 2 * y * width, next = two ? width : 0;
    const float share = two ? 1.0f : 0.0f;  // of the second row
    // Cells beyond the border count as 0.
    const auto means = [&](const float* from, float* line, float* to) {
        const float *FINGERFLOW_RESTRICT one = from + at, *FINGERFLOW_RESTRICT other = one + next;
        float *FINGERFLOW_RESTRICT sum = line, *FINGERFLOW_RESTRICT mean = to + y * count;
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = 0; x < width; ++x) sum[x] = one[x] + share * other[x];
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = 0; x < width / 2; ++x) mean[x] = (sum[2 * x] + sum[2 * x + 1]) / 4;
        if (width % 2) mean[count - 1] = sum[width - 1] / 4;
    };
    for (int k = 0; k < 3; ++k) means(level.tensor + k * plane, memory + k * width, coarser.tensor + k * area);
    means(level.inside, memory + 3 * width, coarser.inside);
    float* FINGERFLOW_RESTRICT inside = coarser.inside + y * count;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < count; ++x) inside[x] = inside[x] > 0 ? 1.0f : 0.0f;
    const float *FINGERFLOW_RESTRICT one = level.right + 2 * y * (width - 1), *FINGERFLOW_RESTRICT other = one + (two ? width - 1 : 0);
    float* FINGERFLOW_RESTRICT right = coarser.right + y * (count - 1);
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < count - 1; ++x) right[x] = (one[2 * x + 1] + share * other[2 * x + 1]) / 8;
    if (y + 1 == coarser.height) return;
    const float* FINGERFLOW_RESTRICT below = level.down + (2 * y + 1) * width;
    float* FINGERFLOW_RESTRICT down = coarser.down + y * count;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < width / 2; ++x) down[x] = (below[2 * x] + below[2 * x + 1]) / 8;
    if (width % 2) down[count - 1] = below[width - 1] / 8;
}

void flow_covariance_row(const float* const* tensor, const FlowNoise& noise, std::int64_t width, float* const* covariance) {
    const float *FINGERFLOW_RESTRICT xx = tensor[0], *FINGERFLOW_RESTRICT xy = tensor[1], *FINGERFLOW_RESTRICT yy = tensor[2];
    float *FINGERFLOW_RESTRICT to_xx = covariance[0], *FINGERFLOW_RESTRICT to_xy = covariance[1], *FINGERFLOW_RESTRICT to_yy = covariance[2];
    const float tiny = 1e-12f, by_alpha = 1 / noise.alpha, factor = noise.density / (4 * 3.14159265f * noise.alpha), none = static_cast<float>(NAN);
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < width; ++x) {
        const float mean = (xx[x] + yy[x]) / 2, half = (xx[x] - yy[x]) / 2, apart = sqrtf(half * half + xy[x] * xy[x]);
        const float larger = (mean + apart) * by_alpha, least = mean - apart, smaller = (least > 0 ? least : 0.0f) * by_alpha;
        const float of_larger = factor * passed(noise.rho_square * (larger > tiny ? larger : tiny));
        const float of_smaller = factor * passed(noise.rho_square * (smaller > tiny ? smaller : tiny));
        const float slope = (of_larger - of_smaller) / (2 * apart > tiny ? 2 * apart : tiny);
        const bool known = mean + apart > noise.textured;
        to_xx[x] = known ? of_smaller + slope * (apart + half) : none;
        to_xy[x] = known ? slope * xy[x] : none;
        to_yy[x] = known ? of_smaller + slope * (apart - half) : none;
    }
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
