// build: each instruction set, fused
// TR-BDF2 of skin chains, as fingerflow/models/skin_implicit.py has it: what is written once here for a double or for a
// vector of doubles is a chain, or as many chains side by side, each with a step and a time of its own. The linear system
// is swept from both ends at once: two chains of operations that do not wait for each other, and mirrored results for a
// mirrored press.
#include "skin_chain_press.h"

#include <math.h>
#include <string.h>

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

#if defined(__GNUC__) || defined(__clang__)
#if defined(__AVX512F__)
constexpr int kSide = 8;
#elif defined(__AVX__)
constexpr int kSide = 4;
#else
constexpr int kSide = 2;
#endif
typedef double Doubles __attribute__((vector_size(8 * kSide)));
typedef std::int64_t Integers __attribute__((vector_size(8 * kSide)));
typedef std::uint64_t Naturals __attribute__((vector_size(8 * kSide)));
#else
constexpr int kSide = 1;
#endif

// What a number, or a vector of them, is made of.
template <class T>
struct Of;
template <>
struct Of<double> {
    using Bits = std::uint64_t;
    using Mask = bool;
    static constexpr int kLanes = 1;
    static double& at(double& value, int) { return value; }
    static double at(const double& value, int) { return value; }
    static bool in(bool mask, int) { return mask; }
    static void set(bool& mask, int, bool value) { mask = value; }
};
#if defined(__GNUC__) || defined(__clang__)
template <>
struct Of<Doubles> {
    using Bits = Naturals;
    using Mask = Integers;
    static constexpr int kLanes = kSide;
    static double at(const Doubles& value, int lane) { return value[lane]; }
    static bool in(const Integers& mask, int lane) { return mask[lane] != 0; }
    static void set(Integers& mask, int lane, bool value) { mask[lane] = value ? -1 : 0; }
};
#endif

template <class T>
inline T all(double value) {
    return T{} + value;
}
template <class T>
inline void put(T& to, int lane, double value) {
    memcpy(reinterpret_cast<char*>(&to) + sizeof(double) * static_cast<std::size_t>(lane), &value, sizeof value);
}
template <class T, class Mask>
inline T pick(Mask mask, T a, T b) {
    return mask ? a : b;
}
template <class T>
inline T greater(T a, T b) {
    return a > b ? a : b;
}
template <class T>
inline T lesser(T a, T b) {
    return a < b ? a : b;
}
template <class T>
inline T magnitude(T a) {
    return a < all<T>(0) ? -a : a;
}
inline double root(double value) { return sqrt(value); }
#if defined(__GNUC__) || defined(__clang__)
inline Doubles root(Doubles value) {
    Doubles result;
    for (int k = 0; k < kSide; ++k) result[k] = sqrt(value[k]);
    return result;
}
#endif
template <class To, class From>
inline To bits(const From& from) {
    static_assert(sizeof(To) == sizeof(From), "the same bits");
    To to;
    memcpy(&to, &from, sizeof to);
    return to;
}

// log of a positive normal number, and exp of one up to 700, to some units in the last place; the compiler makes vector
// code of these, not of calls.
template <class T>
inline T logarithm(T value) {
    using Bits = typename Of<T>::Bits;
    const Bits raw = bits<Bits>(value);
    const std::uint64_t shift = 0x3fe6a09e667f3bcdULL;  // sqrt(1/2): the fraction goes from there to sqrt 2
    const Bits exponent = (raw - shift) & 0xfff0000000000000ULL;
    const T fraction = bits<T>(static_cast<Bits>(raw - exponent));
    // The exponent as a number: biased, into the last bits of 2^52.
    const Bits biased = ((exponent >> 52) & 0xfff) + 2048;
    const T power = bits<T>(static_cast<Bits>((biased & 0xfff) | 0x4330000000000000ULL)) - (4503599627370496.0 + 2048.0);
    const T s = (fraction - 1.0) / (fraction + 1.0), square = s * s;
    T sum = all<T>(1.0 / 21);
    for (int odd = 19; odd >= 3; odd -= 2) sum = sum * square + 1.0 / odd;
    return power * 0.693147180559945309417 + (2.0 * s + 2.0 * s * square * sum);
}
template <class T>
inline T exponential(T value) {
    using Bits = typename Of<T>::Bits;
    const double shift = 6755399441055744.0;  // 1.5 x 2^52: whole numbers stand in the last bits
    const auto none = value < all<T>(-700.0);
    value = pick<T>(none, all<T>(-700.0), value);
    const T shifted = value * 1.44269504088896340736 + shift;
    const T whole = shifted - shift;
    const T rest = (value - whole * 0.693147180369123816490) - whole * 1.90821492927058770002e-10;
    T sum = all<T>(1.0 / 6227020800.0);
    const double factorials[] = {1.0 / 479001600, 1.0 / 39916800, 1.0 / 3628800, 1.0 / 362880, 1.0 / 40320, 1.0 / 5040,
                                 1.0 / 720,       1.0 / 120,      1.0 / 24,      1.0 / 6,      0.5,         1.0, 1.0};
    for (const double factorial : factorials) sum = sum * rest + factorial;
    const Bits scale = bits<Bits>(sum) + (bits<Bits>(shifted) << 52);
    return pick<T>(none, all<T>(0.0), bits<T>(scale));
}
// base^exponent of base >= 0, 0 for 0.
template <class T>
inline T power(T base, T exponent) {
    const auto some = base > all<T>(1e-300);
    return pick<T>(some, exponential(exponent * logarithm(pick<T>(some, base, all<T>(1.0)))), all<T>(0.0));
}

