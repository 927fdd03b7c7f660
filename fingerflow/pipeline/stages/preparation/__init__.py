"""Stages and helpers that open the inputs of a recording and detect unusable frames."""
