"""Files that may be damaged, cut short or hostile: what every reader does before and while it lets a library read."""
