"""Validation of the content of a scene file: each key, and rules between several keys."""

import difflib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fingerflow.errors import FingerflowError
from fingerflow.schema.calibration_file import Pixels, read_calibration
from fingerflow.schema.key_types import File, Reader, WrongValue, either
from fingerflow.schema.keys import SceneKey, SceneTable
from fingerflow.schema.profiles import PROFILES, with_profile
from fingerflow.schema.scene_kinds import KINDS, default_kind
from fingerflow.schema.scene_tables import SCENE, views_of

Keys = tuple[str, ...]
_LEAST_SIDE = 9  # px, of a view
_TOP = "kind", "profile"  # keys outside of tables
MISSING = "is missing; add it: `fingerflow init` and the scene.toml of a bundle show how"


class TableCheck:
    """Validation of the tables of one file, which collects at most one problem for each key.

    Attributes:
        values: by table and key, with defaults; paths are absolute, ranges and matrices are tuples. A key that is left
            out and has no default is None, as is an optional table that is left out.
        given: dotted keys that the file, or the calibration file that it names, sets.
    """

    missing = MISSING

    def __init__(self, written: Mapping[str, Any], folder: Path, reader: Reader) -> None:
        """Prepare the check of tables and keys as parsed from TOML, for the needs of a reader; paths are relative to
        `folder`, that of the file.
        """
        self.written, self._folder, self._reader = written, folder, reader
        self.messages: dict[Keys, str] = {}
        self._missing: set[Keys] = set()
        self._meant: set[Keys] = set()  # likely intended keys of misspelt ones, which are not reported missing
        self.calibration: tuple[dict[str, Any], dict[str, tuple[Pixels, Pixels]]] | None = None
        self.values: dict[str, Any] = {}
        self.given: set[str] = set()

    def problems(self) -> list[tuple[str, str]]:
        """Return all problems found, as pairs of a dotted key and a message that continues a sentence which begins with
        it, without missing keys that a misspelt one was meant to be.
        """
        reported = (keys for keys in self.messages if keys not in self._missing & self._meant)
        return [(".".join(keys), self.messages[keys]) for keys in reported]

    def raise_problems(self, place_of: Callable[[Keys], str]) -> None:
        """Raise FingerflowError with one line for each problem, if there are any; `place_of` returns the place of a key
        in the file.
        """
        lines = [f"{place_of(tuple(key.split('.')))}: {key} {message}" for key, message in self.problems()]
        if lines:
            raise FingerflowError("\n".join(lines))

    def refuse(self, keys: Keys, message: str) -> None:
        """Record a problem of a key, unless it has one."""
        self.messages.setdefault(keys, message)

    def table(self, prefix: Keys, table: SceneTable, written: Mapping[str, Any], besides: Keys = ()) -> dict[str, Any]:
        """Return the validated values of a table at a place in the file, given what is written there."""
        values: dict[str, Any] = {}
        for name, key in table.keys.items():
            keys = (*prefix, name)
            if (value := written.get(name)) is None:  # left out; settings of results say so by None
                if self._reader in key.needed_by:
                    self.lacks(keys)
                values[name] = key.left_out()
                continue
            self.given.add(".".join(keys))
            if isinstance(key, SceneKey):
                values[name] = self.value(keys, key, value)
            elif isinstance(value, dict):
                values[name] = self.table(keys, key, value)
            else:
                self.refuse(keys, f"{_shown(value)}: it should be a table")
        for name, value in written.items():
            if name not in table.keys and value is not None:
                self._unknown((*prefix, name), table, besides)
        return values

    def lacks(self, keys: Keys) -> None:
        """Record that a key is missing."""
        self._missing.add(keys)
        self.refuse(keys, self.missing)

    def value(self, keys: Keys, key: SceneKey, value: Any) -> Any:
        """Return the validated value of a key; record a problem and return None if it is wrong."""
        try:
            if not isinstance(key.type, File):
                return key.type.convert(value)
            path = key.type.path(value, self._folder, self._reader)
            if key.type.calibration:
                self.calibration = read_calibration(path)
            return path
        except (WrongValue, FingerflowError) as wrong:
            self.refuse(keys, f"{_shown(value)}: {wrong}")
            return None

    def _unknown(self, keys: Keys, table: SceneTable, besides: Keys) -> None:
        names = sorted((*table.keys, *besides))
        close = difflib.get_close_matches(keys[-1], names, n=1)
        self._meant |= {(*keys[:-1], key) for key in close}
        hint = f"did you mean {close[0]!r}? " if close else ""
        self.refuse(keys, f"is not a key; {hint}known here: {', '.join(names)}")

    def record_conflict(self, key: str, message: str) -> None:
        """Record a problem of a key that conflicts with other keys; the message quotes the value in the scene file."""
        written = find(self.written, key)
        value = self.find_value(key) if written is None else written
        self.refuse(tuple(key.split(".")), f"{_shown(value)}: {message}")

    def find_value(self, key: str) -> Any:
        """Return the validated value at a dotted path such as "forces.tangential"; None if missing or invalid."""
        return find(self.values, key)


