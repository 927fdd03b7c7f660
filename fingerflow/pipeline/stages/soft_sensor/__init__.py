"""Soft sensors with printed markers."""
