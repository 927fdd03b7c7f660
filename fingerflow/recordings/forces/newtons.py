"""Conversion of force sensor readings to newtons by unit, zero, sensitivity and sign."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fingerflow.errors import FingerflowError
from fingerflow.recordings.forces.forces import Forces
from fingerflow.schema.scene_tables import ForceSettings

_CORRECTION = 2.0  # largest plausible gain for a force that is in N already, which is then a correction
_CHANGES = 0.1  # N, change of a force within the tare above which a warning is given


def to_newtons(forces: Forces, settings: ForceSettings, columns: Mapping[str, str | int]) -> Forces:
    """Return `forces` with the channels named in `columns` converted from sensor readings to newtons.

    The force is sign x gain x (reading - zero), where zero is the reading without a load: the offset, in the unit of
    the file, or the mean reading within the tare.

    Args:
        forces: from `open_forces`, aligned: times are from the trigger.
        settings: calibration of the sensors: one value for all, or one for each channel.
        columns: names of the channels in the file, for messages.

    Raises FingerflowError for a channel in V without a gain, and a tare without a sample.
    """
    values, units = dict(forces.channels), dict(forces.units)
    warnings = list(forces.warnings)
    stated = settings.gain, settings.sign, settings.offset
    for number, name in enumerate(columns):
        gain, sign, offset = (value[number] if isinstance(value, tuple) else value for value in stated)
        if units[name] != "N" and gain is None:
            raise FingerflowError(
                f"{forces.path}: column {columns[name]!r} of the {name.replace('_', ' ')} is in {units[name]}, not in "
                f"N; give the sensor's sensitivity in the scene, [forces] gain = 2.5 in N/{units[name]}, and [forces] "
                f'units = "N" if the heading is wrong'
            )
        if units[name] == "N" and gain and not 1 / _CORRECTION <= abs(gain) <= _CORRECTION:
            warnings.append(
                f"{forces.path}: column {columns[name]!r} of the {name.replace('_', ' ')} is in N already, and "
                f'[forces] gain = {gain:g} multiplies it: leave gain out, or give units = "V"'
            )
        factor = (sign or 1.0) * (1.0 if gain is None else gain)
        readings = forces.channels[name]
        zero = 0.0 if offset is None else offset * forces.scales.get(name, 1.0)
        if settings.tare is not None:
            first, last = settings.tare
            resting = readings[(forces.times >= first) & (forces.times <= last)]
            resting = resting[np.isfinite(resting)]
            if not resting.size:
                raise FingerflowError(
                    f"{forces.path}: forces.tare is [{first:g}, {last:g}] s from the trigger, and no sample of "
                    f"{columns[name]!r} lies there: the file lasts from {forces.times[0]:g} to {forces.times[-1]:g} s"
                )
            zero = float(resting.mean())
            early, late = (float(part.mean()) for part in np.array_split(resting, 2)) if resting.size > 1 else (0, 0)
            if abs(factor * (late - early)) > _CHANGES:
                warnings.append(
                    f"{forces.path}: the {name.replace('_', ' ')} changes by {abs(factor * (late - early)):.2g} N "
                    f"within forces.tare = [{first:g}, {last:g}] s: is the finger off the glass all the time?"
                )
        values[name], units[name] = factor * (readings - zero), "N"
    return replace(forces, channels=values, units=units, warnings=warnings)
