"""Figures, the self-contained page and the video of a processed scene."""

from fingerflow.report.overlay import write_overlay
from fingerflow.report.page import write_report

__all__ = ["write_overlay", "write_report"]
