// Weighted linear fits around a block of neighbouring queries, for one or many frames (local_fit_block.cpp).
#pragma once

#include <cstdint>

#include "instruction_sets.h"

namespace fingerflow {

// Queries of a block; the last is repeated where there are fewer.
constexpr int kFitBlock = 16;
// Weights of a point at each query: 1 within the radius, w, w dx, w dy, w dx dx, w dx dy, w dy dy.
constexpr int kFitWeights = 7;

// Frames that share points and queries, and their results. Records (frames, points, 1 + components + noises) hold 1,
// the values less their levels and the variances of a usable point, zeros for any other.
template <class Real>
struct FitFrames {
    std::int64_t count, points, queries, components, noises, minimum_points;
    Real radius, least_spread;
    const Real* records;
    const Real* levels;                // (frames, components)
    const unsigned char* same_usable;  // (frames), whether the usable points are those of the previous frame
    bool symmetric;                    // whether all noise matrices are symmetric
    Real* value;                       // (frames, queries, components), or null if not needed
    Real* gradient;
    Real* covariance = nullptr;           // null without variances
    std::int64_t* point_count = nullptr;  // null if neither it nor the offset is needed
    Real* offset = nullptr;
};

// Queries, and candidates: the points that may lie within the radius of one of them.
template <class Real>
struct FitBlock {
    Real query_x[kFitBlock], query_y[kFitBlock];
    std::int64_t query[kFitBlock];  // their indices
    int queries;
    const Real *x, *y;  // (candidates)
    const std::int64_t* point;
    std::int64_t candidates;
};

// Numbers that `memory` of a block must hold.
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
