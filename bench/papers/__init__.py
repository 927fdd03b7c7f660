"""Both papers: simulate their experiments, measure them, and set every printed number beside what is obtained."""
