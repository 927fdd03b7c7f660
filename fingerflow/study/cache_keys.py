"""Compute the cache keys of a trial, which decide whether it must run again.

`result` is the key of the whole result; `row` is the key of the row in the table and includes `result`. Which stages
depend on a changed setting is decided in `fingerflow.pipeline.reuse`: a changed gauge length reads no image.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path

from fingerflow.errors import FingerflowError
from fingerflow.pipeline.reuse import code_version, content
from fingerflow.recordings.digest import digest_of, digest_of_bytes
from fingerflow.recordings.recording_files import files_of
from fingerflow.schema.scene import Scene
from fingerflow.study.dotted_keys import flattened


@dataclass(frozen=True)
class InputFile:
    """Size, times and content digest of an input file (or folder) of a trial.

    Attributes:
        path: as it was found.
        size: bytes; of a folder the sum over its files.
        modified: ns; of a folder the latest.
        digest: of names, sizes and bytes; above 16 MB of names, sizes, times of modification and samples.
        state: digest of inode and change time of each file, which a file put in its place does not have, even with the
            same size and modification time.
    """

    path: str
    size: int
    modified: int
    digest: str
    state: str = ""


@dataclass(frozen=True)
class Keys:
    """Cache keys of a trial: a digest of all that its result depends on, one that adds what its table row depends on,
    and the input files by their key in the scene file, such as `recording.frames`.
    """

    result: str
    row: str
    inputs: Mapping[str, InputFile]

    def changed_inputs(self, now: "Keys") -> list[str]:
        """Return the scene-file keys, such as `recording.frames`, of the input files that differ between these cache
        keys and `now` by digest, or that only one of the two lists.
        """
        before, after = self.inputs, now.inputs
        same = {name for name in before.keys() & after if before[name].digest == after[name].digest}
        return [name for name in {**before, **after} if name not in same]


def trial_keys(scene: Scene, earlier: Mapping[str, InputFile] | None = None) -> Keys:
    """Compute the cache keys of a trial from its current input files, settings and code version.

    A file that `earlier` lists with the same size, times and inode is not read again.

    Raises FingerflowError for a file that cannot be read.
    """
    settings = json.loads(scene.as_json())
    settings.pop("path")
    settings["stream"].pop("output", None)
    settings["calibration"].pop("file", None)
    paths = set(map(str, scene.files()[1:]))
    values = dict(flattened(settings))
    named = {name: value for name, value in values.items() if isinstance(value, str) and value in paths}
    inputs = {name: describe_file(Path(path), (earlier or {}).get(name)) for name, path in named.items()}
    # Identify files by their content, not by their names.
    values |= {name: [file.size, file.digest] for name, file in inputs.items()}
    result = digest_of(values, all_codes()["result"])
    return Keys(result, digest_of(result, all_codes()["row"]), inputs)


def describe_file(path: Path, earlier: InputFile | None = None) -> InputFile:
    """Return size, times and digest of a file or folder, taking `earlier.digest` if nothing was written since."""
    try:
        facts = [(part, part.stat()) for part in files_of(path)]
        size, modified = sum(fact.st_size for _, fact in facts), max((fact.st_mtime_ns for _, fact in facts), default=0)
        state = digest_of(*((part.name, fact.st_ino, fact.st_ctime_ns) for part, fact in facts))
        if earlier is not None and (earlier.size, earlier.modified, earlier.state) == (size, modified, state):
            return InputFile(str(path), size, modified, earlier.digest, state)
        digest = digest_of_bytes(chain([str(path).partition("::")[2].encode()], content([part for part, _ in facts])))
    except OSError as error:
        raise FingerflowError(f"{path} cannot be read ({error.strerror or error}); copy it again") from error
    return InputFile(str(path), size, modified, digest, state)


@cache
def all_codes() -> dict[str, str]:
    """Return a digest of the source code that computes results and one of the code that computes table rows, under the
    keys "result" and "row".
    """
    of_row = ("study/row.py", "models/growth_laws.py", "schema/trial_columns.py")  # decide the content of a row
    texts = ((Path(__file__).parents[1] / name).read_text("utf-8") for name in of_row)
    return {"result": code_version(), "row": digest_of(*texts)}
