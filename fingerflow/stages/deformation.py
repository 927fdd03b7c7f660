"""Displacement since contact, its gradient, strain and strain energy, from the tracks."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.signal import savgol_filter
from scipy.spatial import Delaunay, QhullError, cKDTree
from torch import Tensor

from fingerflow.graphs import FieldsGraph, GrossEllipse
from fingerflow.graphs.frame import LASTING
from fingerflow.ops.local_fit import local_gradients
from fingerflow.ops.triangle_strain import SharedErrors, triangle_strain
from fingerflow.stages.contact import ContactSeries
from fingerflow.stages.inputs import Inputs
from fingerflow.stages.tracking import TrackSeries

DISPLACEMENT_GIVES = frozenset(
    {
        "onset_frame",
        "reference_position",
        "displacement",
        "displacement_std",
        "global_displacement",
        "global_displacement_vector",
    }
)
FIELDS_GIVE = frozenset(
    {
        "divergence",
        "curl",
        "divergence_std",
        "curl_std",
        "median_divergence",
        "median_divergence_std",
        "median_curl",
        "median_curl_std",
        "median_strain",
        "median_strain_std",
        "median_divergence_rate",
        "median_strain_rate",
    }
)
STRAIN_GIVES = frozenset(
    {
        "triangles",
        "strain",
        "strain_std",
        "strain_energy_density",
        "strain_energy",
        "strain_energy_std",
        "strain_energy_rate",
    }
)
_FRAMES = 64  # a batch
# Standard deviation of the place of the contact's border: it runs between ridges, which lie 0.4 to 0.5 mm apart.
# Measured on the shipped press, where the border is known.
_BORDER_MM = 0.06
_LONGEST_ONSET = 8  # frames to either side over which the speed at onset is taken


@dataclass
class Displacement:
    """Displacement since the onset of contact, mm; NaN before it and for points that never touch.

    Attributes:
        onset: (N,) first frame in which the contact covers the point and stays, -1 for never, or if the point was lost
            then.
        reference: (N, 2) position at onset, mm; of points that are touched in passing alone, where they were then.
        reference_px: (N, 2) the same, px of the topographic view.
        displacement: (F, N, 2) mm; in a touch that does not stay, before the onset, since that touch.
        variance: (F, N) mm^2, of a component, by the noise of the pictures.
        of_onset: (N, 2, 2) mm^2, covariance by the error of the time of onset, the same in all frames.
        late: (N, 2) mm, how far skin moves in half a frame at onset: the first frame with contact comes so much after
            the contact, on average. Of neighbours it is the same, and no part of the errors of a gradient.
        vector: (F, 2) mm, median component by component (the lab's script takes the x median twice).
    """

    onset: NDArray[np.int32]
    reference: NDArray[np.float64]
    reference_px: NDArray[np.float64]
    displacement: NDArray[np.float64]
    variance: NDArray[np.float32]
    of_onset: NDArray[np.float64]
    late: NDArray[np.float64]
    vector: NDArray[np.float64]

    def covariance(self, frames: slice) -> NDArray[np.float32]:
        """(n, N, 2, 2) mm^2, of the displacement in these frames."""
        own = self.variance[frames, :, None, None] * np.eye(2, dtype=np.float32)
        result: NDArray[np.float32] = own + self.of_onset.astype(np.float32)
        return result

    def displacement_std(self) -> NDArray[np.float32]:
        """(F, N) mm, root mean square error of a component."""
        of_onset = (np.trace(self.of_onset, axis1=1, axis2=2) + (self.late**2).sum(1)).astype(np.float32) / 2
        result: NDArray[np.float32] = np.sqrt(self.variance + of_onset)
        return result


@dataclass
class FieldSeries:
    """Fields at the points (F, N), and (F, 5) medians of divergence, curl, exx, eyy, exy over the gross contact."""

    divergence: NDArray[np.float32]
    curl: NDArray[np.float32]
    divergence_std: NDArray[np.float32]
    curl_std: NDArray[np.float32]
    median: NDArray[np.float64]
    median_std: NDArray[np.float64]


@dataclass
class StrainSeries:
    """Strain of triangles (F, M, 3), energy density (F, M) mJ/mm^3 and total (F,) mJ; triangles (M, 3).

    ``strain_std`` and ``energy_std`` are standard deviations. The total is that of the skin: what the errors of the
    points add to it on average is taken off.
    """

    triangles: NDArray[np.int32]
    strain: NDArray[np.float32]
    strain_std: NDArray[np.float32]
    density: NDArray[np.float32]
    energy: NDArray[np.float64]
    energy_std: NDArray[np.float64]


def glass_positions(inputs: Inputs, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 2) px of the topographic view to mm on the glass."""
    matrix = inputs.topography_to_contact
    result: NDArray[np.float64] = (pixels @ matrix[:, :2].T + matrix[:, 2]) * inputs.mm_per_px
    return result


def displace(inputs: Inputs, tracks: TrackSeries, covered: NDArray[np.bool_]) -> Displacement:
    """Displacement of each point from where it was when the contact came to cover it."""
    position = glass_positions(inputs, tracks.position)
    numbers = np.arange(position.shape[1])
    lasting = _lasting(covered)
    stays, touched = np.any(lasting, axis=0), np.any(covered, axis=0)
    came = np.where(stays, lasting.argmax(0), covered.argmax(0))
    place = np.where(touched[:, None], position[came, numbers], np.nan)
    # A point that was lost when the contact reached it has no known place of onset: a later one would be taken for it.
    onset = np.where(stays & np.isfinite(place).all(-1), came, -1).astype(np.int32)
    displacement = position - place
    before = (np.arange(len(position))[:, None] < came) | ~stays
    displacement[before] = np.nan
    # Whether a touch stays is not known while it lasts: a short one counts by itself, as in a stream.
    frame, point = np.nonzero(covered & before)
    displacement[frame, point] = position[frame, point] - position[_begin_of_touch(covered)[frame, point], point]
    scale = inputs.mm_per_px * np.sqrt(abs(np.linalg.det(inputs.topography_to_contact[:, :2])))
    variance = np.float32(scale**2) * _noise_since(tracks.position_std, onset, inputs.scene.tracking.template)
    variance[np.isnan(displacement).any(-1)] = np.nan
    of_onset, late = _errors_of_onset(inputs, position, scale * tracks.position_std, onset, place)
    pixels = np.where(touched[:, None], tracks.position[came, numbers], np.nan)
    return Displacement(onset, place, pixels, displacement, variance, of_onset, late, nanmedian(displacement))


def _lasting(covered: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(F, N): covered in this frame and in as many of the next as make an onset (`SinceOnsetGraph`), or to the end."""
    result = covered.copy()
    for later in range(1, min(LASTING, len(covered))):
        result[:-later] &= covered[later:]
    return result


def _begin_of_touch(covered: NDArray[np.bool_]) -> NDArray[np.intp]:
    """(F, N): the last frame in which the contact came to cover a point; 0 before."""
    came = covered.copy()
    came[1:] &= ~covered[:-1]
    result: NDArray[np.intp] = np.maximum.accumulate(np.where(came, np.arange(len(covered))[:, None], 0), axis=0)
    return result


def _noise_since(position_std: NDArray[np.float32], onset: NDArray[np.int32], template: str) -> NDArray[np.float32]:
    """Variance (F, N) px^2 of a component of the displacement since onset, from the deviation (F, N) of positions.

    Against a key frame half of a position's variance is the template's noise, the same in every frame: it falls out of
    the difference of two positions, unless one of them is the key frame's, which is exact. From frame to frame
    variances add up.
    """
    variance = position_std**2
    then = variance[onset, np.arange(len(onset))]
    if template == "previous":
        result = abs(variance - then)
    else:
        result = np.where(then > 0, (variance + then) / 2, variance)
        result[np.arange(len(variance))[:, None] == onset] = 0
    return result.astype(np.float32)


def _errors_of_onset(
    inputs: Inputs,
    position: NDArray[np.float64],
    position_std: NDArray[np.float64],
    onset: NDArray[np.int32],
    reference: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Covariance (N, 2, 2) mm^2 of the place of onset, the skin's speed then times the error of the time; and its mean.

    The time is known to a frame, uniformly within it: 1/12 frame^2; and the place of the border to `_BORDER_MM`, which
    takes it as many frames as neighbouring points are apart in time. Both change from one neighbour to the next, as the
    border crosses several between two frames or one ridge after the other, so errors are taken as independent. A point
    that touches in the first frame has no onset: its displacement counts from that frame.
    """
    frames, numbers = len(position), np.arange(len(onset))
    after_first = onset > 0
    known = torch.from_numpy(np.where(after_first[:, None], reference, np.nan))[None]
    slope = local_gradients(
        known,
        torch.from_numpy(onset.astype(np.float64))[None, :, None],
        gauge_length=inputs.scene.fields.gauge_length_mm,
    ).gradient[0, :, 0]
    frames_per_mm = slope.norm(dim=-1).nan_to_num(0.0).numpy()
    variance = 1 / 12 + (_BORDER_MM * frames_per_mm) ** 2
    reach = np.clip(np.sqrt(variance).round(), 2, _LONGEST_ONSET).astype(int)
    before, after = np.maximum(onset - reach, 0), np.minimum(onset + reach, frames - 1)
    before, after = (np.where(np.isfinite(position[k, numbers]).all(-1), k, onset) for k in (before, after))
    step = position[after, numbers] - position[before, numbers]
    speed = np.where((after_first & (after > before))[:, None], step / np.maximum(after - before, 1)[:, None], 0.0)
    # A square of a speed that is measured is too large by the speed's variance: half of two positions'.
    noise = (
        (position_std[after, numbers] ** 2 + position_std[before, numbers] ** 2)
        / 2
        / np.maximum(after - before, 1) ** 2
    )
    square = (speed**2).sum(1)
    share = np.where(square > 0, np.clip(1 - 2 * noise / np.maximum(square, 1e-30), 0, 1), 0.0)
    speed = speed * np.sqrt(share)[:, None]
    return variance[:, None, None] * speed[:, :, None] * speed[:, None, :], speed / 2


def fields(inputs: Inputs, moved: Displacement, contact: ContactSeries) -> FieldSeries:
    """Divergence, curl and strain by local fits in reference coordinates, and their medians over the gross contact."""
    settings = inputs.scene.fields
    graph = inputs.engine(FieldsGraph(settings.gauge_length_mm, settings.strain))
    count, points = moved.displacement.shape[:2]
    series = FieldSeries(
        divergence=np.full((count, points), np.nan, dtype=np.float32),
        curl=np.full((count, points), np.nan, dtype=np.float32),
        divergence_std=np.full((count, points), np.nan, dtype=np.float32),
        curl_std=np.full((count, points), np.nan, dtype=np.float32),
        median=np.full((count, 5), np.nan),
        median_std=np.full((count, 5), np.nan),
    )
    reference = _tensor(inputs, moved.reference)[None]
    for first in range(0, count, _FRAMES):
        part = slice(first, min(first + _FRAMES, count))
        ellipse = GrossEllipse(
            *(_tensor(inputs, values[part]) for values in (contact.center, contact.semi_axes, contact.angle))
        )
        found = graph(
            reference, _tensor(inputs, moved.displacement[part]), _tensor(inputs, moved.covariance(part)), ellipse
        )
        for name, values in found._asdict().items():
            if name in vars(series):
                vars(series)[name][part] = values.cpu()
    return series


def strains(inputs: Inputs, moved: Displacement, contact: ContactSeries) -> StrainSeries:
    """Strain on the Delaunay triangles of the reference positions, and its energy."""
    settings = inputs.scene.fields
    triangles = _triangulate(moved.reference)
    count = len(moved.displacement)
    shape = (count, len(triangles))
    series = StrainSeries(
        triangles,
        np.full((*shape, 3), np.nan, dtype=np.float32),
        np.full((*shape, 3), np.nan, dtype=np.float32),
        np.full(shape, np.nan, dtype=np.float32),
        np.full(count, np.nan),
        np.full(count, np.nan),
    )
    reference = _tensor(inputs, moved.reference)[None]
    onset = torch.from_numpy(np.where(moved.onset < 0, count, moved.onset)).to(inputs.device)
    corners = torch.from_numpy(triangles.astype(np.int64)).to(inputs.device)
    begins = onset[corners].amax(1) if len(corners) else onset[:0]  # the frame in which a triangle touches as a whole
    shared = SharedErrors(
        *(torch.from_numpy(one).to(inputs.device) for one in _shared_errors(inputs, moved, triangles))
    )
    for first in range(0, count, _FRAMES):
        part = slice(first, min(first + _FRAMES, count))
        found = triangle_strain(
            reference,
            corners,
            _tensor(inputs, moved.displacement[part]),
            _tensor(inputs, moved.covariance(part)),
            torch.arange(part.start, part.stop, device=inputs.device)[:, None] >= begins,
            shared,
            measure=settings.strain,
            young_modulus_mpa=settings.young_modulus_mpa,
            poisson_ratio=settings.poisson_ratio,
        )
        for name, values in found._asdict().items():
            vars(series)[name][part] = values.cpu()
    series.energy *= settings.depth_mm
    series.energy_std *= settings.depth_mm
    # Where nothing touches there is no energy; where something does and no triangle of it is known, nobody knows.
    nothing = contact.gross_area == 0
    series.energy[nothing] = series.energy_std[nothing] = 0.0
    return series


def rate(values: NDArray[np.float64], times: NDArray[np.float64], window_s: float) -> NDArray[np.float64]:
    """Time derivative (F, ...) per second: the slope of a parabola fitted over ``window_s`` (Savitzky & Golay 1964).

    Each run of finite values is differentiated by itself; a run shorter than the window gives NaN.
    """
    step = float(np.median(np.diff(times))) if len(times) > 1 else np.nan
    length = max(3, 2 * round(window_s / step / 2) + 1) if np.isfinite(step) else 3
    flat = values.reshape(len(values), -1)
    result = np.full(flat.shape, np.nan)
    for column in range(flat.shape[1]):
        finite = np.isfinite(flat[:, column])
        edges = np.flatnonzero(np.diff(np.concatenate(([0], finite.astype(np.int8), [0]))))
        for start, end in edges.reshape(-1, 2):
            if end - start >= length:
                result[start:end, column] = savgol_filter(flat[start:end, column], length, 2, deriv=1, delta=step)
    return result.reshape(values.shape)


def _shared_errors(
    inputs: Inputs, moved: Displacement, triangles: NDArray[np.int32]
) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.float32]]:
    """`SharedErrors` of the triangles (M, 3).

    Errors of tracking come from the noise of the pixels of a window, and correlate by the share that two windows have
    in common: on a press where it is a fifth, two fifths and two thirds by 0.2, 0.4 and 0.6 to 0.75. Half of a
    displacement's noise is that of onset, which is another one where points touch in other frames. Errors of the time
    of onset are independent: of neighbours on a press they correlate by less than 0.1.
    """
    window, onset = inputs.scene.tracking.window_px, moved.onset
    noise = np.nansum(moved.variance, axis=0) / np.maximum(np.isfinite(moved.variance).sum(0), 1)
    of_onset = np.trace(moved.of_onset, axis1=1, axis2=2) / 2
    share = np.sqrt(noise / np.maximum(noise + of_onset, 1e-30))

    def correlation(one: NDArray[np.integer], other: NDArray[np.integer]) -> NDArray[np.float32]:
        apart = np.abs(moved.reference_px[one] - moved.reference_px[other]) / window
        common = np.clip(1 - apart, 0, 1).prod(-1) * np.where(onset[one] == onset[other], 1, 0.5)
        return np.nan_to_num(common * share[one] * share[other]).astype(np.float32)

    known = np.flatnonzero(np.isfinite(moved.reference_px).all(-1))
    near = cKDTree(moved.reference_px[known]).query_pairs(window, p=np.inf, output_type="ndarray")
    pairs = known[near].astype(np.int64)
    corners = np.stack([correlation(triangles[:, k], triangles[:, (k + 1) % 3]) for k in range(3)], axis=1)
    return corners, pairs, correlation(*pairs.T)


