"""Live force sensors: modules in this folder with an `ADDRESS` are found automatically."""
