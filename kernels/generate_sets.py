"""Generator of the C++ header that names the features of a processor that each instruction set needs."""

# Features by their names in GCC's options and in `__builtin_cpu_supports`. MSVC compiles for more with /arch:AVX2 and
# /arch:AVX512, which every processor with these features has.
FEATURES = {
    "baseline": (),
    "avx2": ("avx2", "fma"),
    "avx512": ("avx2", "fma", "avx512f", "avx512bw", "avx512vl", "avx512dq"),
}
GENERATES = "instruction_features.h"


def source() -> str:
    """Return macros such as FINGERFLOW_AVX2(has), true if has(feature) is true for all features of the set."""
    lines = ["#pragma once", ""]
    for name, features in FEATURES.items():
        if features:
            lines.append(f"#define FINGERFLOW_{name.upper()}(has) ({' && '.join(f'has({one})' for one in features)})")
    return "\n".join((*lines, ""))
