// Keywords and types that let every compiler vectorize a loop.
#pragma once

#include <cstdint>
#ifdef __AVX512BW__
#include <immintrin.h>
#endif

#include "prefetch.h"

#if defined(_MSC_VER) && !defined(__clang__)
#define FINGERFLOW_RESTRICT __restrict
#define FINGERFLOW_INDEPENDENT __pragma(loop(ivdep))
#elif defined(__clang__)
#define FINGERFLOW_RESTRICT __restrict__
#define FINGERFLOW_INDEPENDENT _Pragma("clang loop vectorize(assume_safety)")
#else
#define FINGERFLOW_RESTRICT __restrict__
#define FINGERFLOW_INDEPENDENT _Pragma("GCC ivdep")
#endif

namespace fingerflow {
namespace FINGERFLOW_ISA {

// Loops run over whole vectors of the widest set, so that they have no scalar remainder.
constexpr int kVectorBytes = 64;
template <class Pixel>
constexpr long kLanes = kVectorBytes / static_cast<long>(sizeof(Pixel));
template <class Pixel>
inline long whole_lanes(long count) {
    return (count + kLanes<Pixel> - 1) / kLanes<Pixel> * kLanes<Pixel>;
}

// One value, which the compiler vectorizes, or with AVX-512 a whole vector.
template <class Pixel>
struct Lanes {
    using Value = Pixel;
    static constexpr long kStep = 1;
    static Value load(const Pixel* from) { return *from; }
    static void store(Pixel* to, Value value) { *to = value; }
    static Value lesser(Value a, Value b) { return a < b ? a : b; }
    static Value greater(Value a, Value b) { return a > b ? a : b; }
    // In vectors excess is max(a - b, 0), from which minimum and maximum follow.
    static Value excess(Value a, Value) { return a; }
    static Value lesser(Value a, Value b, Value) { return lesser(a, b); }
    static Value greater(Value a, Value b, Value) { return greater(a, b); }
};

#ifdef __AVX512BW__
// Intel processors have one port for minima of 64 bytes and two for sums: a share of the pairs of minimum and maximum
// is computed by a saturating difference and two sums, so that both ports are busy.
struct Wide {
    using Value = __m512i;
    static Value load(const void* from) { return _mm512_loadu_si512(from); }
    static void store(void* to, Value value) { _mm512_storeu_si512(to, value); }
};
template <>
struct Lanes<std::uint8_t> : Wide {
    static constexpr long kStep = 64;
    static Value lesser(Value a, Value b) { return _mm512_min_epu8(a, b); }
    static Value greater(Value a, Value b) { return _mm512_max_epu8(a, b); }
    static Value excess(Value a, Value b) { return _mm512_subs_epu8(a, b); }
    static Value lesser(Value a, Value, Value excess) { return _mm512_sub_epi8(a, excess); }
    static Value greater(Value, Value b, Value excess) { return _mm512_add_epi8(b, excess); }
};
template <>
struct Lanes<std::uint16_t> : Wide {
    static constexpr long kStep = 32;
    static Value lesser(Value a, Value b) { return _mm512_min_epu16(a, b); }
    static Value greater(Value a, Value b) { return _mm512_max_epu16(a, b); }
    static Value excess(Value a, Value b) { return _mm512_subs_epu16(a, b); }
    static Value lesser(Value a, Value, Value excess) { return _mm512_sub_epi16(a, excess); }
    static Value greater(Value, Value b, Value excess) { return _mm512_add_epi16(b, excess); }
};
#endif

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
