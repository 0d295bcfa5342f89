"""The paper's experiments, one file each: flight, measurement, figure and conclusion.

An experiment consists of independent trials, one a seed, and a conclusion over all of them.
"""
