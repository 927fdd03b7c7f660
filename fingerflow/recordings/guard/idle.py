"""Time limit for a process that makes no progress, not counting time during which the machine is busy."""

import threading
from types import TracebackType
from typing import Self

import psutil

_LOOK_SECONDS = 1.0
_AT_WORK = (psutil.STATUS_RUNNING, psutil.STATUS_WAKING)  # states of a process that is running or waits for a CPU


class IdleLimit:
    """Context manager that kills a child process, given by its process id, once it has been idle for a number of
    seconds.

    It checks once a second. A check counts as idle if neither the process nor any of its children is running, waits for
    a CPU, or has used CPU time since the check before. Time in which other programs occupy the machine, or in which it
    sleeps, does not count. Endless computation is ended by a limit of CPU time (`child_reader`).
    """

    def __init__(self, process: int, seconds: float) -> None:
        self._process, self._looks = process, max(1, round(seconds / _LOOK_SECONDS))
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self.reached = False

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, exception_type: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        self._over.set()

    def _watch(self) -> None:
        idle, used = 0, -1.0
        while not self._over.wait(_LOOK_SECONDS):
            try:
                watched = psutil.Process(self._process)
                family = [watched, *watched.children(recursive=True)]
                at_work, now = False, 0.0
                for process in family:
                    times = process.cpu_times()
                    now += times.user + times.system
                    at_work |= process.status() in _AT_WORK
            except psutil.NoSuchProcess:  # the process, or one of its children, has just ended
                if not psutil.pid_exists(self._process):
                    return
                continue
            idle = 0 if at_work or now != used else idle + 1
            used = now
            if idle >= self._looks and not self._over.is_set():
                self.reached = True
                watched.kill()
                return
