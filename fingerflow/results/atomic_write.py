"""Write output files atomically, and protect inputs and unrelated files from being overwritten."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.schema.unfinished import finish, remove, unfinished

MARK = "written by fingerflow"  # text that identifies files without structure of their own: pages, images, videos

# Suffixes of the second file of recordings in two files.
_PARTNERS = {".mraw": (".cih", ".cihx"), ".cih": (".mraw",), ".cihx": (".mraw",)}
_END_BYTES = 1 << 20
_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


def spare(output: Path, *inputs: Path | None) -> None:
    """Check that writing `output` would overwrite none of the input files of a command.

    Raises FingerflowError where the output is an input file, the second file of a recording stored in two, or a picture
    in an input folder of frames, where it would be read as a frame. An input may name a data set within its file
    ("file::dataset").
    """
    for source in filter(None, inputs):
        file = Path(str(source).split("::")[0])
        if not file.exists():
            continue
        if file.is_dir():
            taken = output.suffix.lower() in _PICTURES and output.resolve().parent == file.resolve()
        else:
            partners = _PARTNERS.get(file.suffix.lower(), ())
            companions = [
                candidate
                for candidate in file.parent.iterdir()
                if candidate.stem == file.stem and candidate.suffix.lower() in partners
            ]
            taken = output.exists() and any(output.samefile(candidate) for candidate in (file, *companions))
        if taken:
            raise FingerflowError(
                f"{output} is an input of this command, or among its frames, and would be replaced; give another output"
            )


def keep_others(path: Path, is_ours: Callable[[Path], bool], overwrite: bool) -> None:
    """Check that writing `path` would not overwrite a file from another program; `is_ours` tells whether a file is from
    this one.

    Raises FingerflowError where a file exists that `is_ours` does not recognise, unless `overwrite`.
    """
    if not overwrite and path.exists() and not path.is_dir() and not (path.is_file() and is_ours(path)):
        raise FingerflowError(
            f"{path} exists and was not written by this command; give another name, remove it, or allow it by "
            "overwrite (--overwrite)"
        )


def is_marked(path: Path) -> bool:
    """Return whether a file contains, in its first or last MiB, the text `MARK` that this package writes into its
    pages, pictures and videos.
    """
    try:
        with path.open("rb") as file:
            ends = file.read(_END_BYTES)
            file.seek(max(len(ends), path.stat().st_size - _END_BYTES))
            return MARK.encode() in ends + file.read()
    except OSError:
        return False


def write_atomically(path: Path, write: Callable[[Path], Any]) -> None:
    """Write a file by calling `write` with a temporary path in the same folder and then renaming the temporary file to
    `path`.

    Neither a crash nor a loss of power leaves a half-written file: its content is on the disk before it has its name.

    Raises FingerflowError where the system does not allow writing.
    """
    with written_atomically(path) as part:
        write(part)


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8 by `write_atomically`."""
    write_atomically(path, lambda part: part.write_text(text, encoding="utf-8"))


def write_csv(path: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write a table, columns (R,) by name, to a CSV file by `write_atomically`."""
    rows, header = np.column_stack(list(columns.values())), ",".join(columns)
    settings = {"delimiter": ",", "fmt": "%.9g", "comments": "", "encoding": "utf-8"}
    write_atomically(path, lambda part: np.savetxt(part, rows, header=header, **settings))


@contextmanager
def written_atomically(path: Path) -> Iterator[Path]:
    """Context manager that yields a temporary path for writing, and renames the temporary file to `path` at the end, as
    `write_atomically` does.
    """
    part: Path | None = None
    try:
        if not path.name or (path.exists() and not path.is_file()):
            raise FingerflowError(f"{path} is no file (a folder, pipe or device) and cannot be written; name a file")
        path.parent.mkdir(parents=True, exist_ok=True)
        part = unfinished(path)
        yield part
        finish(part, path)
    except BaseException as error:
        if part is not None:
            remove(part)
        if isinstance(error, OSError):
            raise FingerflowError(
                f"{path} cannot be written ({error.strerror or error}); name another place, or make room there"
            ) from error
        raise
