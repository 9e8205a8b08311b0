"""Boards on USB: found among this computer's devices, and what lets its user open them."""
