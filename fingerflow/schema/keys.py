"""Definition of a key of a settings file as a field of a data class: type, meaning, default and unit, and who needs
it.
"""

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from functools import cache
from typing import Any, get_args, get_type_hints

from fingerflow.schema.key_types import BOTH, NOBODY, File, KeyType, NumberType, Reader, key_type

_UNITS = {"_px": "px", "_mm": "mm", "_s": "s", "_mpa": "MPa"}  # units by the endings of key names


@dataclass(frozen=True)
class SceneKey:
    """Definition of one key: type, meaning, default and unit, and which reader (`process` or a stream) requires it.

    Attributes:
        help: what it means; shown in the commented scene file, the page's form and the documentation.
        default: where it is left out.
        type: its type and range.
        needed_by: readers that need it.
        unit: of its value, "" if it has none or the type states it.
        sample: value that the commented scene file shows where there is no default.
        label: words for the key in forms and reports; "" where its name in words says enough.
    """

    help: str
    default: Any
    type: Any
    needed_by: frozenset[Reader] = NOBODY
    unit: str = ""
    sample: Any = None
    label: str = ""

    def left_out(self) -> Any:
        """Return the value of the key where it is left out."""
        return self.default


@dataclass(frozen=True)
class SceneTable:
    """Definition of one table: its keys and meaning, and which reader (`process` or a stream) requires it.

    Attributes:
        help: what it is about.
        needed_by: readers that need it.
        sample: value that the commented scene file shows for an optional table within another.
        keys: its settings and tables.
        made: class of its settings.
        optional: whether it is None where it is left out; else its keys have their defaults.
    """

    help: str = ""
    needed_by: frozenset[Reader] = NOBODY
    sample: Any = None
    keys: Mapping[str, "SceneKey | SceneTable"] = field(default_factory=dict)
    settings: Any = None
    optional: bool = False

    def left_out(self) -> dict[str, Any] | None:
        """Return the values of the table's keys where it is left out."""
        return None if self.optional else {name: key.left_out() for name, key in self.keys.items()}

    def build(self, values: Mapping[str, Any] | None) -> Any:
        """Return the settings, an object of the table's class, that have the validated `values` of all keys."""
        if values is None:
            return None
        built = {name: key.build(values[name]) for name, key in self.keys.items() if isinstance(key, SceneTable)}
        return self.settings(**{**values, **built})


def key(help: str, default: Any = None, type: KeyType | File | NumberType | None = None, **facts: Any) -> Any:
    """Return the data class field of a key; `facts` are other attributes of `SceneKey`. Without `type`, the annotation
    says what the key takes.
    """
    entry = SceneKey(help, default, type, **facts)
    return field(default=MISSING if entry.needed_by == BOTH else default, metadata={"entry": entry})


def table(help: str, needed_by: frozenset[Reader] = NOBODY, sample: Any = None, **default: Any) -> Any:
    """Return the data class field of a table within another; the annotation is its class, or None as well if the table
    is optional.
    """
    return field(**default, metadata={"entry": SceneTable(help, needed_by, sample)})


@cache
def keys_of(settings: Any) -> dict[str, SceneKey | SceneTable]:
    """Return the keys and tables that the fields of a data class of settings define, by name."""
    keys: dict[str, SceneKey | SceneTable] = {}
    hints = get_type_hints(settings)
    for attribute in fields(settings):
        entry, hint = attribute.metadata.get("entry"), hints[attribute.name]
        if isinstance(entry, SceneKey):
            keys[attribute.name] = replace(entry, type=key_type(hint, entry.type))
        elif entry is not None:
            inner: Any = next(part for part in (hint, *get_args(hint)) if is_dataclass(part))
            keys[attribute.name] = replace(entry, keys=keys_of(inner), settings=inner, optional=inner is not hint)
    return keys


def key_words(name: str, key: SceneKey | SceneTable) -> tuple[str, str]:
    """Return the words for a key and its unit, such as "depth" and "mm" for `depth_mm`: its label or, without one, its
    name; the unit is "" if the key has none.
    """
    label, unit = (key.label, key.unit) if isinstance(key, SceneKey) else ("", "")
    end = next((end for end in _UNITS if name.endswith(end)), "")
    return label or name.removesuffix(end).replace("_", " "), unit or _UNITS.get(end, "")
