"""Strain and strain energy of the triangles between points."""
