"""Reader of forces in LabVIEW TDMS files; the properties of channels give names, units and sample rate."""

from pathlib import Path
from typing import Any

import numpy as np

from fingerflow.errors import FingerflowError
from fingerflow.recordings.forces.force_table import ForceTable
from fingerflow.recordings.guard.child_process import check_in_child_process
from fingerflow.recordings.guard.file_checks import reading


def read_table(path: Path) -> ForceTable:
    """Return the columns of a TDMS file, named by channel, or all by group/channel if two channels have one name.

    The rate is 1 / `wf_increment`; the first sample is at `wf_start_offset` after the channel's `wf_start_time`.
    """
    try:
        from nptdms import TdmsFile
    except ImportError:
        raise FingerflowError(f"{path}: TDMS files need the package nptdms: pip install nptdms") from None
    check_in_child_process(path, "TDMS")
    # Open the file without reading the data: the stated sizes are compared with the file's size first.
    with reading(path, "TDMS"), TdmsFile.open(path) as file:
        table = _columns(path, file)
        if file.file_status.incomplete_final_segment:
            table.warnings.append(f"{path}: its last segment is incomplete; the samples in it are read")
    return table


def _columns(path: Path, file: Any) -> ForceTable:
    """Return a table of all numeric channels in an open TDMS file with their clocks, which begin at the earliest
    `wf_start_time`.
    """
    channels = [channel for group in file.groups() for channel in group.channels()]
    shared = len({channel.name for channel in channels}) < len(channels)
    table = ForceTable(path, {})
    waves: dict[str, Any] = {}
    size = path.stat().st_size
    for channel in channels:
        if len(channel) < 2 or channel.dtype is None or np.dtype(channel.dtype).kind not in "iuf":
            continue
        if len(channel) > size:  # a sample has at least one byte
            raise FingerflowError(
                f"{path}: channel {channel.name!r} should have {len(channel)} samples, which a file of {size} bytes "
                "cannot hold; copy it again"
            )
        name = f"{channel.group_name}/{channel.name}" if shared else channel.name
        unit = channel.properties.get("unit_string") or channel.properties.get("NI_UnitDescription") or None
        table.add(name, channel[:], {"Newtons": "N", "Volts": "V"}.get(str(unit), unit))
        if channel.properties.get("wf_increment"):
            waves[name] = channel.properties
    begins = {name: np.datetime64(wave["wf_start_time"]) for name, wave in waves.items() if "wf_start_time" in wave}
    for name, wave in waves.items():
        late = (begins[name] - min(begins.values())) / np.timedelta64(1, "s") if name in begins else 0.0
        table.clocks[name] = float(wave["wf_increment"]), float(wave.get("wf_start_offset", 0.0)) + late
    if 0 < len(begins) < len(waves):
        lacking = ", ".join(name for name in waves if name not in begins)
        table.warnings.append(f"{path}: {lacking} state no start time, and are taken to begin with the first channel")
    if table.clocks:
        table.sample_rate = 1.0 / next(iter(table.clocks.values()))[0]
    return table
