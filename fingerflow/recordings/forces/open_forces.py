"""Opening of force files: selection of the reader, the time column, the force channels and the units."""

import json
import math
import re
from collections.abc import Collection, Mapping, Sequence
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.recordings.forces.force_table import ForceTable
from fingerflow.recordings.forces.forces import Forces
from fingerflow.recordings.guard.file_checks import reading
from fingerflow.schema.text_file import check_file

READER_OF = dict.fromkeys((".csv", ".txt", ".tsv", ".lvm"), "delimited_text")
READER_OF |= {".h5": "hdf5_forces", ".hdf5": "hdf5_forces", ".mat": "matlab_forces", ".tdms": "tdms"}
TO_NEWTON = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "uN": 1e-6, "µN": 1e-6, "μN": 1e-6}
TO_NEWTON |= {"g": 9.80665e-3, "gf": 9.80665e-3, "kgf": 9.80665}  # with standard gravity (CGPM 1901), exact
TO_VOLT = {"V": 1.0, "mV": 1e-3}
TO_METRE = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9}
TO_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9, "min": 60.0}
TO_SECONDS |= {"sec": 1.0, "seconds": 1.0}
SAME_RATE = 0.01  # relative difference up to which two rates count as equal
TIME_NAMES = ("time", "t", "times", "timestamp", "elapsed time")


#: Name of a column, or its number, from 1 in the order of the file, for files without a heading.
Column = str | int


def open_forces(
    path: str | PathLike[str], channels: Sequence[Column] | Mapping[str, Column] | None = None,
    units: Mapping[str, str] | Mapping[int, str] | Mapping[Column, str] | None = None, time: Column | None = None,
    sample_rate: float | None = None, trigger: Column | None = None, lengths: Collection[Column] = (),
) -> Forces:  # fmt: skip
    """Read a force file and convert forces to N, times to s, voltages to V and positions to m.

    Columns are named, or numbered from 1 in the order of the file.

    path: CSV or other delimited text including LabVIEW's `.lvm`, HDF5, MATLAB `.mat` (v5 to v7.3) or LabVIEW `.tdms`.
    channels: names of the columns to keep, or a mapping from channel names to columns; by default all.
    units: unit of a column by its name in the file; overrides the file. Forces in N, mN, kN, uN, g (gf)
        or kgf become N; V and mV become V; a time column may be in s, ms, us or min (s if nothing is stated).
    time: name of the time column. By default the one called as in `TIME_NAMES`, in upper or lower case.
    sample_rate: Hz, for a file without times, or with times of too few digits; overrides the rate that the file
        states. If a time column increases throughout and has another rate, that is an error.
    trigger: name of the column that carries the trigger; kept besides `channels`. Its unit may be missing.
    lengths: columns that hold lengths, not forces; m, mm, um and nm become m.

    Raises FingerflowError for a missing file or column, an unknown or missing unit, times that do not increase, and
    times that contradict `sample_rate`.
    """
    location = Path(path)
    table = _read_table(location)
    table.units.update({_name(table, column): unit for column, unit in (units or {}).items()})
    time, trigger = (None if column is None else _name(table, column) for column in (time, trigger))
    times, time_column = _times(table, time, sample_rate)
    selected = _selected_columns(table, channels, time_column)
    if trigger is not None and trigger not in selected.values():
        selected[trigger] = trigger
    if not selected:
        raise FingerflowError(f"{table.path}: has times but no channel; its columns are {_names(table)}")
    _use_clock(table, list(selected.values()), time_column)
    if time_column is None:  # times follow from the sample rate and the number of samples
        count = len(table.columns[next(iter(selected.values()))])
        times = table.start + np.arange(count) / (sample_rate or table.sample_rate or math.nan)
    long = {_name(table, length) for length in lengths}
    in_unit = {name: _unit(table, column, column == trigger, column in long) for name, column in selected.items()}
    scales = {name: factor for name, (factor, _) in in_unit.items()}
    canonical = {name: unit for name, (_, unit) in in_unit.items()}
    values = {name: table.columns[column] * scales[name] for name, column in selected.items()}
    of_trigger = next((name for name, column in selected.items() if column == trigger), None)
    return Forces(location, times, values, canonical, of_trigger, scales=scales, warnings=table.warnings)


