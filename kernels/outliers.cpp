// build: each instruction set
// Outliers among tracked points by the agreement with their neighbours (fingerflow/ops/tracking/outliers.py), in three
// steps of which each reads the neighbours' results of the one before: a local fit of the displacements, slopes averaged
// over neighbours, and the judgement.
// Disagreement with neighbours j above a plane: harmonic mean of 1 + z_j^2, z_j^2 = |du_j|^2 / (var + var_j), for
// slopes 0, slopes fitted to the neighbours, and slopes averaged over neighbours; the least of the three counts.
// Layout: kOutlierColumns columns of `stride` floats a frame, one a point (OutlierFrame); neighbours are (neighbours,
// stride). Pieces of eight blocks of kJudged points, one a lane. The neighbours of a block are copied to `memory`
// (neighbours, kNeighbour, kJudged), which several steps read, as gathering them takes longer than the arithmetic.
#include <math.h>

#include "floats.h"
#include "instruction_sets.h"
#include "interface.h"
#include "lanes.h"

namespace fingerflow {

constexpr int kJudged = 16;    // points of a block
constexpr int kNeighbour = 4;  // floats of a neighbour in `memory`

// Columns (stride) of a frame's points: read_displacements writes u to `one`, fit_neighbours `number` to `fitted` and `slopes`,
// borrow_slopes `agreement`. `one` is 1 for a known point, else 0, with u = v = 0.
struct OutlierFrame {
    float *u, *v, *variance, *certainty, *one;
    float *number, *level, *fitted;  // `number` of neighbours that count; `level` is 1 without any
    float* agreement;
    float* slopes;  // kSlopes columns, (stride, kSlopes): four slopes times their weight, the weight, and zeros
};
constexpr int kSlopes = 8, kOutlierColumns = 9 + kSlopes;

namespace FINGERFLOW_ISA {
namespace {

constexpr float kLeast = 1e-30f;

inline float at_least(float value, float least) { return value < least ? least : value; }
inline float least_of(float a, float b) { return a < b || a != a ? a : b; }  // NaN where either is NaN

struct Lane {
    float of[kJudged];
    float& operator[](int q) { return of[q]; }
    float operator[](int q) const { return of[q]; }
};

// Calls act(q) for all points of a block, one a lane.
template <class Act>
inline void for_block(const Act& act) {
    FINGERFLOW_INDEPENDENT
    for (int q = 0; q < kJudged; ++q) act(q);
}

// A block of points and their neighbours.
class Block {
public:
    // Copies of each neighbour its displacement relative to the point, 1 / (sum of both variances), and 1 if it counts,
    // else 0.
    Block(const fingerflow_outliers& given, const OutlierFrame& frame, std::int64_t first, float* memory)
        : given_(given), first_(first), memory_(memory) {
        const float *FINGERFLOW_RESTRICT const u = frame.u, *FINGERFLOW_RESTRICT const v = frame.v;
        const float *FINGERFLOW_RESTRICT const variance = frame.variance, *FINGERFLOW_RESTRICT const one = frame.one;
        for (std::int64_t k = 0; k < given.neighbours; ++k) {
            const std::int32_t* FINGERFLOW_RESTRICT const number = given.number + k * given.stride + first;
            const float* FINGERFLOW_RESTRICT const within = given.within + k * given.stride + first;
            float* FINGERFLOW_RESTRICT const to = memory + k * kNeighbour * kJudged;
            for_block([=](int q) {
                const std::int32_t there = number[q];
                to[q] = u[there] - u[first + q];
                to[kJudged + q] = v[there] - v[first + q];
                to[2 * kJudged + q] = 1 / (variance[there] + variance[first + q]);
                to[3 * kJudged + q] = one[there] * within[q];
            });
        }
    }

    // Calls act(q, x, y, u, v, precision, weight) for each neighbour of each point q; x and y are its offset.
    template <class Act>
    void for_neighbours(const Act& act) const {
        for (std::int64_t k = 0; k < given_.neighbours; ++k) {
            const float *const x = given_.x + k * given_.stride + first_, *const y = given_.y + k * given_.stride + first_;
            const float* FINGERFLOW_RESTRICT const of = memory_ + k * kNeighbour * kJudged;
            for_block([&](int q) { act(q, x[q], y[q], of[q], of[kJudged + q], of[2 * kJudged + q], of[3 * kJudged + q]); });
        }
    }

