"""Parser of `interface.h`: packed arguments of each compiled function, and a hash of the interface.

Only the standard library is imported, as the build of the library reads the header by this file too.
"""

import hashlib
import re
from pathlib import Path
from typing import NamedTuple

HEADER = Path(__file__).with_name("interface.h")
_CODES = {"std::int64_t": "q", "std::int32_t": "i", "int": "i", "float": "f", "double": "d"}  # of Python's `struct`
# Sources of constants that Python and C++ share: limits of tracking, sizes for the contact, median networks and tables.
_SHARED = ("tracking_limits.py", "contact_sizes.py", "median_network.py", "median_rows.py")


class Field(NamedTuple):
    """Argument of a compiled function: name, and format code of `struct` (P for an address)."""

    name: str
    code: str


class Function(NamedTuple):
    """Arguments of a compiled function in packing order, with the fields of structures, and their `struct` format."""

    fields: tuple[Field, ...]
    format: str


def read(header: str) -> dict[str, Function]:
    """Return the functions of a header by name, without the prefix `fingerflow_`.

    Raises:
        ValueError: a type that cannot be packed, or a name that stands twice among the arguments of a function.
    """
    text = re.sub(r"//[^\n]*", "", header)
    structures: dict[str, list[Field]] = {}
    for name, body in re.findall(r"struct (\w+) \{(.*?)\};", text, re.DOTALL):
        structures[name] = [field for line in body.split(";") if line.strip() for field in _members(line, structures)]
    functions = {}
    for name, arguments in re.findall(r"void fingerflow_(\w+)\((.*?)\);", text, re.DOTALL):
        parts = [_argument(argument, structures) for argument in arguments.split(",")]
        fields = tuple(field for part in parts for field in part)
        names = [field.name for field in fields]
        if twice := {one for one in names if names.count(one) > 1}:
            raise ValueError(f"fingerflow_{name} of interface.h has {sorted(twice)} twice: give one another name")
        # "0q" goes on to a multiple of 8 bytes, where the next argument begins.
        functions[name] = Function(fields, "@" + "0q".join("".join(field.code for field in part) for part in parts))
    return functions


def digest(header: str) -> str:
    """Return a hash of the declarations and shared constants; a library built with another hash is not used."""
    shared = [Path(__file__).with_name(name).read_text(encoding="utf-8") for name in _SHARED]
    declared = [f"{name} {function.format} {function.fields}" for name, function in read(header).items()]
    return hashlib.sha256("\n".join((*declared, *shared)).encode()).hexdigest()[:16]


def _members(line: str, structures: dict[str, list[Field]]) -> list[Field]:
    """Return the fields of one line of a structure, such as `const float *light, *black`."""
    first, *others = line.split(",")
    kind, pointer, name = _parsed(first)
    if not pointer and kind in structures:
        return structures[kind]
    members = [Field(name, "P" if pointer else _code(kind, line))]
    for other in others:
        named = other.strip()
        members.append(Field(named.lstrip("* "), "P" if named.startswith("*") else _code(kind, line)))
    return members


def _argument(text: str, structures: dict[str, list[Field]]) -> list[Field]:
    """Return the fields of an argument; a pointer to a structure gives the fields of the structure."""
    kind, pointer, name = _parsed(text)
    if pointer and kind in structures:
        return structures[kind]
    return [Field(name, "P" if pointer else _code(kind, text))]


def _parsed(text: str) -> tuple[str, bool, str]:
    """Split a declaration into number type, whether it is an address, and name."""
    found = re.fullmatch(r"\s*(?:const )?(?:unsigned )?([\w:]+)\s*(\*?)\s*(\w+)\s*", text)
    if found is None:
        raise ValueError(f"interface.h declares {text.strip()!r}: a kind, perhaps *, and a name are expected")
    return found[1], found[2] == "*", found[3]


def _code(kind: str, where: str) -> str:
    """Return the format code of `struct` for a number type of C++."""
    if kind not in _CODES:
        raise ValueError(f"interface.h declares {where.strip()!r}: of numbers there are {sorted(_CODES)}")
    return _CODES[kind]
