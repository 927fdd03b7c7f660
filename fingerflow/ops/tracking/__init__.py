"""Tracking of skin points: corners, subsets (templates), registration, outliers."""
