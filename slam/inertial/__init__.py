"""Motion of a flight from its instruments alone: readings, noise identification and filter."""
