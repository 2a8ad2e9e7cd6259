"""The one error type for bad input: its message is a full sentence naming the file, field and remedy."""


class InputError(ValueError):
    """Bad input from a user or a file. The command line prints its message alone, without a traceback."""
