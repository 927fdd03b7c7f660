"""Image filters: illumination, medians, morphology, splines, windows, noise and quantiles."""
