"""Forces at the times of the frames."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.player.contract.variables import LOADING
from fingerflow.recordings import Forces, open_forces
from fingerflow.stages.stage import Stage, Trial

_LEAST_OFFSET = 0.2  # N, of a sensor at rest that is worth a word
_OFFSET_SHARE = 0.05  # of the largest force
_LEAST_NORMAL = 0.05  # N, ten times the noise of a sensor: a quotient by less says nothing
Series = NDArray[np.float64]


class LoadingStage(Stage):
    """The forces of the scene, aligned to the trigger and low-passed to the frame rate.

    Attributes:
        normal: (frames,) N, NaN where the force recording does not reach; None where the scene has no forces.
        tangential: as `normal`.
    """

    name = "loading"
    gives = LOADING
    restored = True

    def __init__(self, trial: Trial) -> None:
        super().__init__(trial)
        self.normal: Series | None = None
        self.tangential: Series | None = None

    def begin(self) -> None:
        settings, inputs = self.inputs.scene.forces, self.inputs
        if settings is None:
            return
        names = {"normal_force": settings.normal}
        if settings.tangential is not None:
            names["tangential_force"] = settings.tangential
        if settings.trigger is not None and settings.trigger in (settings.normal, settings.tangential):
            raise FingerflowError(
                f"{inputs.scene.path}: forces.trigger is {settings.trigger!r}, the channel of a force; name the "
                "channel of the camera's trigger, or leave trigger out where both clocks begin together"
            )
        forces = open_forces(
            settings.file,
            channels=names,
            time=settings.time,
            sample_rate=settings.sample_rate,
            trigger=settings.trigger,
        )
        if settings.trigger is not None and settings.trigger_level is not None:
            forces = forces.align(settings.trigger_level)
            if inputs.scene.recording.trigger_frame is None and not inputs.recording.has_trigger:
                inputs.warnings.append(
                    f"forces are aligned to the trigger {settings.trigger!r}, and nothing says in which frame it came: "
                    "frame 0 is taken; give [recording] trigger_frame"
                )
        _check(settings.file, forces, names, rests=inputs.scene.kind != "slip")
        # Forces are resampled in the order of time, whatever part of the recording was chosen.
        values = forces.resample(inputs.times)
        inputs.warnings.extend(forces.warnings)
        for name, column in names.items():
            unknown = int(np.isnan(forces.channels[name]).sum())
            if unknown:
                inputs.warnings.append(
                    f"{settings.file}: {unknown} of {forces.times.size} samples of {column!r} are NaN; {name} is NaN "
                    f"in {int(np.isnan(values[name]).sum())} of {inputs.times.size} frames"
                )
        self.normal, self.tangential = values["normal_force"], values.get("tangential_force")

    def finish(self) -> None:
        given = {"normal_force": self.normal, "tangential_force": self.tangential, "load_ratio": self.ratio}
        for name, values in given.items():
            if values is not None:
                self.results.put(name, values)

    def restore(self, earlier: xr.Dataset) -> None:
        super().restore(earlier)
        found = {name: earlier[name].values for name in ("normal_force", "tangential_force") if name in earlier}
        self.normal, self.tangential = found.get("normal_force"), found.get("tangential_force")

    @property
    def ratio(self) -> Series | None:
        """(frames,) T/N; NaN where N is below 0.05 N, None without a tangential force."""
        if self.normal is None or self.tangential is None:
            return None
        pressed = self.normal > _LEAST_NORMAL
        return np.where(pressed, self.tangential / np.where(pressed, self.normal, 1), np.nan)


def _check(file: Path, forces: Forces, names: Mapping[str, str], rests: bool) -> None:
    """Whether channels are forces of a finger that presses: in N, positive, and 0 where it `rests` beside the glass.

    Raises FingerflowError for volts and for a normal force with the wrong sign; warns of an offset.
    """
    for name, column in names.items():
        if forces.units[name] != "N":
            raise FingerflowError(
                f"{file}: column {column!r} of the {name.replace('_', ' ')} is in {forces.units[name]}, not in N; "
                "multiply it by the sensor's sensitivity and write its unit in the heading"
            )
    if forces.trigger is not None and forces.units[forces.trigger] == "N":
        forces.warnings.append(
            f"{file}: the trigger {forces.trigger!r} is in N, as a force is; is it the right channel?"
        )
    normal = forces.channels["normal_force"]
    normal = normal[np.isfinite(normal)]
    if not normal.size:
        return
    # A hundredth at either end may be noise or a blow.
    lowest, highest = np.quantile(normal, (0.01, 0.99))
    if -lowest > max(_LEAST_OFFSET, 3 * highest):
        raise FingerflowError(
            f"{file}: the normal force {names['normal_force']!r} lies between {lowest:.3g} and {highest:.3g} N: "
            "pressing must be positive; change its sign in the file"
        )
    if rests and lowest > max(_LEAST_OFFSET, _OFFSET_SHARE * highest):
        forces.warnings.append(
            f"{file}: the normal force {names['normal_force']!r} is never below {lowest:.3g} N; if the finger was off "
            "the glass at some time, that is the sensor's offset: take it off in the file"
        )
