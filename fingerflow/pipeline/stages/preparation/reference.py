"""Reference frame of displacement: the setting `fields.reference` of a scene, resolved to a frame number."""

import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.schema.key_types import parse_seconds
from fingerflow.schema.scene import Scene
from fingerflow.schema.variables import FRAME_STATUS, USABLE

_ONSET = (
    "each point's own onset, the frame in which the contact comes to cover it. Gradients are by the positions of onset "
    "(Willemet et al. 2021), and differ from the strain of skin that moves while the contact grows over it"
)


def requested_frame(scene: Scene, times: NDArray[np.float64]) -> int | None:
    """Return the frame that the setting `fields.reference` gives as a number or time; None for a word such as "onset".

    Frames count from 0 at the first selected frame; `times` (frames,) s. Raises FingerflowError for a frame outside the
    selection.
    """
    setting, first = scene.fields.reference, scene.recording.first_frame
    seconds = parse_seconds(setting)
    if seconds is not None:
        half_step = float(np.median(np.diff(times))) / 2 if len(times) > 1 else 0.0
        within = times[0] - half_step <= seconds <= times[-1] + half_step
        frame = int(np.argmin(np.abs(times - seconds)))
    elif isinstance(setting, int):
        frame = setting - first
        within = 0 <= frame < len(times)
    else:
        return None
    if not within:
        raise FingerflowError(
            f"{scene.path}: fields.reference is {setting!r}, and the frames that count are {first} to "
            f"{first + len(times) - 1}, from {times[0]:g} to {times[-1]:g} s after the trigger; give one of them"
        )
    return frame


def resolve_reference(
    scene: Scene, times: NDArray[np.float64], status: NDArray[np.integer], warnings: list[str]
) -> tuple[int | None, dict[str, str | int]]:
    """Return the frame from which displacement counts, from 0 at the first selected frame, or None for each point's own
    onset; and the attributes that say so of a result variable, with the number of the frame in the file.

    `times` (s) and `status` are those of all frames. Raises FingerflowError for a frame outside the selection or an
    unusable one.
    """
    setting, first = scene.fields.reference, scene.recording.first_frame
    if setting in ("onset", "dilated_onset"):
        rim = f"; the contact has a rim of {scene.contact.gross_radius_px} px here" if setting != "onset" else ""
        return None, {"reference": _ONSET + rim}
    usable = np.flatnonzero(status == USABLE)
    frame = requested_frame(scene, times)
    if frame is None:
        frame = int(usable[0])
        if frame:
            warnings.append(
                f"fields.reference is {setting!r}: frame {first} is {FRAME_STATUS[status[0]]}, so displacement counts "
                f"from frame {frame + first}, the first that can be measured"
            )
    if frame not in usable:
        near = int(usable[np.argmin(np.abs(usable - frame))]) + first
        raise FingerflowError(
            f"{scene.path}: fields.reference is {setting!r}, which is frame {frame + first}: it is "
            f"{FRAME_STATUS[status[frame]]}, so no point is known there; take frame {near}"
        )
    definition = f"frame {frame + first}, {times[frame]:.4g} s from the trigger, for all points that are known there"
    return frame, {"reference": f"{definition}; values are of skin in contact", "reference_frame": frame + first}
