"""Parser of the interface of the library: arrays and numbers of each compiled function, and a hash.

Only the standard library is imported, as the build of the library reads its sources by this file too.
"""

import hashlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

FRAME_KINDS = ("uint8", "uint16", "int32", "float32")  # in the order of the codes of kernels/pixels.h
_CODES = {"std::int64_t": "q", "std::int32_t": "i", "int": "i", "float": "f", "double": "d"}  # of Python's `struct`
_LARGEST = {"q": (1 << 63) - 1, "i": (1 << 31) - 1}  # whole numbers by code
_DTYPES = {
    "float": "float32",
    "double": "float64",
    "std::int64_t": "int64",
    "std::int32_t": "int32",
    "std::uint16_t": "uint16",
    "unsigned char": "uint8",
}
# Sources of constants that Python and C++ share: limits of tracking, sizes for the contact, median networks and tables.
_SHARED = ("tracking_limits.py", "contact_sizes.py", "median_network.py", "median_rows.py")
_DEFINED = re.compile(r"^void (fingerflow_\w+\()[^;{]*\)(?= \{)", re.MULTILINE)
_HIDDEN = str.maketrans({",": "\0", ";": "\1"})  # separators within comments
_SHOWN = str.maketrans({"\0": ",", "\1": ";"})


class ArrayField(NamedTuple):
    """Array of a compiled function, as the comment behind its address declares it.

    Attributes:
        name: of the argument.
        dtypes: that it may have; none where it has the dtype of the array `like`.
        like: name of another array, or "".
        shape: sizes of the axes, as expressions of the function's numbers; `a|b` is 1 or b, known as a.
        role: "input", "updated" or "result".
        optional: whether None stands for a null address.
        needs: name of the array without which a result is None, or "".
        rows: whether its strides are arguments too; the pixels of a row are contiguous, and all if `whole`.
        below: expression of the number that its values stay below, from 0 on, or "".
    """

    name: str
    dtypes: tuple[str, ...]
    like: str
    shape: tuple[str, ...]
    role: str
    optional: bool
    needs: str
    rows: bool
    whole: bool
    below: str


class NumberField(NamedTuple):
    """Number of a compiled function: name and format code of `struct`; for a whole number the range of its values, the
    step between those that serve, these themselves if they are few, and an expression of numbers that must hold.
    """

    name: str
    code: str
    least: int | None = None
    most: int = 0
    step: int = 1
    among: tuple[int, ...] = ()
    where: str = ""


class Function(NamedTuple):
    """Arguments of a compiled function in packing order, with the fields of structures, and their `struct` format."""

    fields: tuple[ArrayField | NumberField, ...]
    format: str

    @property
    def arrays(self) -> list[ArrayField]:
        """Return the arrays, results included."""
        return [field for field in self.fields if isinstance(field, ArrayField)]

    @property
    def derived(self) -> set[str]:
        """Return the numbers that arrays tell: sizes of axes, strides and codes of dtypes; and that of the threads."""
        inputs = [array for array in self.arrays if array.role != "result"]
        sizes = {size.partition("|")[0] for array in inputs for size in array.shape}
        strides = {f"{array.name}_{what}" for array in inputs for what in ("stride", "row_stride", "kind")}
        return {size for size in sizes if size.isidentifier()} | strides | {"threads"}

    @property
    def arguments(self) -> list[ArrayField | NumberField]:
        """Return what a call must give: arrays that are no results, and numbers that these do not tell."""
        left_out = self.derived | {array.name for array in self.arrays if array.role == "result"}
        return [field for field in self.fields if field.name not in left_out]


def interface(folder: Path) -> str:
    """Return the interface of the sources in a folder: the text of `interface.h`, and the declaration of each function
    that it lacks and a source defines at the begin of a line.
    """
    header = (folder / "interface.h").read_text(encoding="utf-8").partition("#pragma once")[2]
    sources = (path.read_text(encoding="utf-8") for path in sorted(folder.glob("*.cpp")))
    defined = (match for source in sources for match in _DEFINED.finditer(source))
    text = "\n".join((header, *(f"{match[0]};" for match in defined if match[1] not in header)))
    return re.sub(r"[ \t]*//[^\n]*", "", text)