def _triangulate(reference: NDArray[np.float64]) -> NDArray[np.int32]:
    """Delaunay triangles (M, 3) of the finite points; none where fewer than three of them span an area."""
    finite = np.flatnonzero(np.isfinite(reference).all(-1))
    if len(finite) < 3:
        return np.zeros((0, 3), dtype=np.int32)
    try:
        return finite[Delaunay(reference[finite]).simplices].astype(np.int32)
    except QhullError:  # all on one line
        return np.zeros((0, 3), dtype=np.int32)


def _tensor(inputs: Inputs, values: NDArray[np.floating]) -> Tensor:
    return torch.from_numpy(np.asarray(values, dtype=np.float32)).to(inputs.device)


def nanmedian(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """Medians (F, ...) over the second axis of values (F, N, ...), of what is not NaN; NaN where nothing is."""
    if values.shape[1] == 0:
        return np.full((len(values), *values.shape[2:]), np.nan)
    ordered = np.sort(values, axis=1)  # NaN last
    known = (~np.isnan(ordered)).sum(1, keepdims=True)
    middle = [np.take_along_axis(ordered, np.maximum(rank, 0), axis=1) for rank in ((known - 1) // 2, known // 2)]
    result: NDArray[np.float64] = np.where(known > 0, (middle[0] + middle[1]) / 2, np.nan).squeeze(1).astype(np.float64)
    return result
