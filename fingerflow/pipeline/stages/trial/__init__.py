"""What a recording is computed from, and which of its frames can be used."""
