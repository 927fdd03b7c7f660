"""Translation of the package's docstrings into reStructuredText, for Sphinx.

Docstrings are plain text with `code`: |u| is a length, x* a name. Indented lines under a line that is no heading of a
section are laid out by hand (an equation, a list), and keep their layout.
"""

import re
from typing import Any

_SECTIONS = re.compile(r"(Args|Arguments|Attributes|Convention|Example|Examples|Note|Notes|Raises|Returns|Yields):\s*$")
_ARGUMENT = re.compile(r"[a-z_]+: \S")
_CODE = re.compile(r"(``.+?``|:\w+:`[^`]+`|`[^`]+`)")
_SPECIAL = re.compile(r"[\\*|]|(?<=\w)_(?!\w)")


def _escaped(line: str) -> str:
    """Return a line with all marks outside code escaped; the mark of a literal block at its end stays."""
    parts = _CODE.split(line)
    return "".join(part if k % 2 else _SPECIAL.sub(r"\\\g<0>", part) for k, part in enumerate(parts))


def _with_heading(lines: list[str]) -> list[str]:
    """The same, with "Args:" over arguments that are listed without it."""
    result: list[str] = []
    inside = False
    for number, line in enumerate(lines):
        begins = bool(_ARGUMENT.match(line)) and (number == 0 or not lines[number - 1].strip())
        if begins:
            result.append("Args:")
        inside = bool(line.strip()) and (inside or begins)
        result.append(f"    {line}" if inside else line)
    return result


def as_restructured_text(lines: list[str]) -> list[str]:
    """Return a docstring (without its common indent) as reStructuredText that shows as it reads."""
    result: list[str] = []
    section = verbatim = False
    above = ""  # the last line that is not empty
    for line in _with_heading(lines):
        set_in = line.startswith(" ")
        if line.strip() and not set_in:
            if verbatim and result[-1].strip():
                result.append("")
            found = _SECTIONS.match(line)
            section, verbatim = bool(found), bool(found) and found[1].startswith("Example")
        elif set_in and not section and not verbatim:
            verbatim = True
            if above and not above.endswith("::"):
                result += [*([""] if result[-1].strip() else []), "::", ""]
        result.append(line if verbatim else _escaped(line))
        above = line if line.strip() else above
    return result


def _process(app: Any, what: str, name: str, one: Any, options: Any, lines: list[str]) -> None:
    lines[:] = as_restructured_text(lines)


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("autodoc-process-docstring", _process, priority=100)  # before napoleon
    return {"parallel_read_safe": True, "parallel_write_safe": True}
