"""Verdict: posterior, held-out gain, roll-outs and the result of a criticism."""
