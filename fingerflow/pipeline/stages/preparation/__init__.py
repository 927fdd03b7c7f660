"""Inputs of a recording, and detection of the frames that can be used."""
