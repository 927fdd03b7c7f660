"""Damage files by a seeded generator, so that a number of the command gives the same bytes again."""

import random
import struct
from collections.abc import Callable

_EXTREMES = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**48, 2**63 - 1,
             2**63, 2**64 - 1)  # fmt: skip
_WORDS = (b"0", b"-1", b"1e308", b"nan", b"inf", b"-0", b"99999999999999999999", b"[]", b"{}", b'""', b"null", b"true",
          b"'", b"\xff\xfe", b"\x00", b"[[[[[[[[", b"1,05", b"../..", b"\xc3\xa9", b"1e-320", b"0x10")  # fmt: skip
_HEADER = 600  # bytes that hold the header of most formats


def damage(data: bytes, other: bytes, rng: random.Random) -> bytes:
    """Return the data with one to three kinds of damage; pieces may come from `other`, a file of the same kind."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        if data:
            data = rng.choice(_KINDS)(data, other, rng)
    return data


def _place(data: bytes, rng: random.Random) -> int:
    """Return a position in the data; about half of them lie near the beginning or the end, where headers and indices
    are.
    """
    reach = min(_HEADER, len(data))
    where = rng.random()
    if where < 0.4:
        return rng.randrange(reach)
    if where < 0.55:
        return len(data) - 1 - rng.randrange(reach)
    return rng.randrange(len(data))


def _flip(data: bytes, other: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 2, 8, 30))):
        changed[_place(data, rng)] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _truncate(data: bytes, other: bytes, rng: random.Random) -> bytes:
    return data[: _place(data, rng)]


def _splice(data: bytes, other: bytes, rng: random.Random) -> bytes:
    source = other if rng.random() < 0.5 and other else data
    start, length = rng.randrange(len(source)), rng.choice((4, 16, 64, 300))
    at = _place(data, rng)
    cut = at + length if rng.random() < 0.5 else at  # replace bytes, or insert
    return data[:at] + source[start : start + length] + data[cut:]


def _remove(data: bytes, other: bytes, rng: random.Random) -> bytes:
    at = _place(data, rng)
    return data[:at] + data[at + rng.choice((1, 4, 40, 400)) :]


def _extreme_number(data: bytes, other: bytes, rng: random.Random) -> bytes:
    size, order = rng.choice((1, 2, 2, 4, 4, 4, 8)), rng.choice("<<>")
    at = min(_place(data, rng), max(len(data) - size, 0))
    if rng.random() < 0.7:
        at -= at % min(size, 4)
    value = rng.choice(_EXTREMES) % 2 ** (8 * size)
    if rng.random() < 0.15:  # a floating-point number
        packed = struct.pack(order + ("d" if size == 8 else "f"), rng.choice((0.0, -1.0, 1e30, float("nan"))))
    else:
        packed = value.to_bytes(size, "little" if order == "<" else "big")
    return data[:at] + packed + data[at + len(packed) :]


def _word(data: bytes, other: bytes, rng: random.Random) -> bytes:
    """Return a text with a word or number replaced by another one."""
    at = _place(data, rng)
    start, end = at, at
    while start and data[start - 1 : start].isalnum():
        start -= 1
    while end < len(data) and (data[end : end + 1].isalnum() or data[end : end + 1] in b".-"):
        end += 1
    return data[:start] + rng.choice(_WORDS) + data[min(end, start + 60) :]


_KINDS: tuple[Callable[[bytes, bytes, random.Random], bytes], ...] = (
    _flip, _flip, _truncate, _splice, _remove, _extreme_number, _extreme_number, _word,
)  # fmt: skip
