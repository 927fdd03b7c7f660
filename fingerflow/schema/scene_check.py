"""Validation of the content of a scene file: each key, and rules between several keys."""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fingerflow.schema.calibration_file import CalibrationError, CalibrationFile, Pixels, read_calibration
from fingerflow.schema.scene_keys import (
    RENAMED,
    RULES,
    SCENE,
    File,
    FitsTheViews,
    InPlaceOf,
    Inside,
    NotBefore,
    NotBoth,
    OneEach,
    OneOf,
    Reader,
    Rule,
    SceneKey,
    SceneTable,
    Together,
    views_of,
)
from fingerflow.schema.scene_kinds import KINDS, default_kind
from fingerflow.schema.scene_values import WrongValue, either, value_of

Keys = tuple[str, ...]
MISSING = "is missing; add it: `fingerflow init` and the scene.toml of a bundle show how"


@dataclass(frozen=True)
class Problem:
    """Problem with one key of a scene file; the message `said` continues a sentence that begins with the name of the
    key.
    """

    keys: Keys
    said: str


@dataclass(frozen=True)
class Checked:
    """Validated content of a scene file.

    Attributes:
        kind: one of KINDS.
        values: by table and key, with defaults; paths are absolute, ranges and matrices are tuples. A key that is left
            out and has no default is None, as is a table that is left out where one of its keys is needed.
        given: dotted keys that the scene file, or the calibration file that it names, sets.
    """

    kind: str
    values: Mapping[str, Any]
    given: frozenset[str]


def check_scene(written: Mapping[str, Any], folder: Path, reader: Reader) -> tuple[Checked, list[Problem]]:
    """Validate the parsed content of a scene file; return it with defaults filled in, and all problems found.

    Args:
        written: tables and keys as parsed from TOML.
        folder: the folder of the file, to which paths are relative.
        reader: the reader whose needs are checked.

    Returns:
        The checked content, which is valid only if there are no problems; and the problems as they were found.
    """
    check = _Check(written, folder, reader)
    check.all()
    return Checked(check.kind, check.values, frozenset(check.given)), check.problems()


