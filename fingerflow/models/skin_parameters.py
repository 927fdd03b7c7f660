"""Parameter sets of the skin chain in SI units: the paper's, those of the lab's code, and one whose tissue is fitted to
the contact area that the paper states.
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
    shear_stiffness: Number  # N/m, k_s of the same column across that line
    contact_stiffness: Number  # N/m, stiffness of the plate
    nail_stiffness: Number = 2500.0  # N/m, of the links between the ends of the chain and the bone
    stiffening: Number = 0.0  # 1/m, 1 / c_0: a column compressed by c is exp(c / c_0) times as stiff; 0 is linear
    damping: Number = 0.1  # N s/m, damping zeta of an element, and of the bone
    friction_stiffness: Number = 500.0  # N/m, sigma_0 of Dahl's model
    friction_exponent: Number = 0.7  # n of Dahl's model
    width: Number = 8e-3  # m, width across the chain, which converts element forces to pressure

    def for_elements(self, count: int) -> "SkinParameters":
        """Return the parameters of this skin, converted from a chain of 501 elements to one of ``count`` elements.

        The link stiffness is inverse to the element length, all else is proportional to it.
        """
        finer = (count - 1) / 500
        shared = "tissue_stiffness", "shear_stiffness", "contact_stiffness", "damping", "friction_stiffness"
        parts = {name: getattr(self, name) / finer for name in shared}
        return replace(self, membrane_stiffness=self.membrane_stiffness * finer, **parts)

    def softer(self, times: float) -> "SkinParameters":
        """Return a skin of the same membrane on softer tissue, whose stiffnesses are divided by ``times``."""
        return replace(
            self, tissue_stiffness=self.tissue_stiffness / times, shear_stiffness=self.shear_stiffness / times
        )


def _shear(tissue: float, poisson_ratio: float) -> float:
    """Return k_s of a column with the stiffness k_t: a solid's shear modulus is E / (2 (1 + nu))."""
    return tissue / (2 * (1 + poisson_ratio))


def _lab() -> SkinParameters:
    """Return the parameters of the lab's published script.

    The radius is 8 mm and E is 1.54 MPa, with a layer of 20 um, a width d of 10 mm and tissue of 25 kPa. k_m = E d e /
    dL / 2 is 3.06 kN/m, where 2.5 kN/m is printed; k_t = pi r E_t / 2 is 0.31 kN/m per element.
    """
    radius, width = 8e-3, 10e-3
    membrane = 1.54e6 * width * 20e-6 / (math.pi * radius / 500) / 2
    tissue = math.pi * radius * 25e3 / 2
    return SkinParameters(radius, membrane, tissue, _shear(tissue, 0.48), 100 * tissue, 5000.0, width=width)


PARAMETERS = {
    # The stiffnesses are printed as 2.5 and 0.13 "kNm", meaning kN/m. The radius follows from "10 %" at 3 mm (equation
    # 10). The plate's stiffness is not printed; its ratio to the others is that of the lab's parameters.
    "paper": SkinParameters(10e-3, 2500.0, 130.0, _shear(130.0, 0.4), 13000.0, width=10e-3),
    "lab": _lab(),
    # The supplement fits the tissue to the relation of force and area, but a chain with the printed stiffnesses has a
    # contact of 21 mm² at 3 N where the supplement's contacts have 70.1. A pulp that stiffens as it is compressed has
    # the shape of that relation (Serina 1997; Pawluk & Howe 1999). The membrane and Poisson's ratio are as printed, and
    # c_0 of 0.7 mm is assumed. k_t alone is fitted, to 70 mm² at 5.4 N, the mean printed force; strain and energy are
    # predictions. The printed k_t of 130 N/m would have 27 mm²: it is the stiffness of 2 mm of skin, not of 63 µm.
    "fitted": SkinParameters(10e-3, 2500.0, 3.7, _shear(3.7, 0.4), 1600.0, stiffening=1 / 0.7e-3, width=10e-3),
}


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
        from_zero = field.name in ("friction_exponent", "stiffening")
        allowed, limits = (value >= 0, "0 or more") if from_zero else (value > 0, "positive")
        allowed = allowed & (value < math.inf)
        if not allowed.all():
            raise ValueError(f"{field.name} is {value[~allowed].flatten()[0].item():g}: it must be {limits}")
    return parameters
