"""Printed markers of soft sensors: found, and matched between frames."""
