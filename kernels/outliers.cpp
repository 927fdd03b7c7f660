// Outliers among tracked points (fingerflow/ops/tracking/outliers.py), in three steps of which each reads the
// neighbours' results of the one before: a local fit of the displacements, slopes averaged over neighbours, and the
// judgement.
// Layout: kOutlierColumns columns of `stride` floats a frame, one a point (OutlierFrame); pieces of eight blocks of
// kJudged points, one a lane.
#include <algorithm>
#include <cstdint>
#include <vector>

#include "interface.h"
#include "outliers_points.h"
#include "parallel.h"

void fingerflow_find_outliers(const fingerflow_outliers* given, int threads) {
    using namespace fingerflow;
    const std::int64_t blocks = given->stride / kJudged, at_a_time = 8, pieces = (blocks + at_a_time - 1) / at_a_time;
    std::vector<float> memory(static_cast<std::size_t>(given->frames * given->stride * kOutlierColumns));
    const auto frame_of = [&](std::int64_t frame) {
        float* column = memory.data() + frame * given->stride * kOutlierColumns;
        const auto take = [&] {
            float* const taken = column;
            column += given->stride;
            return taken;
        };
        OutlierFrame of{};
        for (float** one : {&of.u, &of.v, &of.variance, &of.certainty, &of.one, &of.number, &of.level, &of.fitted, &of.slope[0],
                            &of.slope[1], &of.slope[2], &of.slope[3], &of.trust, &of.agreement})
            *one = take();
        return of;
    };
    const auto for_pieces = [&](const auto& act) {
        parallel_for(given->frames * pieces, threads, [&](std::int64_t piece) {
            const std::int64_t frame = piece / pieces, first = piece % pieces * at_a_time;
            act(frame, frame_of(frame), first, std::min(blocks, first + at_a_time));
        });
    };
    const auto read = FINGERFLOW_PICK(read_displacements);
    const auto fit = FINGERFLOW_PICK(fit_neighbours);
    const auto borrow = FINGERFLOW_PICK(borrow_slopes);
    const auto judge = FINGERFLOW_PICK(judge_points);
    parallel_for(given->frames, threads, [&](std::int64_t frame) { read(*given, frame, frame_of(frame)); });
    for_pieces([&](std::int64_t, const OutlierFrame& of, std::int64_t first, std::int64_t last) { fit(*given, of, first, last); });
    for_pieces([&](std::int64_t, const OutlierFrame& of, std::int64_t first, std::int64_t last) { borrow(*given, of, first, last); });
    for_pieces([&](std::int64_t frame, const OutlierFrame& of, std::int64_t first, std::int64_t last) { judge(*given, frame, of, first, last); });
}
