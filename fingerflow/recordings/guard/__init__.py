"""Protection of the readers against files that are damaged, truncated or hostile."""
