"""Results in memory, in files that grow, in folders of a stream, and as tables for other programs."""
