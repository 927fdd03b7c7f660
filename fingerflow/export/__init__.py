"""Export a recipe (a file of settings) to a deployment bundle: ONNX graphs verified against torch, and the player."""

from fingerflow.export.write_bundle import as_text, export_bundle

__all__ = ["as_text", "export_bundle"]
