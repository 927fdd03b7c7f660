"""Printed markers of soft sensors: detection, and matching between frames."""
