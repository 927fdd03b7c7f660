"""Stages that compute strain and strain energy of the skin in triangles between tracked points."""
