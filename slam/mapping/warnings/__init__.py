"""Sentences about a finished map: what limits it, what contradicts it, what it leaves out."""
