"""Benchmarks of speed and accuracy: this project and other libraries, in one process on the same cores."""
