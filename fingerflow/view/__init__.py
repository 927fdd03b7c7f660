"""A page, served to this computer alone, to set up a scene and to look at results: `fingerflow view`."""

from fingerflow.view.server import serve

__all__ = ["serve"]
