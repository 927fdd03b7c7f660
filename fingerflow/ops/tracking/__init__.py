"""Points of the skin: corners, subsets (templates), registration, outliers."""
