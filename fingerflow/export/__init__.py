"""Export a recipe (a file of settings) to a deployment bundle: ONNX graphs verified against torch, and the player."""

from fingerflow.export.graph_verification import Difference, as_text, verify
from fingerflow.export.write_bundle import export_bundle

__all__ = ["Difference", "as_text", "export_bundle", "verify"]
