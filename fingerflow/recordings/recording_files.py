"""Paths of the files of a recording, and a search for recordings with equal files."""

from collections import defaultdict
from collections.abc import Iterable
from contextlib import suppress
from filecmp import cmp
from itertools import combinations
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
    """Return the pairs of recordings, or of the same member of two, whose files have the same bytes; one that cannot be
    read is in none.

    Files are compared as a whole only where their sizes and bytes in the middle are the same.
    """
    alike: dict[tuple[object, ...], list[Path]] = defaultdict(list)
    for recording in recordings:
        with suppress(OSError, FingerflowError):
            files = files_of(recording)
            middle, sizes = files[len(files) // 2], tuple(map(check_file, files))
            with middle.open("rb") as opened:
                opened.seek(middle.stat().st_size // 2)
                alike[str(recording).partition("::")[2], sizes, opened.read(_SAMPLE_BYTES)].append(recording)
    pairs = (pair for group in alike.values() for pair in combinations(group, 2))
    together = ((pair, zip(*map(files_of, pair), strict=True)) for pair in pairs)
    return [pair for pair, files in together if all(cmp(first, second, False) for first, second in files)]
