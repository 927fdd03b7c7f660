"""What a scene needs to know about skin."""

from typing import Any, ClassVar, Protocol

from torch import Tensor


class Skin(Protocol):
    """Skin in material coordinates (mm, x right, y down): a dataclass with a `centre`, exact at every position.

    Tensors may have any shape, device and floating type.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def centre(self) -> tuple[float, float]:
        """Where the core or the middle of the skin lies, mm."""

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        """Contrast inside [-1, 1], bright on the ridges, at the material positions (x, y), in mm."""

    def ridge_margin(self, x: Tensor, y: Tensor, share: float, depth: Tensor) -> Tensor:
        """How far inside a touching ridge, mm: > 0 where the skin touches; exact in sign, else of first order.

        Args:
            x, y: material positions, mm.
            share: of the skin that touches.
            depth: distance (mm) to the edge of the gross contact, positive inside.
        """
