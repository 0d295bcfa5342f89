"""A map while the pictures arrive: tracking, loop closure and the incremental back end."""
