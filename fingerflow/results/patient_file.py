"""Writer of a file that buffers data in memory while the disk is full, instead of failing at once."""

import contextlib
import errno
import logging
import os
import threading
import time
from pathlib import Path

log = logging.getLogger(__name__)

_FULL = (errno.ENOSPC, errno.EDQUOT)
_PATIENCE = 30.0  # s for which a full disk is tolerated
_AGAIN = 1.0  # s between two attempts to write
_PART = 1 << 20  # bytes copied at a time
_MOST = 256 << 20  # bytes buffered while the disk is full: half a minute of 700 points at 300 frames/s


class PatientFile:
    """Writer that appends to a file, and buffers data in memory while the disk is full.

    Writing is retried each second.

    Nothing is lost if space is freed within half a minute; after that, `flush` raises the error of the disk. `flush`
    returns at once in between, unless `wait` is set or the buffer exceeds 256 MiB.

    Methods may be called by any thread.

    Args:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = self._open(path)
        self._kept = bytearray()
        self._most = 0
        self._since: float | None = None  # s, time when the disk was found full
        self._tried = 0.0
        self._lock = threading.Lock()

    @staticmethod
    def _open(path: Path) -> int:
        return os.open(path, os.O_RDWR | os.O_APPEND | getattr(os, "O_BINARY", 0))

    def is_in_place(self) -> bool:
        """Return False if the file was removed, renamed or unmounted since it was opened."""
        try:
            return os.path.samestat(os.fstat(self._file), self._path.stat())
        except OSError:
            return False

    def move(self, path: Path) -> None:
        """Copy all that was written to an empty file `path`, as far as it can be read, and write there from now on."""
        with self._lock:
            left, self._path, self._file = self._file, path, self._open(path)
            with contextlib.suppress(OSError):  # the disk is gone
                os.lseek(left, 0, os.SEEK_SET)
                while part := os.read(left, _PART):
                    os.write(self._file, part)
            os.close(left)

    def __len__(self) -> int:
        """Return the number of bytes that are buffered in memory but not written to the file yet."""
        return len(self._kept)

    def write(self, data: bytes | memoryview) -> None:
        """Add bytes to the buffer, which `flush` writes to the file."""
        with self._lock:
            self._kept += data

    def flush(self, wait: bool = False) -> tuple[float, int] | None:
        """Write all buffered bytes to the file; while the disk is full, keep them in memory for a later attempt.

        The first success after a full disk returns for how long it was full, s, and the largest number of buffered
        bytes; otherwise None is returned.

        Args:
            wait: wait for room where there is none.

        Raises:
            OSError: of the disk; a full disk raises only after half a minute.
        """
        while True:
            with self._lock:
                must_wait = wait or len(self._kept) > _MOST
                # Do not retry with every record, up to a thousand times a second.
                if self._since is not None and not must_wait and time.monotonic() - self._tried < _AGAIN:
                    return None
                try:
                    while self._kept:
                        del self._kept[: os.write(self._file, self._kept)]
                    return None if self._since is None else self._recover(self._since)
                except OSError as error:
                    self._raise_or_wait(error)
                    if not must_wait:
                        return None
            time.sleep(_AGAIN)  # without holding the lock, so that other threads can write

    def sync(self) -> None:
        """Wait until the disk holds all data written to the file."""
        os.fsync(self._file)

    def close(self) -> None:
        """Close the file. Data that `flush` could not write are lost."""
        os.close(self._file)

    def _raise_or_wait(self, error: OSError) -> None:
        """Raise a write error, unless its cause is a disk that has been full for less than half a minute; then return,
        to try again.
        """
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

    def _recover(self, since: float) -> tuple[float, int]:
        ended = time.monotonic() - since, self._most
        self._since, self._most = None, 0
        log.warning("%s: there is room again after %.1f s, nothing is lost", self._path, ended[0])
        return ended
