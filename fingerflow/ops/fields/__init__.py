"""Fields of tracked points: gradients, strain, medians over an area, and their standard deviations."""
