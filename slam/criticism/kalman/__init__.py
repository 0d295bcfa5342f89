"""From a flight's readings to whitened innovations, and how these move with each parameter of the belief."""
