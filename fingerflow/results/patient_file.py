"""A file that bears a full disk for a while."""

from __future__ import annotations

import errno
import logging
import os
import threading
import time
from pathlib import Path
from typing import NamedTuple

log = logging.getLogger(__name__)

_FULL = (errno.ENOSPC, errno.EDQUOT)
_PATIENCE = 30.0  # s that a disk may be full
_AGAIN = 1.0  # s between two tries
_MOST = 256 << 20  # bytes that are kept meanwhile: half a minute of 700 points at 300 frames/s


class Refusal(NamedTuple):
    """A disk that was full, and has room again."""

    seconds: float
    kept: int  # bytes, at the most


class PatientFile:
    """Appends to a file that is there. What a full disk refuses is kept in memory, and tried again each second.

    Nothing is lost, and nobody waits, where there is room again within half a minute. While more is kept than memory
    should hold, `flush` waits; after half a minute it raises the error of the disk.

    Methods may be called by any thread.

    Args:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = os.open(path, os.O_WRONLY | os.O_APPEND | getattr(os, "O_BINARY", 0))
        self._kept = bytearray()
        self._most = 0
        self._since: float | None = None  # when the disk was found full
        self._tried = 0.0
        self._lock = threading.Lock()

    def __len__(self) -> int:
        """Bytes that are not in the file yet."""
        return len(self._kept)

    def write(self, data: bytes | memoryview) -> None:
        """Takes bytes; `flush` writes them."""
        with self._lock:
            self._kept += data

    def flush(self, wait: bool = False) -> Refusal | None:
        """Writes what is kept; says how long the disk was full, once, where it has room again.

        Args:
            wait: for room, where there is none.

        Raises:
            OSError: of the disk; a full one has been full for half a minute.
        """
        with self._lock:
            # Writing a few bytes a thousand times a second to a full disk helps nobody.
            if self._since is not None and not wait and time.monotonic() - self._tried < _AGAIN:
                return None
            while self._kept:
                try:
                    del self._kept[: os.write(self._file, self._kept)]
                except OSError as error:
                    self._bear(error)
                    if not wait and len(self._kept) <= _MOST:
                        return None
                    time.sleep(_AGAIN)
            return self._recover()

    def sync(self) -> None:
        """Waits until the disk has all that was written."""
        os.fsync(self._file)

    def close(self) -> None:
        """Closes the file; what `flush` could not write is lost."""
        os.close(self._file)

    def _bear(self, error: OSError) -> None:
        """Raises it where it is no full disk, or the disk is full for too long."""
        if error.errno not in _FULL:
            raise error
        self._tried = time.monotonic()
        if self._since is None:
            self._since = self._tried
            log.warning(
                "%s: %s; records are kept in memory, make room within %.0f s", self._path, error.strerror, _PATIENCE
            )
        self._most = max(self._most, len(self._kept))
        if self._tried - self._since >= _PATIENCE:
            raise error

    def _recover(self) -> Refusal | None:
        if self._since is None:
            return None
        refusal = Refusal(time.monotonic() - self._since, self._most)
        self._since, self._most = None, 0
        log.warning("%s: there is room again after %.1f s, nothing is lost", self._path, refusal.seconds)
        return refusal
