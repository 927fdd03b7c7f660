"""Stages that compute divergence, curl, shear and strain from local fits, and their medians."""
