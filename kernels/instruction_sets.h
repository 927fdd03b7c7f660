// Choice of the instruction set: one library holds the hot loops compiled for several sets and picks one at run time.
//
// A source of hot loops is compiled once for each set, in the namespace FINGERFLOW_ISA. These must not call inline or
// template functions of the standard library, of which the linker keeps one copy for all sets. What follows
// `#if FINGERFLOW_ONCE` is compiled with the baseline alone: FINGERFLOW_OTHER_SETS declares a function of FINGERFLOW_ISA
// for the other sets, and FINGERFLOW_PICK is that of the set in use.
#pragma once

#define FINGERFLOW_ONCE_baseline 1
#define FINGERFLOW_JOINED(one, other) one##other
#define FINGERFLOW_JOIN(one, other) FINGERFLOW_JOINED(one, other)
#define FINGERFLOW_ONCE FINGERFLOW_JOIN(FINGERFLOW_ONCE_, FINGERFLOW_ISA)

// FINGERFLOW_SETS sets are compiled; the next narrower one takes the place of a set that is not.
#if FINGERFLOW_SETS > 1
#define FINGERFLOW_IN_AVX2(declaration) namespace avx2 { declaration }
#define FINGERFLOW_OF_AVX2(function) avx2::function
#else
#define FINGERFLOW_IN_AVX2(declaration)
#define FINGERFLOW_OF_AVX2(function) baseline::function
#endif
#if FINGERFLOW_SETS > 2
#define FINGERFLOW_IN_AVX512(declaration) namespace avx512 { declaration }
#define FINGERFLOW_OF_AVX512(function) avx512::function
#else
#define FINGERFLOW_IN_AVX512(declaration)
#define FINGERFLOW_OF_AVX512(function) FINGERFLOW_OF_AVX2(function)
#endif
#define FINGERFLOW_OTHERS(declaration) FINGERFLOW_IN_AVX2(declaration) FINGERFLOW_IN_AVX512(declaration)
#define FINGERFLOW_FOR_EACH_SET(declaration) namespace baseline { declaration } FINGERFLOW_OTHERS(declaration)
#define FINGERFLOW_OTHER_SETS(function) FINGERFLOW_OTHERS(decltype(baseline::function) function;)
#define FINGERFLOW_PICK(function) \
    (fingerflow::pick(baseline::function, FINGERFLOW_OF_AVX2(function), FINGERFLOW_OF_AVX512(function)))

namespace fingerflow {

enum InstructionSet { kBaseline = 0, kAvx2 = 1, kAvx512 = 2 };

InstructionSet instruction_set();

template <class Function>
Function* pick(Function* baseline, Function* avx2, Function* avx512) {
    switch (instruction_set()) {
        case kAvx512: return avx512;
        case kAvx2: return avx2;
        default: return baseline;
    }
}

}  // namespace fingerflow
