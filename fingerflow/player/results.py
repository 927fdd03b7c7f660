"""The folder of results: what a record holds, how it is written and read."""

from __future__ import annotations

import contextlib
import json
import os
import threading
import time
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TextIO

import numpy as np

from .arrays import Array, Tensor
from .errors import PlayerError

RESULTS_FORMAT = 1
_IN_MM = {  # outputs in px that are stored in mm: name, power of mm_per_px
    "real_area_px": ("real_area_mm2", 2),
    "gross_area_px": ("gross_area_mm2", 2),
    "semi_axes": ("semi_axes_mm", 1),
}
_OWN_FIELDS = [  # name, type, unit of what the player adds to a record
    ("frame", "<i8", "number of the frame as it came in, or in its file, from 0; gaps are dropped frames"),
    ("time", "<f8", "s since the first frame"),
    ("latency", "<f4", "s from the frame's arrival to its result"),
    ("key_frame", "<i8", "number of the frame with which this one was compared"),
    ("restart", "<i4", "how often points had been chosen anew; points of different restarts are different points"),
]
_MATLAB = {"f4": "single", "f8": "double", "u1": "uint8", "u2": "uint16", "i4": "int32", "i8": "int64"}
_STORED = {np.dtype(np.bool_): "|u1", np.dtype(np.float16): "<f4"}


class StreamResults(NamedTuple):
    """What `read_results` gives: one record a processed frame, the header, and what happened beside the frames."""

    records: Array
    header: dict[str, Any]
    events: list[dict[str, Any]]


def read_results(folder: str | Path) -> StreamResults:
    """Reads a results folder, also one that is being written or whose writer was killed: the whole records of it.

    ``records`` is a structured array mapped from the file: ``records["real_area_mm2"]`` (F,), ``records["points"]``
    (F, N, 2). Raises PlayerError where it is no results folder.
    """
    folder = Path(folder)
    try:
        header = json.loads((folder / "header.json").read_text(encoding="utf-8"))
        if header["format"] != RESULTS_FORMAT:
            raise PlayerError(f"{folder}: results of format {header['format']}, this player reads {RESULTS_FORMAT}")
        dtype = np.dtype([(f["name"], f["dtype"], tuple(f["shape"])) for f in header["fields"]])
        count = (folder / "records.bin").stat().st_size // dtype.itemsize
        lines = (folder / "events.jsonl").read_text(encoding="utf-8").splitlines(keepends=True)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise PlayerError(f"{folder}: is no results folder of a stream ({error})") from None
    records = np.memmap(folder / "records.bin", dtype, "r", shape=(count,)) if count else np.empty(0, dtype)
    return StreamResults(records, header, [json.loads(line) for line in lines if line.endswith("\n")])


def write_table(folder: str | Path, table: str | Path) -> None:
    """Writes the scalars of a results folder as CSV, one row a frame; raises PlayerError where the file exists."""
    records = read_results(folder).records
    names = [name for name in records.dtype.names or () if records.dtype[name].shape in ((), (2,))]
    columns: dict[str, Array] = {}
    for name in names:
        pair = records.dtype[name].shape == (2,)
        columns |= {f"{name}_{i + 1}": records[name][:, i] for i in range(2)} if pair else {name: records[name]}
    try:
        with open(table, "x", encoding="utf-8") as file:
            file.write(",".join(columns) + "\n")
            for row in zip(*(column.tolist() for column in columns.values()), strict=True):
                file.write(",".join(f"{value:.9g}" for value in row) + "\n")
    except OSError as error:
        raise PlayerError(
            f"{table}: cannot be written ({error.strerror}); name a new file where there is room"
        ) from None


class Sink:
    """Appends records to a new folder; a kill loses at most what came since the last second.

    header.json says what a record holds, records.bin has them one after another, events.jsonl what happened when.
    """

    def __init__(self, folder: Path, header: Mapping[str, Any]) -> None:
        self.folder, self._header = folder, header
        self._records: BinaryIO | None = None
        self._events: TextIO | None = None
        self._synced = 0.0
        self._lock = threading.Lock()

    def open(self) -> None:
        """Makes the folder; raises PlayerError where it is there already or cannot be made."""
        with self._said():
            self.folder.mkdir(parents=True)
            with open(self.folder / "header.json", "x", encoding="utf-8") as file:
                file.write(json.dumps(self._header, indent=1) + "\n")
                file.flush()
                os.fsync(file.fileno())
            self._events = open(self.folder / "events.jsonl", "x", encoding="utf-8")  # noqa: SIM115
            self._records = open(self.folder / "records.bin", "xb")  # noqa: SIM115

    def write(self, record: Array) -> None:
        """A record as bytes; once a second all of them go to the disk."""
        assert self._records is not None
        with self._said():
            self._records.write(record.data)
            if time.perf_counter() - self._synced >= 1:
                self.sync()

    def sync(self) -> None:
        assert self._records is not None
        self._synced = time.perf_counter()
        self._records.flush()
        os.fsync(self._records.fileno())

    def event(self, event: str, frame: int, **facts: Any) -> None:
        """One line; may come from any thread."""
        assert self._events is not None
        with self._said(), self._lock:
            line = {"event": event, "frame": frame, "clock": datetime.now(UTC).isoformat(), **facts}
            self._events.write(json.dumps(line) + "\n")
            self._events.flush()

    def close(self) -> None:
        if self._records is None or self._events is None:
            return
        with self._said():
            try:
                self.sync()
            finally:
                for file in (self._records, self._events):
                    # After a full disk the rest cannot be written at the second try either.
                    with contextlib.suppress(OSError):
                        file.close()

    @contextlib.contextmanager
    def _said(self) -> Iterator[None]:
        try:
            yield
        except FileExistsError:
            raise PlayerError(
                f"{self.folder}: exists already and results are never overwritten; give --output another name"
            ) from None
        except OSError as error:
            raise PlayerError(
                f"{self.folder}: cannot be written ({error.strerror}); what was written stays readable. Make room, or "
                "give --output another place"
            ) from None


class RecordLayout:
    """Which outputs of the graphs a record holds, in which units, and how they get there."""

    def __init__(self, outputs: Mapping[str, Tensor], mm_per_px: float, units: Mapping[str, str]) -> None:
        own: list[tuple[str, str, tuple[int, ...]]] = [(name, kind, ()) for name, kind, _ in _OWN_FIELDS]
        self._copied: list[tuple[str, str, float | None]] = []
        said = {name: unit for name, _, unit in _OWN_FIELDS}
        for name, tensor in outputs.items():
            if len(tensor.shape) > 3:  # images are for the live page
                continue
            stored, power = _IN_MM.get(name, (name, 0))
            self._copied.append((name, stored, mm_per_px**power if power else None))
            own.append((stored, _STORED.get(tensor.dtype, tensor.dtype.newbyteorder("<").str), tensor.shape[1:]))
            said[stored] = {0: units.get(name, ""), 1: "mm", 2: "mm2"}[power]
        self.dtype = np.dtype(own)
        self.fields = [
            {"name": name, "dtype": kind, "shape": shape, "unit": said[name], "matlab": _MATLAB[kind[1:]]}
            for name, kind, shape in own
        ]

    def fill(self, records: Mapping[str, Array], place: int, outputs: Mapping[str, Array]) -> None:
        """Stores the outputs in one of the records, whose fields are given by name."""
        for name, stored, factor in self._copied:
            value = outputs[name][0]
            records[stored][place] = value if factor is None else value * factor
