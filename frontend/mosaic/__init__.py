"""The mosaic of placed pictures: who shows which ground, evened out, blended, and how far to trust it."""
