"""A flight's motion from its instruments alone: what they read, how far each is trusted, the filter."""
