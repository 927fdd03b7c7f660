// Derivatives of a press by reverse differentiation along the recorded steps.
#pragma once

#include "skin_press.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

// Adjoint of a recorded press (fingerflow/models/skin_adjoint.py); T is double. `left_over` holds the adjoint of the
// positions, `guess` of the positions at the start of a stage, `rubbed_end` of the friction, `start_speed` of the
// velocity.
template <class T>
inline void Press<T>::back(const fingerflow_skin_back& asked, std::int64_t chain) {
    load(chain);
    const std::int64_t size = 3 * count + 2, row = 2 + 2 * size;
    const double* const record = asked.record + chain * asked.record_steps * row;
    double* const stiffness = asked.stiffness + 6 * chain;
    double* const of_mu = asked.of_friction + chain * count;
    for (int k = 0; k < 6; ++k) stiffness[k] = 0;
    const double* const wanted = asked.wanted + chain * size;
    for (std::int64_t i = 0; i < count; ++i) {
        of_mu[i] = 0;
        left_over.at[i] = {wanted[2 * i], wanted[2 * i + 1]};
        rubbed_end[i] = wanted[2 * count + 2 + i];
        start_speed.at[i] = {0, 0};
    }
    left_over.bone = {wanted[2 * count], wanted[2 * count + 1]};
    start_speed.bone = {0, 0};
    for (std::int64_t number = asked.steps[chain] - 1; number >= 0; --number) {
        const double* const step = record + number * row;
        c = (kGamma / 2) * step[1];
        // The velocity at the end is (end - known) / c.
        for (std::int64_t i = 0; i < count; ++i) left_over.at[i] = left_over.at[i] + (1 / c) * start_speed.at[i];
        left_over.bone = left_over.bone + (1 / c) * start_speed.bone;
        read(middle, rubbed_middle, step + 2);
        read(end, nullptr, step + 2 + size);
        through(middle, rubbed_middle, stiffness, of_mu);
        // `known` is the adjoint of the stage's known part, kLater middle - kEarlier start; `guess` of where it slid
        // from.
        for (std::int64_t i = 0; i < count; ++i) {
            const Pair<T> of = known.at[i] - (1 / c) * start_speed.at[i];
            start_speed.at[i] = -kEarlier * of;
            left_over.at[i] = kLater * of + guess.at[i];
        }
        const Pair<T> of = known.bone - (1 / c) * start_speed.bone;
        const Pair<T> earlier = -kEarlier * of;
        left_over.bone = kLater * of;
        end = swapped(end, middle);
        if (number) read(middle, rubbed_middle, step - row + 2 + size);
        else for (std::int64_t i = 0; i < count; ++i) middle.at[i] = start.at[i], rubbed_middle[i] = rubbed[i];
        through(middle, rubbed_middle, stiffness, of_mu);
        for (std::int64_t i = 0; i < count; ++i) {
            left_over.at[i] = start_speed.at[i] + known.at[i] + guess.at[i];
            start_speed.at[i] = c * known.at[i];
        }
        left_over.bone = earlier + known.bone;
        start_speed.bone = c * known.bone;
        hold(start_speed.bone, {0, 0});
    }
    // The first velocity is given by the forces at the start.
    for (std::int64_t i = 0; i < count; ++i) start_speed.at[i] = (1 / damping) * start_speed.at[i], end.at[i] = start.at[i];
    start_speed.bone = (1 / bone_damping) * start_speed.bone;
    end.bone = start.bone;
    by_stiffness(start_speed, 1.0, stiffness);
    double* const result = asked.result + chain * size;
    Pair<T> on_bone = left_over.bone;
    for (std::int64_t i = 0; i < count; ++i) {
        const Pair<T> own = start_speed.at[i], pull = own - start_speed.bone;
        const Pair<T> held = held_at(end, i).slope * pull;
        Pair<T> of = left_over.at[i] - held;
        if (i) of = of + membrane * (start_speed.at[i - 1] - own);
        if (i + 1 < count) of = of + membrane * (start_speed.at[i + 1] - own);
        if (end.at[i].z < 0) of.z -= contact * own.z;
        on_bone = on_bone + held;
        result[2 * i] = of.x;
        result[2 * i + 1] = of.z;
        result[2 * count + 2 + i] = rubbed_end[i] - own.x;
    }
    result[2 * count] = on_bone.x;
    result[2 * count + 1] = on_bone.z;
}

