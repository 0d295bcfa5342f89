"""How improbable chance must be before something is reported: the levels that several tests share."""

from __future__ import annotations

FALSE_ALARM = 1e-3
"""Probability that a test fails where nothing is wrong. A map passes some ten such tests, so that about one
sound map in a hundred has a false report, which is rarer than real faults."""
SURE_SIGMAS = 3.0
"""Standard deviations that count as no chance for one quantity: Gaussian noise exceeds them in 0.27 %."""
SIGMAS_OF_SEVERAL = 4.0
"""The same for the largest of several quantities, such as the gains, offsets and axes of an instrument. Of
sixteen, Gaussian noise exceeds it in one with the probability ``FALSE_ALARM``."""
RIVAL_CHI_SQUARE = SURE_SIGMAS**2
"""Difference of chi-squares, or of -2 log-likelihoods, below which two explanations are equally good."""
STRONG_NATS = 3.0
"""Logarithm of the ratio of two likelihoods from which the evidence is strong (Kass and Raftery 1995, section
3.2)."""
VERY_STRONG_NATS = 5.0
"""The same from which it is very strong."""
RARE_LOG_CHANCE = -20.0
"""Logarithm of the largest probability of a find that counts where about 10^5 are tried, as all runs or all
frequencies of a recording are: 2e-4 for all of them."""