template <class T>
struct Pair {
    T x, z;
};
// [[xx, xz], [xz, zz]]
template <class T>
struct Symmetric {
    T xx, xz, zz;
};
// [[xx, xz], [zx, zz]]
template <class T>
struct Block {
    T xx, xz, zx, zz;
};
template <class T>
inline Pair<T> operator+(Pair<T> a, Pair<T> b) { return {a.x + b.x, a.z + b.z}; }
template <class T>
inline Pair<T> operator-(Pair<T> a, Pair<T> b) { return {a.x - b.x, a.z - b.z}; }
template <class T>
inline Pair<T> operator*(T a, Pair<T> b) { return {a * b.x, a * b.z}; }
template <class T>
inline Pair<T> operator*(Symmetric<T> a, Pair<T> b) { return {a.xx * b.x + a.xz * b.z, a.xz * b.x + a.zz * b.z}; }
template <class T>
inline Pair<T> operator*(Block<T> a, Pair<T> b) { return {a.xx * b.x + a.xz * b.z, a.zx * b.x + a.zz * b.z}; }
template <class T>
inline Block<T> operator*(Block<T> a, Block<T> b) {
    return {a.xx * b.xx + a.xz * b.zx, a.xx * b.xz + a.xz * b.zz, a.zx * b.xx + a.zz * b.zx, a.zx * b.xz + a.zz * b.zz};
}
template <class T>
inline Block<T> operator-(Block<T> a, Block<T> b) { return {a.xx - b.xx, a.xz - b.xz, a.zx - b.zx, a.zz - b.zz}; }
template <class T>
inline Block<T> operator+(Block<T> a, Block<T> b) { return {a.xx + b.xx, a.xz + b.xz, a.zx + b.zx, a.zz + b.zz}; }
template <class T>
inline Block<T> operator*(T a, Block<T> b) { return {a * b.xx, a * b.xz, a * b.zx, a * b.zz}; }
template <class T>
inline Block<T> scaled(T by, Symmetric<T> a) { return {by * a.xx, by * a.xz, by * a.xz, by * a.zz}; }
template <class T>
inline Block<T> inverse(Block<T> a) {
    const T one = 1.0 / (a.xx * a.zz - a.xz * a.zx);
    return {one * a.zz, -(one * a.xz), -(one * a.zx), one * a.xx};
}
template <class T>
inline T farthest(T most, Pair<T> of) { return greater(most, greater(magnitude(of.x), magnitude(of.z))); }

// A place of the bone and of all elements.
template <class T>
struct Body {
    Pair<T>* at;
    Pair<T> bone;
};

