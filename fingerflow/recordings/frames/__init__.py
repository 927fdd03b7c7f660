"""Files of frames, a reader each."""
