"""Names under which outputs stand until they are whole, and the end of those that killed runs have left."""

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
    """A hidden path beside a file or folder, for it while it is being written.

    Removes those that killed runs have left there: they name the computer and the process that wrote them, and only
    those count whose process is no more.
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
    """A file or a folder with all in it; what cannot be removed stays, as the error before says more."""
    with contextlib.suppress(OSError):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _is_running(process: int) -> bool:
    """True where nobody can tell without harm."""
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
