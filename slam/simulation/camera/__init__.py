"""The simulated camera: pictures of a scene along a path, with the effects of a real camera."""
