"""Definitions of scene files and result variables, shared by the package and the player of a deployment bundle."""