def _times(table: ForceTable, time: str | None, sample_rate: float | None) -> tuple[NDArray[np.float64], str | None]:
    """Return the sample times in s, taken from a time column, and the name of that column; or an empty array and None
    if the times follow from a sample rate.
    """
    if sample_rate is not None:
        if time is not None:
            raise FingerflowError(f"{table.path}: pass time={time!r} or sample_rate={sample_rate}, not both")
        if not (math.isfinite(sample_rate) and sample_rate > 0):
            raise FingerflowError(f"{table.path}: sample_rate={sample_rate} is not a positive number of Hz")
        _check_sample_rate(table, sample_rate)
        return np.empty(0), None
    if time is None:
        candidates = [name for name in table.columns if _is_time(name)]
        if len(candidates) > 1:
            raise FingerflowError(f"{table.path}: several columns could be the time, {candidates}; choose one as time")
        time = candidates[0] if candidates else None
    if time is None:
        if table.sample_rate is None:
            raise FingerflowError(
                f"{table.path}: has no time: no sample rate and no column called {', '.join(TIME_NAMES)}. "
                f"Give as time one of {_names(table)}, or sample_rate in Hz"
            )
        return np.empty(0), None
    unit = table.units.get(time, "s")
    if unit not in TO_SECONDS:
        raise FingerflowError(f"{table.path}: time column {time!r} is in {unit!r}; known are {', '.join(TO_SECONDS)}")
    times = table.columns[time] * TO_SECONDS[unit]
    stated, measured = table.sample_rate, _rate(times)
    if stated is not None and measured is not None and abs(measured / stated - 1) > SAME_RATE:
        table.warnings.append(
            f"{table.path}: states {stated:g} Hz, and its times {time!r} are {measured:g} Hz apart; the times count"
        )
    return times, time


def _use_clock(table: ForceTable, columns: list[str], time_column: str | None) -> None:
    """Set rate and start of a table to those of the selected columns; raise FingerflowError if these have different
    clocks, or other times in their group of the file than the selected ones.
    """
    clocks = {column: table.clocks[column] for column in columns if column in table.clocks}
    steps, starts = zip(*clocks.values() or [(1.0, 0.0)], strict=True)
    if max(np.ptp(steps), np.ptp(starts)) > SAME_RATE * min(steps):
        listed = ", ".join(f"{name!r} every {step:g} s from {start:g} s" for name, (step, start) in clocks.items())
        remedy = "export them with one clock, or leave out those of another"
        raise FingerflowError(f"{table.path}: its channels run on different clocks ({listed}); {remedy}")
    if clocks:
        table.sample_rate, table.start = 1.0 / steps[0], starts[0]
    if time_column is None:
        return
    for name in filter(_is_time, table.columns):
        beside = [column for column in columns if _group(column) == _group(name) != _group(time_column)]
        if beside and not np.array_equal(table.columns[name], table.columns[time_column]):
            raise FingerflowError(
                f"{table.path}: {beside[0]!r} has times of its own, {name!r}, which differ from {time_column!r}; "
                "export both with the same times"
            )


def _group(column: str) -> str:
    return re.sub(r"[^./]*$", "", column)


def _check_sample_rate(table: ForceTable, sample_rate: float) -> None:
    """Raise FingerflowError if a time column of the file contradicts the given `sample_rate`."""
    for name in filter(_is_time, table.columns):
        unit = table.units.get(name, "s")
        measured = _rate(table.columns[name] * TO_SECONDS.get(unit, 1.0))
        if measured is not None and abs(measured / sample_rate - 1) > SAME_RATE:
            raise FingerflowError(
                f"{table.path}: sample_rate={sample_rate:g} Hz, but its column {name!r} in {unit} says {measured:g} "
                f"Hz. Leave sample_rate out; if the column is in another unit, write it in its heading, '{name} (ms)'; "
                "if it is no time, rename it"
            )


def _rate(times: NDArray[np.float64]) -> float | None:
    """Return the sample rate in Hz that the median interval of a time column (s) gives; None if the times do not
    increase throughout.
    """
    steps = np.diff(times)
    return 1.0 / float(np.median(steps)) if steps.size and np.all(steps > 0) else None


def _selected_columns(
    table: ForceTable, channels: Sequence[Column] | Mapping[str, Column] | None, time_column: str | None
) -> dict[str, str]:
    """Return a mapping from the name of each selected force channel to the name of its column in the file.

    Without a choice these are all columns as long as the times, or as the longest column.
    """
    if isinstance(channels, Mapping):
        selected = {name: _name(table, column) for name, column in channels.items()}
        if len({*selected.values(), time_column}) <= len(selected):
            raise FingerflowError(f"{table.path}: one column is named twice in {selected}, time {time_column!r}")
        return selected
    if channels is not None:
        chosen = [channels] if isinstance(channels, str) else channels
        return {name: name for name in (_name(table, column) for column in chosen)}
    times = [time_column] if time_column else list(filter(_is_time, table.columns))
    count = max(len(table.columns[name]) for name in ([time_column] if time_column else table.columns))
    return {name: name for name, data in table.columns.items() if len(data) == count and name not in times}


