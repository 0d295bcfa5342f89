"""Rasters of an estimate on the ground: GeoTIFFs and their pictures."""
