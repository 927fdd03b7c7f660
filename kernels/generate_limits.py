"""Generator of the C++ header of the statuses and limits in `fingerflow/kernels/tracking_limits.py`."""

import runpy
from enum import IntEnum
from pathlib import Path

SOURCE = Path(__file__).resolve().parent.parent / "fingerflow" / "kernels" / "tracking_limits.py"
GENERATES = "tracking_limits.h"


def source() -> str:
    """Return enumerations as they are, and numbers as constants: kMostGain for MOST_GAIN."""
    lines = ["#pragma once", "", "namespace fingerflow {", ""]
    for name, value in runpy.run_path(str(SOURCE)).items():
        if isinstance(value, type) and issubclass(value, IntEnum) and value is not IntEnum:
            members = ", ".join(f"k{_camel(member.name)} = {int(member)}" for member in value)
            lines.append(f"enum {name} {{ {members} }};")
        elif name.isupper() and isinstance(value, int):
            lines.append(f"constexpr int k{_camel(name)} = {value};")
        elif name.isupper() and isinstance(value, float):
            lines.append(f"constexpr float k{_camel(name)} = {value!r}f;")
    return "\n".join((*lines, "", "}  // namespace fingerflow", ""))


def _camel(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))
