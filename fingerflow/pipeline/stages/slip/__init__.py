"""The stick and slip regions of the contact."""
