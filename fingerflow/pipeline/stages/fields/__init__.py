"""Divergence, curl, shear and strain from local fits, and their medians."""