class SceneCheck(TableCheck):
    """Validation of one scene file: each key, and rules between several keys. The values are valid only if there are no
    problems. ``kind`` is one of KINDS.
    """

    def __init__(self, written: Mapping[str, Any], folder: Path, reader: Reader) -> None:
        super().__init__(with_profile(written), folder, reader)
        self.profile = self.written.get("profile")
        if not (self.profile is None or self.profile in list(PROFILES)):
            self.refuse(("profile",), f"is {self.profile!r}: it should be {either(PROFILES)}")
        stated, self.kind = self.written.get("kind"), default_kind(self.written)
        if isinstance(stated, str) and stated in KINDS:
            self.kind = stated
        elif "kind" in self.written:
            self.refuse(("kind",), f"is {stated!r}: it should be {either(KINDS)}")
        tables = {"recording": SCENE["recording"], "views": views_of(KINDS[self.kind]), **SCENE}
        rest = {name: value for name, value in self.written.items() if name not in _TOP}
        self.values = self.table((), SceneTable(keys=tables), rest, _TOP)
        for role, view in KINDS[self.kind].roles.items() if self.values.get("views") else ():
            self.values["views"][role] = self.find_value(f"views.{view}")
        self._check_rules()

    # Rules between keys, which are named by their dotted paths. An error is reported for the first key of a rule.

    def _check_rules(self) -> None:
        last, first = self.find_value("recording.last_frame"), self.find_value("recording.first_frame")
        if last is not None and first is not None and last < first:
            remedy = f"both are included, so give at least {first} or leave last_frame out"
            self.record_conflict("recording.last_frame", f"that is before first_frame, {first}; {remedy}")
        together = "trigger and trigger_level belong together: the channel, and the level that it crosses at time 0"
        for key, partner in (("trigger", "trigger_level"), ("trigger_level", "trigger")):
            if f"forces.{key}" in self.given and f"forces.{partner}" not in self.given:
                self.record_conflict(f"forces.{key}", f"{together}; add {partner}")
        for table, keys in PROFILES.get(str(self.profile), {}).items():
            for name, value in keys.items():
                key, conflict = f"{table}.{name}", f"the profile {self.profile} has {value!r}; leave one of the two out"
                if self.find_value(key) != value:
                    self.record_conflict(key, conflict)
        self._not_both("forces.tare", "forces.offset", "both say what the sensor reads without a load")
        for name in ("gain", "sign", "offset"):
            self._one_each(f"forces.{name}")
        self._read_calibration()
        self._check_lens()
        region, around = map(self._rectangle, ("stream.region", "views.topography"))
        if region and around and any(part[1] > end - first for part, (first, end) in zip(region, around, strict=True)):
            size = " x ".join(str(end - first) for first, end in around)
            self.record_conflict("stream.region", f"it ends beyond the topography view of {size} px; give less")
        for view in KINDS[self.kind].all_views:
            self._one_shape(f"views.{view}.region")
            if view != "contact":
                self._not_both("stream.region", f"views.{view}.region", "both say where points are chosen")
        self._fits_the_views()
        self._large_enough()

    def _not_both(self, key: str, rival: str, why: str) -> None:
        if key in self.given and rival in self.given:
            self.record_conflict(key, f"it and {_name(rival)} exclude each other: {why}")

    def _one_each(self, key: str) -> None:
        """Record a problem unless a list in `key` has one number for each force channel."""
        value = self.find_value(key)
        normal, tangential = self.find_value("forces.normal"), self.find_value("forces.tangential")
        if not isinstance(value, tuple) or normal is None:
            return
        count = 1 + (len(tangential) if isinstance(tangential, tuple) else tangential is not None)
        if len(value) != count:
            self.record_conflict(key, f"it has {len(value)} numbers for {count} forces; give one a force, normal first")

    def _read_calibration(self) -> None:
        """Take scale and transform from the calibration file in place of their keys, and record conflicts."""
        key = "calibration.file"
        if key not in self.given:
            if "calibration" in self.given and "calibration.mm_per_px" not in self.given:
                self.lacks(("calibration", "mm_per_px"))
            return
        keys = ("mm_per_px", "topography_to_contact", "intrinsics", "distortion")
        excluded = [name for name in keys if f"calibration.{name}" in self.given]
        if excluded:
            # The conflict replaces other problems of this key, as the user may remove it.
            self.messages.pop(("calibration", "file"), None)
            self.record_conflict(key, f"a file and {', '.join(excluded)} exclude each other; keep one of them")
            return
        for name, value in (self.calibration or ({},))[0].items():
            self.given.add(f"calibration.{name}")
            entry = SCENE["calibration"].keys[name]
            assert isinstance(entry, SceneKey)
            self.values["calibration"][name] = self.value(("calibration", name), entry, value)

    def _check_lens(self) -> None:
        """Record a problem of a lens whose intrinsics are not stated, or in a scene that cannot be corrected for it."""
        lens = "calibration.intrinsics"
        if lens not in self.given:
            if "calibration.distortion" in self.given:
                self.record_conflict("calibration.distortion", "it needs intrinsics = [fx, fy, cx, cy], px; add them")
        elif self.kind == "slip":
            self.record_conflict(
                lens,
                'a scene of the kind "slip" is not corrected for the lens; leave intrinsics and distortion out, or set '
                'kind = "press" and leave [slip] out',
            )

    def _one_shape(self, key: str) -> None:
        """Record a problem unless a region that is stated has exactly one of its possible keys."""
        shapes = self.find_value(key)
        wrong = any(".".join(keys).startswith(f"{key}.") for keys in self.messages)
        if key not in self.given or not shapes or wrong:
            return
        stated = [shape for shape in shapes if f"{key}.{shape}" in self.given]
        if len(stated) != 1:
            there = " and ".join(stated) or "none"
            self.record_conflict(key, f"one of {either(shapes)} is needed, and there are {there}")

    def _fits_the_views(self) -> None:
        """Record a problem unless the calibration has a transform between the views and was made with the views of this
        scene.
        """
        key, scale, transform = "calibration.file", "calibration.mm_per_px", "calibration.topography_to_contact"
        views = {name: self._rectangle(f"views.{name}") for name in ("topography", "contact")}
        from_view, into_view = views.values()
        if from_view is None or into_view is None or any(keys[0] == "calibration" for keys in self.messages):
            return
        # Without a second view to map, the scale suffices: it holds for any part of the frame.
        if from_view == into_view and transform not in self.given:
            return
        if transform not in self.given:
            self.record_conflict(
                scale if self.calibration is None else key,
                "the scene has a topography view, and nothing says where its pixels are in the contact view; add "
                "topography_to_contact = [[a, b, x], [c, d, y]], use a file of `fingerflow calibrate --target`, or "
                "remove [views.topography]",
            )
        elif self.calibration is not None:
            for name, view in views.items():
                made_with = self.calibration[1].get(name)
                if made_with != view:
                    self.record_conflict(
                        key,
                        f"it was made with the {name} view {_ranges(made_with)}, and the scene has {_ranges(view)}: "
                        "the transform holds for the same pixels only. Calibrate with the views of this scene, "
                        f"`fingerflow calibrate --topography {_option(from_view)} --contact {_option(into_view)}`, or "
                        "use the views of the calibration",
                    )

    def _large_enough(self) -> None:
        for view in ("views.topography", "views.contact"):
            least = min((end - first for first, end in self._rectangle(view) or ()), default=_LEAST_SIDE)
            radius = self.find_value("contact.gross_radius_px") or 0
            if least < _LEAST_SIDE:
                self.record_conflict(view, f"its shorter side is {least} px, and a view needs {_LEAST_SIDE}; give more")
            elif view == "views.contact" and self._rectangle(view) and 3 * radius > least:
                at_most = f"at most a third of the contact view's shorter side fits, {least // 3} px; give less"
                self.record_conflict("contact.gross_radius_px", at_most)

    def _rectangle(self, key: str) -> tuple[Pixels, Pixels] | None:
        rows, columns = (self.find_value(f"{key}.{side}") for side in ("rows", "columns"))
        return None if rows is None or columns is None else (rows, columns)


def find(values: Any, key: str) -> Any:
    """Return the value at a dotted path in nested tables; None if there is none."""
    for name in key.split("."):
        values = values.get(name) if isinstance(values, Mapping) else None
    return values


def _name(key: str) -> str:
    return key.rpartition(".")[2]


_MOST_SHOWN = 300  # characters of a wrong value


def _shown(value: Any) -> str:
    return "is a table" if isinstance(value, dict) else f"is {value!r}"[:_MOST_SHOWN]


def _ranges(view: tuple[Pixels, Pixels] | None) -> str:
    return "none" if view is None else f"rows {list(view[0])}, columns {list(view[1])}"


def _option(view: tuple[Pixels, Pixels]) -> str:
    """Return the row and column ranges of a view as four numbers in a text, as the options of `fingerflow calibrate`
    take them.
    """
    return " ".join(map(str, (*view[0], *view[1])))
