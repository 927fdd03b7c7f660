"""Interface of skin textures that a synthetic scene can show."""

from typing import Any, ClassVar, Protocol

from torch import Tensor


class Skin(Protocol):
    """Interface of a skin texture with a `centre`, exact at every material position (mm, x right, y down).

    Tensors may have any shape, device and floating type.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def centre(self) -> tuple[float, float]:
        """Return the position of the fingerprint's core or centre, mm."""

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        """Return the skin's optical contrast, within [-1, 1] and bright on ridges, at material positions (x, y), mm."""

    def ridge_margin(self, x: Tensor, y: Tensor, share: float, depth: Tensor) -> Tensor:
        """Return the signed distance, mm, from positions (x, y) to the edge of the part of a ridge that touches the
        glass (a `share` of its width), positive inside; `depth` is the distance (mm) to the contact border.

        The sign is exact, the distance is exact to first order.

        Args:
            x, y: material positions, mm.
            share: of the skin that touches.
            depth: distance (mm) to the edge of the apparent contact, positive inside.
        """
