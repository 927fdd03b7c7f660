// Doubles and vectors of doubles (SIMD lanes) with the same functions, for sources compiled for each instruction set.
#pragma once

#include <math.h>
#include <string.h>

#include <cstdint>

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

// Lanes, bits and masks of a double or of a vector of doubles.
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

// log of a positive normal number, and exp of a number up to 700 (0 below -700), to some units in the last place:
// unlike calls of the C library these vectorize.
template <class T>
inline T logarithm(T value) {
    using Bits = typename Of<T>::Bits;
    const Bits raw = bits<Bits>(value);
    const std::uint64_t shift = 0x3fe6a09e667f3bcdULL;  // sqrt(1/2): the fraction lies in [sqrt(1/2), sqrt 2)
    const Bits exponent = (raw - shift) & 0xfff0000000000000ULL;
    const T fraction = bits<T>(static_cast<Bits>(raw - exponent));
    // The exponent as a double: biased, in the last bits of 2^52.
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
    const double shift = 6755399441055744.0;  // 1.5 x 2^52: rounds to an integer, which lies in the last bits
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
// base^exponent for base >= 0; 0 for base 0.
template <class T>
inline T power(T base, T exponent) {
    const auto some = base > all<T>(1e-300);
    return pick<T>(some, exponential(exponent * logarithm(pick<T>(some, base, all<T>(1.0)))), all<T>(0.0));
}


}  // namespace
}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
