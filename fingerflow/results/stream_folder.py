"""Results folder of a stream: file format, reader and writer."""

import contextlib
import itertools
import json
import logging
import os
import tempfile
import time
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError, PlayerError, first_line
from fingerflow.results.atomic_write import keep_others, write_csv, write_text
from fingerflow.results.patient_file import PatientFile
from fingerflow.schema.text_file import read_text
from fingerflow.schema.unfinished import remove, unfinished
from fingerflow.schema.variable_record import LABELS
from fingerflow.schema.variables import FRAME, VARIABLES, shown_unit

Array = NDArray[Any]
RESULTS_FORMAT = 2
log = logging.getLogger("fingerflow.results")
_AGAIN = "name the results folder of a stream, or copy it again"
#: Variables that are truth values, and numbers in files from before December 2026, with their data type.
MASKS = {name: "?" for name, variable in VARIABLES.items() if variable.dtype == "?"}
_AT_ONCE = 1 << 13  # bytes of records written together, which are lost at most if the process is killed


class StreamResults(NamedTuple):
    """Content of the results folder of a camera stream: header, one record per processed frame, and events."""

    records: Array
    header: dict[str, Any]
    events: list[dict[str, Any]]


def read_results(folder: str | Path) -> StreamResults:
    """Read the complete records, header and events in the results folder of a stream, even while the writer is still
    running.

    ``records`` is a structured array mapped from the file: ``records["real_contact_area"]`` (F,),
    ``records["position_px"]`` (F, N, 2). Raises FingerflowError where it is no results folder.
    """
    folder = Path(folder)
    try:
        header = json.loads(read_text(folder / "header.json", _AGAIN))
        if header["format"] != RESULTS_FORMAT:
            raise PlayerError(
                f"{folder}: results of format {header['format']}, this player reads {RESULTS_FORMAT}; use the player "
                "of the bundle that wrote them"
            )
        dtype = np.dtype([(f["name"], MASKS.get(f["name"], f["dtype"]), tuple(f["shape"])) for f in header["fields"]])
        if lacking := {"frame", "time"} - set(dtype.names or ()):
            raise ValueError(f"its records have no {' and no '.join(sorted(lacking))}")
        for field in header["fields"]:
            tuple(map(str, field["dims"])), str(field["unit"])
        count = (folder / "records.bin").stat().st_size // dtype.itemsize
        events = [json.loads(line) for line in read_text(folder / "events.jsonl", _AGAIN, 1 << 30).split("\n")[:-1]]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise PlayerError(f"{folder}: is no results folder of a stream ({first_line(error)}); {_AGAIN}") from None
    records = np.memmap(folder / "records.bin", dtype, "r", shape=(count,)) if count else np.empty(0, dtype)
    return StreamResults(records, header, events)


def write_table(folder: str | Path, table: str | Path, overwrite: bool = False) -> None:
    """Write the results of a stream to a CSV table with one row per frame, and one column per scalar variable or
    component of a vector.

    Columns are named as by `fingerflow export-table`. Raises FingerflowError where the file cannot be written, or
    exists without `overwrite`.
    """
    records, header, _ = read_results(folder)
    columns: dict[str, Array] = {}
    for field in header["fields"]:
        name, dims = field["name"], tuple(field["dims"])
        unit = shown_unit(name, str(field["unit"]))
        if dims == FRAME:
            columns[unit.heading(name)] = unit.factor * records[name]
        elif len(dims) == 2 and dims[1] in LABELS:
            parts = enumerate(LABELS[dims[1]])
            columns |= {unit.heading(f"{name}_{part}"): unit.factor * records[name][:, i] for i, part in parts}
    keep_others(Path(table), lambda _: False, overwrite)
    write_csv(Path(table), columns)


