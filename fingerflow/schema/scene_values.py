"""Validation of single values in a scene file, and conversion to the type of the key."""

import math
import re
from collections.abc import Iterable
from typing import Any

from fingerflow.schema.calibration_file import can_be_undone
from fingerflow.schema.scene_keys import (
    Choice,
    Column,
    CornersType,
    Each,
    Moment,
    NumberType,
    Pair,
    PixelRange,
    Switch,
    Text,
    TimeRange,
    TransformType,
    Type,
    Whole,
)

_LEAST_DETERMINANT = 1e-6
_TIME = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*s")


class WrongValue(Exception):
    """Error for an invalid value in a scene file; the message continues the text "KEY is VALUE: "."""


def value_of(kind: Type, value: Any) -> Any:
    """Check a value from a scene file against the type `kind` of its key and return it converted to that type; raise
    WrongValue if it is invalid.
    """
    match kind:
        case Whole():
            return _whole(kind, value)
        case NumberType():
            return _number(kind, value)
        case Choice():
            return _choice(kind, value)
        case Column():
            return _column(kind, value)
        case Each():
            return _each(kind, value)
        case TimeRange():
            return _time_range(value)
        case Moment():
            return _moment(kind, value)
        case PixelRange():
            return _pixel_range(value)
        case CornersType():
            return _corners(value)
        case Pair():
            return _pair(kind.each, value)
        case TransformType():
            return _transform(value)
        case Switch():
            if not isinstance(value, bool):
                raise WrongValue("it should be true or false")
        case Text():
            if not isinstance(value, str):
                raise WrongValue("it should be text in quotes")
    return value


def either(words: Iterable[str]) -> str:
    """Return words as a text of alternatives, in the form "'a', 'b' or 'c'"."""
    *others, last = map(repr, words)
    return f"{', '.join(others)} or {last}" if others else last


def _whole(kind: Whole, value: Any) -> int:
    if type(value) is not int:
        raise WrongValue(f"it should be a whole number{_without_quotes(value)}")
    _within(kind, value)
    if kind.odd and value % 2 == 0:
        raise WrongValue(f"{value} is even; the middle pixel needs an odd side, such as {value + 1}")
    return value


