"""Compute the forces at the times of the frames: aligned to the trigger, in newtons and low-pass filtered."""

from pathlib import Path

import numpy as np

from fingerflow.errors import FingerflowError
from fingerflow.kernels.array_types import Series
from fingerflow.pipeline.stages.preparation import plausibility
from fingerflow.pipeline.stages.stage import Stage
from fingerflow.recordings import Forces, open_forces
from fingerflow.recordings.forces.newtons import to_newtons
from fingerflow.schema.variables import LOADING

_LEAST_OFFSET = 0.2  # N, smallest offset of an unloaded sensor that is reported
_OFFSET_SHARE = 0.05  # smallest such offset as a share of the largest force
_LEAST_TANGENTIAL = 0.05  # N, tangential force below which its direction is undefined
# Names of the channels: normal force, and tangential force with one or two components.
_NAMES = ("normal_force", "tangential_force", "tangential_force_across")


class LoadingStage(Stage):
    """Stage that reads the forces of a scene, aligns them to the trigger and resamples them at the times of the frames.

    They are NaN outside the force recording.
    """

    name = "loading"
    gives = LOADING
    settings = ("kind", "forces", "recording.times", "recording.trigger_frame")

    def begin(self) -> None:
        settings, inputs = self.inputs.scene.forces, self.inputs
        if settings is None:
            return
        sideways = settings.tangential if isinstance(settings.tangential, tuple) else (settings.tangential,)
        columns = [settings.normal, *(column for column in sideways if column is not None)]
        names = dict(zip(_NAMES, columns, strict=False))  # column of each force in the file
        travel = {} if settings.position is None else {"actuator_position": settings.position}
        units = None if settings.units is None else dict.fromkeys(names.values(), settings.units)
        clock = settings.time, settings.sample_rate, settings.trigger
        forces = open_forces(settings.file, names | travel, units, *clock, lengths=travel.values())
        if forces.trigger in names:
            raise FingerflowError(
                f"{inputs.scene.path}: forces.trigger is {settings.trigger!r}, the channel of a force; name the "
                "channel of the camera's trigger, or leave trigger out where both clocks begin together"
            )
        if settings.trigger_level is not None:
            forces = forces.align(settings.trigger_level)
            if inputs.scene.recording.trigger_frame is None and not inputs.recording.has_trigger:
                self.warnings.append(
                    f"forces are aligned to the trigger {settings.trigger!r}, and nothing says in which frame it came: "
                    "frame 0 is taken; give [recording] trigger_frame"
                )
        forces = to_newtons(forces, settings, names)
        values = forces.resample(inputs.times)
        self.warnings += forces.warnings
        self._check(settings.file, forces, names["normal_force"], values["normal_force"])
        for name, column in names.items():
            self.warnings += plausibility.check_saturation(forces.channels[name], name)
            self.warnings += plausibility.check_spikes(forces.channels[name], name)
            if unknown := np.count_nonzero(~np.isfinite(forces.channels[name])):
                self.warnings.append(
                    f"{settings.file}: {unknown} of {forces.times.size} samples of {column!r} are NaN or infinite; "
                    f"{name} is NaN in {int(np.isnan(values[name]).sum())} of {inputs.times.size} frames"
                )
        self.warnings += plausibility.check_force(values["normal_force"])
        if travel:
            self.series["actuator_position"] = 1e3 * values["actuator_position"]
        normal, *components = (values[name] for name in names)
        self.series["normal_force"] = normal
        if components:
            x, y = components if len(components) == 2 else (components[0], np.zeros_like(components[0]))
            # Take the magnitude of filtered components: with unfiltered ones noise biases it where the force is near 0.
            tangential, pressed = np.hypot(x, y) if len(components) == 2 else x, normal > plausibility.LEAST_NORMAL
            direction = np.where(np.hypot(x, y) > _LEAST_TANGENTIAL, np.arctan2(y, x), np.nan)
            ratio = np.where(pressed, tangential / np.where(pressed, normal, 1), np.nan)
            self.warnings += plausibility.check_load_ratio(ratio, normal)
            self.series |= {"tangential_force": tangential, "tangential_direction": direction}
            self.series |= {"load_ratio": ratio, "force_angle": np.arctan(ratio)}

    def _check(self, file: Path, forces: Forces, column: str | int, of_frames: Series) -> None:
        """Check that forces are plausible for a pressing finger: positive, in newtons, and 0 without contact, also in
        the frames (`of_frames`).

        Raises FingerflowError for a normal force with the wrong sign; warns of an offset, of recordings that begin when
        the finger already presses, and of a trigger channel in N.
        """
        if forces.trigger is not None and forces.units[forces.trigger] == "N":
            self.warnings.append(
                f"{file}: the trigger {forces.trigger!r} is in N, as a force is; is it the right channel?"
            )
        normal, of_frames = (force[np.isfinite(force)] for force in (forces.channels["normal_force"], of_frames))
        if not normal.size:
            return
        # Use quantiles, since the outer hundredth at either end may be noise or a shock.
        lowest, highest = np.quantile(normal, (0.01, 0.99))
        limit = max(_LEAST_OFFSET, _OFFSET_SHARE * max(highest, -lowest))
        if -lowest > max(_LEAST_OFFSET, 3 * highest):
            # Without a load a force is near 0, whatever its sign.
            remedy = "sign = -1" if abs(highest) < limit else "offset or tare, and sign = -1 if pressing lowers it,"
            raise FingerflowError(
                f"{file}: the normal force {column!r} lies between {lowest:.3g} and {highest:.3g} N: pressing must be "
                f"positive; give [forces] {remedy} in the scene"
            )
        if -lowest > limit:
            self.warnings.append(f"{file}: {column!r} falls to {lowest:.3g} N: give [forces] offset or tare")
        if self.inputs.scene.kind == "slip":
            return
        if lowest > limit:
            self.warnings.append(
                f"{file}: the normal force {column!r} is never below {lowest:.3g} N; if the finger was off the glass "
                "at some time, that is the sensor's offset: give [forces] offset or tare = [t0, t1] in the scene"
            )
        elif of_frames.size and lowest < limit < of_frames.min():
            self.warnings.append(
                f"{file}: the normal force falls to {lowest:.2g} N, but not below {of_frames.min():.2g} N in the "
                "frames that count: they begin in contact. Lower recording.first_frame, or check the trigger"
            )
