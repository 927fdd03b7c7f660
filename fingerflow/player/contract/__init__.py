"""What scenes and results are made of, as data, for the package and for a bundle's player alike: Python alone."""
