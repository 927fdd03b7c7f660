"""Writes what each instruction set asks of a processor, from the one list of features that it is compiled for.

python kernels/generate_sets.py instruction_features.h
"""

import sys
from pathlib import Path

# Features by their names in GCC's options and in `__builtin_cpu_supports`. MSVC compiles for more with /arch:AVX2 and
# /arch:AVX512, which every processor with these features has.
FEATURES = {
    "baseline": (),
    "avx2": ("avx2", "fma"),
    "avx512": ("avx2", "fma", "avx512f", "avx512bw", "avx512vl", "avx512dq"),
}
GENERATES = "instruction_features.h"


def header() -> str:
    """FINGERFLOW_AVX2(has), true where has(feature) is for all features of the set."""
    lines = ["#pragma once", ""]
    for name, features in FEATURES.items():
        if features:
            lines.append(f"#define FINGERFLOW_{name.upper()}(has) ({' && '.join(f'has({one})' for one in features)})")
    return "\n".join((*lines, ""))


def main(path: str) -> None:
    Path(path).write_text(header(), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
