"""Dense optical flow of a picture."""
