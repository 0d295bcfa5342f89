"""The search for causes: the catalogue as directions, score tests, fits, and steps from belief to belief."""
