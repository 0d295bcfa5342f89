"""Tables of readings, and what their columns and cells mean."""
