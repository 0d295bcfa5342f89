"""The page of a criticism: what is wrong, how sure that is, and what to fly next."""
