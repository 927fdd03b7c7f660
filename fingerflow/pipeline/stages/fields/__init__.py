"""Stages that compute divergence, curl, shear and strain by local fits, and medians over the contact."""
