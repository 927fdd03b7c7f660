"""Mechanics and decisions: partial slip, skin chain, friction, stress at depth, observer; float64, no images."""
