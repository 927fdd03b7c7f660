"""Readers of frames, one module a file format."""
