"""GPS fixes: which of them agree with the map, how well, and the messages about them."""
