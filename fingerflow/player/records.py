"""What a record of a frame holds: the variables of `contract`, as far as the graphs of a bundle give them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from .arrays import Array, Tensor
from .contract.variables import (
    CONTACT,
    FIELDS,
    FRAME,
    FRAME_CHECK,
    STREAM,
    TIME,
    TRACK_STATUS,
    TRACKING,
    Variable,
    by_name,
)

_VARIABLES = by_name((TIME,), FRAME_CHECK, CONTACT, TRACKING, FIELDS, STREAM)
_OF_GRAPHS = {  # outputs that are variables of another name, and the power of mm_per_px that their units take
    "real_area_px": ("real_contact_area", 2),
    "gross_area_px": ("gross_contact_area", 2),
    "center": ("ellipse_center", 1),
    "semi_axes": ("ellipse_semi_axes", 1),
    "angle": ("ellipse_angle", 0),
    "points": ("position_px", 0),
    "error": ("forward_backward_error", 0),
    "position_std": ("position_std_px", 0),
    "covered": ("in_contact", 0),
    "strain": ("point_strain", 0),
}
_FRAME_NUMBER = Variable(
    "frame", FRAME, "", "number of the frame as it came in, or in its file, from 0; gaps are dropped frames", "i8"
)
# What the player itself adds to a record.
_OWN = (
    _FRAME_NUMBER,
    *(_VARIABLES[name] for name in ("time", "latency", "frame_status", "key_frame", "restart", "contact_threshold")),
)
# And where the graphs give points, their noise, and which of them the contact covers.
_OF_SLIP = tuple(_VARIABLES[name] for name in ("slip_residual", "slip_flag"))
_FOR_SLIP = ("points", "position_std", "covered")
_NOT_USABLE = TRACK_STATUS.index("frame_not_usable")
_MATLAB = {"f4": "single", "f8": "double", "u1": "uint8", "u2": "uint16", "i4": "int32", "i8": "int64"}
_STORED = {np.dtype(np.bool_): "|u1", np.dtype(np.float16): "<f4"}


class _Field(NamedTuple):
    """Of a record, with its type as NumPy writes it and its shape without the frame."""

    variable: Variable
    type: str
    shape: tuple[int, ...]

    def said(self) -> dict[str, object]:
        """In the header of the results."""
        one = self.variable
        about = {"name": one.name, "dtype": self.type, "shape": self.shape, "dims": one.dims, "unit": one.units}
        return {**about, "long_name": one.long_name, "matlab": _MATLAB[self.type[1:]]}


class RecordLayout:
    """Which outputs of the graphs a record holds, in which units, and how they get there.

    Args:
        outputs: of the graphs; images are left out.
        mm_per_px: of the contact view.
        units: of outputs that are no variables, by name.

    Attributes:
        dtype: of a record.
        tells_slip: whether it has the flag of incipient slip.
        fields: what the header says of each field.
    """

    def __init__(self, outputs: Mapping[str, Tensor], mm_per_px: float, units: Mapping[str, str]) -> None:
        self.tells_slip = all(name in outputs for name in _FOR_SLIP)
        own = _OWN + (_OF_SLIP if self.tells_slip else ())
        fields = [_Field(one, np.dtype(one.kind).newbyteorder("<").str, ()) for one in own]
        self._copied: list[tuple[str, str, float | None]] = []
        for name, tensor in outputs.items():
            if len(tensor.shape) > 3:  # images are for the live page
                continue
            stored, power = _OF_GRAPHS.get(name, (name, 0))
            self._copied.append((name, stored, mm_per_px**power if power else None))
            shape = tensor.shape[1:]
            dims = ("frame", *(f"{name}_{place}" for place in range(len(shape))))
            variable = _VARIABLES.get(stored) or Variable(stored, dims, units.get(name, ""), "")
            kind = _STORED.get(tensor.dtype, tensor.dtype.newbyteorder("<").str)
            fields.append(_Field(variable, kind, shape))
        self.dtype = np.dtype([(one.variable.name, one.type, one.shape) for one in fields])
        self.fields = [one.said() for one in fields]

    def fill(self, records: Mapping[str, Array], place: int, outputs: Mapping[str, Array]) -> None:
        """Stores the outputs in one of the records, whose fields are given by name."""
        for name, stored, factor in self._copied:
            value = outputs[name][0]
            records[stored][place] = value if factor is None else value * factor

    def fill_unknown(self, records: Mapping[str, Array], place: int) -> None:
        """Stores that a frame counts in no result: NaN, and 0 in integers, but for the status of points."""
        for _, stored, _ in self._copied:
            kind = records[stored].dtype.kind
            records[stored][place] = np.nan if kind == "f" else _NOT_USABLE if stored == "status" else 0
