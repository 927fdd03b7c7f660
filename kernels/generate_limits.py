"""Generator of the C++ header of statuses, limits and sizes that Python and C++ share."""

import runpy
from collections.abc import Iterator
from enum import IntEnum
from pathlib import Path

SOURCES = Path(__file__).resolve().parent.parent / "fingerflow" / "kernels"
GENERATES = "shared_limits.h"


def source() -> str:
    """Return `tracking_limits.py` and `contact_sizes.py` in C++, the latter in a namespace of its own."""
    parts = {"fingerflow": "tracking_limits.py", "fingerflow::contact": "contact_sizes.py"}
    lines = ["#pragma once", ""]
    for namespace, name in parts.items():
        lines += [f"namespace {namespace} {{", "", *_declared(SOURCES / name), "", f"}}  // namespace {namespace}", ""]
    return "\n".join(lines)


def _declared(path: Path) -> Iterator[str]:
    """Return enumerations as they are, and numbers as constants: kMostGain for MOST_GAIN."""
    for name, value in runpy.run_path(str(path)).items():
        if isinstance(value, type) and issubclass(value, IntEnum) and value is not IntEnum:
            members = ", ".join(f"k{_camel(member.name)} = {int(member)}" for member in value)
            yield f"enum {name} {{ {members} }};"
        elif name.isupper() and isinstance(value, int):
            yield f"constexpr int k{_camel(name)} = {value};"
        elif name.isupper() and isinstance(value, float):
            yield f"constexpr float k{_camel(name)} = {value!r}f;"
        elif name.isupper() and isinstance(value, tuple):
            yield f"constexpr float k{_camel(name)}[] = {{{', '.join(f'{one!r}f' for one in value)}}};"


def _camel(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))
