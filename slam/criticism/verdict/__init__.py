"""From what a search found to a verdict: posteriors, held-out gain, roll-outs, and the product of it all."""
