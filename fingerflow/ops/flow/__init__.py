"""Dense optical flow between two images."""
