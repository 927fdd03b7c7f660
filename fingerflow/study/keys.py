"""What a result was made of: files by their content, settings, and the code of the stages that made it.

There are three parts, each of which contains the one before: `pictures` is what contact and tracks come from, `numbers`
what the whole result comes from, `row` what the row of the table comes from. The first of them that differs from what a
trial had says what has to be done again: a changed gauge length changes `numbers`, and pictures are not read.
"""

import ast
import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import fingerflow
from fingerflow.errors import FingerflowError
from fingerflow.scene import Scene
from fingerflow.stages import all_stages

_PACKAGE = Path(fingerflow.__file__).parent
_OF_NUMBERS = ("fields", "slip")  # tables of the scene that no stage which reads pictures looks at (a test holds it)
_FILES = ("path", "frames", "dark", "file")  # keys whose files count by their content, and streams' output not at all
_WHOLE_BYTES = 16 << 20  # up to which a file is digested as a whole
_SAMPLES, _SAMPLE_BYTES = 64, 4096  # of a larger one, evenly over it


@dataclass(frozen=True)
class InputFile:
    """A file or folder that a trial is made of.

    Attributes:
        path: as it was found.
        size: bytes, of a folder those of all its files.
        modified: ns, of a folder the latest.
        digest: of its bytes; of a file above 16 MB, of its size and 64 samples of 4 kB evenly over it. A change that
            keeps the size and misses the samples is known by `modified` alone.
    """

    path: str
    size: int
    modified: int
    digest: str

    @property
    def whole(self) -> bool:
        """Whether the digest is of all bytes."""
        return self.size <= _WHOLE_BYTES


@dataclass(frozen=True)
class Keys:
    """Digests; `inputs` by the key of the scene that names each."""

    pictures: str
    numbers: str
    row: str
    inputs: Mapping[str, InputFile]

    def as_json(self) -> dict[str, Any]:
        """For the file of a row."""
        return asdict(self)

    @classmethod
    def from_json(cls, found: Mapping[str, Any]) -> "Keys":
        """From what `as_json` gave; raises KeyError or TypeError for something else."""
        inputs = {name: InputFile(**one) for name, one in found["inputs"].items()}
        return cls(found["pictures"], found["numbers"], found["row"], inputs)


def keys_of(scene: Scene, earlier: Mapping[str, InputFile] | None = None) -> Keys:
    """The keys of a trial as it is now.

    A file that `earlier` knows with the same size and time of change is not read again.

    Raises FingerflowError for a file that cannot be read.
    """
    inputs = {name: look_at(path, (earlier or {}).get(name)) for name, path in input_files(scene).items()}
    settings = json.loads(scene.as_json())
    kept = {name: _without_files(value) for name, value in settings.items() if name not in ("path", "stream")}
    kept["stream"] = {"region": settings["stream"]["region"]}  # where `process` looks for points
    later = {name: kept.pop(name) for name in _OF_NUMBERS}
    contents = {name: [one.size, one.digest] for name, one in inputs.items()}
    pictures = _digest(kept, contents, code_of("pictures"))
    numbers = _digest(pictures, later, code_of("numbers"))
    return Keys(pictures, numbers, _digest(numbers, code_of("row")), inputs)


def input_files(scene: Scene) -> dict[str, Path]:
    """Files that a result depends on, by key; a calibration counts by its numbers, which are among the settings."""
    named = {
        "recording.frames": scene.recording.frames,
        "background.frames": scene.background.frames,
        "background.dark": scene.background.dark,
        "forces.file": None if scene.forces is None else scene.forces.file,
    }
    return {name: path for name, path in named.items() if path is not None}


