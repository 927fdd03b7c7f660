"""Image filters: illumination, medians, splines, windows, noise and quantiles."""
