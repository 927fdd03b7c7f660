// Newton's method for a stage of a step. The block-tridiagonal system is swept from both ends at once: the two sweeps
// are independent, so that they overlap, and a mirrored press has mirrored results.
#pragma once

#include "skin_press.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

template <class T>
inline typename Press<T>::Row Press<T>::assembled(const Body<T>& from, const T* before, std::int64_t i, Pair<T>& held,
                                                    Block<T>& whole) const {
    const Held own = held_at(end, i);
    const Rubbed rubbing = rub(i, from.at[i], end.at[i], before[i]);
    const Pair<T> at = end.at[i], off = known.at[i] - at, pull = drawn(end, i);
    const T none = all<T>(0), links = i == 0 || i == count - 1 ? membrane : 2.0 * membrane;
    const T touching = pick(at.z < none, contact, none);
    held = own.force;
    whole = scaled(c, own.slope);
    const Block<T> column{-whole.xx, -whole.xz, -whole.zx, -whole.zz};
    return {{damping + c * (own.slope.xx + links + rubbing.along), c * (own.slope.xz + rubbing.above), c * own.slope.xz,
             damping + c * (own.slope.zz + links + touching)},
            column,
            column,
            {damping * off.x + c * (pull.x - own.force.x - rubbing.force),
             damping * off.z + c * (pull.z - own.force.z + contact * greater(-at.z, none))}};
}

// Eliminates the neighbour outside a row from it.
template <class T>
inline void Press<T>::follow(Row& row, const Row& before, T joined) const {
    row.undone = row.undone - (joined * joined) * before.undone;
    row.from_bone = row.from_bone - joined * before.from_bone;
    row.to_bone = row.to_bone - joined * (before.to_bone * before.undone);
    row.swept = row.swept - joined * before.swept;
}

template <class T>
inline void Press<T>::finish(Row& row, std::int64_t i, Mask here, bool whole) {
    row.undone = inverse(row.undone);
    row.from_bone = row.undone * row.from_bone;
    row.swept = row.undone * row.swept;
    swept[i] = row.swept;
    if (kLanes == 1 || whole) {
        undone[i] = row.undone, from_bone[i] = row.from_bone, to_bone[i] = row.to_bone;
    } else {
        take(here, undone[i], row.undone), take(here, from_bone[i], row.from_bone), take(here, to_bone[i], row.to_bone);
    }
}

// One Newton step from `end`, taken in the lanes `here`: makes the rows one by one, eliminates them from both ends and
// solves for the bone. Keeps the factored matrix for `solved` in these lanes. Returns the greatest motion.
template <class T>
inline T Press<T>::newton_step(const Body<T>& from, const T* before, Pair<T> load, Mask here, bool whole) {
    const std::int64_t centre = count / 2;
    const T joined = -c * membrane, none = all<T>(0);
    Block<T> of{bone_damping, none, none, bone_damping};
    Pair<T> on_bone{none, none}, bone{none, none}, held{}, other_held{};
    Block<T> slope{}, other_slope{};
    Row left{}, right{};
    for (std::int64_t i = 0; i < centre; ++i) {
        const std::int64_t j = count - 1 - i;
        Row row = assembled(from, before, i, held, slope);
        if (i) follow(row, left, joined);
        finish(row, i, here, whole);
        left = row;
        if (j > centre) {
            row = assembled(from, before, j, other_held, other_slope);
            if (i) follow(row, right, joined);
            finish(row, j, here, whole);
            right = row;
            on_bone = on_bone + (held + other_held);
            of = of + (slope + other_slope) - (left.to_bone * left.from_bone + right.to_bone * right.from_bone);
            bone = bone + (left.to_bone * left.swept + right.to_bone * right.swept);
        } else {
            on_bone = on_bone + held;
            of = of + slope - left.to_bone * left.from_bone;
            bone = bone + left.to_bone * left.swept;
        }
    }
    Row row = assembled(from, before, centre, held, slope);
    const Row sum{left.undone + right.undone, left.from_bone + right.from_bone,
                  left.to_bone * left.undone + right.to_bone * right.undone, left.swept + right.swept};
    row.undone = row.undone - (joined * joined) * sum.undone;
    row.from_bone = row.from_bone - joined * sum.from_bone;
    row.to_bone = row.to_bone - joined * sum.to_bone;
    row.swept = row.swept - joined * sum.swept;
    finish(row, centre, here, whole);
    of = of + slope - row.to_bone * row.from_bone;
    bone = bone + row.to_bone * row.swept;
    if (whole) bone_block = of;
    else take(here, bone_block, of);

    on_bone = on_bone + held;
    const Pair<T> off = known.bone - end.bone;
    const Pair<T> side{bone_damping * off.x + c * (on_bone.x + load.x), bone_damping * off.z + c * (on_bone.z + load.z)};
    bone_gone = inverse(of) * (side - bone);
    T most = farthest(none, bone_gone);
    substitute(bone_gone, [&](std::int64_t i, Pair<T> moved) {
        most = farthest(most, moved);
        if (kLanes == 1 || whole) end.at[i] = end.at[i] + moved;
        else end.at[i] = end.at[i] + Pair<T>{pick(here, moved.x, none), pick(here, moved.z, none)};
    });
    end.bone = end.bone + Pair<T>{pick(here, bone_gone.x, none), pick(here, bone_gone.z, none)};
    return most;
}

