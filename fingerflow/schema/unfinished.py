"""Manage temporary paths of unfinished outputs: naming, renaming on completion, and removal after killed runs."""

import contextlib
import os
import platform
import re
import secrets
import shutil
import zlib
from pathlib import Path


def unfinished(path: Path) -> Path:
    """Return a hidden temporary path under which an output is written until it is complete and renamed to `path`.

    Also removes the temporary paths of the same output that killed runs have left. Their names hold the computer and
    the process id; a path is removed only if it is of this computer and its process has ended.
    """
    here = f"{zlib.crc32(platform.node().encode()):08x}"
    stem, suffix = path.stem, path.suffix
    pattern = re.compile(rf"\.{re.escape(stem)}-{here}-(\d+)-[0-9a-f]{{8}}{re.escape(suffix)}")
    with contextlib.suppress(OSError):
        for candidate in path.parent.iterdir():
            match = pattern.fullmatch(candidate.name)
            if match and not _is_running(int(match[1])):
                remove(candidate)
    return path.with_name(f".{stem}-{here}-{os.getpid()}-{secrets.token_hex(4)}{suffix}")


def finish(part: Path, path: Path) -> None:
    """Rename the complete temporary file or folder `part` to the final path, once its content is safely on the disk.

    The content is on the disk before the name, and the name before this returns. Raises OSError where the system
    refuses.
    """
    for written in (*part.rglob("*"), part):
        if written.is_file():
            with written.open("r+b") as file:
                os.fsync(file.fileno())
    part.replace(path)
    with contextlib.suppress(OSError):  # Windows cannot open folders, and some network disks cannot sync
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def remove(path: Path) -> None:
    """Remove a file, or a folder with all content, ignoring errors."""
    shutil.rmtree(path, ignore_errors=True)
    with contextlib.suppress(OSError):  # a file
        path.unlink()


def _is_running(process: int) -> bool:
    """Return whether a process with this id exists; True on systems where this cannot be checked safely."""
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
    except OSError as error:
        return not isinstance(error, ProcessLookupError)
    return True
