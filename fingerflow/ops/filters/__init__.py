"""Filters of pictures: illumination, medians, splines, noise, histograms of neighbourhoods."""
