"""Stages for soft tactile sensors: gels with printed markers that a camera observes."""