def read(interface: str) -> dict[str, Function]:
    """Return the functions of an interface by name, without the prefix `fingerflow_`.

    Raises:
        ValueError: a type that cannot be packed, an array without a shape, or a name that stands twice among the
            arguments of a function.
    """
    text = re.sub(r"/\*.*?\*/", lambda comment: comment[0].translate(_HIDDEN), interface, flags=re.DOTALL)
    structures = dict(re.findall(r"struct (\w+) \{(.*?)\};", text, re.DOTALL))
    functions = {}
    for name, arguments in re.findall(r"void fingerflow_(\w+)\((.*?)\);", text, re.DOTALL):
        parts = [list(_fields(argument, structures)) for argument in arguments.split(",")]
        fields = tuple(field for part in parts for field in part)
        names = [field.name for field in fields]
        if twice := {name for name in names if names.count(name) > 1}:
            raise ValueError(f"fingerflow_{name} has {sorted(twice)} twice: give one another name")
        codes = ("".join(field.code if isinstance(field, NumberField) else "P" for field in part) for part in parts)
        # "0q" goes on to a multiple of 8 bytes, where the next argument begins.
        functions[name] = Function(fields, "@" + "0q".join(codes))
    return functions


def digest(interface: str) -> str:
    """Return a hash of an interface and the shared constants; a library built with another hash is not used."""
    shared = [Path(__file__).with_name(name).read_text(encoding="utf-8") for name in _SHARED]
    return hashlib.sha256("\n".join((*interface.split(), *shared)).encode()).hexdigest()[:16]


def _fields(line: str, structures: dict[str, str]) -> Iterator[ArrayField | NumberField]:
    """Yield the arrays and numbers of one declaration, such as `const float *light /* (height, width) */`. A structure
    passed by value yields its members.
    """
    start = re.match(r"\s*(const )?((?:unsigned )?[\w:]+)(.*)", line, re.DOTALL)
    if start is None:
        raise ValueError(f"a kernel declares {line.strip()!r}: a type and a name are expected")
    constant, kind, rest = start.groups()
    for declarator in rest.split(","):
        parts = re.fullmatch(r"\s*(\*?)\s*(\w+)\s*(?:/\*(.*?)\*/)?\s*", declarator, re.DOTALL)
        if parts is None:
            raise ValueError(f"a kernel declares {line.strip()!r}: perhaps *, and a name are expected")
        address, name, comment = parts[1], parts[2], (parts[3] or "").translate(_SHOWN)
        if kind == "fingerflow_frames":
            yield from _frames(name, comment)
        elif kind in structures and not comment:
            for member in structures[kind].split(";")[:-1]:
                yield from _fields(member, structures)
        elif address:
            yield _array(name, kind, bool(constant), comment)
        elif kind in _CODES:
            yield _number(name, _CODES[kind], comment)
        else:
            raise ValueError(f"a kernel declares {line.strip()!r}: of numbers there are {sorted(_CODES)}")


def _frames(name: str, comment: str) -> Iterator[ArrayField | NumberField]:
    """Yield the fields of frames (batch, 1, height, width); the comment may name dtypes, and the least height x width,
    and say `whole` where all pixels are contiguous.
    """
    dtypes = tuple(word for word in comment.split() if word in FRAME_KINDS) or FRAME_KINDS
    sides = re.search(r"(\d+) x (\d+)", comment)
    shape = ("batch", "1", "height", "width")
    yield ArrayField(name, dtypes, "", shape, "input", False, "", True, "whole" in comment, "")
    yield _number("batch", "q")
    for side, least in zip(("height", "width"), sides.groups() if sides else (0, 0), strict=True):
        yield _number(side, "q", f"from {least}")
    yield from (_number(f"{name}_{what}", "q") for what in ("stride", "row_stride", "kind"))


def _number(name: str, code: str, comment: str = "") -> NumberField:
    if code not in _LARGEST:
        return NumberField(name, code)
    comment, _, where = comment.partition("where")
    least, most, step = (re.search(rf"\b{word} (-?\d+)", comment) for word in ("from", "to", "by"))
    limits = int(least[1]) if least else 0, int(most[1]) if most else _LARGEST[code]
    among = tuple(map(int, comment.partition("among")[2].split()))
    return NumberField(name, code, *limits, int(step[1]) if step else 1, among, where.strip())


def _array(name: str, kind: str, constant: bool, comment: str) -> ArrayField:
    shape = re.search(r"\((.*)\)", comment)
    if shape is None:
        raise ValueError(f"a kernel declares {name} without a shape: give it in a comment, as in /* (batch, 2) */")
    before, behind = comment[: shape.start()].split(), comment[shape.end() :]
    dtypes = tuple(before) or (_DTYPES[kind],)
    like = "" if dtypes[0] in {*_DTYPES.values(), "bool"} else dtypes[0]
    words = {word: re.search(rf"\b{word} (\w+)", behind) for word in ("below", "if")}
    below, needs = (match[1] if match else "" for match in words.values())
    role = "input" if constant else "updated" if "updated" in behind else "result"
    sizes = tuple(size.strip().replace("/", "//") for size in shape[1].split(","))
    optional, rows = "optional" in behind, "rows" in behind
    return ArrayField(name, () if like else dtypes, like, sizes, role, optional, needs, rows, False, below)
