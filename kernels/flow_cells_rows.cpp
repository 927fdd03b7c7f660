// build: each instruction set, fused
// Row loops of flow_cells.cpp and flow_course.cpp: interpolation between cells and pixels, warping, residuals, gradients,
// covariances, moments and window means. Cells are interpolated with weights 3/4 and 1/4 along each axis, normalised by
// the known cells. Warping evaluates the cubic B-spline of the coefficients with 4 x 4 taps.
// Covariance from the eigenvalues k of the tensor: density / (4 pi alpha) * (1 - z e^z E1(z)) with z = rho^2 k / alpha.
// Logarithm, exponential and E1 are polynomials, so that they vectorize.
// Layout: one pixel or cell of a row a lane; `to` and `memory` hold rows, one after the other. Sums over a row are
// taken in float lanes and added as doubles.
#include "flow_cells_rows.h"

#include <math.h>
#include <string.h>

#include "floats.h"
#include "lanes.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

inline double total(const Floats& value) {
    double result = 0;
    for (int k = 0; k < kFloats; ++k) result += static_cast<double>(value[k]);
    return result;
}

// Adds `count` sums over a row to `sums`: terms(x, lanes) adds a vector, term(x, sums) a single element.
template <int count, class Terms, class Term>
inline void add_sums(std::int64_t width, double* sums, const Terms& terms, const Term& term) {
    Floats lanes[count];
    for (int k = 0; k < count; ++k) lanes[k] = all(0);
    std::int64_t x = 0;
    for (; x + kFloats <= width; x += kFloats) terms(x, lanes);
    for (int k = 0; k < count; ++k) sums[k] += total(lanes[k]);
    for (; x < width; ++x) term(x, sums);
}

// Weighted least-squares plane from its moments; flat where the cells do not span a plane.
inline void solve_plane(float around, float sum_x, float sum_y, float sum_xx, float sum_xy, float sum_yy, float field, float by_x,
                        float by_y, float& height, float& slope_x, float& slope_y) {
    const float tiny = 1e-12f, narrow = 0.01f;
    const float some = around > tiny ? around : 1.0f, per = 1 / some;
    const float x = sum_x * per, y = sum_y * per, mean = field * per;
    const float xx = sum_xx * per - x * x, xy = sum_xy * per - x * y, yy = sum_yy * per - y * y;
    const float on_x = by_x * per - x * mean, on_y = by_y * per - y * mean;
    const float determinant = xx * yy - xy * xy, trace = xx + yy;
    const bool spanned = determinant > narrow * trace * trace && determinant > tiny;
    const float by = spanned ? 1 / determinant : 0.0f;
    slope_x = (on_x * yy - on_y * xy) * by;
    slope_y = (on_y * xx - on_x * xy) * by;
    height = mean - slope_x * x - slope_y * y;
}

inline float at(const FlowPlane& plane, int channel, float x, float y) {
    return plane.height[channel] + plane.slope_x[channel] * x + plane.slope_y[channel] * y;
}

}  // namespace

