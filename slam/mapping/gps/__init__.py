"""GPS fixes: which of them agree with the map, how well, and what the user is told."""
