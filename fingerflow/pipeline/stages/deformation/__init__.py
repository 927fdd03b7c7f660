"""Stages that measure the displacement of tracked skin points."""