def _number(kind: NumberType, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise WrongValue(f"it should be a number{_without_quotes(value)}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise WrongValue("it should be a finite number")
    _within(kind, number)
    return number


def _without_quotes(value: Any) -> str:
    """Return a remedy for a number that was written as text."""
    return (
        ", without quotes" if isinstance(value, str) and re.fullmatch(r"\s*[-+]?[\d.]+(e[-+]?\d+)?\s*", value) else ""
    )


def _within(kind: NumberType, value: float) -> None:
    if kind.above is not None and value <= kind.above:
        raise WrongValue(f"it should be above {kind.above:g}")
    if kind.least is not None and value < kind.least:
        raise WrongValue(f"it should be at least {kind.least:g}")
    if kind.most is not None and value > kind.most:
        raise WrongValue(f"it should be at most {kind.most:g}")
    if kind.below is not None and value >= kind.below:
        raise WrongValue(f"it should be below {kind.below:g}")


def _choice(kind: Choice, value: Any) -> Any:
    if isinstance(value, str) and value in kind.words:
        return value
    words = f"it should be {either(kind.words)}"
    if kind.number is None:
        raise WrongValue(words)
    try:
        return _number(kind.number, value)
    except WrongValue as wrong:
        raise WrongValue(f"{words}, or {wrong}") from None


def seconds_of(moment: Any) -> float | None:
    """Return the time in s from the trigger in a text such as "0.25 s"; None for a word or a frame number."""
    found = _TIME.fullmatch(moment.strip()) if isinstance(moment, str) else None
    return None if found is None else float(found.group(1))


def _moment(kind: Moment, value: Any) -> str | int:
    if value in kind.words or seconds_of(value) is not None:
        return str(value)
    if type(value) is int and value >= 0:
        return value
    raise WrongValue(
        f"it should be {either(kind.words)}, the number of a frame, from 0, or a time from the trigger in quotes and "
        'with its unit, "0.25 s"'
    )


def _column(kind: Column, value: Any) -> str | int | tuple[str | int, ...]:
    if (isinstance(value, str) and value) or (type(value) is int and value >= 1):
        return value
    if isinstance(value, list) and kind.several > 1 and 1 <= len(value) <= kind.several:
        return tuple(_column(Column(), item) for item in value)  # type: ignore[misc]
    several = f", or a list of up to {kind.several} of them" if kind.several > 1 else ""
    raise WrongValue(f"it should be the name of a column, in quotes, or its number, from 1{several}")


def _each(kind: Each, value: Any) -> float | tuple[float, ...]:
    if isinstance(value, list) and value:
        return tuple(_one_of(kind, item) for item in value)
    if not isinstance(value, int | float):
        one, example = ("1, -1", "[-1, 1]") if kind.among else ("a number", "[2.5, 4]")
        raise WrongValue(f"it should be {one} or a list with one for each channel, such as {example}")
    return _one_of(kind, value)


def _one_of(kind: Each, value: Any) -> float:
    number = _number(kind.number, value)
    if kind.among and number not in kind.among:
        raise WrongValue(f"it should be {' or '.join(f'{one:g}' for one in kind.among)}")
    return number


def _time_range(value: Any) -> tuple[float, float]:
    needed = "two times in s from the trigger are needed, the earlier first, for example [-0.5, -0.1]"
    if not isinstance(value, list) or len(value) != 2:
        raise WrongValue(needed)
    try:
        first, last = (_number(NumberType(), item) for item in value)
    except WrongValue as wrong:
        raise WrongValue(f"of its items {wrong}; {needed}") from None
    if first >= last:
        raise WrongValue(needed)
    return first, last


def _pixel_range(value: Any) -> tuple[int, int]:
    if not isinstance(value, list):
        raise WrongValue("it should be a list of two whole numbers, [first, end)")
    if len(value) != 2:
        raise WrongValue(f"it should have at {'most' if len(value) > 2 else 'least'} 2 items, not {len(value)}")
    for place, item in enumerate(value, start=1):
        if type(item) is not int:
            raise WrongValue(f"item {place} should be a whole number")
    first, end = value
    if not 0 <= first < end:
        raise WrongValue("two whole numbers [first, end) with 0 <= first < end are needed, for example [0, 512]")
    return first, end


def _pair(each: NumberType, value: Any) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise WrongValue("it should be a list of two numbers, [x, y]")
    x, y = (_number(each, item) for item in value)
    return x, y


def _corners(value: Any) -> tuple[tuple[float, float], ...]:
    needed = "three or more corners [x, y] in px of the view are needed, such as [[100, 80], [500, 80], [300, 400]]"
    if not isinstance(value, list) or len(value) < 3:
        raise WrongValue(needed)
    try:
        corners = tuple(_pair(NumberType(), corner) for corner in value)
    except WrongValue as wrong:
        raise WrongValue(f"of a corner {wrong}; {needed}") from None
    twice = sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in zip(corners, (*corners[1:], corners[0]), strict=True))
    if not twice:
        raise WrongValue(f"they span no area; {needed}")
    return corners


def _transform(value: Any) -> tuple[tuple[float, ...], ...]:
    needed = "an invertible [[a, b, x], [c, d, y]] is needed"
    rows = value if isinstance(value, list) else []
    if [len(row) if isinstance(row, list) else 0 for row in rows] != [3, 3]:
        raise WrongValue(f"it should be a list of 2 lists of 3 numbers; {needed}")
    try:
        matrix = tuple(tuple(_number(NumberType(), item) for item in row) for row in rows)
    except WrongValue as wrong:
        raise WrongValue(f"of its items {wrong}; {needed}") from None
    if not can_be_undone(matrix, _LEAST_DETERMINANT):
        raise WrongValue(f"it maps the whole view onto a line; its 2 x 2 part must be invertible; {needed}")
    return matrix
