// Floats: a vector of floats as wide as the instruction set's registers, so that sums stay in registers.
#pragma once

#include <cstdint>
#include <cstring>

#include "lanes.h"

// Unrolls a loop over a few vectors, so that they stay in registers.
#if defined(__clang__)
#define FINGERFLOW_UNROLL _Pragma("clang loop unroll(full)")
#elif defined(__GNUC__)
#define FINGERFLOW_UNROLL _Pragma("GCC unroll 16")
#else
#define FINGERFLOW_UNROLL
#endif

namespace fingerflow {
namespace FINGERFLOW_ISA {

#if defined(__AVX512F__)
constexpr int kFloats = 16;
#elif defined(__AVX__)
constexpr int kFloats = 8;
#else
constexpr int kFloats = 4;
#endif

// A vector of `length` numbers: the compiler's own, or an array where it has none.
#if defined(__GNUC__) || defined(__clang__)
#define FINGERFLOW_VECTORS
template <class Number, int length>
struct VectorOf {
    typedef Number Type __attribute__((vector_size(sizeof(Number) * length)));
};
template <class Number, int length>
using Register = typename VectorOf<Number, length>::Type;
#else
template <class Number, int length>
struct Register {
    Number of[length];
    Number& operator[](int k) { return of[k]; }
    Number operator[](int k) const { return of[k]; }
    // A vector of act(0), act(1), ...
    template <class Act>
    static Register each(const Act& act) {
        Register result;
        for (int k = 0; k < length; ++k) result[k] = act(k);
        return result;
    }
    static Register all(Number value) {
        return each([&](int) { return value; });
    }
    friend Register operator+(const Register& a, const Register& b) {
        return each([&](int k) { return a[k] + b[k]; });
    }
    friend Register operator-(const Register& a, const Register& b) {
        return each([&](int k) { return a[k] - b[k]; });
    }
    friend Register operator*(const Register& a, const Register& b) {
        return each([&](int k) { return a[k] * b[k]; });
    }
    friend Register operator+(const Register& a, Number b) { return a + all(b); }
    friend Register operator-(const Register& a, Number b) { return a - all(b); }
    friend Register operator-(Number a, const Register& b) { return all(a) - b; }
    friend Register operator*(const Register& a, Number b) { return a * all(b); }
    Register& operator+=(const Register& other) { return *this = *this + other; }
};
#endif
using Floats = Register<float, kFloats>;
using Floats4 = Register<float, 4>;
#if defined(FINGERFLOW_VECTORS)
using Integers = Register<int, kFloats>;
inline Floats all(float value) { return Floats{} + value; }
// Mask that keeps the first `count` floats of a vector and sets the others to 0.
struct Beginning {
    Integers mask;
    explicit Beginning(int count) {
        for (int k = 0; k < kFloats; ++k) mask[k] = k < count ? -1 : 0;
    }
    Floats of(Floats value) const { return (Floats)((Integers)value & mask); }
};
// The floats where a mask of the same length is -1; 0 where it is 0.
inline Floats kept(Floats value, const std::int32_t* mask) {
    Integers of;
    std::memcpy(&of, mask, sizeof of);
    return (Floats)((Integers)value & of);
}
// Elementwise: minimum and maximum of two; max(value, 0); 1 where value > 0, else 0.
inline Floats lesser(Floats a, Floats b) { return a < b ? a : b; }
inline Floats greater(Floats a, Floats b) { return a > b ? a : b; }
inline Floats positive(Floats value) { return value > all(0) ? value : all(0); }
inline Floats is_positive(Floats value) { return value > all(0) ? all(1) : all(0); }
#else
inline Floats all(float value) { return Floats::all(value); }
struct Beginning {
    int count;
    explicit Beginning(int count) : count(count) {}
    Floats of(const Floats& value) const {
        return Floats::each([&](int k) { return k < count ? value[k] : 0.0f; });
    }
};
inline Floats kept(const Floats& value, const std::int32_t* mask) {
    return Floats::each([&](int k) { return mask[k] != 0 ? value[k] : 0.0f; });
}
inline Floats lesser(const Floats& a, const Floats& b) {
    return Floats::each([&](int k) { return a[k] < b[k] ? a[k] : b[k]; });
}
inline Floats greater(const Floats& a, const Floats& b) {
    return Floats::each([&](int k) { return a[k] > b[k] ? a[k] : b[k]; });
}
inline Floats positive(const Floats& value) { return greater(value, all(0)); }
inline Floats is_positive(const Floats& value) {
    return Floats::each([&](int k) { return value[k] > 0 ? 1.0f : 0.0f; });
}
#endif

template <class Vector, class Number>
inline Vector loaded(const Number* from) {
    Vector value;
    std::memcpy(&value, from, sizeof value);
    return value;
}
inline Floats load(const float* from) { return loaded<Floats>(from); }
inline Floats4 load4(const float* from) { return loaded<Floats4>(from); }
// Keeps a value in a register. Unaligned vectors cross cache lines, where a load takes twice as long, and compilers
// would load the value again for each use.
template <class Vector>
inline Vector held(Vector value) {
#if defined(__GNUC__) && defined(FINGERFLOW_X86)
    __asm__("" : "+v"(value));
#endif
    return value;
}
inline void store(float* to, const Floats& value) { std::memcpy(to, &value, sizeof value); }

// Sums of pairs of neighbours of `a`, then of `b`; with AVX within each half of the vectors.
#if defined(__clang__) || (defined(__GNUC__) && __GNUC__ >= 12)
#if defined(__AVX512F__)
#define FINGERFLOW_EVEN 0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30
#define FINGERFLOW_ODD 1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31
#elif defined(__AVX__)
// Within each half, since shuffles across the middle take three times as long.
#define FINGERFLOW_HALVES
#define FINGERFLOW_EVEN 0, 2, 8, 10, 4, 6, 12, 14
#define FINGERFLOW_ODD 1, 3, 9, 11, 5, 7, 13, 15
#else
#define FINGERFLOW_EVEN 0, 2, 4, 6
#define FINGERFLOW_ODD 1, 3, 5, 7
#endif
inline Floats pair_sums(Floats a, Floats b) {
    return __builtin_shufflevector(a, b, FINGERFLOW_EVEN) + __builtin_shufflevector(a, b, FINGERFLOW_ODD);
}
#else
inline Floats pair_sums(const Floats& a, const Floats& b) {
    Floats result = all(0);
    for (int k = 0; k < kFloats / 2; ++k) {
        result[k] = a[2 * k] + a[2 * k + 1];
        result[kFloats / 2 + k] = b[2 * k] + b[2 * k + 1];
    }
    return result;
}
#endif
// Sums of `count` vectors (a power of 2) by pairs; for kFloats vectors the vector of their sums.
template <int count>
inline Floats folded(const Floats* of) {
    if constexpr (count == 1) return of[0];
#if defined(FINGERFLOW_HALVES)
    else if constexpr (count == kFloats) {
        const Floats first = folded<count / 2>(of), second = folded<count / 2>(of + count / 2);
        return __builtin_shufflevector(first, second, 0, 1, 2, 3, 8, 9, 10, 11) + __builtin_shufflevector(first, second, 4, 5, 6, 7, 12, 13, 14, 15);
    }
#endif
    else return pair_sums(folded<count / 2>(of), folded<count / 2>(of + count / 2));
}
// Writes the sum of each vector to `to`, which has space for whole vectors.
template <int count>
inline void sums(const Floats (&of)[count], float* to) {
    static_assert(count % kFloats == 0, "whole vectors of sums");
    for (int k = 0; k < count; k += kFloats) store(to + k, folded<kFloats>(of + k));
}
inline float sum(const Floats4& value) { return (value[0] + value[2]) + (value[1] + value[3]); }

// Range of the fraction from the border pixel to the opposite one, at the first and last positions with all four taps;
// beyond, the border is repeated, as in the portable form.
constexpr float kLeastFraction = -1, kMostFraction = 2;
// Integer part, clamped to [low, high], and fraction; NaN gives `low`.
struct Split {
    std::int32_t whole[kFloats];
    Floats fraction;
};
#if defined(FINGERFLOW_VECTORS)
inline Split split(Floats value, float low, float high) {
    // Only the integer part is clamped: beyond the limits the fraction grows, as far as the border.
    Floats whole = value > all(low) ? value : all(low);
    whole = whole < all(high) ? whole : all(high);
    const Floats towards_zero = __builtin_convertvector(__builtin_convertvector(whole, Integers), Floats);
    whole = towards_zero > whole ? towards_zero - 1.0f : towards_zero;
    Split result;
    const Integers integers = __builtin_convertvector(whole, Integers);
    std::memcpy(result.whole, &integers, sizeof integers);
    const Floats fraction = value - whole;
    result.fraction = fraction < all(kLeastFraction) ? all(kLeastFraction) : fraction > all(kMostFraction) ? all(kMostFraction) : fraction;
    return result;
}
#else
inline Split split(const Floats& value, float low, float high) {
    Split result;
    for (int k = 0; k < kFloats; ++k) {
        float whole = value.of[k] > low ? value.of[k] : low;
        whole = whole < high ? whole : high;
        std::int32_t integer = static_cast<std::int32_t>(whole);
        if (static_cast<float>(integer) > whole) --integer;
        result.whole[k] = integer;
        const float fraction = value.of[k] - static_cast<float>(integer);
        result.fraction.of[k] = fraction < kLeastFraction ? kLeastFraction : fraction > kMostFraction ? kMostFraction : fraction;
    }
    return result;
}
#endif

// `count` rounded up to a multiple of the vector's length.
constexpr int whole_floats(int count) { return (count + kFloats - 1) / kFloats * kFloats; }

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
