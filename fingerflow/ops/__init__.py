"""Batched tensor ops: pure functions of tensors, one op a file, that know nothing of fingers."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fingerflow.ops.corners import detect_corners as detect_corners
    from fingerflow.ops.flow import dense_flow as dense_flow
    from fingerflow.ops.gridding import scattered_to_grid as scattered_to_grid
    from fingerflow.ops.illumination import normalize_illumination as normalize_illumination
    from fingerflow.ops.local_fit import local_gradients as local_gradients
    from fingerflow.ops.median import median_filter as median_filter
    from fingerflow.ops.otsu import otsu_threshold as otsu_threshold
    from fingerflow.ops.strain import curl as curl
    from fingerflow.ops.strain import divergence as divergence
    from fingerflow.ops.strain import green_lagrange as green_lagrange
    from fingerflow.ops.strain import strain_energy_density as strain_energy_density
    from fingerflow.ops.tracking import track_points as track_points
    from fingerflow.ops.triangles import triangle_gradients as triangle_gradients
    from fingerflow.ops.vector_parts import helmholtz_hodge as helmholtz_hodge

_HOMES = {
    "curl": "strain",
    "dense_flow": "flow",
    "detect_corners": "corners",
    "divergence": "strain",
    "green_lagrange": "strain",
    "helmholtz_hodge": "vector_parts",
    "local_gradients": "local_fit",
    "median_filter": "median",
    "normalize_illumination": "illumination",
    "otsu_threshold": "otsu",
    "scattered_to_grid": "gridding",
    "strain_energy_density": "strain",
    "track_points": "tracking",
    "triangle_gradients": "triangles",
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    """An op by its name, loaded when it is first used."""
    if name in _HOMES:
        return getattr(import_module(f"fingerflow.ops.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'fingerflow.ops' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