template <class T>
inline void Press<T>::read(Body<T>& body, T* rub, const double* from) const {
    for (std::int64_t i = 0; i < count; ++i) {
        body.at[i] = {from[2 * i], from[2 * i + 1]};
        if (rub != nullptr) rub[i] = from[2 * count + 2 + i];
    }
    body.bone = {from[2 * count], from[2 * count + 1]};
}

// Swaps two bodies: `other` becomes `one`, and the former `other` is returned.
template <class T>
inline Body<T> Press<T>::swapped(Body<T> one, Body<T>& other) {
    const Body<T> before = other;
    other = one;
    return before;
}

// Adjoint of one stage that slid from `from` to `end`. Reads the adjoints of its end in `left_over` and `rubbed_end`;
// writes those of the known part to `known`, of `from` to `guess`, of the friction before to `rubbed_end`.
template <class T>
inline void Press<T>::through(const Body<T>& from, const T* before, double* stiffness, double* of_mu) {
    const auto make = [&](std::int64_t i, Pair<T>& held, Block<T>& slope) {
        const Held own = held_at(end, i);
        const Rubbed rubbing = rub(i, from.at[i], end.at[i], before[i]);
        const double links = i == 0 || i == count - 1 ? membrane : 2.0 * membrane;
        const double touching = end.at[i].z < 0 ? contact : 0.0;
        held = {0, 0};
        slope = scaled(c, own.slope);
        const Block<T> column{-slope.xx, -slope.xz, -slope.zx, -slope.zz};
        return Row{{damping + c * (own.slope.xx + links + rubbing.along), c * own.slope.xz, c * (own.slope.xz + rubbing.above),
                    damping + c * (own.slope.zz + links + touching)},
                   column,
                   column,
                   left_over.at[i] + Pair<T>{rubbing.along * rubbed_end[i], rubbing.above * rubbed_end[i]}};
    };
    const auto side = [&](Pair<T>) { return left_over.bone; };
    const auto gone = [&](std::int64_t i, Pair<T> by) { known.at[i] = by; };
    known.bone = sweep(true, true, make, side, {0, 0}, gone);
    by_stiffness(known, c, stiffness);
    for (std::int64_t i = 0; i < count; ++i) {
        const Rubbed rubbing = rub(i, from.at[i], end.at[i], before[i]);
        const double of = rubbed_end[i] - c * known.at[i].x;
        guess.at[i] = {-rubbing.along * of, rubbing.from_above * of};
        rubbed_end[i] = rubbing.before * of;
        of_mu[i] += rubbing.steep * of * contact;
        stiffness[4] += rubbing.steep * of * mu[i];
        stiffness[5] += rubbing.spring * of;
        known.at[i] = damping * known.at[i];
    }
    known.bone = bone_damping * known.bone;
}

// Adds the derivatives by membrane, tissue, shear, nail and contact stiffness: work of their unit forces at `end` along
// a motion.
template <class T>
inline void Press<T>::by_stiffness(const Body<T>& along, double times, double* stiffness) const {
    double sums[5] = {};
    for (std::int64_t i = 0; i < count; ++i) {
        const Pair<T> at = end.at[i], line{at.x - end.bone.x, at.z - radius - end.bone.z}, off = at - reference[i] - end.bone;
        const Pair<T> pull = along.bone - along.at[i];
        const double ratio = radius / root(line.x * line.x + line.z * line.z), own = pull.x * off.x + pull.z * off.z;
        sums[1] += (1.0 - ratio) * (pull.x * line.x + pull.z * line.z);
        sums[2] += own;
        if (i == 0 || i == count - 1) sums[3] += own;
        sums[4] += along.at[i].z * greater(-at.z, 0.0);
        if (i + 1 < count) {
            const Pair<T> apart = (end.at[i + 1] - reference[i + 1]) - (at - reference[i]), opened = along.at[i + 1] - along.at[i];
            sums[0] -= apart.x * opened.x + apart.z * opened.z;
        }
    }
    for (int k = 0; k < 5; ++k) stiffness[k] += times * sums[k];
}

}  // namespace
}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
