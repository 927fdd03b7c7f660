"""Reproduction of both papers from simulated recordings: each printed result next to the reproduced one."""
