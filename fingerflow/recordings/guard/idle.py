"""When a process that should answer has come to a stand, told from one that a busy machine keeps waiting."""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Self

import psutil

_LOOK_SECONDS = 1.0
_AT_WORK = (psutil.STATUS_RUNNING, psutil.STATUS_WAKING)  # on a processor, or waiting for one


class IdleLimit:
    """While the context lasts, ends a process that does nothing for too long.

    It counts looks, a second apart, at which neither the process nor one that it has started was on a processor, waited
    for one, or had used one since the look before: time in which other programs have the machine, or in which it
    sleeps, is not held against it. What computes without end has a limit of the processor's time (`walk`).
    """

    def __init__(self, process: int, seconds: float) -> None:
        self._process, self._looks = process, max(1, round(seconds / _LOOK_SECONDS))
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self.reached = False

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._over.set()

    def _watch(self) -> None:
        idle, used = 0, -1.0
        while not self._over.wait(_LOOK_SECONDS):
            try:
                watched = psutil.Process(self._process)
                family = [watched, *watched.children(recursive=True)]
                at_work, now = False, 0.0
                for one in family:
                    times = one.cpu_times()
                    now += times.user + times.system
                    at_work |= one.status() in _AT_WORK
            except psutil.NoSuchProcess:  # it has ended, or one of its children just now
                if not psutil.pid_exists(self._process):
                    return
                continue
            idle = 0 if at_work or now != used else idle + 1
            used = now
            if idle >= self._looks and not self._over.is_set():
                self.reached = True
                watched.kill()
                return