void flow_finer_row(const FlowCells& cells, const FlowPlane* plane, std::int64_t width, std::int64_t y, float* const* to, float* memory) {
    const std::int64_t count = cells.width, near = y / 2;
    const std::int64_t next = y % 2 ? (near + 1 < cells.height ? near + 1 : near) : (near > 0 ? near - 1 : 0);
    const float middle_x = 0.5f * static_cast<float>(count - 1), middle_y = 0.5f * static_cast<float>(cells.height - 1);
    float* FINGERFLOW_RESTRICT share = memory + 1;  // the end cells are repeated
    bool whole = true;
    const float *FINGERFLOW_RESTRICT here = cells.known ? cells.known + near * count : nullptr;
    const float *FINGERFLOW_RESTRICT there = cells.known ? cells.known + next * count : nullptr;
    if (cells.known) {
        float least = 1;
        for (std::int64_t x = 0; x < count; ++x) {
            share[x] = 0.75f * here[x] + 0.25f * there[x];
            least = share[x] < least ? share[x] : least;
        }
        whole = least == 1.0f;
        share[-1] = share[0];
        share[count] = share[count - 1];
    }
    const std::int64_t pairs = width / 2;
    for (std::int64_t channel = 0; channel < cells.channels; ++channel) {
        float* FINGERFLOW_RESTRICT line = memory + (channel + 1) * (count + 2) + 1;
        const float *FINGERFLOW_RESTRICT a = cells.planes + (channel * cells.height + near) * count;
        const float *FINGERFLOW_RESTRICT b = cells.planes + (channel * cells.height + next) * count;
        const bool beside = plane && channel < 2;
        const float slope = beside ? plane->slope_x[channel] : 0.0f;
        const float level = beside ? at(*plane, static_cast<int>(channel), -middle_x, static_cast<float>(near) - middle_y) : 0.0f;
        const float other = beside ? at(*plane, static_cast<int>(channel), -middle_x, static_cast<float>(next) - middle_y) : 0.0f;
        if (whole) {
            FINGERFLOW_INDEPENDENT
            for (std::int64_t x = 0; x < count; ++x) {
                const float along = slope * static_cast<float>(static_cast<int>(x));
                line[x] = 0.75f * (a[x] - (level + along)) + 0.25f * (b[x] - (other + along));
            }
        } else {
            FINGERFLOW_INDEPENDENT
            for (std::int64_t x = 0; x < count; ++x) {
                const float along = slope * static_cast<float>(static_cast<int>(x));
                const float one = a[x] - (level + along), two = b[x] - (other + along);
                line[x] = 0.75f * (here[x] > 0 ? one : 0.0f) + 0.25f * (there[x] > 0 ? two : 0.0f);
            }
        }
        line[-1] = line[0];
        line[count] = line[count - 1];
        float* FINGERFLOW_RESTRICT out = to[channel];
        const float height = beside ? at(*plane, static_cast<int>(channel), -middle_x, 0.5f * (static_cast<float>(y) - 0.5f) - middle_y) : 0.0f;
        if (whole) {
            FINGERFLOW_INDEPENDENT
            for (std::int64_t x = 0; x < pairs; ++x) {
                const float along = height + slope * static_cast<float>(static_cast<int>(x));
                out[2 * x] = along - 0.25f * slope + (0.75f * line[x] + 0.25f * line[x - 1]);
                out[2 * x + 1] = along + 0.25f * slope + (0.75f * line[x] + 0.25f * line[x + 1]);
            }
        } else {
            FINGERFLOW_INDEPENDENT
            for (std::int64_t x = 0; x < pairs; ++x) {
                const float along = height + slope * static_cast<float>(static_cast<int>(x));
                const float before = 0.75f * share[x] + 0.25f * share[x - 1], behind = 0.75f * share[x] + 0.25f * share[x + 1];
                out[2 * x] = along - 0.25f * slope + (0.75f * line[x] + 0.25f * line[x - 1]) / (before > 0 ? before : 1.0f);
                out[2 * x + 1] = along + 0.25f * slope + (0.75f * line[x] + 0.25f * line[x + 1]) / (behind > 0 ? behind : 1.0f);
            }
        }
        if (width % 2) {
            const float before = whole ? 1.0f : 0.75f * share[pairs] + 0.25f * share[pairs - 1];
            out[width - 1] = height + slope * (static_cast<float>(pairs) - 0.25f) +
                             (0.75f * line[pairs] + 0.25f * line[pairs - 1]) / (before > 0 ? before : 1.0f);
        }
    }
}

void flow_moments_row(const float* known, const float* u, const float* v, std::int64_t width, float begin, float y, double* sums) {
    float steps[kFloats];
    for (int k = 0; k < kFloats; ++k) steps[k] = static_cast<float>(k) + begin;
    const Floats ramp = load(steps);
    double row[7] = {};  // of weight, x, x x, u, v, u x, v x
    add_sums<7>(
        width, row,
        [&](std::int64_t x, Floats* lanes) {
            const Floats w = load(known + x), along = ramp + static_cast<float>(x), wx = w * along, on_u = w * load(u + x), on_v = w * load(v + x);
            lanes[0] += w;
            lanes[1] += wx;
            lanes[2] += wx * along;
            lanes[3] += on_u;
            lanes[4] += on_v;
            lanes[5] += on_u * along;
            lanes[6] += on_v * along;
        },
        [&](std::int64_t x, double* to) {
            const double w = known[x], along = static_cast<double>(begin) + static_cast<double>(x);
            to[0] += w;
            to[1] += w * along;
            to[2] += w * along * along;
            to[3] += w * u[x];
            to[4] += w * v[x];
            to[5] += w * u[x] * along;
            to[6] += w * v[x] * along;
        });
    const double down = y;
    sums[0] += row[0];
    sums[1] += row[1];
    sums[2] += row[0] * down;
    sums[3] += row[2];
    sums[4] += row[1] * down;
    sums[5] += row[0] * down * down;
    sums[6] += row[3];
    sums[7] += row[4];
    sums[8] += row[5];
    sums[9] += row[6];
    sums[10] += row[3] * down;
    sums[11] += row[4] * down;
}

