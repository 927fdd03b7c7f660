"""Reuse of an earlier result: check stage by stage which results are still valid for the current settings.

The key of a stage is a digest of its settings, the keys of the stages before it, the code, the engine and the device,
and, where it or a stage before it reads pictures, of the first frame and of the files of all frames.
The engine counts because results of two engines agree only to rounding. Where the key is the same, results are the same
bit for bit.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import torch
import xarray as xr

from fingerflow import __version__
from fingerflow.errors import FingerflowError
from fingerflow.kernels import tensors as kernels
from fingerflow.pipeline.plan import Plan
from fingerflow.pipeline.stages.preparation.inputs import Inputs
from fingerflow.pipeline.stages.stage import Stage
from fingerflow.recordings.digest import digest_of, digest_of_bytes
from fingerflow.recordings.identity import identity_of
from fingerflow.recordings.recording_files import files_of
from fingerflow.results.store import Store
from fingerflow.schema.scene_check import find
from fingerflow.schema.text_file import check_file

#: Attributes of a result, both JSON: the cache keys of its stages (`record`), and the stages copied from an earlier
#: result.
STAGES, TAKEN_OVER = "stages", "taken_over"
_TIMES, _MASK = "recording.times", ".region.mask"
_FILES = ("background.frames", "background.dark", "forces.file")
_CODE = (
    *("engines", "export", "graphs", "kernels", "models", "ops", "pipeline/stages", "recordings", "results"),
    *("schema", "tracker"),
)
WHOLE_BYTES = 16 << 20  # bytes, size up to which the files of a recording are digested as a whole
_SAMPLES, _SAMPLE_BYTES = 64, 4096  # number and size in bytes of the evenly spaced samples of larger ones
_PIECE_BYTES = 1 << 20  # bytes of other files that are held in memory at a time


#: Cache keys of stages by class: the "digest" of everything that determines their results (settings, inputs and code),
#: and the values of the "settings" used by dotted keys of the scene. The digest of `_written` represents a file.
Keys = dict[type[Stage], dict[str, Any]]


def stage_keys(plan: Plan, inputs: Inputs, recording: str) -> Keys:
    """Return the cache keys of all planned stages; `recording` is the digest by `identity_of`."""
    values = json.loads(inputs.scene.as_json())
    common = [code_version(), kernels.serve(), torch.__version__, inputs.engine.name, inputs.device.type]
    keys: Keys = {}
    recording += recording and _written(inputs.recording.path)  # empty where no stage reads pictures
    settings_of = cache(lambda name: [*_settings(name, values, inputs)])  # several stages digest the same files
    pictures: set[type[Stage]] = set()  # stages whose results depend on frames
    for stage in plan.stages:
        before = sorted({*stage.after, *stage.same_pass}, key=lambda earlier: earlier.name)
        settings = dict(pair for name in stage.settings for pair in settings_of(name))
        if stage.reads_frames or pictures.intersection(before):
            pictures.add(stage)
        seen, of_stages = recording if stage in pictures else "", [keys[earlier]["digest"] for earlier in before]
        digest = digest_of(stage.name, settings, seen, of_stages, common)
        keys[stage] = {"digest": digest, "settings": settings}
    return keys


def record(keys: Keys, stages: Mapping[type[Stage], Stage], results: Store) -> str:
    """Return cache key, variable names and warnings of each stage as JSON, to be stored in the result for later
    reuse.
    """
    rows = {}
    for stage, key in keys.items():
        gave = [variable.name for variable in stage.gives if variable.name in results]
        rows[stage.name] = {**key, "gave": gave, "warnings": stages[stage].warnings}
    return json.dumps(rows)


def reasons_to_compute(earlier: xr.Dataset, path: Path, plan: Plan, keys: Keys, inputs: Inputs) -> dict[str, str]:
    """Compare a plan with an earlier result, and return by the names of stages why each is computed again; the other
    stages can be copied from the result.

    Raises FingerflowError where the result is of another recording, or of other frames of it.
    """
    if "recording" in earlier.attrs and identity_of(inputs.recording) != earlier.attrs["recording"]:
        raise FingerflowError(
            f"{path} is of another recording than {inputs.recording.path}, or of other frames. Name the result of "
            f"{inputs.scene.path}, or compute it again without --from"
        )
    earlier_stages: dict[str, dict[str, Any]] = json.loads(earlier.attrs.get(STAGES, "{}"))
    whole = "" if earlier_stages else f"{path} of an older version does not say what its stages depend on"
    computed: dict[str, str] = {}
    for stage in plan.stages:
        if why := whole or _reason_to_compute(stage, plan, keys, earlier_stages.get(stage.name), computed):
            computed[stage.name] = why
    # A stage that runs needs the steps of the stages in `same_pass`, and the stages in `after` unless these can be
    # `restored`.
    for stage in reversed(plan.stages):
        if stage.name in computed:
            for needed in (*stage.same_pass, *(earlier for earlier in stage.after if not earlier.restored)):
                computed.setdefault(needed.name, f"{stage.name} needs what only it knows")
    return computed


def _reason_to_compute(stage: type[Stage], plan: Plan, keys: Keys, record: Any, computed: dict[str, str]) -> str:
    """Return why a stage must be computed, or "" if the earlier results of the stage can be reused."""
    if record is None:
        return "it was not computed there"
    optional = {variable.name for variable in stage.gives if not variable.unasked}
    lacking = sorted((optional & plan.requested).difference(record["gave"]))
    if lacking:
        return f"{lacking[0]} is not there"
    if record["digest"] == keys[stage]["digest"]:
        return ""
    then: Mapping[str, Any] = record["settings"]
    changed = {name: value for name, value in keys[stage]["settings"].items() if then.get(name) != value}
    if changed:
        return ", ".join(f"{name} was {then.get(name)!s:.60} and is {value!s:.60}" for name, value in changed.items())
    before = [earlier.name for earlier in (*stage.after, *stage.same_pass) if earlier.name in computed]
    version = "it was computed by another version of the code, by another engine, or from other frames"
    return f"it depends on {', '.join(before)}" if before else version


def _settings(key: str, values: Mapping[str, Any], inputs: Inputs) -> Iterable[tuple[str, Any]]:
    """Yield the dotted name and the value of the scene setting `key`, or of each setting in it if it is a table;
    `values` are all settings of the scene.

    For a key that names a file, the value is the digest of `_written`.
    """
    if key == _TIMES:
        yield key, digest_of_bytes([inputs.times.tobytes()])
        return
    value = find(values, key)
    if isinstance(value, dict):
        for name in value:
            yield from _settings(f"{key}.{name}", values, inputs)
    elif (key in _FILES or key.endswith(_MASK)) and value is not None:
        yield key, _written(Path(value))
    else:
        yield key, value


def _written(path: Path) -> str:
    """Return a digest of the files of a recording, of which "::" names a member."""
    return digest_of_bytes(content(files_of(path)))


def content(files: Sequence[Path]) -> Iterator[bytes]:
    """Yield name and size of each file as bytes, then its content; of more than `WHOLE_BYTES` in all the times of
    modification and evenly spaced samples.
    """
    sizes = [check_file(file) for file in files]
    large = sum(sizes) > WHOLE_BYTES
    for file, size in zip(files, sizes, strict=True):
        step = size * len(sizes) // _SAMPLES + 1 if large else _PIECE_BYTES
        yield f"{file.name} {size} {large and file.stat().st_mtime_ns} ".encode()
        with file.open("rb") as opened:
            for at in range(0, size, step):
                opened.seek(at)
                yield opened.read(min(step, _SAMPLE_BYTES) if large else step)


@cache
def code_version() -> str:
    """Return the package version and a digest of all source code and compiled kernels that affect results."""
    package = Path(__file__).parents[1]
    files = (*(file for room in _CODE for file in (package / room).rglob("*.py")), *package.glob("_kernels*"))
    parts = (f"{file.relative_to(package).as_posix()} ".encode() + file.read_bytes() for file in sorted(files))
    return f"{__version__} {digest_of_bytes(parts)}"
