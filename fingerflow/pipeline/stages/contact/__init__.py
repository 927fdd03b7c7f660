"""Stages that measure the contact in every frame."""
