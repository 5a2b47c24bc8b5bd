"""One file a command: the work behind the command line, as functions that return plain data."""
