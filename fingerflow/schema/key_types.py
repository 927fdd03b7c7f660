"""Types of keys in scene files and recipes: each converts a value, says in words what it takes, and describes the input
field of the page.
"""

import math
import operator
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from fingerflow.schema.calibration_file import can_be_undone

Reader = Literal["process", "stream"]
PROCESS, STREAM = frozenset[Reader](("process",)), frozenset[Reader](("stream",))
BOTH = PROCESS | STREAM
NOBODY = frozenset[Reader]()
_LEAST_DETERMINANT = 1e-6
_TIME = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*s")


class WrongValue(Exception):
    """Error for an invalid value of a key; the message continues the text "KEY is VALUE: "."""


@dataclass(frozen=True)
class KeyType:
    """Type of a key; types of one class with the same limits are equal."""

    @property
    def words(self) -> str:
        """Return what a key of this type takes, as the list of keys shows it."""
        raise NotImplementedError

    def convert(self, value: Any) -> Any:
        """Return a value from a file converted to this type; raise WrongValue if it is invalid."""
        raise NotImplementedError

    def form(self) -> dict[str, Any]:
        """Return kind and limits of the input field of the page; by default the value is entered as TOML text."""
        return {"input": "toml"}


@dataclass(frozen=True)
class NumberType(KeyType):
    """Type of a key that takes a finite number, a ``whole`` or an ``odd`` one where that is set, but no boolean."""

    above: float | None = None
    least: float | None = None
    most: float | None = None
    below: float | None = None
    odd: bool = False
    whole: bool = False

    @property
    def words(self) -> str:
        limits = ((">", self.above), ("≥", self.least), ("≤", self.most), ("<", self.below))
        bounds = " and ".join(f"{sign} {limit:g}" for sign, limit in limits if limit is not None)
        return f"{'odd ' if self.odd else ''}{'whole ' if self.whole else ''}number {bounds}".strip()

    def convert(self, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int if self.whole else int | float):
            quoted = isinstance(value, str) and re.fullmatch(r"\s*[-+]?[\d.]+(e[-+]?\d+)?\s*", value)
            expected = "a whole number" if self.whole else "a number"
            raise WrongValue(f"it should be {expected}{', without quotes' if quoted else ''}")
        try:
            finite = math.isfinite(value)
        except OverflowError:
            finite = False
        if not finite:
            raise WrongValue("it should be a finite number")
        number = value if self.whole else float(value)
        for words, limit, is_beyond in (
            *(("above", self.above, operator.le), ("at least", self.least, operator.lt)),
            *(("at most", self.most, operator.gt), ("below", self.below, operator.ge)),
        ):
            if limit is not None and is_beyond(number, limit):
                raise WrongValue(f"it should be {words} {limit:g}")
        if self.odd and number % 2 == 0:
            raise WrongValue(f"{number} is even; the middle pixel needs an odd side, such as {number + 1}")
        return number

    def form(self) -> dict[str, Any]:
        of_whole = {"odd": self.odd} if self.whole else {}
        return {"input": "whole" if self.whole else "number", **self.limits(), **of_whole}

    def limits(self) -> dict[str, float | None]:
        """Return the smallest and the largest number that the input field of the page offers."""
        return {
            "least": self.above if self.least is None else self.least,
            "most": self.below if self.most is None else self.most,
        }


class Switch(KeyType):
    """Type of a key that takes true or false."""

    words = "true or false"

    def convert(self, value: Any) -> bool:
        if not isinstance(value, bool):
            raise WrongValue("it should be true or false")
        return value

    def form(self) -> dict[str, Any]:
        return {"input": "switch"}


class Text(KeyType):
    """Type of a key that takes any text."""

    words = "text"

    def convert(self, value: Any) -> str:
        if not isinstance(value, str):
            raise WrongValue("it should be text in quotes")
        return value

    def form(self) -> dict[str, Any]:
        return {"input": "text"}


@dataclass(frozen=True)
class Choice(KeyType):
    """Type of a key that takes one of several words or numbers, or also any number of the type ``number``."""

    choices: tuple[str | int, ...]
    number: NumberType | None = None

    @property
    def words(self) -> str:
        shown = [f'"{choice}"' if isinstance(choice, str) else str(choice) for choice in self.choices]
        return " or ".join([*shown, *([] if self.number is None else [self.number.words])])

    def convert(self, value: Any) -> Any:
        if isinstance(value, str | int) and not isinstance(value, bool) and value in self.choices:
            return value
        words = f"it should be {either(self.choices)}"
        if self.number is None:
            raise WrongValue(words)
        try:
            return self.number.convert(value)
        except WrongValue as wrong:
            raise WrongValue(f"{words}, or {wrong}") from None

    def form(self) -> dict[str, Any]:
        return {"input": "choice", "words": self.choices, "number": self.number and self.number.limits()}


