"""Reproduction of both papers from simulated recordings: every printed number and figure beside what is obtained."""
