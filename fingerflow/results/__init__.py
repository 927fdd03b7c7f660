"""Results in memory, in files that grow frame by frame, in folders of a stream, and as tables for other programs."""
