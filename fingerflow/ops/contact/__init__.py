"""Segmentation of the real and the apparent contact in images, and measurement of contact areas."""
