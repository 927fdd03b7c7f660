"""Stages for soft sensors with printed markers."""
