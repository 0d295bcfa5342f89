"""The simulated camera: from a scene and a path to pictures, with all that a camera does untold."""
