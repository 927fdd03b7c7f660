"""Mechanics and statistics of results in float64, without images: partial slip, skin chain, friction, observer."""
