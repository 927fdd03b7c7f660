// What a loop needs so that every compiler turns it into vector code.
#pragma once

#include <cstdint>

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

// Loops run over whole vectors of the widest kind, so that none is left to be done one by one.
constexpr int kVectorBytes = 64;
template <class Pixel>
constexpr long kLanes = kVectorBytes / static_cast<long>(sizeof(Pixel));
template <class Pixel>
inline long whole_lanes(long count) {
    return (count + kLanes<Pixel> - 1) / kLanes<Pixel> * kLanes<Pixel>;
}

template <class Pixel>
inline Pixel lesser(Pixel a, Pixel b) {
    return a < b ? a : b;
}
template <class Pixel>
inline Pixel greater(Pixel a, Pixel b) {
    return a > b ? a : b;
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
