"""Puts values in the scratch memory: those that are not needed at the same time share space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from neuroflight.toolchain.codegen.kernel_calls import BufferPlace, Call


@dataclass(frozen=True)
class PendingCall:
    """A call whose scratch buffers have no place yet."""

    call: Call
    target: int | None  # buffer
    sources: tuple[int | None, ...]  # buffers
    size: int = 0  # floats that it writes in the target


def place_buffers(pending: Sequence[PendingCall]) -> tuple[list[Call], int, int]:
    """Return the calls with their scratch buffers placed, the floats needed, and the floats needed without
    sharing.

    Buffers are placed by size, the largest first, each at the lowest place where it meets no other that
    lives at the same time; what a call reads and what it writes live at the same time.
    """
    sizes: dict[int, int] = {}
    lives: dict[int, tuple[int, int]] = {}
    for moment, one in enumerate(pending):
        for buffer in (one.target, *one.sources):
            if buffer is not None:
                lives[buffer] = (lives.get(buffer, (moment, moment))[0], moment)
        if one.target is not None:
            sizes[one.target] = max(sizes.get(one.target, 0), one.size)
    places: dict[int, int] = {}
    for buffer in sorted(sizes, key=lambda number: (-sizes[number], number)):
        begin, end = lives[buffer]
        taken = sorted(
            (place, place + sizes[other])
            for other, place in places.items()
            if lives[other][0] <= end and begin <= lives[other][1]
        )
        place = 0
        for low, high in taken:
            if place + sizes[buffer] <= low:
                break
            place = max(place, high)
        places[buffer] = place

    def put(place: BufferPlace, buffer: int | None) -> BufferPlace:
        return place if buffer is None else replace(place, offset=places[buffer] + place.offset)

    calls = [
        replace(
            one.call,
            target=None if one.call.target is None else put(one.call.target, one.target),
            sources=tuple(put(p, b) for p, b in zip(one.call.sources, one.sources, strict=True)),
        )
        for one in pending
    ]
    used = max((places[buffer] + size for buffer, size in sizes.items()), default=0)
    return calls, used, sum(sizes.values())
