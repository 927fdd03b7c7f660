// build: each instruction set, fused
// Time steps of skin chains by TR-BDF2 (fingerflow/models/skin_implicit.py): damping X' = forces(X), a trapezoidal
// stage to gamma = 2 - sqrt(2) of a step, then BDF2 to its end; step control by the embedded error estimate.
// Layout: one chain a lane, or a single chain in doubles (template T); elements are contiguous arrays of Pair<T>. Each
// lane has its own step and time.
#include "skin_chain_press.h"

#include "skin_press.h"
#include "skin_press_forces.h"
#include "skin_press_newton.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

// Writes the unbalanced forces at `start` to `left_over` and returns the sum of their magnitudes.
template <class T>
inline T Press<T>::unbalanced(Pair<T> load) {
    elastic(left_over);
    T sum = all<T>(0);
    for (std::int64_t i = 0; i < count; ++i) {
        left_over.at[i].x = left_over.at[i].x - rubbed[i];
        sum = sum + magnitude(left_over.at[i].x) + magnitude(left_over.at[i].z);
    }
    left_over.bone = left_over.bone + load;
    return sum + magnitude(left_over.bone.x) + magnitude(left_over.bone.z);
}

template <class T>
inline void Press<T>::run(std::int64_t first, std::int64_t chains) {
    load(first);
    Pair<T> load_first, load_change;
    T rest;
    double time[kLanes] = {}, step[kLanes], next[kLanes], tolerance[kLanes], error[kLanes];
    std::int64_t steps[kLanes] = {}, rejected[kLanes] = {};
    bool live[kLanes], go_on[kLanes];
    for (int lane = 0; lane < kLanes; ++lane) {
        const std::int64_t chain = chain_of(first, lane);
        put(load_first.x, lane, given.load[4 * chain]);
        put(load_first.z, lane, given.load[4 * chain + 1]);
        put(load_change.x, lane, given.load[4 * chain + 2] - given.load[4 * chain]);
        put(load_change.z, lane, given.load[4 * chain + 3] - given.load[4 * chain + 1]);
        put(rest, lane, given.rest[chain]);
        next[lane] = given.step[chain];
        tolerance[lane] = 0.1 * given.tolerance;
        live[lane] = first + lane < given.batch && lane < chains;
    }
    const double duration = given.duration;
    unbalanced(load_first);
    for (std::int64_t i = 0; i < count; ++i) start_speed.at[i] = (1.0 / damping) * left_over.at[i];
    start_speed.bone = {left_over.bone.x / bone_damping, left_over.bone.z / bone_damping};

    for (std::int64_t attempt = 0; attempt < given.most_steps; ++attempt) {
        bool some = false;
        T h{}, begin{};
        for (int lane = 0; lane < kLanes; ++lane) {
            const double left = duration - time[lane];
            step[lane] = next[lane] > 0.99 * left ? left : next[lane];
            if (!live[lane]) step[lane] = 1e-9;
            put(h, lane, step[lane]);
            put(begin, lane, time[lane] / duration);
            go_on[lane] = live[lane];
            some = some || live[lane];
        }
        if (!some) break;
        c = (kGamma / 2) * h;
        const T share = h * (1 / duration), gone = kGamma * h, to_go = (1 - kGamma) * h;
        // First stage, to gamma of the step.
        for (std::int64_t i = 0; i < count; ++i) {
            known.at[i] = start.at[i] + c * start_speed.at[i];
            end.at[i] = start.at[i] + gone * start_speed.at[i];
        }
        known.bone = start.bone + c * start_speed.bone;
        end.bone = start.bone + gone * start_speed.bone;
        newton(start, rubbed, rubbed_middle, load_first + (begin + kGamma * share) * load_change, tolerance, go_on);
        const T per_c = 1.0 / c;
        for (std::int64_t i = 0; i < count; ++i) {
            middle.at[i] = end.at[i];
            middle_speed.at[i] = per_c * (end.at[i] - known.at[i]);
        }
        middle.bone = end.bone;
        middle_speed.bone = per_c * (end.bone - known.bone);
        // Second stage, to the end of the step.
        for (std::int64_t i = 0; i < count; ++i) {
            known.at[i] = all<T>(kLater) * middle.at[i] - all<T>(kEarlier) * start.at[i];
            end.at[i] = middle.at[i] + to_go * middle_speed.at[i];
        }
        known.bone = all<T>(kLater) * middle.bone - all<T>(kEarlier) * start.bone;
        end.bone = middle.bone + to_go * middle_speed.bone;
        newton(middle, rubbed_middle, rubbed_end, load_first + (begin + share) * load_change, tolerance, go_on);
        // The error estimate; `guess` holds the velocity at the end.
        const auto estimate = [&](Pair<T> one, Pair<T> two, Pair<T> three) {
            return all<T>(1 / kGamma) * one - all<T>(1 / (kGamma * (1 - kGamma))) * two + all<T>(1 / (1 - kGamma)) * three;
        };
        for (std::int64_t i = 0; i < count; ++i) {
            guess.at[i] = per_c * (end.at[i] - known.at[i]);
            left_over.at[i] = (damping * (kError * h)) * estimate(start_speed.at[i], middle_speed.at[i], guess.at[i]);
        }
        guess.bone = per_c * (end.bone - known.bone);
        left_over.bone = (bone_damping * (kError * h)) * estimate(start_speed.bone, middle_speed.bone, guess.bone);
        const T most = solved(left_over);
        Mask kept{};
        bool any_kept = false;
        for (int lane = 0; lane < kLanes; ++lane) {
            bool keep = false;
            if (live[lane]) {
                error[lane] = go_on[lane] ? Of<T>::at(most, lane) / given.tolerance : 1e30;
                if (!(error[lane] < 1e30)) error[lane] = 1e30;
                keep = error[lane] <= 1;
            }
            Of<T>::set(kept, lane, keep);
            any_kept = any_kept || keep;
        }
        if (any_kept) {
            for (std::int64_t i = 0; i < count; ++i) {
                take(kept, start.at[i], end.at[i]);
                take(kept, start_speed.at[i], guess.at[i]);
                rubbed[i] = pick(kept, rubbed_end[i], rubbed[i]);
            }
            take(kept, start.bone, end.bone);
            take(kept, start_speed.bone, guess.bone);
        }
        for (int lane = 0; lane < kLanes; ++lane) {
            if (!live[lane]) continue;
            // A step shortened to end at the duration does not limit the next one.
            const double growth = quarters(error[lane]);
            if (growth < 1 || step[lane] == next[lane]) next[lane] = step[lane] * growth;
            if (error[lane] <= 1) {
                time[lane] += step[lane];
                ++steps[lane];
                if (time[lane] >= duration * (1 - 1e-12)) {
                    time[lane] = duration;
                    live[lane] = false;
                }
            } else {
                ++rejected[lane];
            }
            if (next[lane] < 1e-13) live[lane] = false;
        }
        if (any_kept) {
            T share_gone{};
            for (int lane = 0; lane < kLanes; ++lane) put(share_gone, lane, time[lane] / duration);
            const T sum = unbalanced(load_first + share_gone * load_change);
            for (int lane = 0; lane < kLanes; ++lane)
                if (Of<T>::in(kept, lane) && Of<T>::at(sum, lane) <= Of<T>::at(rest, lane)) live[lane] = false;
        }
    }
    store(first, chains);
    for (int lane = 0; lane < kLanes && lane < chains && first + lane < given.batch; ++lane) {
        const std::int64_t chain = first + lane;
        given.step[chain] = next[lane];
        given.time[chain] = time[lane];
        given.counts[2 * chain] = steps[lane];
        given.counts[2 * chain + 1] = rejected[lane];
    }
}