class Sink:
    """Writer of the folder in which the results of a camera stream are stored frame by frame; a killed process loses at
    most the last second.

    header.json describes a record, records.bin holds the records one after another, and events.jsonl the events with
    their times. While the disk is full, records are buffered in memory for half a minute (`PatientFile`); the event
    `disk_full` gives the duration.

    Args:
        folder: a new one.
        header: content of header.json.
        numbered: use the first of folder, folder-2, folder-3 ... that does not exist.
    """

    def __init__(self, folder: Path, header: Mapping[str, Any], numbered: bool = False) -> None:
        self.folder, self._header, self._numbered = folder, header, numbered
        self._records: PatientFile | None = None
        self._events: PatientFile | None = None
        self._made, self._synced, self._frame = False, 0.0, 0

    def open(self) -> None:
        """Create the results folder with all files, or raise PlayerError and create nothing."""
        with self._explained():
            self._make()
        self._made = True
        try:
            with self._explained():
                self._events = PatientFile(self.folder / "events.jsonl")
                self._records = PatientFile(self.folder / "records.bin")
        except PlayerError:
            self.discard()
            raise

    def write_summary(self, summary: Mapping[str, Any]) -> None:
        """Write counts and latencies of the stream to summary.json; if the disk is full, only log this, since the
        results are stored already.
        """
        text = json.dumps(summary, indent=1) + "\n"
        try:
            write_text(self.folder / "summary.json", text)
        except FingerflowError as error:
            log.warning("%s", error)

    def discard(self) -> None:
        """Delete the results folder created by `open`, if a stream received no frame."""
        for name in ("header.json", "events.jsonl", "records.bin") if self._made else ():
            with contextlib.suppress(OSError):
                (self.folder / name).unlink()
        if self._made:
            with contextlib.suppress(OSError):
                self.folder.rmdir()

    def _make(self) -> None:
        """Create the results folder with the header file in it.

        If another stream began in the same second, a number is appended to the name, but only with `numbered`.
        """
        named = self.folder
        for number in itertools.count(2):
            if not self.folder.exists():
                part = unfinished(self.folder)
                try:
                    part.mkdir(parents=True)
                    self._fill(part)
                    part.rename(self.folder)
                    return
                except OSError:
                    if not self.folder.exists():  # if the folder exists, another stream has just created it
                        raise
                finally:
                    remove(part)
            if not self._numbered:
                raise FileExistsError
            self.folder = named.with_name(f"{named.name}-{number}")

    def _fill(self, folder: Path) -> None:
        with open(folder / "header.json", "x", encoding="utf-8") as file:
            file.write(json.dumps(self._header, indent=1) + "\n")
            file.flush()
            os.fsync(file.fileno())
        for name in ("events.jsonl", "records.bin"):
            (folder / name).touch()

    def write(self, record: Array, frame: int) -> None:
        """Append the record of one frame to the results folder; records are flushed to the disk once a second."""
        assert self._records is not None
        self._frame = frame
        self._records.write(record.data)
        due = time.perf_counter() - self._synced >= 1
        if due or len(self._records) >= _AT_ONCE:
            try:  # `_explained` is five calls of Python
                if due:
                    self._stay()
                self._flush(self._records)
                if due:
                    self._synced = time.perf_counter()
                    self._records.sync()
            except OSError as error:
                raise self._unwritable(error) from None

    def _stay(self) -> None:
        """Continue in another folder, with all results until now, if this one was removed, renamed or unmounted."""
        assert self._records is not None
        assert self._events is not None
        if self._records.is_in_place() and self._events.is_in_place() and (self.folder / "header.json").exists():
            return
        gone, self._numbered = self.folder, True
        for parent in (gone.parent, Path(), Path(tempfile.gettempdir())):
            self.folder = parent / f"{gone.name}-moved"
            with contextlib.suppress(OSError):
                self._make()
                break
        self._records.move(self.folder / "records.bin")
        self._events.move(self.folder / "events.jsonl")
        log.warning("%s: was removed or renamed while in use; the results go on in %s", gone, self.folder)
        self.event("moved", self._frame, folder=str(gone))

    def _flush(self, records: PatientFile, wait: bool = False) -> None:
        if (full_disk := records.flush(wait)) is not None:
            seconds, kept_bytes = full_disk
            self.event("disk_full", self._frame, seconds=round(seconds, 1), kept_bytes=kept_bytes)

    def event(self, event: str, frame: int, **facts: Any) -> None:
        """Append one event of the stream, with its frame number and further facts, as one line to events.jsonl; any
        thread may call this.
        """
        assert self._events is not None
        line = {"event": event, "frame": frame, "clock": datetime.now(UTC).isoformat(), **facts}
        with self._explained():
            self._events.write((json.dumps(line) + "\n").encode())
            self._events.flush()

    def close(self) -> None:
        """Write all buffered records to the disk and close all files. Raises PlayerError where that fails."""
        if self._records is None or self._events is None:
            return
        with self._explained():
            try:
                self._stay()
                self._flush(self._records, wait=True)
                self._events.flush(wait=True)
                self._records.sync()
            finally:
                self._records.close()
                self._events.close()

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except FileExistsError:
            raise PlayerError(
                f"{self.folder}: exists already and results are never overwritten; give --output another name"
            ) from None
        except OSError as error:
            raise self._unwritable(error) from None

    def _unwritable(self, error: OSError) -> PlayerError:
        return PlayerError(
            f"{self.folder}: cannot be written ({error.strerror}); what was written stays readable. Make room, or "
            "give --output another place"
        )
