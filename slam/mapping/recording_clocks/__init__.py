"""Several recordings of one flight, each on a clock of its own, brought onto one clock."""
