"""Writes the entries of the library, one a function of `fingerflow/kernels/interface.h`.

python kernels/generate_entries.py entries.cpp
"""

import runpy
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent.parent / "fingerflow" / "kernels"
GENERATES = "entries.cpp"


def source() -> str:
    """An exported `enter_<name>` for each, and the digest of what they were written from."""
    declarations = runpy.run_path(str(FOLDER / "declarations.py"))
    header = (FOLDER / "interface.h").read_text(encoding="utf-8")
    lines = ['#include "entry.h"', '#include "interface.h"', ""]
    for name in declarations["read"](header):
        arguments = f"(&fingerflow_{name}, packed)"
        lines.append(
            f"FINGERFLOW_EXPORT int enter_{name}(const void* packed) {{ return fingerflow::enter{arguments}; }}"
        )
    digest = declarations["digest"](header)
    lines += ["", f'FINGERFLOW_EXPORT const char* fingerflow_digest() {{ return "{digest}"; }}', ""]
    return "\n".join(lines)


def main(path: str) -> None:
    Path(path).write_text(source(), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
