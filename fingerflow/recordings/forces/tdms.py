"""Forces in a LabVIEW TDMS file: names, units and rate as the channels' properties state them."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from fingerflow.errors import FingerflowError
from fingerflow.recordings.forces.table import Table


def read_table(path: Path) -> Table:
    """Columns have the name of their channel, group/channel where two groups share one. The rate is 1 / `wf_increment`,
    the first sample is at `wf_start_offset`; channels with different ones have to be told apart by the user.
    """
    try:
        from nptdms import TdmsFile
    except ImportError:
        raise FingerflowError(
            f'{path}: TDMS files need the package nptdms; install it with pip install "fingerflow-engine[tdms]"'
        ) from None
    try:
        file = TdmsFile.read(path)
    except (ValueError, OSError, KeyError, EOFError) as error:
        raise FingerflowError(f"{path}: cannot be read as TDMS, it is of another kind or damaged ({error})") from None
    channels = [channel for group in file.groups() for channel in group.channels()]
    shared = Counter(channel.name for channel in channels)
    table = Table(path, {})
    clocks = set()
    for channel in channels:
        values = channel[:]
        if len(values) < 2 or values.dtype.kind not in "iuf":
            continue
        name = channel.name if shared[channel.name] == 1 else f"{channel.group_name}/{channel.name}"
        table.add(name, values)
        unit = channel.properties.get("unit_string") or channel.properties.get("NI_UnitDescription")
        if unit:
            table.units[name] = {"Newtons": "N", "Volts": "V"}.get(str(unit), str(unit))
        if channel.properties.get("wf_increment"):
            clocks.add(
                (float(channel.properties["wf_increment"]), float(channel.properties.get("wf_start_offset", 0.0)))
            )
    if len(clocks) > 1:
        steps = ", ".join(f"{step:g} s from {start:g} s" for step, start in sorted(clocks))
        raise FingerflowError(
            f"{path}: its channels run on different clocks ({steps}); export those that belong together"
        )
    if clocks:
        increment, table.start = clocks.pop()
        table.sample_rate = 1.0 / increment
    return table
