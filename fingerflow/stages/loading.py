"""Forces at the times of the frames."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fingerflow.recordings import open_forces
from fingerflow.stages.inputs import Inputs

GIVES = frozenset({"normal_force", "tangential_force", "load_ratio"})
_LEAST_NORMAL = 0.05  # N, ten times the noise of a sensor: a quotient by less says nothing


@dataclass
class Loading:
    """(frames,) N; NaN where the force recording does not reach."""

    normal: NDArray[np.float64]
    tangential: NDArray[np.float64] | None

    @property
    def ratio(self) -> NDArray[np.float64] | None:
        """(frames,) T/N; NaN where N is below 0.05 N, None without a tangential force."""
        if self.tangential is None:
            return None
        pressed = self.normal > _LEAST_NORMAL
        return np.where(pressed, self.tangential / np.where(pressed, self.normal, 1), np.nan)


def load(inputs: Inputs) -> Loading | None:
    """The forces of the scene, aligned to the trigger and low-passed to the frame rate; None where the scene has
    none."""
    settings = inputs.scene.forces
    if settings is None:
        return None
    names = {"normal_force": settings.normal}
    if settings.tangential is not None:
        names["tangential_force"] = settings.tangential
    forces = open_forces(
        settings.file, channels=names, time=settings.time, sample_rate=settings.sample_rate, trigger=settings.trigger
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
                f"{settings.file}: {unknown} of {forces.times.size} samples of {column!r} are NaN; {name} is NaN in "
                f"{int(np.isnan(values[name]).sum())} of {inputs.times.size} frames"
            )
    return Loading(values["normal_force"], values.get("tangential_force"))