    // The harmonic mean of 1 + z^2 over the neighbours relative to planes of these slopes; 1 without neighbours.
    Lane agreement(const Lane (&slope)[4], const float* number) const {
        Lane agreeing{}, result;
        for_neighbours([&](int q, float x, float y, float u, float v, float precision, float weight) {
            const float du = u - slope[0][q] * x - slope[1][q] * y, dv = v - slope[2][q] * x - slope[3][q] * y;
            agreeing[q] += weight / (1 + (du * du + dv * dv) * precision);
        });
        for_block([&](int q) { result[q] = number[q] > 0 ? number[q] / at_least(agreeing[q], kLeast) : 1; });
        return result;
    }

private:
    const fingerflow_outliers& given_;
    const std::int64_t first_;
    const float* const memory_;
};

void fit(const fingerflow_outliers& given, const OutlierFrame& frame, std::int64_t first, float* memory) {
    const Block block(given, frame, first, memory);
    Lane agreeing{}, number{}, level;
    block.for_neighbours([&](int q, float, float, float u, float v, float precision, float weight) {
        agreeing[q] += weight / (1 + (u * u + v * v) * precision);
        number[q] += weight;
    });
    for_block([&](int q) { level[q] = number[q] > 0 ? number[q] / at_least(agreeing[q], kLeast) : 1; });

    // Plane through the point, fitted to neighbours with weights that fall with their disagreement.
    Lane total{}, sum_x{}, sum_y{}, xx{}, xy{}, yy{}, rise[2]{}, along_x[2]{}, along_y[2]{};
    block.for_neighbours([&](int q, float x, float y, float u, float v, float precision, float weight) {
        weight /= 1 + (u * u + v * v) * precision / (given.spread * level[q]);
        const float by_x = weight * x, by_y = weight * y;
        total[q] += weight;
        sum_x[q] += by_x;
        sum_y[q] += by_y;
        xx[q] += by_x * x;
        xy[q] += by_x * y;
        yy[q] += by_y * y;
        rise[0][q] += weight * u;
        rise[1][q] += weight * v;
        along_x[0][q] += by_x * u;
        along_x[1][q] += by_x * v;
        along_y[0][q] += by_y * u;
        along_y[1][q] += by_y * v;
    });
    Lane slope[4];
    for_block([&](int q) {
        const float mass = at_least(total[q], kLeast), mean_x = sum_x[q] / mass, mean_y = sum_y[q] / mass;
        float a = xx[q] - mean_x * sum_x[q], b = xy[q] - mean_x * sum_y[q], d = yy[q] - mean_y * sum_y[q];
        const float ridge = given.ridge * (a + d) + kLeast;
        a += ridge;
        d += ridge;
        const float determinant = at_least(a * d - b * b, kLeast);
        for (int c = 0; c < 2; ++c) {
            const float x = along_x[c][q] - mean_x * rise[c][q], y = along_y[c][q] - mean_y * rise[c][q];
            slope[2 * c][q] = (d * x - b * y) / determinant;
            slope[2 * c + 1][q] = (a * y - b * x) / determinant;
        }
    });
    const Lane fitted = block.agreement(slope, number.of);
    for_block([&](int q) {
        const float trust = frame.one[first + q] / (fitted[q] * fitted[q]);
        frame.number[first + q] = number[q];
        frame.level[first + q] = level[q];
        frame.fitted[first + q] = fitted[q];
        float* const row = frame.slopes + (first + q) * kSlopes;
        for (int c = 0; c < 4; ++c) row[c] = slope[c][q] * trust;
        row[4] = trust;
    });
}

void borrow(const fingerflow_outliers& given, const OutlierFrame& frame, std::int64_t first, float* memory) {
    Register<float, kSlopes> sums[kJudged] = {};
    for (std::int64_t k = 0; k < given.neighbours; ++k) {
        const std::int64_t at = k * given.stride + first;
        for (int q = 0; q < kJudged; ++q)
            sums[q] += loaded<Register<float, kSlopes>>(frame.slopes + given.number[at + q] * kSlopes) * given.within[at + q];
    }
    Lane slope[4];
    for (int q = 0; q < kJudged; ++q) {
        const float* const row = frame.slopes + (first + q) * kSlopes;
        const float all = at_least(sums[q][4] + row[4], kLeast);
        for (int c = 0; c < 4; ++c) slope[c][q] = (sums[q][c] + row[c]) / all;
    }
    const Lane borrowed = Block(given, frame, first, memory).agreement(slope, frame.number + first);
    for_block([&](int q) {
        const float least = least_of(least_of(frame.level[first + q], frame.fitted[first + q]), borrowed[q]);
        frame.agreement[first + q] = 1 / sqrtf(least);
    });
}

void judge(const fingerflow_outliers& given, std::int64_t frame_number, const OutlierFrame& frame, std::int64_t first) {
    Lane agreement{}, certainty{};
    for (std::int64_t k = 0; k < given.neighbours; ++k) {
        const std::int64_t at = k * given.stride + first;
        for_block([&](int q) {
            const std::int32_t there = given.number[at + q];
            const float weight = frame.one[there] * given.within[at + q];
            agreement[q] += frame.agreement[there] * weight;
            certainty[q] += frame.certainty[there] * weight;
        });
    }
    const std::int64_t left = given.points - first;
    for (int q = 0; q < (left < kJudged ? static_cast<int>(left) : kJudged); ++q) {
        const float number = frame.number[first + q];
        const bool judged = frame.one[first + q] != 0 && number >= static_cast<float>(given.least_neighbours);
        // Harmonic means of the neighbours' disagreement and deviation, in which outliers among them hardly count.
        const float usual = number / at_least(agreement[q], kLeast), usual_deviation = number / at_least(certainty[q], kLeast);
        const std::int64_t to = frame_number * given.points + first + q;
        given.off_neighbours[to] = judged && 1 / frame.agreement[first + q] > given.most_disagreement * usual;
        given.uncertain[to] = judged && sqrtf(frame.variance[first + q]) > given.most_uncertainty * usual_deviation;
    }
}

}  // namespace

// Three steps over blocks `first` to before `last`, after read_displacements for all points of a frame.
void read_displacements(const fingerflow_outliers& given, std::int64_t frame, const OutlierFrame& to) {
    const float* const displacement = given.displacement + 2 * frame * given.points;
    const float* const deviation = given.deviation + frame * given.points;
    for (std::int64_t k = 0; k < given.stride; ++k) {
        const bool inside = k < given.points;
        const float u = inside ? displacement[2 * k] : NAN, v = inside ? displacement[2 * k + 1] : NAN;
        const float sum = u + v + (inside ? deviation[k] : NAN);
        const bool known = sum - sum == 0;
        const float sure = at_least(known ? deviation[k] : 1, given.least_deviation);
        to.u[k] = known ? u : 0;
        to.v[k] = known ? v : 0;
        to.variance[k] = sure * sure;
        to.certainty[k] = 1 / sure;
        to.one[k] = known ? 1.0f : 0.0f;
    }
}

void fit_neighbours(const fingerflow_outliers& given, const OutlierFrame& of, std::int64_t first, std::int64_t last, float* memory) {
    for (std::int64_t block = first; block < last; ++block) fit(given, of, block * kJudged, memory);
}
void borrow_slopes(const fingerflow_outliers& given, const OutlierFrame& of, std::int64_t first, std::int64_t last, float* memory) {
    for (std::int64_t block = first; block < last; ++block) borrow(given, of, block * kJudged, memory);
}
void judge_points(const fingerflow_outliers& given, std::int64_t frame, const OutlierFrame& of, std::int64_t first, std::int64_t last) {
    for (std::int64_t block = first; block < last; ++block) judge(given, frame, of, block * kJudged);
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow

#if FINGERFLOW_ONCE

#include <vector>

#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
FINGERFLOW_OTHER_SETS(read_displacements)
FINGERFLOW_OTHER_SETS(fit_neighbours)
FINGERFLOW_OTHER_SETS(borrow_slopes)
FINGERFLOW_OTHER_SETS(judge_points)
}  // namespace fingerflow

void fingerflow_find_outliers(const fingerflow_outliers* given, int threads) {
    using namespace fingerflow;
    std::vector<float> memory(static_cast<std::size_t>(given->frames * given->stride * kOutlierColumns));
    const auto frame_of = [&](std::int64_t frame) {
        float* column = memory.data() + frame * given->stride * kOutlierColumns;
        const auto take = [&] {
            float* const taken = column;
            column += given->stride;
            return taken;
        };
        OutlierFrame of{};
        for (float** one : {&of.u, &of.v, &of.variance, &of.certainty, &of.one, &of.number, &of.level, &of.fitted, &of.agreement, &of.slopes})
            *one = take();
        return of;
    };
    const std::size_t copied = sizeof(float) * kNeighbour * kJudged * static_cast<std::size_t>(given->neighbours);
    const auto in_pieces = [&](const auto& act) {
        for_bands(given->frames, given->stride / kJudged, 8, threads, act);
    };
    parallel_for(given->frames, threads, [&](std::int64_t frame) { FINGERFLOW_PICK(read_displacements)(*given, frame, frame_of(frame)); });
    in_pieces([&](std::int64_t frame, std::int64_t first, std::int64_t last) {
        FINGERFLOW_PICK(fit_neighbours)(*given, frame_of(frame), first, last, static_cast<float*>(workspace(copied)));
    });
    in_pieces([&](std::int64_t frame, std::int64_t first, std::int64_t last) {
        FINGERFLOW_PICK(borrow_slopes)(*given, frame_of(frame), first, last, static_cast<float*>(workspace(copied)));
    });
    in_pieces([&](std::int64_t frame, std::int64_t first, std::int64_t last) {
        FINGERFLOW_PICK(judge_points)(*given, frame, frame_of(frame), first, last);
    });
}

#endif
