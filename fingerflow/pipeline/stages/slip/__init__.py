"""Stick and slip regions of the contact."""
