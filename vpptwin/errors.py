"""The one exception that users see as a single line on stderr and exit code 2."""

from __future__ import annotations


class InputError(ValueError):
    """Bad input: what was found, what was expected, and what to do.

    Args:
        found: what the input holds, naming the file or key it was found in.
        expected: what would have been accepted.
        action: what the user can do about it.
    """

    def __init__(self, found: str, expected: str, action: str) -> None:
        self.found, self.expected, self.action = found, expected, action
        super().__init__(" ".join(f"{found}; expected {expected}; {action}".split()))
