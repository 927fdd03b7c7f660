"""What a path is: a scene, a recording or a result."""

from pathlib import Path
from typing import NamedTuple

from fingerflow.errors import FingerflowError
from fingerflow.recordings import open_recording
from fingerflow.results.result import is_result, scene_of
from fingerflow.view.draft import Draft

RESULT = "result.h5"  #: beside the scene, as `fingerflow process` names it


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
        beside = path.parent / RESULT
        return Opened(Draft.of_file(path), beside if beside.is_file() and is_result(beside) else None)
    if path.is_file() and is_result(path):
        return Opened(_draft_of(path), path)
    with open_recording(path) as recording:
        return Opened(Draft.of_recording(recording), None)


def _draft_of(result: Path) -> Draft | None:
    """The scene file of a result, where it is still there and can be read."""
    try:
        return Draft.of_file(scene_of(result))
    except FingerflowError:
        return None
