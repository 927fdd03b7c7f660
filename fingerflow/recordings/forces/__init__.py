"""Readers of force files, one module per file format."""
