"""How accurate a refined map is: its ground, its lengths, its points, and errors that all pictures share."""
