"""Forces at the times of the frames."""

import numpy as np
from numpy.typing import NDArray

from fingerflow.player.contract.variables import LOADING
from fingerflow.recordings import open_forces
from fingerflow.stages.stage import Stage, Trial

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
        forces = open_forces(
            settings.file,
            channels=names,
            time=settings.time,
            sample_rate=settings.sample_rate,
            trigger=settings.trigger,
        )
        if settings.trigger is not None and settings.trigger_level is not None:
            forces = forces.align(settings.trigger_level)
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

    @property
    def ratio(self) -> Series | None:
        """(frames,) T/N; NaN where N is below 0.05 N, None without a tangential force."""
        if self.normal is None or self.tangential is None:
            return None
        pressed = self.normal > _LEAST_NORMAL
        return np.where(pressed, self.tangential / np.where(pressed, self.normal, 1), np.nan)
