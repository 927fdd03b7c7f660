"""Stages that find the stick and slip regions of the contact."""
