"""PWR: the regulator's scale, over-drive in its two steps, and the supply with its detector.

Times: over-drive is ready and switched after 45 us each (data sheet DS11853, over-drive switching, typical).
"""

from __future__ import annotations

from collections.abc import Callable

from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.peripherals.rcc import MICROSECOND
from neuroflight.sim.board.registers.bus import Device

OVER_DRIVE = 45 * MICROSECOND  # [cycles]
SUPPLY_MV = 3300
_PVD_MV = (2000, 2100, 2300, 2500, 2600, 2700, 2800, 2900)  # PLS 0..7, falling (data sheet)


class Pwr(Device):
    """The power control. `pll` returns whether the PLL is on and whether the core runs from it."""

    kept = ("words", "supply_mv")

    def __init__(self, engine: Engine) -> None:
        super().__init__(engine, "PWR")
        self.pll: Callable[[], tuple[bool, bool]] = lambda: (False, False)
        self.on_change: Callable[[], None] = lambda: None
        self.supply_mv = SUPPLY_MV
        self._ready = engine.alarm("pwr.overdrive", lambda: self.put("CSR1", "ODRDY", 1))
        self._switched = engine.alarm("pwr.switch", self._become_switched)
        self.put("CSR1", "VOSRDY", 1)

    def reset(self) -> None:
        super().reset()
        self._ready.cancel()
        self._switched.cancel()
        self.put("CSR1", "VOSRDY", 1)

    @property
    def scale(self) -> tuple[int, bool]:
        """The regulator's scale 1 to 3, and whether over-drive is switched on (RM0431 4.4.1)."""
        return 4 - max(self.get("CR1", "VOS"), 1), bool(self.get("CSR1", "ODSWRDY"))

    def write_cr1(self, value: int) -> None:
        changed = self.keep("CR1", value)
        fail, now = self.engine.fail, self.engine.cycle
        pll_on, pll_used = self.pll()
        if changed & self.mask("CR1", "VOS"):
            if self.get("CR1", "VOS") == 0:
                fail("PWR_CR1 VOS is 0, which is reserved; expected 1, 2 or 3")
            if pll_on:
                fail("PWR_CR1 VOS is changed while the PLL is on, expected before")
        if changed & self.mask("CR1", "ODEN"):
            if self.get("CR1", "ODEN"):
                self._ready.set(now + OVER_DRIVE)
            else:
                self._ready.cancel()
                self.put("CSR1", "ODRDY", 0)
        if changed & self.mask("CR1", "ODSWEN"):
            if pll_used:
                fail("PWR_CR1 ODSWEN is changed while the core runs from the PLL, expected HSI or HSE")
            if not self.get("CR1", "ODSWEN"):
                self._switched.cancel()
                self.put("CSR1", "ODSWRDY", 0)
            elif not self.get("CSR1", "ODRDY"):
                fail("PWR_CR1 ODSWEN is set before PWR_CSR1 ODRDY")
            else:
                self._switched.set(now + OVER_DRIVE)

    def read_csr1(self) -> int:
        low = self.get("CR1", "PVDE") and self.supply_mv < _PVD_MV[self.get("CR1", "PLS")]
        self.put("CSR1", "PVDO", 1 if low else 0)
        return self.words["CSR1"]

    def write_csr1(self, value: int) -> None:
        """Ignore the write: the ready flags are the regulator's (UDRDY is not modelled)."""

    def _become_switched(self) -> None:
        self.put("CSR1", "ODSWRDY", 1)
        self.on_change()
