"""The exceptions of drivetwin."""


class Error(ValueError):
    """A name, a value, a file or a state that is not valid, in one sentence."""


class UnknownName(Error, KeyError):
    """A name that is not there; the sentence offers the nearest one."""

    # That of KeyError puts the sentence in quotes.
    __str__ = Exception.__str__


class NotOnBoard(Error):
    """Something that a bench does, and a board cannot do: virtual time, faults of a line, emulated motors and wires."""
