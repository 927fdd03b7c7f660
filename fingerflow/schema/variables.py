"""Result variables of a trial: name, dimensions, unit and definition of each, stated once.

The data set, its files and tables, the records of a stream and the report use these entries. Only the standard library
is imported, because an exported bundle contains this file.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from operator import truediv
from typing import Any

#: Coordinate labels of dimensions.
LABELS = {
    "xy": ("x", "y"),
    "axis": ("major", "minor"),
    "strain_component": ("exx", "eyy", "exy"),
    "shear_component": ("along_axes", "along_diagonals"),
    "principal": ("major", "minor"),
}


@dataclass(frozen=True)
class Variable:
    """Result variable.

    Attributes:
        name: in the data set, in tables and in records.
        dims: names of its dimensions.
        units: in UDUNITS notation; "1" if dimensionless.
        long_name: its definition.
        kind: data type in NumPy notation.
        needs: keys of the scene without which it is not computed.
        flags: meanings of the values 0, 1, 2 ...
        unasked: whether it is computed by default, without being requested by name.
        formula, of: function of other results of the same stage, and their names, where that suffices to compute it.
    """

    name: str
    dims: tuple[str, ...]
    units: str
    long_name: str
    kind: str = "f8"
    needs: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()
    unasked: bool = True
    formula: Callable[..., Any] | None = None
    of: tuple[str, ...] = ()

    def attributes(self) -> dict[str, object]:
        """Return its attributes by the CF conventions."""
        flags: dict[str, object] = {}
        if self.flags:
            flags = {"flag_values": list(range(len(self.flags))), "flag_meanings": " ".join(self.flags)}
        return {"units": self.units, "long_name": self.long_name, **flags}


FRAME, POINT, FRAME_POINT, TRIANGLE = ("frame",), ("point",), ("frame", "point"), ("frame", "triangle")
CELLS = ("frame", "cell_row", "cell_column")

TIME = Variable("time", FRAME, "s", "time from the trigger, or from the first frame")

#: Status of a frame; only usable frames have results.
FRAME_STATUS = ("usable", "unreadable", "not_finite", "dark", "saturated", "repeated", "jumps_and_returns")
DARK_SHARE = 0.1  # of the light of the empty glass; a frame below is dark, while a contact leaves half of it
SATURATED_SHARE = 0.5  # of the blocks at the highest grey level; a frame above is saturated
FRAME_CHECK = (
    Variable(
        "frame_status",
        FRAME,
        "1",
        "whether a frame is a picture of the trial; where it is not, results are NaN",
        "u1",
        flags=FRAME_STATUS,
    ),
)

LOADING = (
    Variable("normal_force", FRAME, "N", "normal force", needs=("forces",)),
    Variable(
        "tangential_force",
        FRAME,
        "N",
        "tangential force; its length where two components are given",
        needs=("forces.tangential",),
    ),
    Variable(
        "tangential_direction",
        FRAME,
        "rad",
        "direction of the tangential force from the first component towards the second, of one channel 0 or pi by its "
        "sign; NaN below 0.05 N",
        needs=("forces.tangential",),
    ),
    Variable(
        "load_ratio",
        FRAME,
        "1",
        "friction ratio: tangential over normal force, T/N; NaN where the normal force is below 0.05 N",
        needs=("forces.tangential",),
    ),
    Variable(
        "force_angle",
        FRAME,
        "rad",
        "angle between the force and the normal of the glass, atan(T/N); NaN where the normal force is below 0.05 N",
        needs=("forces.tangential",),
    ),
)

CONTACT = (
    Variable("contact_threshold", FRAME, "1", "relative intensity loss 1 - I/I0 that counts as contact"),
    Variable("real_contact_area", FRAME, "mm2", "area of the micro-junctions"),
    Variable("gross_contact_area", FRAME, "mm2", "area of the region that the contact spans (apparent contact area)"),
    Variable(
        "contact_area_ratio",
        FRAME,
        "1",
        "real over gross contact area",
        formula=truediv,
        of=("real_contact_area", "gross_contact_area"),
    ),
    Variable("ellipse_center", ("frame", "xy"), "mm", "centre of the gross contact on the glass"),
    Variable("ellipse_semi_axes", ("frame", "axis"), "mm", "semi-axes of the gross contact"),
    Variable("ellipse_angle", FRAME, "rad", "major axis of the gross contact, from x towards y"),
    Variable(
        "gross_contact_region", CELLS, "1", "1 where the gross contact covers a cell of the contact view", "u1",
        unasked=False,
    ),
)  # fmt: skip

#: Names of `fingerflow.kernels.tracking_limits.TrackStatus`, which defines each.
TRACK_STATUS = (
    "tracked",
    "not_finite",
    "left_frame",
    "no_texture",
    "not_converged",
    "mismatch",
    "forward_backward",
    "uncertain",
    "off_neighbours",
    "frame_not_usable",
    "window_differs",
    "not_chosen_yet",
)
TRACKING = (
    Variable("position", ("frame", "point", "xy"), "mm", "position on the glass"),
    Variable("position_px", ("frame", "point", "xy"), "px", "position in the topographic view"),
    Variable("position_std_px", FRAME_POINT, "px", "standard deviation of a component of the position", "f4"),
    Variable("forward_backward_error", FRAME_POINT, "px", "distance after tracking forward and back", "f4"),
    Variable("status", FRAME_POINT, "1", "why a point has a position, or none", "u1", flags=TRACK_STATUS),
    Variable("in_contact", FRAME_POINT, "1", "1 where the gross contact covers the point, or its last place", "u1"),
    Variable("tracked_share", FRAME, "1", "share of the points that are tracked"),
    Variable(
        "window_differs_share",
        FRAME,
        "1",
        "share of the points that were followed to where their window differs from that in which they were chosen",
    ),
    Variable("forward_backward_median", FRAME, "px", "median forward-backward distance"),
)

ENTRY = ("never", "covered", "moved_in", "chosen_inside")
#: Reference instant of displacement. The attribute ``reference`` of a variable states it for this result.
SINCE = "of skin in contact since fields.reference, by default since each point's own onset"
DISPLACEMENT = (
    Variable(
        "onset_frame", POINT, "1", "first frame in which the contact comes to cover the point, -1 for never", "i4"
    ),
    Variable(
        "entry",
        POINT,
        "1",
        "how skin came into contact: the contact came to cover it, or it moved in over a border at rest; fields of the "
        "latter count since its own entry, with all its neighbours, F(t) F(entry)^-1 - I, and its triangles since the "
        "last of their points has touched; of skin that had no point until it was inside nobody knows when it came: "
        "it has no displacement",
        "u1",
        flags=ENTRY,
    ),
    Variable(
        "reference_position",
        ("point", "xy"),
        "mm",
        "position from which displacement counts (fields.reference), by default that at onset, where the border of the "
        "contact passed the point between two frames; of points that are "
        "touched in passing alone, where they were then",
    ),
    Variable("displacement", ("frame", "point", "xy"), "mm", f"displacement {SINCE}"),
    Variable("displacement_std", FRAME_POINT, "mm", f"standard deviation of a component {SINCE}", "f4"),
    Variable("global_displacement_vector", ("frame", "xy"), "mm", f"median displacement {SINCE}, by component"),
    Variable("global_displacement", FRAME, "mm", "length of the median displacement"),
)

_MEDIAN = "over the area of the gross contact"
_ERROR = "standard deviation of the"
_ALONE = (
    "by the errors of the points, the difference to medians by twice the gauge length, a border 0.06 mm off, the share "
    "that is not known, and points that moved in"
)
FIELDS = (
    Variable("divergence", FRAME_POINT, "1", f"divergence of the displacement {SINCE}", "f4"),
    Variable("curl", FRAME_POINT, "rad", f"curl of the displacement {SINCE}", "f4"),
    Variable(
        "shear",
        ("frame", "point", "shear_component"),
        "1",
        "shear of the displacement: du/dx - dv/dy along the axes, du/dy + dv/dx along the diagonals; with the global "
        "displacement, divergence and curl the decomposition of Willemet et al. 2021, figure S6",
        "f4",
        unasked=False,
    ),
    Variable(
        "rigid_residual",
        ("frame", "point", "xy"),
        "mm",
        "displacement that the best rigid motion of all points leaves: the usual sign of incipient slip",
        "f4",
        unasked=False,
    ),
    Variable("rigid_residual_median", FRAME, "mm", "median length of rigid_residual"),
    Variable("divergence_std", FRAME_POINT, "1", f"{_ERROR} divergence", "f4"),
    Variable("curl_std", FRAME_POINT, "rad", f"{_ERROR} curl", "f4"),
    Variable(
        "field_coverage",
        FRAME,
        "1",
        "share of the gross contact in which divergence, curl and strain are known; medians below 0.85 are NaN",
    ),
    Variable("median_divergence", FRAME, "1", f"median divergence {_MEDIAN}"),
    Variable("median_divergence_std", FRAME, "1", f"{_ERROR} median divergence {_ALONE}"),
    Variable("median_divergence_rate", FRAME, "1/s", "rate of median_divergence"),
    Variable("median_curl", FRAME, "rad", f"median curl {_MEDIAN}"),
    Variable("median_curl_std", FRAME, "rad", f"{_ERROR} median curl {_ALONE}"),
    Variable("median_strain", ("frame", "strain_component"), "1", f"median strain {_MEDIAN}"),
    Variable("median_strain_std", ("frame", "strain_component"), "1", f"{_ERROR} median strain {_ALONE}"),
    Variable("median_strain_rate", ("frame", "strain_component"), "1/s", "rate of median_strain"),
)

STRAIN = (
    Variable("triangles", ("triangle", "corner"), "1", "points at the corners of a triangle", "i4"),
    Variable("strain", (*TRIANGLE, "strain_component"), "1", f"strain of a triangle {SINCE}", "f4"),
    Variable("strain_std", (*TRIANGLE, "strain_component"), "1", "standard deviation of the strain", "f4"),
    Variable(
        "principal_strains", (*TRIANGLE, "principal"), "1", "major and minor principal strain", "f4", unasked=False
    ),
    Variable(
        "principal_angle",
        TRIANGLE,
        "rad",
        "direction of the major principal strain, from x towards y",
        "f4",
        unasked=False,
    ),
    Variable("strain_energy_density", TRIANGLE, "mJ/mm3", "strain energy density, plane strain", "f4"),
    Variable("strain_energy", FRAME, "mJ", "strain energy of the skin in contact between points, less that of noise"),
    Variable("strain_energy_std", FRAME, "mJ", "standard deviation of strain_energy, with that of the border's place"),
    Variable("strain_energy_rate", FRAME, "mJ/s", "rate of strain_energy"),
)

SLIP = (
    Variable("stuck_area", FRAME, "mm2", "area of the contact whose skin has not slipped"),
    Variable("stuck_ratio", FRAME, "1", "stuck area over gross contact area, d²"),
    Variable("stuck_region", CELLS, "1", "1 where the skin has not slipped", "u1"),
    Variable("slip_coverage", FRAME, "1", "share of the gross contact that the windows of tracked points show"),
    Variable("slip_annulus_area", FRAME, "mm2", "area of the contact whose skin has slipped"),
    Variable(
        "slip_direction",
        FRAME,
        "rad",
        "direction of the mean displacement of the skin in contact that has slipped, from x towards y",
    ),
    Variable("slip_speed", FRAME, "mm/s", "mean speed, over 50 ms, of the skin in contact that has slipped"),
    Variable(
        "incipient_slip",
        FRAME,
        "mm",
        "root mean square over the contact of the displacement since the first frame without its best rigid motion",
    ),
    Variable(
        "incipient_slip_irrotational",
        FRAME,
        "mm",
        "root mean square of the part of incipient_slip that its divergence makes: natural Helmholtz-Hodge "
        "decomposition, no boundary condition (Bhatia et al. 2014)",
    ),
    Variable(
        "incipient_slip_solenoidal",
        FRAME,
        "mm",
        "root mean square of the part of incipient_slip that its curl makes",
    ),
    Variable(
        "skin_displacement",
        (*CELLS, "xy"),
        "mm",
        "displacement since the first frame, by dense flow, of the skin that lay in the cell in the first frame",
        "f4",
        needs=("dense_flow_slip",),
    ),
    Variable(
        "dense_flow_difference",
        FRAME,
        "mm",
        "median over tracked points of the distance between their displacement and that by dense flow",
        needs=("dense_flow_slip",),
    ),
    Variable(
        "dense_flow_difference_95",
        FRAME,
        "mm",
        "95th percentile over tracked points of the distance between their displacement and that by dense flow",
        needs=("dense_flow_slip",),
    ),
)

#: Variables of a soft sensor, where markers on a gel are tracked.
SENSOR_SLIP = (
    Variable("slip_ratio", FRAME, "1", "share of the markers in contact that depart from its best rigid motion"),
    Variable("contact_displacement", ("frame", "xy"), "mm", "mean displacement of the markers in contact since rest"),
    Variable(
        "gross_slip",
        FRAME,
        "1",
        "1 where the markers in contact spring back: the object slides, or lets go of a sheared gel",
        "u1",
        flags=("no", "gross_slip"),
    ),
)

#: Variables of streams alone: the state of the stream, and fields that its graphs compute differently.
STREAM = (
    Variable("latency", FRAME, "s", "from the arrival of the frame to its result", "f4"),
    Variable("key_frame", FRAME, "1", "number of the frame with which this one was compared", "i8"),
    Variable(
        "restart", FRAME, "1", "how often points had been chosen: points of two restarts are different points", "i4"
    ),
    Variable("slip_residual", FRAME, "mm", "rms of what the best rigid motion since touch leaves, in contact", "f4"),
    Variable(
        "slip_flag", FRAME, "1", "1 where slip_residual is above twice its noise for three frames: partial slip", "u1"
    ),
    Variable("light_gain", FRAME, "1", "brightness of the contact view over that of the empty glass", "f4"),
    Variable("point_strain", (*FRAME_POINT, "strain_component"), "1", "Green-Lagrange strain around a point", "f4"),
    Variable(
        "moved_in",
        FRAME_POINT,
        "1",
        "1 for a point that came into contact by moving into it: divergence, curl and strain there count from its own "
        "entry, its neighbours from that moment",
        "u1",
    ),
)


def by_name(*groups: Iterable[Variable]) -> dict[str, Variable]:
    """Return variables by their names."""
    return {variable.name: variable for group in groups for variable in group}
