// Weighted linear fits around some queries that lie near each other, in one cloud of points, for one or many frames.
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

// Queries of a block; the last one is repeated where there are fewer.
constexpr int kFitBlock = 16;
// Weights of a point at every query of a block: 1 within the radius, w, w dx, w dy, w dx dx, w dx dy, w dy dy.
constexpr int kFitWeights = 7;

// Frames that share points and queries, and where their results go. Records (frames, points, 1 + components + noises)
// hold 1 for a point that is usable, its values without their level, its variances; zeros for one that is not.
template <class Real>
struct FitFrames {
    std::int64_t count, points, queries, components, noises, minimum_points;
    Real radius, least_spread;
    const Real* records;
    const Real* levels;                // (frames, components)
    const unsigned char* same_usable;  // (frames), whether the usable points are those of the frame before
    bool symmetric;                    // covariances are, so that half of what is beside their diagonal tells the rest
    Real* value;                       // (frames, queries, components) and so on, or null: not needed
    Real* gradient;
    Real* covariance;  // null without variances
    std::int64_t* point_count;  // null: neither it nor the offset is needed
    Real* offset;
};

// Queries, and the points that may lie within the radius of one of them.
template <class Real>
struct FitBlock {
    Real query_x[kFitBlock], query_y[kFitBlock];
    std::int64_t query[kFitBlock];  // their numbers
    int queries;
    const Real *x, *y;  // (candidates)
    const std::int64_t* point;
    std::int64_t candidates;
};

// How many numbers `memory` of a block has to hold.
template <class Real>
std::int64_t fit_memory(const FitFrames<Real>& frames) {
    return kFitBlock * (kFitWeights * (frames.points + 1) + 2 * 3 * frames.components + 6 * frames.noises);
}

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    void fit_floats(const FitFrames<float>& frames, const FitBlock<float>& block, float* memory);
    void fit_doubles(const FitFrames<double>& frames, const FitBlock<double>& block, double* memory);
)
// clang-format on

}  // namespace fingerflow
