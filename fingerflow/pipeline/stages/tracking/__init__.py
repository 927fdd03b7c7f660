"""Stages that track points of the skin through all frames and decide where new points are seeded."""
