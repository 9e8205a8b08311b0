"""Betaflight's `diff` and `dump` files: what of them has a counterpart among this firmware's settings."""
