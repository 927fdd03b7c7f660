"""Optics of skin and glass: the grey levels of both views, in 8-bit levels above the camera's dark level."""

import torch
from torch import Tensor

from fingerflow.synthetic.motion import Ellipse
from fingerflow.synthetic.skin_interface import Skin

#: Grey levels at full illumination: mean of the skin in the grazing light, amplitude of the ridges there, and the glass
#: in the bright field.
SKIN_LEVEL, RIDGE_LEVEL, GLASS_LEVEL = 100.0, 95.0, 178.0
#: Share of the bright field lost at a touching ridge, and at the skin between the ridges.
CONTACT_LOSS, VALLEY_LOSS = 0.5, 0.04
#: Width (mm) of the logistic blur of an edge in focus, of the finger's outline and of the rim of the lit disc.
#: In focus it is 0.35 px, close to a Gaussian of standard deviation 0.6 px.
EDGE_WIDTH, OUTLINE_WIDTH, DISC_WIDTH = 0.0114, 0.4, 0.2
#: Distance (mm) from the edge of the contact beyond which only glass is visible: there the edge's blur is 1e-15.
GLASS_FROM = 0.4


def grazing(x: Tensor, y: Tensor, width: float, height: float) -> Tensor:
    """Return the relative intensity, at most 1, of the grazing light at positions (x, y) in mm on the glass, in a
    contact view of a width and height in mm; it fades from left to right, and does not move with the skin.
    """
    return (1 - 0.25 * (x / width)) * (0.93 + 0.07 * torch.cos(3 * (y / height - 0.45)))


def stray(x: Tensor, y: Tensor, width: float, height: float) -> Tensor:
    """Return the grey levels of stray light, as `grazing`, which the topography view shows without a finger."""
    return 6 + 1.5 * torch.sin(2.5 * x / width + 0.5) * torch.cos(2 * y / height)


def bright_field(x: Tensor, y: Tensor, width: float, height: float) -> Tensor:
    """Return the grey levels of the contact view without a finger, as `grazing`: an uneven bright disc with black
    corners.
    """
    radius = 0.47 * height
    disc = Ellipse((0.505 * width, 0.5 * height), (radius, radius)).distance(x, y)
    uneven = 0.87 + 0.13 * torch.cos(3 * (x / width - 0.58)) * torch.cos(3 * (y / height - 0.4))
    return 2 + GLASS_LEVEL * uneven * torch.sigmoid(disc / DISC_WIDTH)


def topography(texture: Skin, outline: Ellipse, x: Tensor, y: Tensor, grazing: Tensor, stray: Tensor) -> Tensor:
    """Return the grey levels of the topography view: the skin at material coordinates (x, y) in grazing and stray
    light.

    The outline of the finger is in material coordinates: like the ridges it moves with the skin.
    """
    skin = texture(x, y).mul_(RIDGE_LEVEL).add_(SKIN_LEVEL)
    return skin.mul_(torch.sigmoid_(outline.distance(x, y).div_(OUTLINE_WIDTH))).mul_(grazing).add_(stray)


def contact(ridge_margin: Tensor, gross_margin: Tensor, bright_field: Tensor) -> Tensor:
    """Return the grey levels of the contact view: the bright field, darkened where skin touches, from signed distances
    (mm) to the edges of the ridges and of the apparent contact, positive inside.

    Margins are distances (mm) to the edges of ridge and apparent contact, positive inside. The level half-way between
    ridge and valley lies on the edge of the real contact.
    """
    touching = torch.sigmoid_(torch.minimum(ridge_margin, gross_margin).div_(EDGE_WIDTH))
    skin = torch.sigmoid(gross_margin / EDGE_WIDTH).mul_(VALLEY_LOSS)
    return bright_field * (1 - skin).sub_(touching.mul_(CONTACT_LOSS - VALLEY_LOSS))
