// Vectors of pixels, as wide as the instruction set's registers.
#pragma once

#if defined(__AVX512BW__)
#include <immintrin.h>
#endif

#include "floats.h"

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

// A vector of pixels; a single one where the compiler has no vectors, but makes them of a loop.
template <class Pixel>
struct Lanes {
#if defined(FINGERFLOW_VECTORS)
    using Value = Register<Pixel, static_cast<int>(sizeof(Floats) / sizeof(Pixel))>;
#else
    using Value = Pixel;
#endif
    static constexpr long kStep = static_cast<long>(sizeof(Value) / sizeof(Pixel));
    static Value load(const Pixel* from) { return loaded<Value>(from); }
    static void store(Pixel* to, Value value) { std::memcpy(to, &value, sizeof value); }
    static Value lesser(Value a, Value b) { return a < b ? a : b; }
    static Value greater(Value a, Value b) { return a > b ? a : b; }
#if defined(FINGERFLOW_VECTORS) && defined(__AVX512BW__)
    // Intel processors have one port for minima of 64 bytes and two for sums: a share of the pairs of minimum and
    // maximum is computed by a saturating difference, max(a - b, 0), and two sums, so that both ports are busy.
    static Value excess(Value a, Value b) {
        if constexpr (sizeof(Pixel) == 1) return (Value)_mm512_subs_epu8((__m512i)a, (__m512i)b);
        else return (Value)_mm512_subs_epu16((__m512i)a, (__m512i)b);
    }
    static Value lesser(Value a, Value, Value excess) { return a - excess; }
    static Value greater(Value, Value b, Value excess) { return b + excess; }
#else
    static Value excess(Value a, Value) { return a; }
    static Value lesser(Value a, Value b, Value) { return lesser(a, b); }
    static Value greater(Value a, Value b, Value) { return greater(a, b); }
#endif
};

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
