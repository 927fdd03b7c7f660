"""Types of keys in scene files and recipes: each converts a value, says in words what it takes, and describes the input
field of the page.
"""

import operator
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

Reader = Literal["process", "stream"]
PROCESS, STREAM = frozenset[Reader](("process",)), frozenset[Reader](("stream",))
BOTH = PROCESS | STREAM
NOBODY = frozenset[Reader]()
_TIME = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*s")


class WrongValue(Exception):
    """Error for an invalid value of a key; the message continues the text "KEY is VALUE: "."""


@dataclass(frozen=True)
class KeyType:
    """Type of a key: what it takes and how it is entered.

    Attributes:
        words: what it takes, as the list of keys shows it.
        convert: returns a value from a file converted to this type; raises WrongValue if it is invalid.
        form: name and limits of the input field of the page; by default the value is entered as TOML text.
        choices: words or numbers that it takes, if it names any.
    """

    words: str
    convert: Callable[[Any], Any]
    form: Mapping[str, Any] = field(default_factory=lambda: {"input": "toml"})
    choices: tuple[str | int, ...] = ()


@dataclass(frozen=True)
class File:
    """Type of a key that takes a path relative to the scene file, or "file.h5::/dataset" for a data set in a file.

    Attributes:
        there_for: readers for which the file must exist: a scene may be taken to a lab PC without its recording.
        calibration: whether it is a calibration file, which is read with the scene.
    """

    there_for: frozenset[Reader] = BOTH
    calibration: bool = False
    words, form, choices = "path", {"input": "file"}, ()

    def path(self, value: Any, folder: Path, reader: Reader) -> Path:
        """Return the absolute path that a value names, relative to a folder; raise WrongValue if there is none or the
        reader needs a file there.
        """
        if not isinstance(value, str):
            raise WrongValue("that is no path of a file; it should be in quotes, relative to the scene file")
        if not value.isprintable():
            raise WrongValue(r"that is no path: it has control characters, which TOML makes of \ and a letter; write /")
        try:
            path = (folder / value).resolve()
            there = Path(str(path).split("::")[0]).exists()
        except (OSError, ValueError) as error:  # an invalid file name, or a folder without permission
            raise WrongValue(f"that is no path that can be looked up ({error}); correct it") from None
        if reader in self.there_for and not there:
            raise WrongValue(f"{path} does not exist; paths are relative to the folder of the scene file")
        return path


#: Type of a number of which the range is stated, given whether it is whole, which the annotation of the key says.
NumberType = Callable[[bool], KeyType]


def number(
    above: float | None = None,
    least: float | None = None,
    most: float | None = None,
    below: float | None = None,
    odd: bool = False,
) -> NumberType:
    """Return the type of a key that takes a finite number in a range, an ``odd`` one where that is set."""
    possible = (
        (">", "above", above, operator.le),
        ("≥", "at least", least, operator.lt),
        ("≤", "at most", most, operator.gt),
        ("<", "below", below, operator.ge),
    )
    limits = [(sign, words, limit, beyond) for sign, words, limit, beyond in possible if limit is not None]
    bounds = " and ".join(f"{sign} {limit:g}" for sign, _, limit, _ in limits)
    form = {"least": above if least is None else least, "most": below if most is None else most}

    def of_kind(whole: bool) -> KeyType:
        def convert(value: Any) -> float:
            if isinstance(value, bool) or not isinstance(value, int if whole else int | float):
                quoted = isinstance(value, str) and re.fullmatch(r"\s*[-+]?[\d.]+(e[-+]?\d+)?\s*", value)
                expected = "a whole number" if whole else "a number"
                raise WrongValue(f"it should be {expected}{', without quotes' if quoted else ''}")
            if not abs(value) <= sys.float_info.max:
                raise WrongValue("it should be a finite number")
            converted = value if whole else float(value)
            for _, words, limit, is_beyond in limits:
                if is_beyond(converted, limit):
                    raise WrongValue(f"it should be {words} {limit:g}")
            if odd and converted % 2 == 0:
                raise WrongValue(f"{converted} is even; the middle pixel needs an odd side, such as {converted + 1}")
            return converted

        words = f"{'odd ' if odd else ''}{'whole ' if whole else ''}number {bounds}".strip()
        return KeyType(words, convert, ({"input": "whole", "odd": odd} if whole else {"input": "number"}) | form)

    return of_kind


