"""Files that appear only when they are complete."""

import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fingerflow.errors import FingerflowError


def spare(output: Path, *inputs: Path | None) -> None:
    """Raises FingerflowError where an output would replace an input, which may name a data set within its file."""
    for given in inputs:
        file = None if given is None else Path(str(given).split("::")[0])
        if file is not None and output.exists() and file.exists() and output.samefile(file):
            raise FingerflowError(f"{output} is an input of this command and would be replaced; give another output")


def write_atomically(path: Path, write: Callable[[Path], Any]) -> None:
    """Calls ``write`` with a temporary path in the same folder and renames it: a crash leaves no half-written file.

    Raises FingerflowError where the system does not let it be written.
    """
    if not path.name or path.is_dir():
        raise FingerflowError(f"{path} is a folder and cannot be written; name a file in it")
    part = path.with_name(f".{path.stem}-{secrets.token_hex(4)}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(part)
        part.replace(path)
    except BaseException as error:
        if part.parent.is_dir():
            part.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise FingerflowError(
                f"{path} cannot be written ({error.strerror or error}); name another place, or make room there"
            ) from error
        raise
