"""What the pictures of a flight say about the camera: where the same points appear, and how they look."""
