"""Paths of the files of a recording, and a search for recordings with equal files."""

from collections import defaultdict
from collections.abc import Iterable
from contextlib import suppress
from filecmp import cmp
from pathlib import Path

from fingerflow.errors import FingerflowError
from fingerflow.recordings.frames.images import list_images
from fingerflow.schema.text_file import check_file

_IN_TWO = (".mraw", ".cih", ".cihx")  # suffixes of recordings in two files
_SAMPLE_BYTES = 4096  # bytes from the middle of a recording by which others of its size are told from it


def files_of(recording: Path) -> list[Path]:
    """Return the files of a recording, of which "::" names a member: the images of a folder, both files of an MRAW
    recording, or the file itself.
    """
    file = Path(str(recording).partition("::")[0])
    if file.is_dir():
        return sorted(list_images(file))
    beside = file.parent.iterdir() if file.suffix.lower() in _IN_TWO else ()
    return sorted(path for path in beside if path.stem == file.stem and path.suffix.lower() in _IN_TWO) or [file]


def equal_recordings(recordings: Iterable[Path]) -> list[tuple[Path, Path]]:
    """Return a pair for each recording whose files have the same bytes as those of an earlier one: the first such, or
    the same member of it, and the recording. One that cannot be read is in none.

    Files are compared as a whole only where their sizes and bytes in the middle are the same, and not read where they
    are links to one file.
    """
    alike: dict[tuple[object, ...], list[Path]] = defaultdict(list)
    pairs = []
    for recording in recordings:
        with suppress(OSError, FingerflowError):
            files = files_of(recording)
            middle, sizes = files[len(files) // 2], tuple(map(check_file, files))
            with middle.open("rb") as opened:
                opened.seek(middle.stat().st_size // 2)
                different = alike[str(recording).partition("::")[2], sizes, opened.read(_SAMPLE_BYTES)]
            equal = (other for other in different if all(map(_same_bytes, files_of(other), files)))
            if (first := next(equal, None)) is None:
                different.append(recording)
            else:
                pairs.append((first, recording))
    return pairs


def _same_bytes(first: Path, second: Path) -> bool:
    return first.samefile(second) or cmp(first, second, shallow=False)
