"""Stages that compute strain and strain energy of the triangles between points."""
