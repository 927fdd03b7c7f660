"""Tracking of skin points: corner detection, templates (subsets), registration and outlier detection."""
