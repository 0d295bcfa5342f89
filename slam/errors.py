"""The one root of all errors that a user can cause and mend."""

from unicodedata import category


class InputError(Exception):
    """The input was refused: one line that says what, where, and what to do. Exit code 1."""


def one_line(text: str) -> str:
    """Text that holds names from outside, safe to print: no line breaks, nothing invisible."""
    return "".join(
        "\N{REPLACEMENT CHARACTER}" if category(letter) in _UNPRINTABLE else letter for letter in text
    )


_UNPRINTABLE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}
