"""Parameters of the skin chain, in SI units, and the two sets that are in print and in the lab's code."""

import math
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

Number = float | Tensor


@dataclass(frozen=True)
class SkinParameters:
    """Of one element of a chain of 501; every number may be a tensor of one shape, a chain for each entry."""

    radius: Number  # m, of the half-circle
    membrane_stiffness: Number  # N/m, k_m of the link between two neighbours
    tissue_stiffness: Number  # N/m, k_t along the line from an element to the bone
    contact_stiffness: Number  # N/m, of the plate
    damping: Number = 0.1  # N s/m, zeta of an element, and of the bone
    friction_stiffness: Number = 500.0  # N/m, sigma_0 of Dahl's model
    friction_exponent: Number = 0.7  # n of Dahl's model
    poisson_ratio: Number = 0.4  # of the tissue; the paper's, from its strain energy
    width: Number = 8e-3  # m across the chain: from forces of elements to pressure

    def for_elements(self, count: int) -> "SkinParameters":
        """The same skin cut into another number: what is in parallel shrinks with an element, a link grows stiffer."""
        finer = (count - 1) / 500
        return replace(
            self,
            membrane_stiffness=self.membrane_stiffness * finer,
            tissue_stiffness=self.tissue_stiffness / finer,
            contact_stiffness=self.contact_stiffness / finer,
            damping=self.damping / finer,
            friction_stiffness=self.friction_stiffness / finer,
        )

    def softer(self, times: float) -> "SkinParameters":
        """The same skin with every stiffness of its own divided by a number, the plate's penalty too."""
        return replace(
            self,
            membrane_stiffness=self.membrane_stiffness / times,
            tissue_stiffness=self.tissue_stiffness / times,
            contact_stiffness=self.contact_stiffness / times,
        )


def _lab() -> SkinParameters:
    """The published script: radius 8 mm, E 1.54 MPa, a layer of 20 um, tissue of 25 kPa.

    k_m = E d e / dL / 2 with d = 8 mm is 2.45 kN/m, the 2.5 kN/m in print; k_t = pi r E_t / 2 is 0.31 kN/m an element.
    """
    radius, spacing = 8e-3, math.pi * 8e-3 / 500
    tissue = math.pi * radius * 25e3 / 2
    return SkinParameters(radius, 1.54e6 * radius * 20e-6 / spacing / 2, tissue, 100 * tissue, width=radius)


PARAMETERS = {
    # In print as 2.5 and 0.13 "kNm": they are kN/m. The radius is that of "10 %" at 3 mm (equation 10); the plate is
    # not in print and takes the lab's ratio.
    "paper": SkinParameters(10e-3, 2500.0, 130.0, 13000.0, width=10e-3),
    "lab": _lab(),
}


def named(parameters: "str | SkinParameters") -> SkinParameters:
    """A set by its name, or itself; raises ValueError for another name or a number that cannot be."""
    if isinstance(parameters, str):
        if parameters not in PARAMETERS:
            raise ValueError(
                f"no parameters named {parameters!r}: choose one of {', '.join(PARAMETERS)} or give SkinParameters"
            )
        return PARAMETERS[parameters]
    for field in fields(parameters):
        value = torch.as_tensor(getattr(parameters, field.name))
        poisson = field.name == "poisson_ratio"
        allowed = (value > -1) & (value <= 0.5) if poisson else (value >= 0 if "exponent" in field.name else value > 0)
        if not bool(allowed.all()):
            limits = "above -1 and at most 0.5" if poisson else "positive"
            raise ValueError(f"{field.name} is {value[~allowed].flatten()[0].item():g}: it must be {limits}")
    return parameters
