"""Pictures of the floor: what pairs of them show of moving objects, lamps, flicker and the lens."""
