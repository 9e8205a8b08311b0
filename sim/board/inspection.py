"""Mistakes that no single access shows: every access is legal, but together they achieve nothing.

The board is inspected every 10 ms. Where a stream stands still, two more inspections follow, at distances
that are longer than a byte at 9600 baud and no multiple of an image's periods: a stream in use moves
something meanwhile.
"""

from __future__ import annotations

from collections.abc import Sequence

from neuroflight.sim.board.core.context import TIME_HZ, Kept
from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.devices.esc import Esc
from neuroflight.sim.board.native.library import NativeDevice
from neuroflight.sim.board.peripherals.dma import STREAMS, DmaSystem
from neuroflight.sim.board.peripherals.rcc import MICROSECOND
from neuroflight.sim.board.registers.bus import load_table

PERIOD = TIME_HZ // 100  # [cycles]
AGAIN = (1300 * MICROSECOND, 1700 * MICROSECOND)  # one after the other
_NAMES = tuple((f"S{stream}CR", f"S{stream}NDTR") for stream in range(STREAMS))  # of each stream's registers

Stream = tuple[int, int, int]  # controller, stream, items left


class Inspection(Kept):
    """A check for streams that wait in vain, broken-off frames, the gyro's pulse taken by a wrong edge."""

    kept = ("_waiting", "_again")

    def __init__(
        self, engine: Engine, dma: DmaSystem, exti: NativeDevice, line: int | None, escs: Sequence[Esc]
    ) -> None:
        """line: of EXTI, which the gyro's data-ready line is connected to; None: it is not."""
        self._engine, self._dma, self._exti, self._line, self._escs = engine, dma, exti, line, escs
        fields = load_table().blocks["DMA1"].registers["S0CR"].fields  # those of every stream are alike
        self._enabled, self._direction = fields["EN"].mask, fields["DIR"].mask
        self._alarm = engine.alarm("inspection", self._inspect)
        self._rest()

    def _rest(self) -> None:
        self._waiting: frozenset[Stream] = frozenset()  # as seen 10 ms ago, and at each inspection since then
        self._again = 0  # inspections that have followed the one after 10 ms

    def restart(self) -> None:
        """Restore the alarm after a reset of the chip."""
        self._rest()
        self._alarm.set(self._engine.cycle + PERIOD)

    def _inspect(self) -> None:
        self._validate_edge()
        for esc in self._escs:
            esc.inspect(self._engine.cycle)
        waiting = frozenset(self._to_peripherals())
        still = self._waiting & waiting
        if still and self._again < len(AGAIN):
            self._waiting = still
            self._alarm.set(self._engine.cycle + AGAIN[self._again])
            self._again += 1
            return
        if still:
            self._reject(*min(still))
        self._waiting, self._again = waiting, 0
        self._alarm.set(self._engine.cycle + PERIOD)

    def _to_peripherals(self) -> list[Stream]:
        """Return the enabled streams to peripherals with items left to move."""
        found = []
        for number, controller in self._dma.controllers.items():
            controller.sync()
            words = controller.words
            for stream, (settings, left) in enumerate(_NAMES):
                if words[settings] & self._enabled and words[settings] & self._direction:
                    found.append((number, stream, words[left]))
        return found

    def _reject(self, number: int, stream: int, left: int) -> None:
        controller = self._dma.controllers[number]
        channel, address = controller.get(f"S{stream}CR", "CHSEL"), controller.words[f"S{stream}PAR"]
        self._engine.fail(
            f"{controller.name} stream {stream} has waited more than {1000 * PERIOD // TIME_HZ} ms to move "
            f"{left} items to 0x{address:08X}, but nothing makes the requests of its "
            f"channel {channel}"
        )

    def _validate_edge(self) -> None:
        """Fail if only the end of the gyro's pulse is used: it begins with the sample and is 50 us long."""
        if self._line is None:
            return
        bit = 1 << self._line
        words = self._exti.words
        if words["IMR"] & words["FTSR"] & bit and not words["RTSR"] & bit:
            self._engine.fail(
                f"EXTI line {self._line} takes the falling edge of the gyro's data-ready pulse, 50 us after "
                f"the sample; expected the rising edge (EXTI_RTSR TR{self._line})"
            )