def look_at(path: Path, earlier: InputFile | None = None) -> InputFile:
    """A file or folder as it is now; its digest is the earlier one where size and time have not changed."""
    file = Path(str(path).partition("::")[0])
    try:
        parts = sorted(one for one in file.rglob("*") if one.is_file()) if file.is_dir() else _with_partners(file)
        facts = [(one, one.stat()) for one in parts]
        size, modified = sum(fact.st_size for _, fact in facts), max((fact.st_mtime_ns for _, fact in facts), default=0)
        if earlier is not None and (earlier.size, earlier.modified) == (size, modified):
            return InputFile(str(path), size, modified, earlier.digest)
        digest = hashlib.sha256()
        for one, fact in facts:
            digest.update(f"{one.name} {fact.st_size} ".encode())
            _add_content(digest, one, fact.st_size)
    except OSError as error:
        raise FingerflowError(f"{path} cannot be read ({error.strerror or error}); copy it again") from error
    return InputFile(str(path), size, modified, digest.hexdigest()[:16])


def same_content(before: InputFile, now: InputFile) -> bool:
    """Whether a file is certainly what it was: a digest of samples counts only beside an unchanged time."""
    unchanged = (before.size, before.digest) == (now.size, now.digest)
    return unchanged and (before.modified == now.modified or now.whole)


@cache
def code_of(part: str) -> str:
    """Digest of the source of all modules behind a part, "pictures", "numbers" or "row", and of the kernels."""
    stages = {kind for instead in ((), _stand_ins()) for kind in all_stages(instead)}
    roots = {
        "pictures": {kind.__module__ for kind in stages if kind.restored} | _readers(),
        "numbers": {kind.__module__ for kind in stages if not kind.restored} | {"fingerflow.store"},
        "row": {"fingerflow.study.row", "fingerflow.study.columns"},
    }[part]
    digest = hashlib.sha256()
    for name, path in sorted(_behind(roots).items()):
        digest.update(name.encode() + path.read_bytes())
    if part != "row":
        for library in sorted(_PACKAGE.glob("_kernels*")):
            digest.update(library.read_bytes())
    return digest.hexdigest()[:16]


def _readers() -> set[str]:
    """They are imported by name, when a file asks for one."""
    files = _PACKAGE.joinpath("recordings").rglob("*.py")
    return {".".join(("fingerflow", *file.relative_to(_PACKAGE).with_suffix("").parts)) for file in files}


def _stand_ins() -> tuple[str, ...]:
    from fingerflow.player.contract.scene_kinds import KINDS

    return tuple(name for kind in KINDS.values() for name in kind.instead)


def _behind(roots: Iterable[str]) -> dict[str, Path]:
    """Modules of the package that these import, themselves and at any depth, by their names."""
    found: dict[str, Path] = {}
    waiting = list(roots)
    while waiting:
        name = waiting.pop()
        path = _file_of(name)
        if name in found or path is None:
            continue
        found[name] = path
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.Import):
                waiting += [one.name for one in node.names]
            elif isinstance(node, ast.ImportFrom):
                base = node.module or ""
                if node.level:
                    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
                    above = package.split(".")[: len(package.split(".")) - node.level + 1]
                    base = ".".join([*above, *([node.module] if node.module else [])])
                waiting += [base, *(f"{base}.{one.name}" for one in node.names)]
    # The package's own file loads lazily and would lead everywhere.
    return {name: path for name, path in found.items() if name != "fingerflow"}


def _file_of(module: str) -> Path | None:
    first, *rest = module.split(".")
    if first != "fingerflow" or module == "fingerflow":
        return None
    place = _PACKAGE.joinpath(*rest)
    return next((path for path in (place.with_suffix(".py"), place / "__init__.py") if path.is_file()), None)


def _with_partners(file: Path) -> list[Path]:
    """A recording in two files is both."""
    if file.suffix.lower() in (".mraw", ".cih", ".cihx"):
        return sorted(
            one for one in file.parent.glob(f"{file.stem}.*") if one.suffix.lower() in (".mraw", ".cih", ".cihx")
        )
    return [file]


def _add_content(digest: Any, file: Path, size: int) -> None:
    with file.open("rb") as opened:
        if size <= _WHOLE_BYTES:
            while part := opened.read(1 << 20):
                digest.update(part)
            return
        for number in range(_SAMPLES):
            opened.seek(round(number * (size - _SAMPLE_BYTES) / (_SAMPLES - 1)))
            digest.update(opened.read(_SAMPLE_BYTES))


def _without_files(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _without_files(one) for name, one in value.items() if name not in _FILES}
    return value


def _digest(*parts: Any) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]
