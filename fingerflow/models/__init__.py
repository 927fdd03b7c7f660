"""Mechanical models of a pressed fingertip (partial slip, skin chain, friction, stress) and statistics of measured
results (ideal observer), in float64 and without images.
"""
