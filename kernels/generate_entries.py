"""Generator of the entries of the library, one for each function that Python calls, and of its interface as text."""

import runpy
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
GENERATES = "entries.cpp"


def source() -> str:
    """Return an exported `enter_<name>` for each function, the interface and its digest."""
    declarations = runpy.run_path(str(FOLDER.parent / "fingerflow" / "kernels" / "declarations.py"))
    interface = declarations["interface"](FOLDER)
    lines = ['#include "entry.h"', interface]
    for name in declarations["read"](interface):
        entered = f"return fingerflow::enter(&fingerflow_{name}, packed);"
        lines.append(f"FINGERFLOW_EXPORT int enter_{name}(const void* packed) {{ {entered} }}")
    texts = {"digest": declarations["digest"](interface), "interface": interface}
    for name, text in texts.items():
        literals = "\n".join(f'R"~({line} )~"' for line in text.splitlines())  # compilers limit the length of each
        lines.append(f"FINGERFLOW_EXPORT const char* fingerflow_{name}() {{ return {literals}; }}")
    return "\n".join(lines) + "\n"
