"""Real and apparent contact area of a picture."""
