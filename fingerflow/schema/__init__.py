"""Schema of scene files and result variables as data, shared by the package and the player of a bundle."""
