"""What shows in what is left over and changes no equation: odd readings, steps in the floor, vibration."""
