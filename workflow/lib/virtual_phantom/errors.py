"""The one exception that means: the user's input is at fault, not the program."""


class InputError(ValueError):
    """Bad input. The message is one line: the file or key, what is wrong with it, and what to do."""
