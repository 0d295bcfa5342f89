"""Pages and pictures for a person: what came out of a flight and how good it is, in one offline page."""
