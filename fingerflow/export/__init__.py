"""Export a recipe (a file of settings) to a deployment bundle: ONNX graphs verified against torch, and the player."""

from fingerflow.engines.check import Difference
from fingerflow.export.write_bundle import as_text, export_bundle

__all__ = ["Difference", "as_text", "export_bundle"]
