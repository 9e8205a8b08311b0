"""Kernels go over a value LANES floats at a time; every value has room for a multiple of them."""

LANES = 4


def padded(count: int) -> int:
    """Round `count` up to whole lanes."""
    return -(-count // LANES) * LANES
