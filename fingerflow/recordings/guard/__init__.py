"""Protection against files that are damaged, truncated or hostile, applied by every reader around library calls."""