@dataclass(frozen=True)
class Several(KeyType):
    """Type of a key of a recipe that takes a list of some of several words."""

    choices: tuple[str, ...]

    @property
    def words(self) -> str:
        return f"list of {either(self.choices)}"

    def convert(self, value: Any) -> tuple[str, ...]:
        if not isinstance(value, list | tuple) or not all(item in self.choices for item in value):
            raise WrongValue(f"it should be a list of {either(self.choices)}")
        return tuple(value)


@dataclass(frozen=True)
class Column(KeyType):
    """Type of a key that takes a column of the force file, by name or by number from 1, or a list of up to ``several``
    columns.
    """

    several: int = 1

    @property
    def words(self) -> str:
        return "column" if self.several == 1 else f"column, or a list of up to {self.several}"

    def convert(self, value: Any) -> Any:
        if (isinstance(value, str) and value) or (type(value) is int and value >= 1):
            return value
        if isinstance(value, list) and self.several > 1 and 1 <= len(value) <= self.several:
            return tuple(map(Column().convert, value))
        several = f", or a list of up to {self.several} of them" if self.several > 1 else ""
        raise WrongValue(f"it should be the name of a column, in quotes, or its number, from 1{several}")

    def form(self) -> dict[str, Any]:
        return {"input": "column", "several": self.several}


@dataclass(frozen=True)
class Each(KeyType):
    """Type of a key that takes one number for all force channels, or a list with a number for each channel; ``among``
    are the only numbers possible, if any.
    """

    among: tuple[float, ...] = ()

    @property
    def words(self) -> str:
        return f"{' or '.join(f'{value:g}' for value in self.among) or 'number'}; or a list, one a force"

    def convert(self, value: Any) -> float | tuple[float, ...]:
        if isinstance(value, list) and value:
            return tuple(map(self._number, value))
        if not isinstance(value, int | float):
            single, example = ("1, -1", "[-1, 1]") if self.among else ("a number", "[2.5, 4]")
            raise WrongValue(f"it should be {single} or a list with one for each channel, such as {example}")
        return self._number(value)

    def _number(self, value: Any) -> float:
        number = NumberType().convert(value)
        if self.among and number not in self.among:
            raise WrongValue(f"it should be {' or '.join(f'{choice:g}' for choice in self.among)}")
        return number

    def form(self) -> dict[str, Any]:
        return {"input": "signs"} if self.among else super().form()


class TimeRange(KeyType):
    """Type of a key that takes an interval [t0, t1] in s from the trigger, with t0 before t1."""

    words = "[t0, t1] from the trigger,"

    def convert(self, value: Any) -> tuple[float, float]:
        needed = "two times in s from the trigger are needed, the earlier first, for example [-0.5, -0.1]"
        if not isinstance(value, list) or len(value) != 2:
            raise WrongValue(needed)
        try:
            first, last = map(NumberType().convert, value)
        except WrongValue as wrong:
            raise WrongValue(f"of its items {wrong}; {needed}") from None
        if first >= last:
            raise WrongValue(needed)
        return first, last


@dataclass(frozen=True)
class Moment(KeyType):
    """Type of a key that takes an instant of the recording: a word, a frame number from 0, or a time from the trigger
    as "0.25 s".
    """

    choices: tuple[str, ...]

    @property
    def words(self) -> str:
        return " or ".join([*(f'"{word}"' for word in self.choices), 'a frame, or a time such as "0.25 s"'])

    def convert(self, value: Any) -> str | int:
        if value in self.choices or parse_seconds(value) is not None:
            return str(value)
        if type(value) is int and value >= 0:
            return value
        raise WrongValue(
            f"it should be {either(self.choices)}, the number of a frame, from 0, or a time from the trigger in quotes "
            'and with its unit, "0.25 s"'
        )


@dataclass(frozen=True)
class File(KeyType):
    """Type of a key that takes a path relative to the scene file, or "file.h5::/dataset" for a data set in a file.

    Attributes:
        there_for: readers for which the file must exist: a scene may be taken to a lab PC without its recording.
        calibration: whether it is a calibration file, which is read with the scene.
    """

    there_for: frozenset[Reader] = BOTH
    calibration: bool = False
    words = "path"

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

    def form(self) -> dict[str, Any]:
        return {"input": "file"}


