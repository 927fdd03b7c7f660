"""Parameter sets of the skin chain in SI units: the paper's, those of the lab's code, and one fitted to the contact
area that the paper states.
"""

import math
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

Number = float | Tensor


@dataclass(frozen=True)
class SkinParameters:
    """Mechanical parameters of the skin (stiffnesses, damping, friction), given per element of a chain of 501 elements.

    Tensors of one shape hold the parameters of many chains.
    """

    radius: Number  # m, radius of the half-circle
    membrane_stiffness: Number  # N/m, k_m of the link between two neighbouring elements
    tissue_stiffness: Number  # N/m, k_t along the line from an element to the bone
    contact_stiffness: Number  # N/m, stiffness of the plate
    damping: Number = 0.1  # N s/m, damping zeta of an element, and of the bone
    friction_stiffness: Number = 500.0  # N/m, sigma_0 of Dahl's model
    friction_exponent: Number = 0.7  # n of Dahl's model
    poisson_ratio: Number = 0.4  # Poisson's ratio of the tissue; the paper's value, from its strain energy
    width: Number = 8e-3  # m, width across the chain, which converts element forces to pressure

    def for_elements(self, count: int) -> "SkinParameters":
        """Return the parameters of this skin, converted from a chain of 501 elements to one of ``count`` elements.

        The link stiffness is inverse to the element length, all else is proportional to it.
        """
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
        """Return a softer skin: membrane, tissue and plate stiffness divided by ``times``."""
        return replace(
            self,
            membrane_stiffness=self.membrane_stiffness / times,
            tissue_stiffness=self.tissue_stiffness / times,
            contact_stiffness=self.contact_stiffness / times,
        )


def _lab() -> SkinParameters:
    """Return the parameters of the lab's published script.

    The radius is 8 mm and E is 1.54 MPa, with a layer of 20 um and tissue of 25 kPa. k_m = E d e / dL / 2 with d = 8 mm
    is 2.45 kN/m, printed as 2.5 kN/m; k_t = pi r E_t / 2 is 0.31 kN/m per element.
    """
    radius, spacing = 8e-3, math.pi * 8e-3 / 500
    tissue = math.pi * radius * 25e3 / 2
    return SkinParameters(radius, 1.54e6 * radius * 20e-6 / spacing / 2, tissue, 100 * tissue, width=radius)


PARAMETERS = {
    # The stiffnesses are printed as 2.5 and 0.13 "kNm", meaning kN/m. The radius follows from "10 %" at 3 mm (equation
    # 10). The plate's stiffness is not printed; its ratio to the others is that of the lab's parameters.
    "paper": SkinParameters(10e-3, 2500.0, 130.0, 13000.0, width=10e-3),
    "lab": _lab(),
}
# The supplement fits the tissue to the relation of force and area, but a chain with the printed stiffnesses has a
# contact of 21 mm² at 3 N where the supplement's contacts have 70.1. With stiffnesses divided by 5.6 the area is 68
# (friction 1) to 71 mm² (friction 0.02).
PARAMETERS["fitted"] = PARAMETERS["paper"].softer(5.6)


def parameter_set(parameters: "str | SkinParameters") -> SkinParameters:
    """Return a parameter set by its name; a set given instead of a name is checked and returned.

    Raises:
        ValueError: an unknown name, or a value out of range.
    """
    if isinstance(parameters, str):
        if parameters not in PARAMETERS:
            raise ValueError(
                f"no parameters named {parameters!r}: choose one of {', '.join(PARAMETERS)} or give SkinParameters"
            )
        return PARAMETERS[parameters]
    for field in fields(parameters):
        value = torch.as_tensor(getattr(parameters, field.name))
        poisson = field.name == "poisson_ratio"
        exponent = "exponent" in field.name
        allowed = (value > -1) & (value <= 0.5) if poisson else (value >= 0 if exponent else value > 0)
        if not bool(allowed.all()):
            limits = "above -1 and at most 0.5" if poisson else "0 or more" if exponent else "positive"
            raise ValueError(f"{field.name} is {value[~allowed].flatten()[0].item():g}: it must be {limits}")
    return parameters
