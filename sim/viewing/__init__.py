"""A flight as pictures of the aircraft in its attitudes."""
