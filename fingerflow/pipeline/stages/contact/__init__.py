"""Contact of every frame."""
