"""The dissertation's experiments repeated: the commands that are run, and their figures beside its own."""