void flow_seen_row(const FlowPicture& picture, const float* u, const float* v, float* warped, float* seen, float margin, std::int64_t y,
                   double* sums) {
    const std::int64_t width = picture.width;
    const float* FINGERFLOW_RESTRICT inside = picture.inside + y * width;
    const float* value = picture.value + y * width;
    const float most_x = static_cast<float>(width - 1) - margin, most_y = static_cast<float>(picture.height - 1) - margin;
    const float down = static_cast<float>(y), endless = static_cast<float>(HUGE_VAL);
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < width; ++x) {
        const float to_x = static_cast<float>(static_cast<int>(x)) + u[x], to_y = down + v[x];
        const bool within = (to_x >= margin) & (to_x <= most_x) & (to_y >= margin) & (to_y <= most_y) & (fabsf(warped[x]) < endless);
        seen[x] = within ? inside[x] : 0.0f;
        warped[x] = within ? warped[x] : 0.0f;
    }
    add_sums<3>(
        width, sums,
        [&](std::int64_t x, Floats* lanes) {
            const Floats s = load(seen + x);
            lanes[0] += s;
            lanes[1] += s * load(value + x);
            lanes[2] += s * load(warped + x);
        },
        [&](std::int64_t x, double* to) {
            to[0] += seen[x];
            to[1] += static_cast<double>(seen[x]) * value[x];
            to[2] += static_cast<double>(seen[x]) * warped[x];
        });
}

void flow_light_row(const FlowPicture& picture, const float* warped, const float* seen, const float* means, std::int64_t y, double* sums) {
    const std::int64_t width = picture.width;
    const float* value = picture.value + y * width;
    add_sums<2>(
        width, sums,
        [&](std::int64_t x, Floats* lanes) {
            const Floats apart = load(seen + x) * (load(value + x) - means[0]);
            lanes[0] += apart * apart;
            lanes[1] += apart * (load(warped + x) - means[1]);
        },
        [&](std::int64_t x, double* to) {
            const float apart = seen[x] * (value[x] - means[0]);
            to[0] += static_cast<double>(apart) * apart;
            to[1] += static_cast<double>(apart) * (warped[x] - means[1]);
        });
}

namespace {

// A quarter of the sum of each pair of columns; an odd last column alone.
inline void halve(const float* FINGERFLOW_RESTRICT from, std::int64_t width, float* FINGERFLOW_RESTRICT to) {
    const std::int64_t pairs = width / 2;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < pairs; ++x) to[x] = 0.25f * (from[2 * x] + from[2 * x + 1]);
    if (width % 2) to[pairs] = 0.25f * from[width - 1];
}

}  // namespace

void flow_left_row(const FlowPicture& picture, const float* warped, const float* seen, float gain, float offset, std::int64_t y,
                   float* const* to, float* memory) {
    const std::int64_t width = picture.width, rows = 2 * y + 1 < picture.height ? 2 : 1;
    float *FINGERFLOW_RESTRICT by_x = memory, *FINGERFLOW_RESTRICT by_y = memory + width;
    float *FINGERFLOW_RESTRICT squares = memory + 2 * width, *FINGERFLOW_RESTRICT count = memory + 3 * width;
    for (std::int64_t row = 0; row < rows; ++row) {
        const std::int64_t at = (2 * y + row) * width;
        const float *FINGERFLOW_RESTRICT value = picture.value + at, *FINGERFLOW_RESTRICT of = warped + at, *FINGERFLOW_RESTRICT s = seen + at;
        const float *FINGERFLOW_RESTRICT slope_x = picture.slope_x + at, *FINGERFLOW_RESTRICT slope_y = picture.slope_y + at;
        const bool second = row == 1;
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = 0; x < width; ++x) {
            const float left = s[x] * (of[x] - offset - gain * value[x]);
            by_x[x] = (second ? by_x[x] : 0.0f) + slope_x[x] * left;
            by_y[x] = (second ? by_y[x] : 0.0f) + slope_y[x] * left;
            squares[x] = (second ? squares[x] : 0.0f) + left * left;
            count[x] = (second ? count[x] : 0.0f) + s[x];
        }
    }
    for (int k = 0; k < 4; ++k) halve(memory + k * width, width, to[k]);
}

