"""Generator of the entries of the library, one for each function of `fingerflow/kernels/interface.h`."""

import runpy
from pathlib import Path

FOLDER = Path(__file__).resolve().parent.parent / "fingerflow" / "kernels"
GENERATES = "entries.cpp"


def source() -> str:
    """Return an exported `enter_<name>` for each function, and the digest of the interface."""
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
