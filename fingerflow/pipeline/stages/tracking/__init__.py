"""Points of the skin through all frames, and where new ones are seeded."""
