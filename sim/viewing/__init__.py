"""A flight shown by the aircraft in its attitudes: page, window, animation, poses side by side."""