void flow_halved_moments_row(const FlowCells& cells, const FlowPlane& plane, std::int64_t y, float* const* to, float* memory) {
    const std::int64_t width = cells.width, area = cells.height * width, rows = 2 * y + 1 < cells.height ? 2 : 1, count = (width + 1) / 2;
    float *FINGERFLOW_RESTRICT share = memory, *FINGERFLOW_RESTRICT u = memory + width, *FINGERFLOW_RESTRICT v = memory + 2 * width;
    const float middle_x = 0.5f * static_cast<float>(width - 1), middle_y = 0.5f * static_cast<float>(cells.height - 1);
    for (std::int64_t row = 0; row < rows; ++row) {
        const std::int64_t at_row = (2 * y + row) * width;
        const float *FINGERFLOW_RESTRICT known = cells.known + at_row, *FINGERFLOW_RESTRICT a = cells.planes + at_row;
        const float* FINGERFLOW_RESTRICT b = a + area;
        const float down = static_cast<float>(2 * y + row) - middle_y;
        const float base_u = at(plane, 0, -middle_x, down), base_v = at(plane, 1, -middle_x, down);
        const bool second = row == 1;
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = 0; x < width; ++x) {
            const float along = static_cast<float>(static_cast<int>(x)), w = known[x];
            const float on_u = w * (a[x] - (base_u + plane.slope_x[0] * along)), on_v = w * (b[x] - (base_v + plane.slope_x[1] * along));
            share[x] = second ? share[x] + w : w;
            u[x] = second ? u[x] + on_u : on_u;
            v[x] = second ? v[x] + on_v : on_v;
        }
    }
    halve(share, width, to[0]);
    halve(u, width, to[6]);
    halve(v, width, to[7]);
    const float *FINGERFLOW_RESTRICT w = to[0], *FINGERFLOW_RESTRICT on_u = to[6], *FINGERFLOW_RESTRICT on_v = to[7];
    float *FINGERFLOW_RESTRICT sx = to[1], *FINGERFLOW_RESTRICT sy = to[2], *FINGERFLOW_RESTRICT sxx = to[3], *FINGERFLOW_RESTRICT sxy = to[4];
    float *FINGERFLOW_RESTRICT syy = to[5], *FINGERFLOW_RESTRICT ux = to[8], *FINGERFLOW_RESTRICT vx = to[9];
    float *FINGERFLOW_RESTRICT uy = to[10], *FINGERFLOW_RESTRICT vy = to[11];
    const float begin = -0.5f * static_cast<float>(count - 1), down = static_cast<float>(y) - 0.5f * static_cast<float>((cells.height + 1) / 2 - 1);
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < count; ++x) {
        const float along = static_cast<float>(static_cast<int>(x)) + begin;
        const float wx = w[x] * along, wy = w[x] * down;
        sx[x] = wx;
        sy[x] = wy;
        sxx[x] = wx * along;
        sxy[x] = wx * down;
        syy[x] = wy * down;
        ux[x] = on_u[x] * along;
        vx[x] = on_v[x] * along;
        uy[x] = on_u[x] * down;
        vy[x] = on_v[x] * down;
    }
}

