// The instruction set in use: the widest whose features processor and operating system have
// (instruction_features.h, written by generate_sets.py), or a narrower one for tests.
// Layout: one atomic integer for the process, -1 until the first call.
#include "instruction_sets.h"

#include <atomic>

#include "instruction_features.h"
#include "interface.h"

#if defined(FINGERFLOW_X86) && defined(_MSC_VER) && !defined(__clang__)
#include <immintrin.h>
#include <intrin.h>
#endif

namespace fingerflow {
namespace {

InstructionSet widest() {
#if !defined(FINGERFLOW_X86)
    return kBaseline;
#elif defined(_MSC_VER) && !defined(__clang__)
    int of_1[4], of_7[4];  // registers eax, ebx, ecx, edx of CPUID leaves 1 and 7
    __cpuid(of_7, 0);
    if (of_7[0] < 7) return kBaseline;
    __cpuid(of_1, 1);
    if ((of_1[2] >> 27 & 1) == 0) return kBaseline;  // no OSXSAVE: the operating system does not save wide registers
    const unsigned long long kept = _xgetbv(0);
    __cpuidex(of_7, 7, 0);
    const bool ymm = (kept & 6) == 6, zmm = (kept & 0xe6) == 0xe6;
    const bool fma = ymm && (of_1[2] >> 12 & 1), avx2 = ymm && (of_7[1] >> 5 & 1);
    const bool avx512f = zmm && (of_7[1] >> 16 & 1), avx512dq = zmm && (of_7[1] >> 17 & 1);
    const bool avx512bw = zmm && (of_7[1] >> 30 & 1), avx512vl = zmm && (of_7[1] >> 31 & 1);
#define FINGERFLOW_HAS(feature) feature
#else
    __builtin_cpu_init();
#define FINGERFLOW_HAS(feature) __builtin_cpu_supports(#feature)
#endif
#ifdef FINGERFLOW_X86
    if (FINGERFLOW_SETS > 2 && FINGERFLOW_AVX512(FINGERFLOW_HAS)) return kAvx512;
    return FINGERFLOW_SETS > 1 && FINGERFLOW_AVX2(FINGERFLOW_HAS) ? kAvx2 : kBaseline;
#endif
}

std::atomic<int> chosen{-1};

}  // namespace

InstructionSet instruction_set() {
    int set = chosen.load(std::memory_order_relaxed);
    if (set < 0) chosen.store(set = widest(), std::memory_order_relaxed);
    return static_cast<InstructionSet>(set);
}

}  // namespace fingerflow

// The widest instruction set in use from now on: 0 for the baseline of the processor's kind, 1 for AVX2, 2 for AVX-512,
void fingerflow_limit_instruction_set(int most /* from -1 */, std::int32_t* taken /* (1) */) {
    const int widest = fingerflow::widest();
    *taken = most < 0 || most > widest ? widest : most;
    fingerflow::chosen.store(*taken);
}
