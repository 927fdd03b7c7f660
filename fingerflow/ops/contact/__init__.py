"""Real and apparent contact area of images."""
