"""Readers of forces, one module a file format."""
