"""Every experiment of the dissertation again: what is run, and its figures beside ours."""