void flow_across_row(const float* from, const float* weights, std::int64_t half, std::int64_t width, float* to, float* memory) {
    float* line = memory + half;
    for (std::int64_t x = 0; x < half; ++x) memory[x] = 0.0f;
    for (std::int64_t x = 0; x < width; ++x) line[x] = from[x];
    for (std::int64_t x = width; x < width + half + kFloats; ++x) line[x] = 0.0f;
    std::int64_t x = 0;
    const auto mean = [&](std::int64_t place) {
        Floats sum = load(line + place) * weights[0];
        for (std::int64_t k = 1; k <= half; ++k) sum += (load(line + place - k) + load(line + place + k)) * weights[k];
        return sum;
    };
    for (; x + kFloats <= width; x += kFloats) store(to + x, mean(x));
    if (x < width) {
        float rest[kFloats];
        store(rest, mean(x));
        for (std::int64_t k = x; k < width; ++k) to[k] = rest[k - x];
    }
}

void flow_down_row(const float* from, const float* weights, std::int64_t half, std::int64_t height, std::int64_t width, std::int64_t y, float* to) {
    std::int64_t x = 0;
    const std::int64_t above = y < half ? y : half, below = height - 1 - y < half ? height - 1 - y : half;
    const float* middle = from + y * width;
    for (; x + kFloats <= width; x += kFloats) {
        Floats sum = load(middle + x) * weights[0];
        for (std::int64_t k = 1; k <= above; ++k) sum += load(middle + x - k * width) * weights[k];
        for (std::int64_t k = 1; k <= below; ++k) sum += load(middle + x + k * width) * weights[k];
        store(to + x, sum);
    }
    for (; x < width; ++x) {
        float sum = middle[x] * weights[0];
        for (std::int64_t k = 1; k <= above; ++k) sum += middle[x - k * width] * weights[k];
        for (std::int64_t k = 1; k <= below; ++k) sum += middle[x + k * width] * weights[k];
        to[x] = sum;
    }
}

void flow_heights_row(const float* const* moments, std::int64_t width, float begin, float y, float* u, float* v) {
    const float *FINGERFLOW_RESTRICT m0 = moments[0], *FINGERFLOW_RESTRICT m1 = moments[1], *FINGERFLOW_RESTRICT m2 = moments[2];
    const float *FINGERFLOW_RESTRICT m3 = moments[3], *FINGERFLOW_RESTRICT m4 = moments[4], *FINGERFLOW_RESTRICT m5 = moments[5];
    const float *FINGERFLOW_RESTRICT m6 = moments[6], *FINGERFLOW_RESTRICT m7 = moments[7], *FINGERFLOW_RESTRICT m8 = moments[8];
    const float *FINGERFLOW_RESTRICT m9 = moments[9], *FINGERFLOW_RESTRICT m10 = moments[10], *FINGERFLOW_RESTRICT m11 = moments[11];
    float *FINGERFLOW_RESTRICT to_u = u, *FINGERFLOW_RESTRICT to_v = v;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < width; ++x) {
        const float along = static_cast<float>(static_cast<int>(x)) + begin;
        float height, slope_x, slope_y;
        solve_plane(m0[x], m1[x], m2[x], m3[x], m4[x], m5[x], m6[x], m8[x], m10[x], height, slope_x, slope_y);
        to_u[x] = height + slope_x * along + slope_y * y;
        solve_plane(m0[x], m1[x], m2[x], m3[x], m4[x], m5[x], m7[x], m9[x], m11[x], height, slope_x, slope_y);
        to_v[x] = height + slope_x * along + slope_y * y;
    }
}

void flow_departure_row(const float* const* from, const FlowPlane& whole, std::int64_t height, std::int64_t width, std::int64_t y,
                        float* const* beside) {
    const float middle_x = 0.5f * static_cast<float>(width - 1), down = static_cast<float>(y) - 0.5f * static_cast<float>(height - 1);
    for (int channel = 0; channel < 2; ++channel) {
        const float* FINGERFLOW_RESTRICT of = from[channel];
        float* FINGERFLOW_RESTRICT to = beside[channel];
        const float base = at(whole, channel, -middle_x, down), slope = whole.slope_x[channel];
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = 0; x < width; ++x) to[x] = of[x] - (base + slope * static_cast<float>(static_cast<int>(x))) - to[x];
    }
}

void flow_clean_row(const float* from, std::int64_t width, float* to) {
    const float* FINGERFLOW_RESTRICT of = from;
    float* FINGERFLOW_RESTRICT clean = to;
    const float endless = static_cast<float>(HUGE_VAL);
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < width; ++x) clean[x] = fabsf(of[x]) < endless ? of[x] : 0.0f;
}