// Growth of the step in powers of 2^(1/4), from 2^(-7/4) to 2, so that rounding of the error does not change the steps.
template <class T>
inline double Press<T>::quarters(double error) {
    const double root = 1.18920711500272106672;
    const double wanted = floor(4 * log2(0.7 / cbrt(error < 1e-9 ? 1e-9 : error)));
    double growth = 1;
    for (double k = 0; k < wanted && k < 4; ++k) growth *= root;
    for (double k = 0; k > wanted && k > -7; --k) growth /= root;
    return growth;
}

template <class T>
void press_group(const fingerflow_skin_chain& given, std::int64_t first, std::int64_t chains, void* memory) {
    Press<T>(given, static_cast<char*>(memory)).run(first, chains);
}

}  // namespace

SkinGroup skin_group(std::int64_t count, std::int64_t batch) {
    const std::int64_t chains = batch == 1 ? 1 : kSide;
    return {chains, chains * count * kBytesEach};
}

void press_skin(const fingerflow_skin_chain& given, std::int64_t first, std::int64_t chains, void* memory) {
#if defined(__GNUC__) || defined(__clang__)
    if (chains > 1) {
        press_group<Doubles>(given, first, chains, memory);
        return;
    }
#endif
    press_group<double>(given, first, chains, memory);
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
