// State and methods of a press of a skin chain, or of as many chains as a vector has lanes. Elements are contiguous
// arrays of `count` T, Pair<T> or Block<T>, one chain a lane.
#pragma once

#include "plane_algebra.h"
#include "skin_chain_press.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

// Positions (or velocities, or forces) of the bone and of all elements.
template <class T>
struct Body {
    Pair<T>* at;
    Pair<T> bone;
};

constexpr std::int64_t kBytesEach = (10 * 2 + 4 + 3 * 4) * 8;  // bytes an element of one chain: pairs, scalars, blocks

template <class T>
struct Press {
    using Mask = typename Of<T>::Mask;
    static constexpr int kLanes = Of<T>::kLanes;
    static constexpr double kGamma = 2 - 1.41421356237309504880;
    static constexpr double kLater = 1 / (kGamma * (2 - kGamma));
    static constexpr double kEarlier = (1 - kGamma) * (1 - kGamma) / (kGamma * (2 - kGamma));
    static constexpr double kError = 2 * (-3 * kGamma * kGamma + 4 * kGamma - 2) / (12 * (2 - kGamma));
    static constexpr int kMostIterations = 12;

    const fingerflow_skin_chain& given;
    const std::int64_t count;
    // Parameters of the chain.
    Pair<T>* reference;
    T* mu;
    T radius, membrane, tissue, shear, nail, contact, damping, bone_damping, spring, exponent;
    // Motion: `known` of a stage, residuals `left_over`, and Dahl friction forces before, in the middle and after a
    // step.
    Body<T> start, start_speed, middle, middle_speed, end, known, left_over, guess;
    T *rubbed, *rubbed_middle, *rubbed_end;
    // The linear system as factored by the sweep.
    Block<T> *undone, *from_bone, *to_bone;
    Pair<T>* swept;
    Block<T> bone_block;
    Pair<T> bone_gone;
    T c;

    Press(const fingerflow_skin_chain& of, char* memory) : given(of), count(of.count) {
        const auto take = [&](auto& to) {
            to = reinterpret_cast<decltype(+to)>(memory);
            memory += static_cast<std::size_t>(count) * sizeof *to;
        };
        take(reference), take(mu);
        take(start.at), take(start_speed.at), take(middle.at), take(middle_speed.at), take(end.at);
        take(known.at), take(left_over.at), take(guess.at);
        take(rubbed), take(rubbed_middle), take(rubbed_end);
        take(undone), take(from_bone), take(to_bone);
        take(swept);
    }

    void load(std::int64_t first) {
        T* const numbers[] = {&radius, &membrane, &tissue, &shear, &nail, &contact, &damping, &bone_damping, &spring, &exponent};
        for (int lane = 0; lane < kLanes; ++lane) {
            const std::int64_t chain = chain_of(first, lane);
            for (int k = 0; k < 10; ++k) put(*numbers[k], lane, given.numbers[10 * chain + k]);
            for (std::int64_t i = 0; i < count; ++i) {
                const std::int64_t at = chain * count + i;
                put(reference[i].x, lane, given.reference[2 * at]);
                put(reference[i].z, lane, given.reference[2 * at + 1]);
                put(mu[i], lane, given.friction[at]);
                put(start.at[i].x, lane, given.place[2 * at]);
                put(start.at[i].z, lane, given.place[2 * at + 1]);
                put(rubbed[i], lane, given.rubbed[at]);
            }
            put(start.bone.x, lane, given.bone[2 * chain]);
            put(start.bone.z, lane, given.bone[2 * chain + 1]);
        }
    }

    void store(std::int64_t first, std::int64_t chains) const {
        for (int lane = 0; lane < kLanes && lane < chains; ++lane) {
            const std::int64_t chain = first + lane;
            if (chain >= given.batch) break;
            for (std::int64_t i = 0; i < count; ++i) {
                const std::int64_t at = chain * count + i;
                given.place[2 * at] = Of<T>::at(start.at[i].x, lane);
                given.place[2 * at + 1] = Of<T>::at(start.at[i].z, lane);
                given.rubbed[at] = Of<T>::at(rubbed[i], lane);
            }
            given.bone[2 * chain] = Of<T>::at(start.bone.x, lane);
            given.bone[2 * chain + 1] = Of<T>::at(start.bone.z, lane);
        }
    }

    // Lanes beyond the last chain repeat it.
    std::int64_t chain_of(std::int64_t first, int lane) const {
        const std::int64_t chain = first + lane;
        return chain < given.batch ? chain : given.batch - 1;
    }

    // Forces: skin_press_forces.h.
    void elastic(Body<T>& force) const;
    // Restoring force of tissue, shear and nail on an element, and its derivative by position.
    struct Held {
        Pair<T> force;
        Symmetric<T> slope;
    };
    Held held_at(const Body<T>& body, std::int64_t i) const;
    Pair<T> drawn(const Body<T>& body, std::int64_t i) const;
    // Dahl friction force of an element after a slide, and its derivatives by the position along and above the plate.
    struct Rubbed {
        T force, along, above;
    };
    Rubbed rub(std::int64_t i, Pair<T> from, Pair<T> to, T before) const;
    static bool any(bool mask) { return mask; }
#if defined(__GNUC__) || defined(__clang__)
    static bool any(const Integers& mask) {
        std::int64_t one = 0;
        for (int lane = 0; lane < kSide; ++lane) one |= mask[lane];
        return one != 0;
    }
#endif

    // Newton's method: skin_press_newton.h.
    // One element's rows of (damping I + c K) moved = residual, before and after elimination of the elements outside
    // it.
    struct Row {
        Block<T> undone, from_bone, to_bone;
        Pair<T> swept;
    };
    Row assembled(const Body<T>& from, const T* before, std::int64_t i, Pair<T>& held, Block<T>& whole) const;
    void follow(Row& row, const Row& before, T joined) const;
    void finish(Row& row, std::int64_t i, Mask here, bool whole);
    T newton_step(const Body<T>& from, const T* before, Pair<T> load, Mask here, bool whole);
    template <class Gone>
    void substitute(Pair<T> by, Gone gone) const;
    T solved(const Body<T>& side);
    void newton(const Body<T>& from, const T* before, T* after, Pair<T> load, const double* tolerance, bool* go_on);

    // Steps: skin_chain_press.cpp.
    T unbalanced(Pair<T> load);
    void run(std::int64_t first, std::int64_t chains);
    static double quarters(double error);

    static void take(Mask where, Block<T>& to, Block<T> from) {
        if constexpr (kLanes == 1) to = from;
        else to = {pick(where, from.xx, to.xx), pick(where, from.xz, to.xz), pick(where, from.zx, to.zx), pick(where, from.zz, to.zz)};
    }
    static void take(Mask where, Pair<T>& to, Pair<T> from) { to = {pick(where, from.x, to.x), pick(where, from.z, to.z)}; }
};

}  // namespace
}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
