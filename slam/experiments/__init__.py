"""The paper's experiments, each one file: what it flies, what it measures, what it draws, what it says.

An experiment is trials, one a seed, that run apart from each other, and a conclusion over all of them.
"""
