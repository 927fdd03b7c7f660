// Forces of skin, tissue, nail, plate and friction on the elements of a chain.
#pragma once

#include "skin_press.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

// Elastic and contact forces on elements and bone at `start`.
template <class T>
inline void Press<T>::elastic(Body<T>& force) const {
    Pair<T> sum{all<T>(0), all<T>(0)};
    for (std::int64_t i = 0, j = count - 1; i <= j; ++i, --j) {
        const Held one = held_at(start, i);
        force.at[i] = drawn(start, i) - one.force;
        force.at[i].z = force.at[i].z + contact * greater(-start.at[i].z, all<T>(0));
        if (i == j) {
            sum = sum + one.force;
            break;
        }
        const Held other = held_at(start, j);
        force.at[j] = drawn(start, j) - other.force;
        force.at[j].z = force.at[j].z + contact * greater(-start.at[j].z, all<T>(0));
        sum = sum + (one.force + other.force);  // symmetric order: a mirrored press has the mirrored sum
    }
    force.bone = sum;
}

template <class T>
inline typename Press<T>::Held Press<T>::held_at(const Body<T>& body, std::int64_t i) const {
    const Pair<T> at = body.at[i], line{at.x - body.bone.x, at.z - radius - body.bone.z}, off = at - reference[i] - body.bone;
    const T along = 1.0 / root(line.x * line.x + line.z * line.z), ratio = radius * along;
    const T own = tissue * (1.0 - ratio), resisted = i == 0 || i == count - 1 ? shear + nail : shear;
    const T x = line.x * along, z = line.z * along, turned = tissue * ratio;
    return {{own * line.x + resisted * off.x, own * line.z + resisted * off.z},
            {own + resisted + turned * (x * x), turned * (x * z), own + resisted + turned * (z * z)}};
}

// Membrane force of the links on an element.
template <class T>
inline Pair<T> Press<T>::drawn(const Body<T>& body, std::int64_t i) const {
    const Pair<T> own = body.at[i] - reference[i];
    Pair<T> sum{all<T>(0), all<T>(0)};
    if (i && i + 1 < count) sum = ((body.at[i - 1] - reference[i - 1]) - own) + ((body.at[i + 1] - reference[i + 1]) - own);
    else if (i) sum = (body.at[i - 1] - reference[i - 1]) - own;
    else sum = (body.at[1] - reference[1]) - own;
    return membrane * sum;
}

template <class T>
inline typename Press<T>::Rubbed Press<T>::rub(std::int64_t i, Pair<T> from, Pair<T> to, T before) const {
    const T none = all<T>(0);
    const T steep = mu[i] * contact, deep = greater(-to.z, none), was_deep = greater(-from.z, none);
    const T last = steep * deep, mean = 0.5 * (last + steep * was_deep);
    const auto active = (mean > none) & (to.z < none);
    if (!any(active)) return {none, none, none};
    const T limit = pick(active, mean, all<T>(1.0)), slid = to.x - from.x;
    const T sign = pick(slid < none, all<T>(-1.0), all<T>(1.0));
    const T held = lesser(greater(before, -limit), limit);
    T left = 1.0 - sign * held / limit;
    const auto done = left <= none;
    left = pick(done, all<T>(1.0), left);
    const T log_left = logarithm(left), left_power = exponential(exponent * log_left);
    const T distance = spring * magnitude(slid) / limit * (left_power / left);
    const T order = 1.0 - exponent;
    const auto exponential_law = order == none;
    const T base = greater(1.0 - order * distance, none);
    const auto some = base > all<T>(1e-300);
    const T safe_order = pick(exponential_law, all<T>(1.0), order);
    const T log_kept = pick(exponential_law, -distance, logarithm(pick(some, base, all<T>(1.0))) / safe_order);
    const T kept = pick(some, exponential(log_kept), none);
    const T rest = pick(some, exponential(log_kept * exponent), none);
    const T after = pick(done, sign * limit, held + sign * limit * left * (1.0 - kept));
    const T of_left = pick(held == before, sign * held / (limit * limit), none);
    const T of_limit = pick(done, sign, sign * (1.0 - left * kept) -
                                            sign * limit * (rest * of_left + left * rest * distance / limit));
    const auto over = magnitude(after) > last, still = done | over | !active;
    const T end_sign = pick(after < none, all<T>(-1.0), all<T>(1.0));
    return {pick(active, lesser(greater(after, -last), last), none),
            pick(still, none, spring * left_power * rest),
            pick(active, pick(over, -end_sign * steep, -0.5 * of_limit * steep), none)};
}

}  // namespace
}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
