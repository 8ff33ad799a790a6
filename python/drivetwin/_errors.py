"""The exceptions of drivetwin."""


class Error(ValueError):
    """A name, a value, a file or a state that is not valid, in one sentence."""


class UnknownName(Error, KeyError):
    """A name that is not there; the sentence offers the nearest one."""

    # That of KeyError puts the sentence in quotes.
    __str__ = Exception.__str__
