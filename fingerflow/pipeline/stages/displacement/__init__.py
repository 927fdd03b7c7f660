"""Displacement of every point."""
