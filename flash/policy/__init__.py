"""The policy that a board flies: what its slots hold, another one into a slot, back to the one before."""
