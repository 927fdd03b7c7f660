"""Stages that measure the displacement of points."""