void flow_slopes_row(const float* coefficients, const float* clean, const float* mask, std::int64_t margin, std::int64_t height,
                     std::int64_t width, std::int64_t y, float* slope_x, float* slope_y, float* inside, float* memory) {
    const std::int64_t above = y > 0 ? y - 1 : 0, below = y + 1 < height ? y + 1 : y;
    const float endless = static_cast<float>(HUGE_VAL);
    float *FINGERFLOW_RESTRICT smooth = memory + 1, *FINGERFLOW_RESTRICT change = memory + width + 3, *FINGERFLOW_RESTRICT usable = memory + 2 * width + 5;
    const float *FINGERFLOW_RESTRICT a = clean + above * width, *FINGERFLOW_RESTRICT b = clean + y * width, *FINGERFLOW_RESTRICT c = clean + below * width;
    const float *FINGERFLOW_RESTRICT p = coefficients + above * width, *FINGERFLOW_RESTRICT q = coefficients + y * width;
    const float* FINGERFLOW_RESTRICT r = coefficients + below * width;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < width; ++x) {
        smooth[x] = (a[x] + 4 * b[x] + c[x]) / 6;
        change[x] = (c[x] - a[x]) / 2;
        usable[x] = (fabsf(p[x]) < endless) & (fabsf(q[x]) < endless) & (fabsf(r[x]) < endless) ? 1.0f : 0.0f;
    }
    float* const lines[3] = {smooth, change, usable};
    for (float* const line : lines) {
        line[-1] = line[0];
        line[width] = line[width - 1];
    }
    const bool far_in = y >= margin && y < height - margin;
    float *FINGERFLOW_RESTRICT to_x = slope_x, *FINGERFLOW_RESTRICT to_y = slope_y, *FINGERFLOW_RESTRICT in = inside;
    FINGERFLOW_INDEPENDENT
    for (std::int64_t x = 0; x < width; ++x) {
        const float here = mask[x] * usable[x - 1] * usable[x] * usable[x + 1], counts = far_in ? here : 0.0f;
        in[x] = here;
        to_x[x] = counts * ((smooth[x + 1] - smooth[x - 1]) / 2);
        to_y[x] = counts * ((change[x - 1] + 4 * change[x] + change[x + 1]) / 6);
    }
    for (std::int64_t x = 0; x < width; x = x + 1 == margin && margin < width - margin ? width - margin : x + 1)
        if (x < margin || x >= width - margin) to_x[x] = to_y[x] = 0.0f;
}

void flow_tensor_row(const FlowPicture& picture, std::int64_t y, float* const* tensor, float* known, float* right, float* down, float* memory) {
    const std::int64_t width = picture.width, count = (width + 1) / 2, rows = 2 * y + 1 < picture.height ? 2 : 1;
    float *FINGERFLOW_RESTRICT xx = memory, *FINGERFLOW_RESTRICT xy = memory + width, *FINGERFLOW_RESTRICT yy = memory + 2 * width;
    for (std::int64_t row = 0; row < rows; ++row) {
        const std::int64_t at = (2 * y + row) * width;
        const float *FINGERFLOW_RESTRICT gx = picture.slope_x + at, *FINGERFLOW_RESTRICT gy = picture.slope_y + at;
        const bool second = row == 1;
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = 0; x < width; ++x) {
            xx[x] = (second ? xx[x] : 0.0f) + gx[x] * gx[x];
            xy[x] = (second ? xy[x] : 0.0f) + gx[x] * gy[x];
            yy[x] = (second ? yy[x] : 0.0f) + gy[x] * gy[x];
        }
    }
    for (int k = 0; k < 3; ++k) halve(memory + k * width, width, tensor[k]);
    const float *FINGERFLOW_RESTRICT one = picture.inside + 2 * y * width, *FINGERFLOW_RESTRICT two = one + (rows - 1) * width;
    const float share = rows == 2 ? 0.125f : 0.0625f;  // with a single row, `one` and `two` are the same row
    for (std::int64_t x = 0; x < count; ++x) {
        const std::int64_t a = 2 * x, b = 2 * x + 1 < width ? 2 * x + 1 : a;
        known[x] = one[a] + one[b] + two[a] + two[b] > 0 ? 1.0f : 0.0f;
    }
    for (std::int64_t x = 0; x + 1 < count; ++x) right[x] = share * (one[2 * x + 1] * one[2 * x + 2] + two[2 * x + 1] * two[2 * x + 2]);
    if (!down) return;
    const float* FINGERFLOW_RESTRICT three = two + width;
    for (std::int64_t x = 0; x < count; ++x) {
        const std::int64_t a = 2 * x, b = a + 1;
        down[x] = 0.125f * (two[a] * three[a] + (b < width ? two[b] * three[b] : 0.0f));
    }
}

