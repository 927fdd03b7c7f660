#include "instruction_sets.h"

#include <atomic>

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
    int registers[4];
    __cpuid(registers, 0);
    if (registers[0] < 7) return kBaseline;
    __cpuid(registers, 1);
    if ((registers[2] >> 27 & 1) == 0) return kBaseline;  // the operating system keeps no wide registers
    const unsigned long long kept = _xgetbv(0);
    __cpuidex(registers, 7, 0);
    const auto has = [&](int bit) { return (registers[1] >> bit & 1) != 0; };
    if ((kept & 0xe6) == 0xe6 && has(16) && has(17) && has(30) && has(31)) return kAvx512;  // F, DQ, BW, VL
    return (kept & 6) == 6 && has(5) ? kAvx2 : kBaseline;
#else
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq"))
        return kAvx512;
    return __builtin_cpu_supports("avx2") ? kAvx2 : kBaseline;
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

void fingerflow_limit_instruction_set(int most, std::int32_t* taken) {
    const int widest = fingerflow::widest();
    *taken = most < 0 || most > widest ? widest : most;
    fingerflow::chosen.store(*taken);
}
