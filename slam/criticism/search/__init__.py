"""Search: hypotheses, likelihood expansions, score tests, fits, and the sequence of filter parameters."""