ANY_NUMBER = number()(False)


def _instance_of(kind: type, words: str, needed: str, name: str) -> KeyType:
    def convert(value: Any) -> Any:
        if not isinstance(value, kind):
            raise WrongValue(f"it should be {needed}")
        return value

    return KeyType(words, convert, {"input": name})


SWITCH = _instance_of(bool, "true or false", "true or false", "switch")
TEXT = _instance_of(str, "text", "text in quotes", "text")


def choice(choices: tuple[str | int, ...], other: KeyType | None = None) -> KeyType:
    """Return the type of a key that takes one of several words or numbers, or also any number of the type `other`."""

    def convert(value: Any) -> Any:
        if isinstance(value, str | int) and not isinstance(value, bool) and value in choices:
            return value
        words = f"it should be {either(choices)}"
        if other is None:
            raise WrongValue(words)
        try:
            return other.convert(value)
        except WrongValue as wrong:
            raise WrongValue(f"{words}, or {wrong}") from None

    shown = [f'"{word}"' if isinstance(word, str) else str(word) for word in choices]
    limits = other and {name: other.form[name] for name in ("least", "most")}
    form = {"input": "choice", "words": choices, "number": limits}
    return KeyType(" or ".join([*shown, *([] if other is None else [other.words])]), convert, form, choices)


def several(choices: tuple[str, ...]) -> KeyType:
    """Return the type of a key of a recipe that takes a list of some of several words."""

    def convert(value: Any) -> tuple[str, ...]:
        if not isinstance(value, list | tuple) or not all(item in choices for item in value):
            raise WrongValue(f"it should be a list of {either(choices)}")
        return tuple(value)

    return KeyType(f"list of {either(choices)}", convert)


def column(most: int = 1) -> KeyType:
    """Return the type of a key that takes a column of the force file, by name or by number from 1, or a list of up to
    `most` columns.
    """

    def convert(value: Any) -> Any:
        if (isinstance(value, str) and value) or (type(value) is int and value >= 1):
            return value
        if isinstance(value, list) and most > 1 and 1 <= len(value) <= most:
            return tuple(map(column().convert, value))
        listed = f", or a list of up to {most} of them" if most > 1 else ""
        raise WrongValue(f"it should be the name of a column, in quotes, or its number, from 1{listed}")

    words = "column" if most == 1 else f"column, or a list of up to {most}"
    return KeyType(words, convert, {"input": "column", "several": most})


def each(*among: float) -> KeyType:
    """Return the type of a key that takes one number for all force channels, or a list with a number for each channel;
    `among` are the only numbers possible, if any.
    """

    def channel(value: Any) -> float:
        converted: float = ANY_NUMBER.convert(value)
        if among and converted not in among:
            raise WrongValue(f"it should be {' or '.join(f'{sign:g}' for sign in among)}")
        return converted

    def convert(value: Any) -> float | tuple[float, ...]:
        if isinstance(value, list) and value:
            return tuple(map(channel, value))
        if not isinstance(value, int | float):
            single, example = ("1, -1", "[-1, 1]") if among else ("a number", "[2.5, 4]")
            raise WrongValue(f"it should be {single} or a list with one for each channel, such as {example}")
        return channel(value)

    words = f"{' or '.join(f'{sign:g}' for sign in among) or 'number'}; or a list, one a force"
    return KeyType(words, convert, {"input": "signs" if among else "toml"})


def list_of(
    words: str,
    needed: str,
    items: Sequence[KeyType],
    more: bool = False,
    holds: Callable[[list[Any]], bool] = lambda _: True,
) -> KeyType:
    """Return the type of a key that takes a list with a value of each of the types `items`; with `more`, further ones
    of the last type. `needed` says so in words, with any rule for the values together, which `holds` checks.
    """

    def convert(value: Any) -> tuple[Any, ...]:
        count = len(value) if isinstance(value, list | tuple) else 0
        if count < len(items) or (count > len(items) and not more):
            raise WrongValue(needed)
        converted = []
        for number, (item, item_type) in enumerate(zip_longest(value, items, fillvalue=items[-1]), start=1):
            try:
                converted.append(item_type.convert(item))
            except WrongValue as wrong:
                raise WrongValue(f"of item {number} {wrong}; {needed}") from None
        if not holds(converted):
            raise WrongValue(needed)
        return tuple(converted)

    return KeyType(words, convert)