class PixelRange(KeyType):
    """Type of a key that takes a half-open range [first, end) of pixels."""

    words = "[first, end)"

    def convert(self, value: Any) -> tuple[int, int]:
        if not isinstance(value, list):
            raise WrongValue("it should be a list of two whole numbers, [first, end)")
        if len(value) != 2:
            raise WrongValue(f"it should have at {'most' if len(value) > 2 else 'least'} 2 items, not {len(value)}")
        for position, item in enumerate(value, start=1):
            if type(item) is not int:
                raise WrongValue(f"item {position} should be a whole number")
        first, end = value
        if not 0 <= first < end:
            raise WrongValue("two whole numbers [first, end) with 0 <= first < end are needed, for example [0, 512]")
        return first, end


@dataclass(frozen=True)
class Pair(KeyType):
    """Type of a key that takes a pair of numbers [x, y]."""

    each: NumberType = NumberType()

    @property
    def words(self) -> str:
        return f"[x, y], each a {self.each.words}"

    def convert(self, value: Any) -> tuple[float, float]:
        if not isinstance(value, list) or len(value) != 2:
            raise WrongValue("it should be a list of two numbers, [x, y]")
        x, y = map(self.each.convert, value)
        return x, y


class CornersType(KeyType):
    """Type of a key that takes a polygon [[x, y], ...] with three or more corners, in px of a view."""

    words = "[[x, y], ...], three or more,"

    def convert(self, value: Any) -> tuple[tuple[float, float], ...]:
        needed = "three or more corners [x, y] in px of the view are needed, such as [[100, 80], [500, 80], [300, 400]]"
        if not isinstance(value, list) or len(value) < 3:
            raise WrongValue(needed)
        try:
            corners = tuple(map(Pair().convert, value))
        except WrongValue as wrong:
            raise WrongValue(f"of a corner {wrong}; {needed}") from None
        if not sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in zip(corners, (*corners[1:], corners[0]), strict=True)):
            raise WrongValue(f"they span no area; {needed}")
        return corners


class TransformType(KeyType):
    """Type of a key that takes an invertible affine transform [[a, b, x], [c, d, y]]."""

    words = "[[a, b, x], [c, d, y]]"

    def convert(self, value: Any) -> tuple[tuple[float, ...], ...]:
        needed = "an invertible [[a, b, x], [c, d, y]] is needed"
        rows = value if isinstance(value, list) else []
        if [len(row) if isinstance(row, list) else 0 for row in rows] != [3, 3]:
            raise WrongValue(f"it should be a list of 2 lists of 3 numbers; {needed}")
        try:
            matrix = tuple(tuple(map(NumberType().convert, row)) for row in rows)
        except WrongValue as wrong:
            raise WrongValue(f"of its items {wrong}; {needed}") from None
        if not can_be_undone(matrix, _LEAST_DETERMINANT):
            raise WrongValue(f"it maps the whole view onto a line; its 2 x 2 part must be invertible; {needed}")
        return matrix


def key_type(hint: Any, stated: KeyType | None) -> KeyType:
    """Return the type of a key: that stated with its field, or else what its annotation `hint` says. Of a number the
    range is stated, and the annotation says whether it is whole.
    """
    if stated is not None and not isinstance(stated, NumberType):
        return stated
    parts = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    number = replace(stated or NumberType(), whole=float not in parts)
    words = tuple(word for part in parts if get_origin(part) is Literal for word in get_args(part))
    if words:
        return Choice(words, number if {int, float} & {*parts} else None)
    (plain,) = (part for part in parts if part is not NoneType)
    types: dict[Any, KeyType] = {bool: Switch(), str: Text(), Path: File()}
    return types.get(plain, number)


def parse_seconds(moment: Any) -> float | None:
    """Return the time in s from the trigger in a text such as "0.25 s"; None for a word or a frame number."""
    match = _TIME.fullmatch(moment.strip()) if isinstance(moment, str) else None
    return None if match is None else float(match.group(1))


def either(words: Iterable[object]) -> str:
    """Return words as a text of alternatives, in the form "'a', 'b' or 'c'"."""
    *rest, last = map(repr, words)
    return f"{', '.join(rest)} or {last}" if rest else last
