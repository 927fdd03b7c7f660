"""Test of the size of the project, by room, against the limits of `tests/size.toml`.

`python -m tests.test_size` prints the table; with `--lower` it also lowers the limits to the present sizes.
"""

import io
import re
import sys
import tokenize
import tomllib
from functools import cache
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "tests" / "size.toml"
LIMITS = tomllib.loads(TABLE.read_text(encoding="utf-8"))
BLANK = {"COMMENT", "NL", "NEWLINE", "INDENT", "DEDENT", "ENDMARKER"}
CPP = re.compile(r"//[^\n]*|/\*.*?\*/|(\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])*'|\w+|[^\w\s])", re.DOTALL)
ADVICE = "Delete or merge as much as was added. If that cannot be, raise the limit and say why in the commit."
Sizes = dict[str, int]  # numbers of lines with code and of tokens; comments, docstrings and blank lines are none


@cache
def python_size(source: str) -> Sizes:
    lines, tokens, depth = set[int](), 0, 0
    statement = True  # begins with the next token
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        name = tokenize.tok_name[token.type]
        if name in BLANK:
            statement |= name == "NEWLINE"
        elif not (statement and name == "STRING"):  # such a string is a docstring
            lines.update(range(token.start[0], token.end[0] + 1))
            tokens += depth == 0  # a formatted string is one token, also where Python 3.12 and later divide it
            depth += name.endswith("STRING_START") - name.endswith("STRING_END")
            statement = False
    return {"lines": len(lines), "tokens": tokens}


def cpp_size(source: str) -> Sizes:
    starts = [match.start(1) for match in CPP.finditer(source) if match[1]]
    lines = bool(starts) + sum("\n" in source[before:start] for before, start in pairwise(starts))
    return {"lines": lines, "tokens": len(starts)}


LANGUAGES = {".py": python_size, ".cpp": cpp_size, ".h": cpp_size}


def sizes(room: str, root: Path = ROOT) -> Sizes:
    """Return the size of a room, of one folder or of several such as "fingerflow/plot + fingerflow/report"."""
    files = [path for folder in room.split(" + ") for path in (root / folder).rglob("*.*") if path.suffix in LANGUAGES]
    counts = [LANGUAGES[path.suffix](path.read_text(encoding="utf-8")) for path in files if path.name != "interface.h"]
    return {what: sum(count[what] for count in counts) for what in ("lines", "tokens")}


def excess(limits: dict[str, Sizes], root: Path = ROOT) -> str:
    """Return a message for every number over its limit."""
    return "\n".join(
        f"{room} has {number:,} {what}; the limit in tests/size.toml is {limits[room][what]:,}. {ADVICE}"
        for room in limits
        for what, number in sizes(room, root).items()
        if number > limits[room].get(what, number)
    )


def test_no_room_is_over_its_limit() -> None:
    folders = {f"fingerflow/{path.parent.name}" for path in (ROOT / "fingerflow").glob("*/*.py")}
    assert folders <= set(" + ".join(LIMITS).split(" + ")), "a folder has no limit in tests/size.toml"
    assert not excess(LIMITS), excess(LIMITS)


def main() -> None:
    lines = [line for line in TABLE.read_text(encoding="utf-8").splitlines() if line.startswith("#")]
    for room, limits in LIMITS.items():
        now = sizes(room)
        print(f"{room:52}", *(f"{now[what]:7,} of {limit:7,} {what}" for what, limit in limits.items()))
        lowered = ", ".join(f"{what} = {min(now[what], limit)}" for what, limit in limits.items())
        lines += [f'"{room}" = {{ {lowered} }}'] if now["lines"] else []
    if "--lower" in sys.argv:
        TABLE.write_text("\n".join([*lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
