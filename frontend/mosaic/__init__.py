"""Mosaic of placed pictures: choice of pictures, exposure compensation, blending and quality rasters."""
