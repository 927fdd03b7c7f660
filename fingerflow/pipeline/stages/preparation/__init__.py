"""Stages and helpers that open the inputs of a recording, process the forces, and detect unusable frames."""
