"""Definitions of scene files and result variables as data, for the package and the player of a deployment bundle."""
