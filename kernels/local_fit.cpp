// Weighted local linear fits around queries (fingerflow/ops/fields/local_fit.py): value, gradient and covariance of a
// plane with weights (1 - r^2 / radius^2)^2.
// Queries near each other go in one block, so that few points beyond the radius are visited.
// Layout: a record of a frame and point is [1 if usable, values less their mean, noise], contiguous; an unusable one is
// zero. Blocks hold kFitBlock queries, one a lane (local_fit_block.h), and serve all frames that share points and
// queries.
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "interface.h"
#include "local_fit_block.h"
#include "local_fit_cloud.h"
#include "parallel.h"
#include "workspace.h"

namespace fingerflow {
namespace {

template <class Real>
class Fits {
public:
    Fits(const fingerflow_local_fit& given, double radius, double least_spread)
        : given_(given), radius_(radius), least_spread_(least_spread), shared_(given.points_batch == 1 && given.queries_batch == 1),
          symmetric_(symmetric(given)), records_(given.batch, given.point_count, given.components, given.noises) {}

    void run(int threads) {
        if (given_.batch == 0) return;
        parallel_for(given_.batch, threads, [&](std::int64_t frame) { record(frame); });
        records_.compare();
        if (shared_) {
            const auto blocks = blocks_of(0, threads);
            parallel_for(blocks->count(), threads, [&](std::int64_t block) { fit(0, (*blocks)[block]); });
            return;
        }
        parallel_for(given_.batch, threads, [&](std::int64_t geometry) {
            const auto blocks = blocks_of(geometry, 1);
            for (std::int64_t block = 0; block < blocks->count(); ++block) fit(geometry, (*blocks)[block]);
        });
    }

private:
    static bool symmetric(const fingerflow_local_fit& given) {
        const std::int64_t components = given.components, numbers = given.noise_batch * given.point_count * given.noises;
        if (given.noises != components * components) return false;
        const auto* const noise = static_cast<const Real*>(given.noise);
        for (const Real* own = noise; own < noise + numbers; own += given.noises)
            for (std::int64_t i = 1; i < components; ++i)
                for (std::int64_t j = 0; j < i; ++j) {
                    const Real one = own[i * components + j], other = own[j * components + i];
                    if (one != other && !(std::isnan(one) && std::isnan(other))) return false;
                }
        return true;
    }
    const Real* part(const void* all, std::int64_t batch, std::int64_t frame, std::int64_t numbers) const {
        return static_cast<const Real*>(all) + (batch == 1 ? 0 : frame) * numbers;
    }
    const Real* points(std::int64_t frame) const {
        return part(given_.points, given_.points_batch, frame, 2 * given_.point_count);
    }
    const Real* queries(std::int64_t frame) const {
        return part(given_.queries, given_.queries_batch, frame, 2 * given_.query_count);
    }

    void record(std::int64_t frame) {
        const std::int64_t count = given_.point_count, components = given_.components, noises = given_.noises;
        const Real* const place = points(frame);
        const Real* const values = part(given_.values, given_.values_batch, frame, count * components);
        const Real* const noise = part(given_.noise, given_.noise_batch, frame, count * noises);
        const std::int64_t own = noises == 1 ? 1 : components + 1;  // step from one component's variance to the next
        records_.fill(frame, [&](std::int64_t k, Real* to) {
            const Real *value = values + k * components, *variance = noise + k * noises;
            bool good = finite(place + 2 * k, 2) && finite(value, components) && finite(variance, noises);
            for (std::int64_t v = 0; v < noises; v += own) good = good && variance[v] >= 0;
            std::copy(value, value + components, to);
            std::copy(variance, variance + noises, to + components);
            return good;
        });
    }

    // Blocks of the queries of a geometry; writes NaN for queries that are not finite.
    typename FitBlocks<Real>::Shared blocks_of(std::int64_t geometry, int threads) {
        const auto blocks = FitBlocks<Real>::around(points(geometry), given_.point_count, queries(geometry), given_.query_count, radius_, threads);
        if (blocks->finite_queries() < given_.query_count) {
            const FitFrames<Real> frames = frames_of(geometry);
            const Real unknown = std::numeric_limits<Real>::quiet_NaN();
            for (std::int64_t k = 0; k < frames.count * frames.queries; ++k) {
                if (finite(queries(geometry) + 2 * (k % frames.queries), 2)) continue;
                const std::int64_t components = frames.components, squared = 4 * components * components;
                std::fill_n(frames.value + k * components, components, unknown);
                std::fill_n(frames.gradient + 2 * k * components, 2 * components, unknown);
                if (frames.covariance != nullptr) std::fill_n(frames.covariance + k * squared, squared, unknown);
                frames.point_count[k] = 0;
                frames.offset[k] = unknown;
            }
        }
        return blocks;
    }

    FitFrames<Real> frames_of(std::int64_t geometry) {
        const std::int64_t components = given_.components, first = geometry * given_.query_count;
        FitFrames<Real> frames{shared_ ? given_.batch : 1,
                               given_.point_count,
                               given_.query_count,
                               components,
                               given_.noises,
                               given_.minimum_points,
                               static_cast<Real>(radius_),
                               static_cast<Real>(least_spread_),
                               records_.of(geometry),
                               records_.levels_of(geometry),
                               records_.same_usable(),
                               symmetric_,
                               static_cast<Real*>(given_.value) + first * components,
                               static_cast<Real*>(given_.gradient) + 2 * first * components};
        if (given_.covariance != nullptr)
            frames.covariance = static_cast<Real*>(given_.covariance) + 4 * first * components * components;
        frames.point_count = given_.counts + first;
        frames.offset = static_cast<Real*>(given_.offset) + first;
        return frames;
    }

    void fit(std::int64_t geometry, const FitBlock<Real>& block) {
        const FitFrames<Real> frames = frames_of(geometry);
        fit_block(frames, block, static_cast<Real*>(workspace(sizeof(Real) * size(fit_memory(frames)))));
    }

    const fingerflow_local_fit given_;
    const double radius_, least_spread_;
    const bool shared_, symmetric_;
    FitRecords<Real> records_;
};

}  // namespace
}  // namespace fingerflow

void fingerflow_local_gradients(const fingerflow_local_fit* given, double radius, double least_spread, int points_kind,
    int threads) {
    if (points_kind)
        fingerflow::Fits<double>(*given, radius, least_spread).run(threads);
    else
        fingerflow::Fits<float>(*given, radius, least_spread).run(threads);
}
