// A vector of floats as wide as the instruction set's registers, so that sums stay in registers.
#pragma once

#include <cstdint>
#include <cstring>

// Before a loop over a few vectors: unrolled, they stay in registers.
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

#if defined(__GNUC__) || defined(__clang__)
typedef float Floats __attribute__((vector_size(4 * kFloats)));
inline Floats all(float value) { return Floats{} + value; }
typedef float Floats4 __attribute__((vector_size(16)));
typedef int Integers __attribute__((vector_size(4 * kFloats)));
// The first `count` of a vector's numbers, zero behind them.
struct Beginning {
    Integers mask;
    explicit Beginning(int count) {
        for (int k = 0; k < kFloats; ++k) mask[k] = k < count ? -1 : 0;
    }
    Floats of(Floats value) const { return (Floats)((Integers)value & mask); }
};
#else
struct Floats {
    float of[kFloats];
    float& operator[](int k) { return of[k]; }
    float operator[](int k) const { return of[k]; }
    Floats& operator+=(const Floats& other) {
        for (int k = 0; k < kFloats; ++k) of[k] += other.of[k];
        return *this;
    }
};
struct Beginning {
    int count;
    explicit Beginning(int count) : count(count) {}
    Floats of(Floats value) const {
        for (int k = count; k < kFloats; ++k) value.of[k] = 0.0f;
        return value;
    }
};
struct Floats4 {
    float of[4];
};
inline Floats4 operator+(Floats4 a, const Floats4& b) {
    for (int k = 0; k < 4; ++k) a.of[k] += b.of[k];
    return a;
}
inline Floats4 operator*(Floats4 a, float b) {
    for (int k = 0; k < 4; ++k) a.of[k] *= b;
    return a;
}
inline Floats operator+(Floats a, const Floats& b) { return a += b; }
inline Floats operator-(Floats a, const Floats& b) {
    for (int k = 0; k < kFloats; ++k) a.of[k] -= b.of[k];
    return a;
}
inline Floats operator*(Floats a, const Floats& b) {
    for (int k = 0; k < kFloats; ++k) a.of[k] *= b.of[k];
    return a;
}
inline Floats all(float value);
inline Floats operator+(Floats a, float b) { return a + all(b); }
inline Floats operator-(Floats a, float b) { return a - all(b); }
inline Floats operator-(float a, Floats b) { return all(a) - b; }
inline Floats operator*(Floats a, float b) { return a * all(b); }
inline Floats all(float value) {
    Floats result;
    for (int k = 0; k < kFloats; ++k) result.of[k] = value;
    return result;
}
#endif

inline Floats4 load4(const float* from) {
    Floats4 value;
    std::memcpy(&value, from, sizeof value);
    return value;
}
inline Floats load(const float* from) {
    Floats value;
    std::memcpy(&value, from, sizeof value);
    return value;
}
// A value that stays in a register from here on. Vectors at odd places cross cache lines, where a load takes twice as
// long; compilers would rather load one again for each use.
template <class Vector>
inline Vector held(Vector value) {
#if defined(__GNUC__) && defined(FINGERFLOW_X86)
    __asm__("" : "+v"(value));
#endif
    return value;
}
inline void store(float* to, const Floats& value) { std::memcpy(to, &value, sizeof value); }

#if defined(__GNUC__) || defined(__clang__)
// Halves added to halves, in registers.
template <class Half, class Whole>
inline Half folded(Whole value) {
    const Whole copy = held(value);  // the sum itself must not be addressed: it would be kept in memory from the start
    Half low, high;
    std::memcpy(&low, &copy, sizeof low);
    std::memcpy(&high, reinterpret_cast<const char*>(&copy) + sizeof low, sizeof high);
    return low + high;
}
inline float sum(Floats4 value) { return (value[0] + value[2]) + (value[1] + value[3]); }
#if defined(__AVX__)
typedef float Floats8 __attribute__((vector_size(32)));
inline float sum(Floats8 value) { return sum(folded<Floats4>(value)); }
#endif
#if defined(__AVX512F__)
inline float sum(Floats value) { return sum(folded<Floats8>(value)); }
#endif
#else
inline float sum(const Floats& value) {
    float result = 0;
    for (int k = 0; k < kFloats; ++k) result += value[k];
    return result;
}
#endif

// Numbers kept within limits and split into whole and fraction. What is not a number becomes `low`.
struct Split {
    std::int32_t whole[kFloats];
    Floats fraction;
};
#if defined(__GNUC__) || defined(__clang__)
inline Split split(Floats value, float low, float high) {
    // The whole part is limited, not the number: beyond the limits the fraction grows.
    Floats whole = value > all(low) ? value : all(low);
    whole = whole < all(high) ? whole : all(high);
    const Floats towards_zero = __builtin_convertvector(__builtin_convertvector(whole, Integers), Floats);
    whole = towards_zero > whole ? towards_zero - 1.0f : towards_zero;
    Split result;
    const Integers integers = __builtin_convertvector(whole, Integers);
    std::memcpy(result.whole, &integers, sizeof integers);
    result.fraction = value - whole;
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
        result.fraction.of[k] = value.of[k] - static_cast<float>(integer);
    }
    return result;
}
#endif

// The least multiple of the vector's length that holds so many floats.
constexpr int whole_floats(int count) { return (count + kFloats - 1) / kFloats * kFloats; }

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
