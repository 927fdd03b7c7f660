"""Outputs of live values to other programs: modules in this folder with an `ADDRESS` are found automatically."""
