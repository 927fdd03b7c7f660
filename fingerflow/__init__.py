"""fingerflow: contact area, skin motion and strain from high-speed recordings of a fingertip on glass."""

__version__ = "0.1.0"
