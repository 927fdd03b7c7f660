"""Settings of a run of a stream."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Settings of a run of a stream.

    Attributes:
        every: process every frame, so that the source waits for free space; else the newest frame, and drop older ones.
        queue: largest number of waiting frames; 1 with the policy `latest`.
        rate: Hz at which a recording is played, None for as fast as possible.
        first: number of the first frame in the source.
        frames: number of frames after which the stream ends, None for the source's end.
        give_up: s without a frame after which the stream ends with an error.
        parallel: number of frames that are computed in parallel.
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
