"""The version of all three packages and of the distribution; pyproject.toml reads it from here."""

VERSION = "0.2.0"
