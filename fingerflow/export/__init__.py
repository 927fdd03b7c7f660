"""Export of recipes to bundles: graphs as ONNX files, verified against torch, with the player that runs them."""

from fingerflow.export.bundle import export_bundle
from fingerflow.export.verification import Difference, as_text, verify

__all__ = ["Difference", "as_text", "export_bundle", "verify"]