#: Interval [t0, t1] in s from the trigger, with t0 before t1.
TIME_RANGE = list_of(
    "[t0, t1] from the trigger,",
    "two times in s from the trigger are needed, the earlier first, for example [-0.5, -0.1]",
    (ANY_NUMBER, ANY_NUMBER),
    holds=lambda times: times[0] < times[1],
)


def moment(choices: tuple[str, ...]) -> KeyType:
    """Return the type of a key that takes an instant of the recording: a word, a frame number from 0, or a time from
    the trigger as "0.25 s".
    """

    def convert(value: Any) -> str | int:
        if value in choices or parse_seconds(value) is not None:
            return str(value)
        if type(value) is int and value >= 0:
            return value
        raise WrongValue(
            f"it should be {either(choices)}, the number of a frame, from 0, or a time from the trigger in quotes "
            'and with its unit, "0.25 s"'
        )

    words = " or ".join([*(f'"{word}"' for word in choices), 'a frame, or a time such as "0.25 s"'])
    return KeyType(words, convert, choices=choices)


#: Half-open range [first, end) of pixels.
PIXEL_RANGE = list_of(
    "[first, end)",
    "two whole numbers [first, end) with 0 <= first < end are needed, for example [0, 512]",
    (number(least=0)(True),) * 2,
    holds=lambda pixels: pixels[0] < pixels[1],
)


def row(**items: NumberType) -> KeyType:
    """Return the type of a key that takes a list of named numbers, each with a range."""
    words = f"[{', '.join(items)}]"
    types = [ranged(False) for ranged in items.values()]
    return list_of(words, f"it should be a list of {len(items)} numbers, {words}", types)


_POSITION = number(least=-1e6, most=1e6)  # px
PAIR = row(x=_POSITION, y=_POSITION)


def _span_area(corners: Sequence[tuple[float, float]]) -> bool:
    return sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in zip(corners, (*corners[1:], corners[0]), strict=True)) != 0


#: Polygon [[x, y], ...] with three or more corners, in px of a view.
CORNERS = list_of(
    "[[x, y], ...], three or more,",
    "three or more corners [x, y] in px of the view, not all on a line, are needed, such as "
    "[[100, 80], [500, 80], [300, 400]]",
    (PAIR, PAIR, PAIR),
    more=True,
    holds=_span_area,
)

_SCALE = number(least=-100, most=100)(False)
_ROW = list_of("", "three numbers are needed", (_SCALE, _SCALE, _POSITION(False)))
#: Invertible affine transform [[a, b, x], [c, d, y]].
TRANSFORM = list_of(
    "[[a, b, x], [c, d, y]]",
    "a transform [[a, b, x], [c, d, y]] that does not map the whole view onto a line is needed",
    (_ROW, _ROW),
    holds=lambda rows: abs(rows[0][0] * rows[1][1] - rows[0][1] * rows[1][0]) > 1e-6,
)


def key_type(hint: Any, stated: KeyType | File | NumberType | None) -> KeyType | File:
    """Return the type of a key: that stated with its field, or else what its annotation `hint` says. Of a number the
    range is stated, and the annotation says whether it is whole.
    """
    if isinstance(stated, KeyType | File):
        return stated
    parts = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    ranged = (stated or number())(float not in parts)
    words = tuple(word for part in parts if get_origin(part) is Literal for word in get_args(part))
    if words:
        return choice(words, ranged if {int, float} & {*parts} else None)
    (plain,) = (part for part in parts if part is not NoneType)
    types: dict[Any, KeyType | File] = {bool: SWITCH, str: TEXT, Path: File()}
    return types.get(plain, ranged)


def parse_seconds(moment: Any) -> float | None:
    """Return the time in s from the trigger in a text such as "0.25 s"; None for a word or a frame number."""
    match = _TIME.fullmatch(moment.strip()) if isinstance(moment, str) else None
    return None if match is None else float(match.group(1))


def either(words: Iterable[object]) -> str:
    """Return words as a text of alternatives, in the form "'a', 'b' or 'c'"."""
    *rest, last = map(repr, words)
    return f"{', '.join(rest)} or {last}" if rest else last