constexpr std::int64_t kBytesEach = (10 * 2 + 4 + 3 * 4) * 8;  // of an element of one chain: pairs, numbers, blocks

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
    const bool held_x, held_z;
    // Of the chain.
    Pair<T>* reference;
    T* mu;
    T radius, membrane, tissue, shear, nail, contact, damping, bone_damping, spring, exponent;
    // Of the motion: what is known of a stage, what is left over, and Dahl's forces before, in the middle and after.
    Body<T> start, start_speed, middle, middle_speed, end, known, left_over, guess;
    T *rubbed, *rubbed_middle, *rubbed_end;
    // Of the system: what the sweep leaves of it.
    Block<T> *undone, *from_bone, *to_bone;
    Pair<T>* swept;
    Block<T> bone_block;
    Pair<T> bone_gone;
    T c;

    Press(const fingerflow_skin_chain& of, char* memory) : given(of), count(of.count), held_x(of.held_x), held_z(of.held_z) {
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

    // Elastic forces on elements and bone at the start.
    void elastic(Body<T>& force) const {
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
            sum = sum + (one.force + other.force);  // so that a mirrored press has the mirrored sum
        }
        force.bone = sum;
    }
    // What tissue and nail hold an element back with, and the slope of that.
    struct Held {
        Pair<T> force;
        Symmetric<T> slope;
    };
    Held held_at(const Body<T>& body, std::int64_t i) const {
        const Pair<T> at = body.at[i], line{at.x - body.bone.x, at.z - radius - body.bone.z}, off = at - reference[i] - body.bone;
        const T along = 1.0 / root(line.x * line.x + line.z * line.z), ratio = radius * along;
        const T own = tissue * (1.0 - ratio), resisted = i == 0 || i == count - 1 ? shear + nail : shear;
        const T x = line.x * along, z = line.z * along, turned = tissue * ratio;
        return {{own * line.x + resisted * off.x, own * line.z + resisted * off.z},
                {own + resisted + turned * (x * x), turned * (x * z), own + resisted + turned * (z * z)}};
    }
    // What its links draw an element with.
    Pair<T> drawn(const Body<T>& body, std::int64_t i) const {
        const Pair<T> own = body.at[i] - reference[i];
        Pair<T> sum{all<T>(0), all<T>(0)};
        if (i && i + 1 < count) sum = ((body.at[i - 1] - reference[i - 1]) - own) + ((body.at[i + 1] - reference[i + 1]) - own);
        else if (i) sum = (body.at[i - 1] - reference[i - 1]) - own;
        else sum = (body.at[1] - reference[1]) - own;
        return membrane * sum;
    }

    // Dahl's force of an element after a slide and its slopes: with the place along and above the plate, with the force
    // before, the height it slid from, mu k_c and sigma_0. With the place it slid from along the plate: minus the first.
    struct Rubbed {
        T force, along, above, before, from_above, steep, spring;
    };
    Rubbed rub(std::int64_t i, Pair<T> from, Pair<T> to, T before) const {
        const T none = all<T>(0);
        const T steep = mu[i] * contact, deep = greater(-to.z, none), was_deep = greater(-from.z, none);
        const T last = steep * deep, mean = 0.5 * (last + steep * was_deep);
        const auto active = (mean > none) & (to.z < none);
        if (!any(active)) return {none, none, none, none, none, none, none};
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
        const auto uncut = held == before;
        const T of_left = pick(uncut, sign * held / (limit * limit), none);
        const T of_limit = pick(done, sign, sign * (1.0 - left * kept) -
                                                sign * limit * (rest * of_left + left * rest * distance / limit));
        const auto over = magnitude(after) > last, still = done | over | !active;
        const T end_sign = pick(after < none, all<T>(-1.0), all<T>(1.0));
        return {pick(active, lesser(greater(after, -last), last), none),
                pick(still, none, spring * left_power * rest),
                pick(active, pick(over, -end_sign * steep, -0.5 * of_limit * steep), none),
                pick(still | !uncut, none, rest),
                pick((from.z < none) & active & !over, -0.5 * of_limit * steep, none),
                pick(active, pick(over, end_sign * deep, 0.5 * of_limit * (deep + was_deep)), none),
                pick(still, none, left_power * rest * slid)};
    }
    static bool any(bool mask) { return mask; }
#if defined(__GNUC__) || defined(__clang__)
    static bool any(const Integers& mask) {
        std::int64_t one = 0;
        for (int lane = 0; lane < kSide; ++lane) one |= mask[lane];
        return one != 0;
    }
