"""Uncertainty of the border of the apparent contact."""

# Standard deviation, mm, of the position of the contact's border, which runs between ridges that lie 0.4 to 0.5 mm
# apart. It was measured on the shipped press, whose border is known.
BORDER_MM = 0.06