// Substitutes the bone's motion back from the centre outwards and calls gone(i, motion) for each element.
template <class T>
template <class Gone>
inline void Press<T>::substitute(Pair<T> by, Gone gone) const {
    const std::int64_t centre = count / 2;
    const T joined = -c * membrane;
    Pair<T> last = swept[centre] - from_bone[centre] * by, other = last;
    gone(centre, last);
    for (std::int64_t i = centre - 1; i >= 0; --i) {
        const std::int64_t j = count - 1 - i;
        last = swept[i] - from_bone[i] * by - joined * (undone[i] * last);
        gone(i, last);
        if (j > centre) {
            other = swept[j] - from_bone[j] * by - joined * (undone[j] * other);
            gone(j, other);
        }
    }
}

// Solves the last factored system for a right-hand side and returns the greatest magnitude of the solution.
template <class T>
inline T Press<T>::solved(const Body<T>& side) {
    const std::int64_t centre = count / 2;
    const T joined = -c * membrane, none = all<T>(0);
    Pair<T> bone{none, none};
    for (std::int64_t i = 0; i < centre; ++i) {
        const std::int64_t j = count - 1 - i;
        swept[i] = undone[i] * (i ? side.at[i] - joined * swept[i - 1] : side.at[i]);
        const Pair<T> one = to_bone[i] * swept[i];
        if (j > centre) {
            swept[j] = undone[j] * (i ? side.at[j] - joined * swept[j + 1] : side.at[j]);
            bone = bone + (one + to_bone[j] * swept[j]);
        } else {
            bone = bone + one;
        }
    }
    swept[centre] = undone[centre] * (side.at[centre] - joined * (swept[centre - 1] + swept[centre + 1]));
    const Pair<T> by = inverse(bone_block) * (side.bone - (bone + to_bone[centre] * swept[centre]));
    T most = farthest(none, by);
    substitute(by, [&](std::int64_t, Pair<T> moved) { most = farthest(most, moved); });
    return most;
}

// Solves damping (X - known) = c forces(X), starting at `end`, which becomes X, and writes the Dahl friction `after`
// the slide from `from`. Lanes without convergence are cleared in `go_on`.
template <class T>
inline void Press<T>::newton(const Body<T>& from, const T* before, T* after, Pair<T> load, const double* tolerance, bool* go_on) {
    bool busy[kLanes];
    Mask going{};
    bool whole = true;
    for (int lane = 0; lane < kLanes; ++lane) {
        Of<T>::set(going, lane, busy[lane] = go_on[lane]);
        whole = whole && busy[lane];
    }
    for (int iteration = 0; iteration < kMostIterations; ++iteration) {
        const T most = newton_step(from, before, load, going, whole);
        bool more = false;
        for (int lane = 0; lane < kLanes; ++lane) {
            if (!busy[lane]) continue;
            const double by = Of<T>::at(most, lane), bone = Of<T>::at(bone_gone.z, lane);
            const bool lost = !(by < 1.0) || bone != bone || iteration + 1 == kMostIterations;  // m
            if (by <= tolerance[lane]) busy[lane] = false;
            else if (lost) busy[lane] = go_on[lane] = false;
            Of<T>::set(going, lane, busy[lane]);
            more = more || busy[lane];
            whole = whole && busy[lane];
        }
        if (!more) break;
    }
    for (std::int64_t i = 0; i < count; ++i) after[i] = rub(i, from.at[i], end.at[i], before[i]).force;
}

}  // namespace
}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