def _is_time(name: str) -> bool:
    return re.split(r"[./]", name)[-1].strip().lower() in TIME_NAMES


def force_columns(path: str | PathLike[str]) -> list[str]:
    """Return all column names of a force file, in file order; raise FingerflowError if the file is unreadable."""
    return list(_read_table(Path(path)).columns)


def holds_forces(path: str | PathLike[str]) -> bool:
    """Return whether a file is a force file, by its suffix; an HDF5 file, which may be a recording too, is one unless
    one of its data sets has three dimensions.

    Raises FingerflowError for an HDF5 file that is missing or unreadable.
    """
    location = Path(path)
    reader = READER_OF.get(location.suffix.lower())
    if reader != "hdf5_forces":
        return reader is not None
    with reading(location, "HDF5"):
        dimensions: list[int] = import_module("fingerflow.recordings.forces.hdf5_forces").dimensions(location)
    return 3 not in dimensions


def force_facts(path: str | PathLike[str]) -> dict[str, Any]:
    """Return the properties of a force file: its sample rate in Hz and, for each column, number of samples, minimum,
    maximum and unit.

    The rate is that which the file states, else that of its time column. Raises FingerflowError if the file is
    unreadable.
    """
    table = _read_table(Path(path))
    ticks = {name: TO_SECONDS.get(table.units.get(name, "s"), math.nan) for name in filter(_is_time, table.columns)}
    rates = [_rate(table.columns[name] * tick) for name, tick in ticks.items()]
    columns = {}
    for name, data in table.columns.items():
        finite = data[np.isfinite(data)]
        least, largest = (f"{finite.min():.6g}", f"{finite.max():.6g}") if finite.size else ("nan", "nan")
        columns[name] = f"{data.size} samples of {least} to {largest} {table.units.get(name, '(no unit)')}"
    return {
        "path": str(table.path),
        "sample_rate_hz": table.sample_rate or next(filter(None, rates), None),
        "columns": columns,
        "warnings": table.warnings,
    }


def _read_table(location: Path) -> ForceTable:
    check_file(location)
    reader = READER_OF.get(location.suffix.lower())
    if reader is None:
        problem = f"{location.suffix or 'a file without suffix'} does not hold forces; known are {', '.join(READER_OF)}"
        raise FingerflowError(f"{location}: {problem}")
    with reading(location, f"forces ({reader.removesuffix('_forces')})"):
        table: ForceTable = import_module(f"fingerflow.recordings.forces.{reader}").read_table(location)
    if not table.columns:
        raise FingerflowError(f"{location}: has no column of numbers")
    return table


def _name(table: ForceTable, column: Column) -> str:
    """Return the name of a column that is given by name or number; raise FingerflowError if no such column exists."""
    names = list(table.columns)
    if isinstance(column, int):
        if not 1 <= column <= len(names):
            raise FingerflowError(
                f"{table.path}: has no column {column}; it has {len(names)}, numbered from 1: {_names(table)}"
            )
        return names[column - 1]
    if column not in names:
        parts = [part.strip() for part in column.split(",")]
        two = f". Two columns? In the scene write [forces] tangential = {json.dumps(parts, ensure_ascii=False)}"
        hint = two if len(parts) == 2 and set(parts) <= set(names) else ""
        raise FingerflowError(f"{table.path}: has no column {column!r}; its columns are {_names(table)}{hint}")
    return column


def _unit(table: ForceTable, column: str, may_be_missing: bool, is_length: bool) -> tuple[float, str]:
    unit = table.units.get(column)
    if unit is None and may_be_missing:
        return 1.0, ""
    # Accept a length only where one is expected, so that a position is not taken for a force.
    allowed = ((TO_METRE, "m"),) if is_length else ((TO_NEWTON, "N"), (TO_VOLT, "V"))
    for factors, canonical in allowed:
        if unit in factors:
            return factors[unit], canonical
    accepted = ", ".join(name for factors, _ in allowed for name in factors)
    state = "has no unit" if unit is None else f"is in {unit!r}, which is not known"
    raise FingerflowError(
        f"{table.path}: column {column!r} {state}. Pass units={{{column!r}: ...}} with one of {accepted}, in a scene "
        f"{'write (mm) in its heading' if is_length else 'give [forces] units (N, mN, g, kgf or V)'}, or leave it out"
    )


def _names(table: ForceTable) -> str:
    return ", ".join(repr(name) for name in table.columns)
