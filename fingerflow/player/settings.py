"""How a stream runs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """How a stream runs.

    Attributes:
        every: process every frame, the source waits for room; else the newest frame, those it overtakes are dropped.
        queue: frames that wait at most; 1 in the policy `latest`.
        rate: Hz at which a recording is played, None as fast as it goes.
        first: number of the first frame in the source.
        frames: end after so many, None at the source's end.
        give_up: s without a frame after which the stream ends with an error.
        parallel: frames that are computed beside each other.
        page: host and port of the live page, None for none; port 0 takes a free one.
    """

    every: bool = True
    queue: int = 32
    rate: float | None = None
    first: int = 0
    frames: int | None = None
    give_up: float = 30.0
    parallel: int = 1
    page: tuple[str, int] | None = None