#endif

    // One element's rows of (damping I + c K) moved = what is left over, before and after the elements outside of it
    // were eliminated.
    struct Row {
        Block<T> undone, from_bone, to_bone;
        Pair<T> swept;
    };
    Row assembled(const Body<T>& from, const T* before, std::int64_t i, Pair<T>& held, Block<T>& whole) const {
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
    // A row after its neighbour's.
    void follow(Row& row, const Row& before, T joined) const {
        row.undone = row.undone - (joined * joined) * before.undone;
        row.from_bone = row.from_bone - joined * before.from_bone;
        row.to_bone = row.to_bone - joined * (before.to_bone * before.undone);
        row.swept = row.swept - joined * before.swept;
    }
    void finish(Row& row, std::int64_t i, Mask here, bool whole) {
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

    // Rows made one by one and swept from both ends; the bone's right-hand side from what its links to elements add up to;
    // then where each element goes. The swept matrix stays for `solved`, in the lanes `here`. Gives the bone's motion.
    template <class Make, class Side, class Gone>
    Pair<T> sweep(Mask here, bool whole, Make make, Side side, Pair<T> motion, Gone gone) {
        const std::int64_t centre = count / 2;
        const T joined = -c * membrane, none = all<T>(0);
        Block<T> of{bone_damping, none, none, bone_damping};
        Pair<T> on_bone{none, none}, bone{none, none}, held{}, other_held{};
        Block<T> slope{}, other_slope{};
        Row left{}, right{};
        for (std::int64_t i = 0; i < centre; ++i) {
            const std::int64_t j = count - 1 - i;
            Row row = make(i, held, slope);
            if (i) follow(row, left, joined);
            finish(row, i, here, whole);
            left = row;
            if (j > centre) {
                row = make(j, other_held, other_slope);
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
        Row row = make(centre, held, slope);
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

        const Pair<T> by = bone_motion(of, side(on_bone + held) - bone, motion);
        Pair<T> last = row.swept - row.from_bone * by, other = last;
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
        return by;
    }

    // A step of Newton's from `end`, gone along by the lanes `here`. The greatest motion.
    T newton_step(const Body<T>& from, const T* before, Pair<T> load, Mask here, bool whole) {
        const T none = all<T>(0);
        T most = none;
        const auto make = [&](std::int64_t i, Pair<T>& held, Block<T>& slope) { return assembled(from, before, i, held, slope); };
        const auto side = [&](Pair<T> on_bone) {
            const Pair<T> off = known.bone - end.bone;
            return Pair<T>{bone_damping * off.x + c * (on_bone.x + load.x), bone_damping * off.z + c * (on_bone.z + load.z)};
        };
        const auto gone = [&](std::int64_t i, Pair<T> moved) {
            most = farthest(most, moved);
            if (kLanes == 1 || whole) end.at[i] = end.at[i] + moved;
            else end.at[i] = end.at[i] + Pair<T>{pick(here, moved.x, none), pick(here, moved.z, none)};
        };
        bone_gone = sweep(here, whole, make, side, load - end.bone, gone);
        end.bone = end.bone + Pair<T>{pick(here, bone_gone.x, none), pick(here, bone_gone.z, none)};
        return farthest(most, bone_gone);
    }
    Pair<T> bone_motion(Block<T> of, Pair<T> side, Pair<T> motion) const {
        if (held_x && held_z) return motion;
        if (held_x) return {motion.x, (side.z - of.zx * motion.x) / of.zz};
        if (held_z) return {(side.x - of.xz * motion.z) / of.xx, motion.z};
        return inverse(of) * side;
    }

    // The greatest of the solution of the last matrix for a right-hand side; that of a direction which is held is its motion.
    T solved(const Body<T>& side) {
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
        const Pair<T> by = bone_motion(bone_block, side.bone - (bone + to_bone[centre] * swept[centre]), side.bone);
        T most = farthest(none, by);
        Pair<T> last = swept[centre] - from_bone[centre] * by, other = last;
        most = farthest(most, last);
        for (std::int64_t i = centre - 1; i >= 0; --i) {
            const std::int64_t j = count - 1 - i;
            last = swept[i] - from_bone[i] * by - joined * (undone[i] * last);
            most = farthest(most, last);
            if (j > centre) {
                other = swept[j] - from_bone[j] * by - joined * (undone[j] * other);
                most = farthest(most, other);
            }
        }
        return most;
    }

    // damping (X - known) = c forces(X) from `end` on, which becomes X, with Dahl's forces `after` the slide from a place;
    // lanes where it is not found are taken off those which go on.
    void newton(const Body<T>& from, const T* before, T* after, Pair<T> load, const double* tolerance, bool* go_on,
                std::int64_t* iterations) {
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
                ++iterations[lane];
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

    // What is out of balance at the start: into `left_over`, and the sum of all of it.
    T unbalanced(Pair<T> load) {
        elastic(left_over);
        T sum = all<T>(0);
        for (std::int64_t i = 0; i < count; ++i) {
            left_over.at[i].x = left_over.at[i].x - rubbed[i];
            sum = sum + magnitude(left_over.at[i].x) + magnitude(left_over.at[i].z);
        }
        const T none = all<T>(0);
        left_over.bone = {held_x ? none : left_over.bone.x + load.x, held_z ? none : left_over.bone.z + load.z};
        return sum + magnitude(left_over.bone.x) + magnitude(left_over.bone.z);
    }

    void run(std::int64_t first, std::int64_t chains) {
        load(first);
        Pair<T> load_first, load_change;
        T rest;
        double time[kLanes] = {}, step[kLanes], next[kLanes], tolerance[kLanes], error[kLanes];
        std::int64_t steps[kLanes] = {}, rejected[kLanes] = {}, iterations[kLanes] = {};
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
        const Pair<T> rate = all<T>(1 / duration) * load_change;
        unbalanced(load_first);
        for (std::int64_t i = 0; i < count; ++i) start_speed.at[i] = (1.0 / damping) * left_over.at[i];
        start_speed.bone = {held_x ? rate.x : left_over.bone.x / bone_damping, held_z ? rate.z : left_over.bone.z / bone_damping};

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
            // To gamma of the step.
            for (std::int64_t i = 0; i < count; ++i) {
                known.at[i] = start.at[i] + c * start_speed.at[i];
                end.at[i] = start.at[i] + gone * start_speed.at[i];
            }
            known.bone = start.bone + c * start_speed.bone;
            end.bone = start.bone + gone * start_speed.bone;
            newton(start, rubbed, rubbed_middle, load_first + (begin + kGamma * share) * load_change, tolerance, go_on, iterations);
            const T per_c = 1.0 / c;
            for (std::int64_t i = 0; i < count; ++i) {
                middle.at[i] = end.at[i];
                middle_speed.at[i] = per_c * (end.at[i] - known.at[i]);
            }
            middle.bone = end.bone;
            middle_speed.bone = per_c * (end.bone - known.bone);
            hold(middle_speed.bone, rate);
            // To the end of it.
            for (std::int64_t i = 0; i < count; ++i) {
                known.at[i] = all<T>(kLater) * middle.at[i] - all<T>(kEarlier) * start.at[i];
                end.at[i] = middle.at[i] + to_go * middle_speed.at[i];
            }
            known.bone = all<T>(kLater) * middle.bone - all<T>(kEarlier) * start.bone;
            end.bone = middle.bone + to_go * middle_speed.bone;
            newton(middle, rubbed_middle, rubbed_end, load_first + (begin + share) * load_change, tolerance, go_on, iterations);
            // The error, and the speed at the end where `guess` keeps it.
            const auto estimate = [&](Pair<T> one, Pair<T> two, Pair<T> three) {
                return all<T>(1 / kGamma) * one - all<T>(1 / (kGamma * (1 - kGamma))) * two + all<T>(1 / (1 - kGamma)) * three;
            };
            for (std::int64_t i = 0; i < count; ++i) {
                guess.at[i] = per_c * (end.at[i] - known.at[i]);
                left_over.at[i] = (damping * (kError * h)) * estimate(start_speed.at[i], middle_speed.at[i], guess.at[i]);
            }
            guess.bone = per_c * (end.bone - known.bone);
            hold(guess.bone, rate);
            left_over.bone = (bone_damping * (kError * h)) * estimate(start_speed.bone, middle_speed.bone, guess.bone);
            hold(left_over.bone, {all<T>(0), all<T>(0)});
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
                // A step that ended the time early says nothing about longer ones.
                const double growth = quarters(error[lane]);
                if (growth < 1 || step[lane] == next[lane]) next[lane] = step[lane] * growth;
                if (error[lane] <= 1) {
                    record(first + lane, lane, steps[lane], time[lane], step[lane]);
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
            given.counts[3 * chain] = steps[lane];
            given.counts[3 * chain + 1] = rejected[lane];
            given.counts[3 * chain + 2] = iterations[lane];
        }
    }

    // Steps grow by powers of 2^(1/4), from 2^(-7/4) to 2: rounding of the error does not go on into the steps.
    static double quarters(double error) {
        const double root = 1.18920711500272106672;
        const double wanted = floor(4 * log2(0.7 / cbrt(error < 1e-9 ? 1e-9 : error)));
        double growth = 1;
        for (double k = 0; k < wanted && k < 4; ++k) growth *= root;
        for (double k = 0; k > wanted && k > -7; --k) growth /= root;
        return growth;
    }
    // Derivatives of the end of a record, back along its steps, as fingerflow/models/skin_adjoint.py has them. T is double.
    // `left_over` is what is wanted of the place, `guess` of what the stage began at; `rubbed_end` of the friction.
    void back(const fingerflow_skin_back& asked, std::int64_t chain) {
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
            // `known` is wanted of what was known, (places later - earlier); `guess` of where the stage slid from.
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
        // The first velocity is that of the forces there.
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
    void read(Body<T>& body, T* rub, const double* from) const {
        for (std::int64_t i = 0; i < count; ++i) {
            body.at[i] = {from[2 * i], from[2 * i + 1]};
            if (rub != nullptr) rub[i] = from[2 * count + 2 + i];
        }
        body.bone = {from[2 * count], from[2 * count + 1]};
    }
    // The other body becomes what this was, and the other way round.
    static Body<T> swapped(Body<T> one, Body<T>& other) {
        const Body<T> before = other;
        other = one;
        return before;
    }
    // Back through the stage that slid from a place to `end`: `left_over` and `rubbed_end` are what is wanted of its end,
    // and become `known` of what was known, `guess` of where it slid from, `rubbed_end` of the friction before.
    void through(const Body<T>& from, const T* before, double* stiffness, double* of_mu) {
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
    // Membrane, tissue, shear, nail and contact, each by what its forces at `end` do along a motion.
    void by_stiffness(const Body<T>& along, double times, double* stiffness) const {
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

    void hold(Pair<T>& value, Pair<T> by) const {
        if (held_x) value.x = by.x;
        if (held_z) value.z = by.z;
    }
    static void take(Mask where, Block<T>& to, Block<T> from) {
        if constexpr (kLanes == 1) to = from;
        else to = {pick(where, from.xx, to.xx), pick(where, from.xz, to.xz), pick(where, from.zx, to.zx), pick(where, from.zz, to.zz)};
    }
    static void take(Mask where, Pair<T>& to, Pair<T> from) { to = {pick(where, from.x, to.x), pick(where, from.z, to.z)}; }

    // A step that is kept: when, how long, then places, bone and friction of both stages.
    void record(std::int64_t chain, int lane, std::int64_t number, double time, double step) const {
        if (given.record == nullptr || number >= given.record_steps) return;
        double* to = given.record + (chain * given.record_steps + number) * (2 + 2 * (3 * count + 2));
        *to++ = time;
        *to++ = step;
        to = written(to, lane, middle, rubbed_middle);
        written(to, lane, end, rubbed_end);
    }
    double* written(double* to, int lane, const Body<T>& body, const T* rub) const {
        for (std::int64_t i = 0; i < count; ++i) {
            *to++ = Of<T>::at(body.at[i].x, lane);
            *to++ = Of<T>::at(body.at[i].z, lane);
        }
        *to++ = Of<T>::at(body.bone.x, lane);
        *to++ = Of<T>::at(body.bone.z, lane);
        for (std::int64_t i = 0; i < count; ++i) *to++ = Of<T>::at(rub[i], lane);
        return to;
    }
};

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

void press_skin_back(const fingerflow_skin_back& given, std::int64_t chain, void* memory) {
    fingerflow_skin_chain of{};
    of.reference = given.reference;
    of.numbers = given.numbers;
    of.friction = given.friction;
    of.place = const_cast<double*>(given.place);
    of.bone = const_cast<double*>(given.bone);
    of.rubbed = const_cast<double*>(given.rubbed);
    of.batch = given.batch;
    of.count = given.count;
    of.held_x = given.held_x;
    of.held_z = given.held_z;
    Press<double>(of, static_cast<char*>(memory)).back(given, chain);
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
