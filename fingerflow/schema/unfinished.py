"""Temporary paths for outputs that are still being written, and removal of those left by killed runs."""

from __future__ import annotations

import contextlib
import os
import platform
import re
import secrets
import shutil
import zlib
from pathlib import Path


def unfinished(path: Path) -> Path:
    """Return a hidden temporary path beside an output file or folder, to be renamed when the output is complete.

    Also removes the temporary paths of the same output that killed runs have left. Their names hold the computer and
    the process id; a path is removed only if it is of this computer and its process has ended.
    """
    here = f"{zlib.crc32(platform.node().encode()):08x}"
    stem, suffix = path.stem, path.suffix
    pattern = re.compile(rf"\.{re.escape(stem)}-{here}-(\d+)-[0-9a-f]{{8}}{re.escape(suffix)}")
    with contextlib.suppress(OSError):
        for other in path.parent.iterdir():
            found = pattern.fullmatch(other.name)
            if found and not _is_running(int(found[1])):
                remove(other)
    return path.with_name(f".{stem}-{here}-{os.getpid()}-{secrets.token_hex(4)}{suffix}")


def remove(path: Path) -> None:
    """Remove a file, or a folder with its content, without raising errors, so that an earlier error remains visible."""
    with contextlib.suppress(OSError):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _is_running(process: int) -> bool:
    """Return whether the process with this id exists; True on systems where this cannot be checked without harm."""
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
