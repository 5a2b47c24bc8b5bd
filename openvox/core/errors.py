"""What goes wrong, as sentences.

An InputError is one sentence: where, what was found, what was expected, what to do.
The command line prints it and exits with 1; a traceback is shown with --debug only.
"""


class OpenvoxError(Exception):
    """Base of everything that openvox raises on purpose; its text is one sentence for people."""


class InputError(OpenvoxError):
    """An input (file, folder, stream, parameter) is not what it should be."""


class OutputError(OpenvoxError):
    """An output could not be written; nothing is left under its final name."""
