"""What a path is: a scene, a recording or a result."""

import contextlib
import json
from pathlib import Path
from typing import NamedTuple

from fingerflow.errors import FingerflowError
from fingerflow.recordings import open_recording
from fingerflow.result import is_result
from fingerflow.untrusted import open_hdf5
from fingerflow.view.draft import Draft

_RESULT = "result.h5"


class Opened(NamedTuple):
    """A draft of a scene, a result's path, or both."""

    draft: Draft | None
    result: Path | None


def open_path(path: Path | None) -> Opened:
    """A scene with its result beside it, a result, or a recording whose scene begins.

    Raises FingerflowError where it is none of these, or nothing is named and there is no scene.toml here.
    """
    if path is None:
        path = Path("scene.toml")
        if not path.is_file():
            raise FingerflowError(f"there is no scene.toml in {Path.cwd()}; name a scene, a recording or a result")
    if not path.exists() and "::" not in str(path):
        raise FingerflowError(f"{path} does not exist; name a scene, a recording or a result")
    if path.suffix.lower() == ".toml":
        beside = path.parent / _RESULT
        return Opened(Draft.of_file(path), beside if beside.is_file() and is_result(beside) else None)
    if path.is_file() and is_result(path):
        return Opened(_draft_of(path), path)
    with open_recording(path) as recording:
        return Opened(Draft.of_recording(recording), None)


def _draft_of(result: Path) -> Draft | None:
    """The scene file of a result, where it is still there and can be read."""
    with open_hdf5(result) as file:
        scene = Path(json.loads(file.attrs["settings"])["path"])
    if not scene.is_file():
        return None
    with contextlib.suppress(FingerflowError):
        return Draft.of_file(scene)
    return None
