"""Keys of scenes and variables of results as data, for the package and for a bundle's player alike."""
