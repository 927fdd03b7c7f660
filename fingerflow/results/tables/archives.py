"""Export of complete results as NWB files and as Zarr stores."""

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import xarray as xr

from fingerflow.errors import FingerflowError
from fingerflow.recordings.guard.checked_hdf5 import open_hdf5
from fingerflow.results.atomic_write import write_atomically
from fingerflow.results.result import MARK
from fingerflow.schema.unfinished import finish, remove, unfinished

NWB_MODULE = "fingerflow"  # name of the processing module that identifies an NWB file of fingerflow


def save_nwb(result: xr.Dataset, path: Path) -> None:
    """Write a result to an NWB file: a time series for each variable with frames, in the processing module fingerflow.

    Values keep the units of the data set. What has no frames, such as `reference_position`, is a table of its first
    dimension, `point` or `triangle`. Times count from the trigger; as a recording states no date, `session_start_time`
    is the time of processing. The subject is `[rig] participant` of the scene.

    Raises FingerflowError where pynwb is not installed, or the file cannot be written.
    """
    try:
        from hdmf.common import DynamicTable, VectorData
        from pynwb import NWBHDF5IO, NWBFile, TimeSeries
        from pynwb.file import Subject
    except ImportError as error:
        raise FingerflowError(
            f"{path}: NWB files need the package {error.name}; install it with pip install pynwb"
        ) from error
    created = datetime.fromisoformat(str(result.attrs["created"]))
    rig = json.loads(result.attrs.get("settings", "{}")).get("rig") or {}
    file = NWBFile(
        subject=Subject(subject_id=rig.get("participant") or "not stated", species="Homo sapiens", sex="U"),
        session_description=f"{result.attrs['title']}: {result.attrs['frames']}; session_start_time is the time of "
        "processing, times of the series count from the trigger",
        identifier=str(result.attrs.get("recording", result.attrs["frames"])),
        session_start_time=created if created.tzinfo else created.replace(tzinfo=UTC),
        source_script=f"fingerflow {result.attrs[MARK]}",
        source_script_file_name=str(result.attrs["frames"]),
        notes=json.dumps({name: str(value) for name, value in result.attrs.items()}),
    )
    module = file.create_processing_module(NWB_MODULE, "contact, motion and strain of skin on glass")
    tables: dict[str, list[VectorData]] = {}
    timestamps: object = result["time"].values.astype(np.float64)
    for name, values in result.data_vars.items():
        about, unit, first = str(values.attrs["long_name"]), str(values.attrs["units"]), str(values.dims[0])
        parts = [list(map(str, result[dim].values)) for dim in values.dims[1:] if dim in result.coords]
        comments = f"dimensions {', '.join(map(str, values.dims))}; components {parts}" if parts else "no comments"
        if "flag_meanings" in values.attrs:
            comments = f"values 0, 1, 2 ... mean {values.attrs['flag_meanings']}"
        if first == "frame":
            texts = {"unit": unit, "description": about, "comments": comments}
            series = TimeSeries(name=str(name), data=values.values, timestamps=timestamps, **texts)
            module.add(series)
            # Later series refer to the first one, so that times are stored only once.
            timestamps = series if not isinstance(timestamps, TimeSeries) else timestamps
        else:
            column = VectorData(name=str(name), data=values.values, description=f"{about}; unit {unit}")
            tables.setdefault(first, []).append(column)
    for dim, columns in tables.items():
        module.add(DynamicTable(name=dim, description=f"one row for each {dim}", columns=columns))

    def write(part: Path) -> None:
        with NWBHDF5IO(str(part), "w") as writer:
            writer.write(file)

    write_atomically(path, write)


def save_zarr(result: xr.Dataset, path: Path) -> None:
    """Write a result as a Zarr store, a folder that `fingerflow.results.result.load_result` and xarray open.

    It has version 2 of the format, which most programs read. A store of that name is replaced.

    Raises FingerflowError where zarr is not installed, or the folder cannot be written.
    """
    part = unfinished(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        result.drop_encoding().to_zarr(part, mode="w", consolidated=True, zarr_format=2)
        remove(path)
        finish(part, path)
    except ImportError as error:
        raise FingerflowError(f"{path}: Zarr stores need the package zarr; install it with pip install zarr") from error
    except OSError as error:
        raise FingerflowError(f"{path} cannot be written ({error.strerror or error}); name another place") from error
    finally:
        remove(part)


def is_nwb_result(path: Path) -> bool:
    """Return whether a file is an NWB file that `save_nwb` has written."""
    with open_hdf5(path) as file:
        return f"processing/{NWB_MODULE}" in file


def is_zarr_result(path: Path) -> bool:
    """Return whether a folder is a Zarr store that `save_zarr` has written."""
    try:
        return MARK in json.loads((path / ".zattrs").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
