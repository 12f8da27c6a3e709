"""The one exception that means: the user's input is at fault, not the program."""


class InputError(ValueError):
    """Bad input. The message is one line: the file or key, what is wrong with it, and what to do.

    Characters that do not print, which names in the input may hold, are escaped: a line stays a line.
    """

    def __init__(self, message: object):
        super().__init__("".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(message)))
