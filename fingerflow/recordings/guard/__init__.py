"""Protection of file readers against damaged, truncated or hostile files."""
