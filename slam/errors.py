"""The one root of all errors that a user can cause and mend."""


class InputError(Exception):
    """The input was refused: one line that says what, where, and what to do. Exit code 1."""
