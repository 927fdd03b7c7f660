"""Files of forces, a reader each."""