namespace {

// Weights of the cubic B-spline at a fraction of a pixel.
inline void weights_of(float fraction, float (&weights)[4]) {
    const float rest = 1 - fraction, square = fraction * fraction, rest_square = rest * rest;
    weights[0] = rest_square * rest / 6;
    weights[1] = 2.0f / 3 + square * (fraction / 2 - 1);
    weights[2] = 2.0f / 3 + rest_square * (rest / 2 - 1);
    weights[3] = square * fraction / 6;
}

inline std::int64_t within(std::int64_t value, std::int64_t count) { return value < 0 ? 0 : value < count ? value : count - 1; }

}  // namespace

void flow_warp_row(const float* coefficients, std::int64_t height, std::int64_t width, const float* u, const float* v, float* values,
                   std::int64_t y) {
    const float farthest = 1e6f;  // px, far outside any image
    for (std::int64_t begin = 0, end; begin < width; begin = end) {
        // A run of pixels whose displacements have the same integer part: their taps are contiguous.
        const float whole_u = floorf(u[begin]), whole_v = floorf(v[begin]);
        for (end = begin + 1; end < width && u[end] >= whole_u && u[end] < whole_u + 1 && v[end] >= whole_v && v[end] < whole_v + 1;) ++end;
        const auto right = static_cast<std::int64_t>(fminf(fmaxf(whole_u, -farthest), farthest)) - 1;
        const auto below = static_cast<std::int64_t>(fminf(fmaxf(whole_v, -farthest), farthest)) - 1;
        const float* lines[4];
        for (int k = 0; k < 4; ++k) lines[k] = coefficients + within(y + below + k, height) * width;
        // The range of the run whose taps all lie in the image.
        const std::int64_t first = begin + right < 0 ? (-right < end ? -right : end) : begin;
        const std::int64_t limit = width - 3 - right, last = limit < end ? (limit > first ? limit : first) : end;
        const auto slowly = [&](std::int64_t from, std::int64_t to) {
            for (std::int64_t x = from; x < to; ++x) {
                float across[4], down[4], value = 0;
                weights_of(u[x] - whole_u, across);
                weights_of(v[x] - whole_v, down);
                for (int k = 0; k < 4; ++k) {
                    float line = 0;
                    for (int j = 0; j < 4; ++j) line += across[j] * lines[k][within(x + right + j, width)];
                    value += down[k] * line;
                }
                values[x] = value;
            }
        };
        slowly(begin, first);
        const float *FINGERFLOW_RESTRICT l0 = lines[0] + right, *FINGERFLOW_RESTRICT l1 = lines[1] + right;
        const float *FINGERFLOW_RESTRICT l2 = lines[2] + right, *FINGERFLOW_RESTRICT l3 = lines[3] + right;
        FINGERFLOW_INDEPENDENT
        for (std::int64_t x = first; x < last; ++x) {
            float a[4], d[4];
            weights_of(u[x] - whole_u, a);
            weights_of(v[x] - whole_v, d);
            const float line0 = a[0] * l0[x] + a[1] * l0[x + 1] + a[2] * l0[x + 2] + a[3] * l0[x + 3];
            const float line1 = a[0] * l1[x] + a[1] * l1[x + 1] + a[2] * l1[x + 2] + a[3] * l1[x + 3];
            const float line2 = a[0] * l2[x] + a[1] * l2[x + 1] + a[2] * l2[x + 2] + a[3] * l2[x + 3];
            const float line3 = a[0] * l3[x] + a[1] * l3[x + 1] + a[2] * l3[x + 2] + a[3] * l3[x + 3];
            values[x] = d[0] * line0 + d[1] * line1 + d[2] * line2 + d[3] * line3;
        }
        slowly(last, end);
    }
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
