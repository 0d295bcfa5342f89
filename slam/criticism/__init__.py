"""Model criticism: what a simulation gets wrong about measured flights, by name, with what it gains to know.

A flight is filtered under a model; what is left over, whitened, is compared with the trace that each term of
the catalogue would leave there.
"""
