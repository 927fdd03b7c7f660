"""Opening of a path given to `fingerflow view`: a scene, a recording or a result."""

from pathlib import Path

from fingerflow.errors import FingerflowError
from fingerflow.recordings import open_recording
from fingerflow.results.result import is_result, scene_of
from fingerflow.view.draft import Draft

RESULT = "result.h5"  #: file name that `fingerflow process` gives to a result, in the scene's folder


def open_path(path: Path | None) -> tuple[Draft | None, Path | None]:
    """Open a scene with the result in its folder, a result with its scene, or a recording with a new draft; return the
    draft of the scene, and the path of the result.

    Raises:
        FingerflowError: the path is none of these, or it is None and the current folder has no scene.toml.
    """
    if path is None:
        path = Path("scene.toml")
        if not path.is_file():
            raise FingerflowError(f"there is no scene.toml in {Path.cwd()}; name a scene, a recording or a result")
    if not path.exists() and "::" not in str(path):
        raise FingerflowError(f"{path} does not exist; name a scene, a recording or a result")
    if path.suffix.lower() == ".toml":
        result = path.parent / RESULT
        return Draft.read(path), result if result.is_file() and is_result(result) else None
    if path.is_file() and is_result(path):
        try:
            return Draft.read(scene_of(path)), path
        except FingerflowError:  # the scene file of the result cannot be read
            return None, path
    with open_recording(path) as recording:
        return Draft.create(recording), None
