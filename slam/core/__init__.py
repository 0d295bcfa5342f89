"""Data that flows between the stages, and what every stage needs: flights, estimates, units, errors."""
