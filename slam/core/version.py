"""The version of all three packages; the one of the distribution is the same."""

VERSION = "0.1.0"