class _Check:
    """Validation of one scene file, which collects at most one problem for each key."""

    def __init__(self, written: Mapping[str, Any], folder: Path, reader: Reader) -> None:
        self._written, self._folder, self._reader = written, folder, reader
        self._said: dict[Keys, str] = {}
        self._missing: set[Keys] = set()
        self._meant: set[Keys] = set()  # likely intended keys of misspelt ones, which are not reported missing
        self._calibration: CalibrationFile | None = None
        self.kind = ""
        self.values: dict[str, Any] = {}
        self.given: set[str] = set()

    def all(self) -> None:
        """Check all keys of the scene file one by one, then all rules between several keys."""
        stated, self.kind = self._written.get("kind"), default_kind(self._written)
        if isinstance(stated, str) and stated in KINDS:
            self.kind = stated
        elif "kind" in self._written:
            self._refuse(("kind",), f"is {stated!r}: it should be {either(KINDS)}")
        kind = KINDS[self.kind]
        tables = {"recording": SCENE["recording"], "views": views_of(kind), **SCENE}
        rest = {name: value for name, value in self._written.items() if name != "kind"}
        self.values = self._table((), SceneTable(tables), rest, ("kind",))
        for role, view in KINDS[self.kind].roles.items() if self.values.get("views") else ():
            self.values["views"][role] = self._value_at(f"views.{view}")
        for rule in RULES:
            self._rule(rule)

    def problems(self) -> list[Problem]:
        return [Problem(keys, said) for keys, said in self._said.items() if keys not in self._missing & self._meant]

    def _refuse(self, keys: Keys, said: str) -> None:
        self._said.setdefault(keys, said)

    def _table(self, place: Keys, table: SceneTable, written: Mapping[str, Any], besides: Keys = ()) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name, key in table.keys.items():
            keys = (*place, name)
            if name not in written:
                found[name] = self._left_out(keys, key)
                continue
            self.given.add(".".join(keys))
            value = written[name]
            if isinstance(key, SceneKey):
                found[name] = self._value(keys, key, value)
            elif isinstance(value, dict):
                found[name] = self._table(keys, key, value)
            else:
                self._refuse(keys, f"is {value!r}: it should be a table")
        for name in written:
            if name not in table.keys:
                self._unknown((*place, name), sorted((*table.keys, *besides)))
        return found

    def _left_out(self, keys: Keys, key: SceneKey | SceneTable) -> Any:
        if self._reader in key.needed_by:
            self._lacks(keys)
        if isinstance(key, SceneKey):
            return key.default
        needed = any(self._reader in one.needed_by for one in key.keys.values())
        return None if needed else self._table(keys, key, {})

    def _lacks(self, keys: Keys) -> None:
        self._missing.add(keys)
        self._refuse(keys, MISSING)

    def _value(self, keys: Keys, key: SceneKey, value: Any) -> Any:
        try:
            return self._path(key.type, value) if isinstance(key.type, File) else value_of(key.type, value)
        except WrongValue as wrong:
            self._refuse(keys, f"{_shown(value)}: {wrong}")
            return None

    def _path(self, file: File, value: Any) -> Path:
        if not isinstance(value, str):
            raise WrongValue("that is no path of a file; it should be in quotes, relative to the scene file")
        if not value.isprintable():
            raise WrongValue(r"that is no path: it has control characters, which TOML makes of \ and a letter; write /")
        try:
            path = (self._folder / value).resolve()
            there = Path(str(path).split("::")[0]).exists()
        except (OSError, ValueError) as error:  # an invalid file name, or a folder without permission
            raise WrongValue(f"that is no path that can be looked up ({error}); correct it") from None
        if self._reader in file.there_for and not there:
            raise WrongValue(f"{path} does not exist; paths are relative to the folder of the scene file")
        if file.calibration:
            try:
                self._calibration = read_calibration(path)
            except CalibrationError as error:
                raise WrongValue(str(error)) from None
        return path

    def _unknown(self, keys: Keys, known: list[str]) -> None:
        if now := RENAMED.get(".".join(keys)):
            self._refuse(keys, f"is no longer a key: it is called {now!r} now")
            return
        close = difflib.get_close_matches(keys[-1], known, n=1)
        self._meant |= {(*keys[:-1], key) for key in close}
        hint = f"did you mean {close[0]!r}? " if close else ""
        self._refuse(keys, f"is not a key; {hint}known here: {', '.join(known)}")

    # Checks of the rules.

    def _rule(self, rule: Rule) -> None:
        match rule:
            case NotBefore():
                self._not_before(rule)
            case Together():
                if rule.key in self.given and rule.other not in self.given:
                    self._record_conflict(rule.key, f"{rule.why}; {rule.remedy}")
            case NotBoth():
                if rule.key in self.given and rule.other in self.given:
                    self._record_conflict(
                        rule.key, f"it and {rule.other.rpartition('.')[2]} exclude each other: {rule.why}"
                    )
            case OneEach():
                self._one_each(rule)
            case InPlaceOf():
                self._in_place_of(rule)
            case Inside():
                self._inside(rule)
            case OneOf():
                self._one_of(rule)
            case FitsTheViews():
                self._fits_the_views(rule)

    def _record_conflict(self, key: str, said: str) -> None:
        """Record a problem of a key that conflicts with other keys; the message quotes the value in the scene file."""
        value: Any = self._written
        for name in key.split("."):
            value = value.get(name) if isinstance(value, dict) else None
        self._refuse(tuple(key.split(".")), f"{_shown(value)}: {said}")

    def _value_at(self, key: str) -> Any:
        """Return the validated value at a dotted path such as "forces.tangential"; None if missing or invalid."""
        value: Any = self.values
        for name in key.split("."):
            value = None if value is None else value.get(name)
        return value

    def _not_before(self, rule: NotBefore) -> None:
        last, first = self._value_at(rule.key), self._value_at(rule.first)
        if last is not None and first is not None and last < first:
            ours, other = (key.rpartition(".")[2] for key in (rule.key, rule.first))
            self._record_conflict(
                rule.key,
                f"that is before {other}, {first}; both are included, so give at least {first} or leave {ours} out",
            )

    def _one_each(self, rule: OneEach) -> None:
        given, named = self._value_at(rule.key), [self._value_at(force) for force in rule.forces]
        if not isinstance(given, tuple) or named[0] is None:
            return
        count = sum(len(one) if isinstance(one, tuple) else one is not None for one in named)
        if len(given) != count:
            self._record_conflict(
                rule.key, f"it has {len(given)} numbers for {count} forces; give one a force, normal first"
            )

    def _in_place_of(self, rule: InPlaceOf) -> None:
        """Apply a rule `InPlaceOf`: take scale and transform from the calibration file, and record conflicts."""
        place, _, name = rule.key.rpartition(".")
        if rule.key not in self.given:
            if place in self.given and rule.needed not in self.given:
                self._lacks(tuple(rule.needed.split(".")))
            return
        others = [one.rpartition(".")[2] for one in (rule.needed, rule.transform) if one in self.given]
        if others:
            # The conflict replaces other problems of this key, as the user may remove it.
            self._said.pop(tuple(rule.key.split(".")), None)
            self._record_conflict(rule.key, f"a {name} and {', '.join(others)} exclude each other; keep one of them")
            return
        found, table = self._calibration, SCENE[place]
        if found is None or not isinstance(table, SceneTable):
            return
        said = {rule.needed: found.mm_per_px, **({rule.transform: found.matrix()} if found.affine else {})}
        for other, value in said.items():
            name = other.rpartition(".")[2]
            self.given.add(other)
            key = table.keys[name]
            assert isinstance(key, SceneKey)
            self.values[place][name] = self._value(tuple(other.split(".")), key, value)

    def _inside(self, rule: Inside) -> None:
        region, view = self._rectangle(rule.key), self._rectangle(rule.view)
        if region is None or view is None:
            return
        height, width = (end - first for first, end in view)
        if region[0][1] > height or region[1][1] > width:
            name = rule.view.rpartition(".")[2]
            self._record_conflict(rule.key, f"it ends beyond the {name} view of {height} x {width} px; give less")

    def _one_of(self, rule: OneOf) -> None:
        """Apply a rule `OneOf`: record a problem unless the table that the rule names has exactly one of its possible
        keys.
        """
        place, _, name = rule.key.rpartition(".")
        table, around = self._value_at(rule.key), self._value_at(place)
        if not table or place not in self.given:  # a role has the region of its view
            return
        given = [key for key in table if f"{rule.key}.{key}" in self.given]
        wrong = any(".".join(keys).startswith(f"{rule.key}.") for keys in self._said)
        if rule.key in self.given and len(given) != 1 and not wrong:
            self._record_conflict(
                rule.key, f"one of {either(table)} is needed, and there are {' and '.join(given) or 'none'}"
            )
        if rule.key not in self.given:
            around[name] = None

    def _fits_the_views(self, rule: FitsTheViews) -> None:
        """Apply a rule `FitsTheViews`: record a problem unless the calibration has a transform between the views and
        was made with the views of this scene.
        """
        from_view, into_view = self._rectangle(rule.view), self._rectangle(rule.into)
        if from_view is None or into_view is None or any(keys[0] == "calibration" for keys in self._said):
            return
        # Without a second view to map, the scale suffices: it holds for any part of the frame.
        if from_view == into_view and rule.transform not in self.given:
            return
        name, into = (key.rpartition(".")[2] for key in (rule.view, rule.into))
        if rule.transform not in self.given:
            if self._calibration is None:
                self._record_conflict(
                    rule.scale,
                    f"the scene has a {name} view, and nothing says where its pixels are in the {into} view; add "
                    "topography_to_contact = [[a, b, x], [c, d, y]], or use a file of `fingerflow calibrate --target`",
                )
            else:
                self._record_conflict(
                    rule.key,
                    f"the scene has a {name} view, and this calibration is the scale alone; write one that holds the "
                    f"transform between the views too, with `fingerflow calibrate --target`, or remove [{rule.view}]",
                )
            return
        for one, view in ((name, from_view), (into, into_view)) if self._calibration is not None else ():
            made_with = self._calibration.views.get(one) if self._calibration is not None else None
            if made_with != view:
                self._record_conflict(
                    rule.key,
                    f"it was made with the {one} view {_ranges(made_with)}, and the scene has {_ranges(view)}: the "
                    "transform holds for the same pixels only. Calibrate with the views of this scene, "
                    f"`fingerflow calibrate --{name} {_option(from_view)} --{into} {_option(into_view)}`, or use the "
                    "views of the calibration",
                )

    def _rectangle(self, key: str) -> tuple[Pixels, Pixels] | None:
        found = self._value_at(key)
        rows, columns = (None, None) if found is None else (found.get("rows"), found.get("columns"))
        return None if rows is None or columns is None else (rows, columns)


def _shown(value: Any) -> str:
    return "is a table" if isinstance(value, dict) else f"is {value!r}"


def _ranges(view: tuple[Pixels, Pixels] | None) -> str:
    return "none" if view is None else f"rows {list(view[0])}, columns {list(view[1])}"


def _option(view: tuple[Pixels, Pixels]) -> str:
    """Return the row and column ranges of a view as four numbers in a text, as the options of `fingerflow calibrate`
    take them.
    """
    return " ".join(map(str, (*view[0], *view[1])))
