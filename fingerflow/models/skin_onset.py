"""Displacement and divergence of a pressed skin chain since each point's onset of contact, as a camera measures them.

A recording shows skin only from its first contact, so displacement counts from there: u = x(t) - xi, with xi the
position where the contact edge passed the point. With the chain as the section of a finger of revolution the divergence
is du/dxi + u/xi. `PressedChain.divergence` counts from the undeformed chain, which a camera cannot measure.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from fingerflow.models.skin_chain import PressedChain, weighted_median

_SYMMETRY = 1e-6  # largest asymmetry that is accepted as rounding, as a share of the contact radius


FIRST_FRAME_M = 1e3  # m, a rim that no finger exceeds: skin counts from the first time with contact


@dataclass(frozen=True)
class SinceOnset:
    """Radial displacement and its gradient of pressed skin since each element touched the plate, at T times and for M
    elements from the finger's axis outward.

    Values of elements off the contact and its rim are NaN.
    """

    radius: Tensor  # (T, ..., M) m, present distance from the axis
    displacement: Tensor  # (T, ..., M) m, outward displacement since the onset
    radial: Tensor  # (T, ..., M) du/dxi
    hoop: Tensor  # (T, ..., M) u/xi
    ring_area: Tensor  # (T, ..., M) m², part of the contact disc that an element stands for
    contact_area: Tensor  # (T, ...) m², area of the contact disc

    @property
    def divergence_field(self) -> Tensor:
        """Return the divergence (T, ..., M), dimensionless."""
        return self.radial + self.hoop

    @property
    def area_median(self) -> Tensor:
        """Return the median (T, ...) of the divergence, weighted by contact area as over the pixels of an image; NaN
        where fewer than two elements touch.
        """
        return weighted_median(self.divergence_field.nan_to_num(0.0), self.ring_area * self.divergence_field.isfinite())

    def mean_within(self, share: float) -> Tensor:
        """Return the mean divergence (T, ...) over the inner part of the contact, a disc whose radius is a `share` of
        the contact radius; NaN without contact.

        By the divergence theorem it measures the flow out of the disc. Unlike a median it depends little on the edge of
        the contact.
        """
        edge = share * (self.contact_area / torch.pi).sqrt()[..., None]
        ring = torch.where(self.radius < edge, self.radius.clamp_min(0.0), 0.0)
        return (ring * self.divergence_field.nan_to_num(0.0)).sum(-1) / ring.sum(-1)


def since_onset(press: PressedChain, rim_m: float = 0.0) -> SinceOnset:
    """Compute radial displacement and divergence of the skin since each point first touched the plate, for presses at T
    times as returned by `follow`.

    The times must be close enough that the contact edge moves evenly between two. A median by area is small: divergence
    falls from the middle outward and is negative at the edge, where most of the area lies.

    Args:
        press: at several times, the first without contact.
        rim_m: width of a rim around the contact in which skin counts already, as in a dilated contact; with
            `FIRST_FRAME_M` all skin counts from the first time with contact. Areas are those of the contact itself.

    Raises:
        ValueError: no time dimension, or a press that is not mirrored about its axis, as under a tangential load.
    """
    x, z = press.position.unbind(-1)
    if x.ndim < 2:
        raise ValueError(f"positions {tuple(press.position.shape)}: give a press at several times, as follow gives it")
    half = press.contact_length / 2
    outward = (x - x.flip(-1))[..., x.shape[-1] // 2 :] / 2
    uneven = ((x + x.flip(-1)).abs() / 2).amax(-1)
    if (uneven > _SYMMETRY * half.clamp_min(1e-4)).any():
        raise ValueError(
            f"a press that is {uneven.max().item():.3g} m off its axis is no finger of revolution: leave out "
            "tangential loads, slides and friction that differs from side to side"
        )
    height = (z + z.flip(-1))[..., z.shape[-1] // 2 :] / 2
    on_plate = height < 0
    if rim_m:
        height = torch.where(half[..., None] > 0, outward - half[..., None] - rim_m, outward)
    inside = height < 0
    first = inside.to(torch.uint8).argmax(0, keepdim=True)
    before = (first - 1).clamp_min(0)
    # Interpolate the onset linearly from the height between two times: a contact counted in elements grows by jumps.
    later, earlier = height.gather(0, first), height.gather(0, before)
    falls = earlier > later
    share = torch.where(falls, later / torch.where(falls, later - earlier, 1.0), 0.0).clamp(0, 1)
    onset = outward.gather(0, first) + share * (outward.gather(0, before) - outward.gather(0, first))
    moved = torch.where(inside, outward - onset, torch.nan)
    onset = onset.expand_as(outward)
    slope = _slope(moved, onset, x.shape[-1] % 2 == 1)
    on_axis = onset < 1e-3 * _SYMMETRY * half.amax(0).clamp_min(1e-4)[..., None]
    hoop = torch.where(on_axis, slope, moved / torch.where(on_axis, 1.0, onset))
    between = (outward[..., 1:] + outward[..., :-1]) / 2
    outer = torch.cat((torch.where(on_plate[..., 1:], between, half[..., None]), half[..., None]), -1)
    inner = torch.cat((torch.zeros_like(outward[..., :1]), between), -1)
    weight = torch.where(on_plate, outer - inner, 0.0).clamp_min(0.0)
    return SinceOnset(
        radius=torch.where(inside, outward, torch.nan),
        displacement=moved,
        radial=slope,
        hoop=hoop,
        ring_area=torch.pi * weight * (outer + inner),
        contact_area=torch.pi * half.square(),
    )


def _slope(values: Tensor, at: Tensor, centred: bool) -> Tensor:
    """Return the radial derivative of values (..., M) at radii `at` (..., M), which are odd functions of the radius;
    `centred` says that the first lies on the axis, and at the outer end it is one-sided.
    """
    mirrored = slice(1, 2) if centred else slice(0, 1)
    value = torch.cat((-values[..., mirrored], values), -1)
    radii = torch.cat((-at[..., mirrored], at), -1)
    steps, lengths = value.diff(dim=-1), radii.diff(dim=-1)
    inner = steps / lengths
    both = (steps[..., :-1] + steps[..., 1:]) / (lengths[..., :-1] + lengths[..., 1:])
    both = torch.cat((both, torch.full_like(inner[..., -1:], torch.nan)), -1)
    return torch.where(both.isnan(), inner, both)
