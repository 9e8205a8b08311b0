"""RCC: oscillators with their start-up times, the clock tree, enables, resets and the causes of a reset.

Everything that the image sets is checked when it takes effect: a clock that is not ready, a PLL out of its
range, buses above their limit, wait states too few. Start-up times are the data sheet's typical ones
(DS11853, electrical characteristics of HSE, HSI, LSI and PLL).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.registers.bus import Device, load_table

HSI_HZ = 16_000_000
LSI_HZ = 32_000
HSE_HZ = 8_000_000  # the board's crystal

MICROSECOND = TIME_HZ // 1_000_000  # [cycles]
HSI_START = 2 * MICROSECOND
HSE_START = 2000 * MICROSECOND
PLL_LOCK = 200 * MICROSECOND
LSI_START = 40 * MICROSECOND

_HSI, _HSE, _PLL = range(3)  # RCC_CFGR SW and SWS
_SOURCES = ("HSI", "HSE", "PLL")
_AHB_SHIFTS = (1, 2, 3, 4, 6, 7, 8, 9)  # HPRE 8..15: divided by 2, 4, 8, 16, 64, ...
_VCO_IN = (950_000, 2_100_000)  # [Hz] (data sheet, PLL characteristics)
_VCO_OUT = (100_000_000, 432_000_000)
# Longest core clock and its buses [Hz] by regulator scale, over-drive off and on (RM0431 4.1.4; data sheet,
# general operating conditions).
_CORE_MAX = {1: (180_000_000, 216_000_000), 2: (168_000_000, 180_000_000), 3: (144_000_000, 144_000_000)}
_APB1_MAX = (45_000_000, 54_000_000)
_APB2_MAX = (90_000_000, 108_000_000)
_FLAGS = {  # RCC_CSR after a reset, beside those that are still set; NRST is pulled low by every one
    "power": ("PORRSTF", "PADRSTF", "BORRSTF"),
    "brown-out": ("PADRSTF", "BORRSTF"),
    "pin": ("PADRSTF",),
    "software": ("SFTRSTF", "PADRSTF"),
    "iwdg": ("WDGRSTF", "PADRSTF"),
}
_ENABLES = {"AHB1ENR": "AHB1RSTR", "AHB2ENR": "AHB2RSTR", "APB1ENR": "APB1RSTR", "APB2ENR": "APB2RSTR"}
# Devices behind one bit that enables them, and behind one that resets them.
_OTG = ("OTG_FS_GLOBAL", "OTG_FS_DEVICE", "OTG_FS_PWRCLK", *(f"OTG_FS_FIFO{i}" for i in range(6)))
_CLOCKED = {"ADC1": ("ADC1", "ADC_Common"), "OTGFS": _OTG}
_RESET = {"ADC": ("ADC1", "ADC_Common"), "OTGFS": _OTG}


@dataclass(frozen=True)
class Clocks:
    """Frequencies [Hz] of the clock tree."""

    core: int  # AHB too
    apb1: int
    apb2: int
    timer1: int  # of timers on APB1
    timer2: int  # of timers on APB2


class Rcc(Device):
    """Reset and clock control. `latency` and `scale` are read when a clock is about to change."""

    kept = ("words", "crystal_dead", "clocks")

    def __init__(self, engine: Engine) -> None:
        super().__init__(engine, "RCC")
        self.latency: Callable[[], int] = lambda: 15  # flash wait states
        self.scale: Callable[[], tuple[int, bool]] = lambda: (1, True)  # regulator scale, over-drive switched
        self.detects_brown_out: Callable[[], bool] = lambda: True  # by a threshold in the option bytes
        self.on_clocks: list[Callable[[Clocks], None]] = []
        self.after_reset: list[Callable[[], None]] = []  # chips beside the processor, whose alarms are gone
        self.crystal_dead = False
        self._irq = load_table().interrupt("RCC")
        self._gated: dict[str, Device] = {}
        self._ready = {
            f"{name}RDY": engine.alarm(f"rcc.{name.lower()}", partial(self._become_ready, f"{name}RDY"))
            for name in ("HSI", "HSE", "PLL", "LSI")
        }
        for enables, resets in _ENABLES.items():
            setattr(self, f"write_{enables.lower()}", partial(self._enable_devices, enables))
            setattr(self, f"write_{resets.lower()}", partial(self._reset_devices, resets))
        engine.on_system_reset(self._note_cause)
        self.clocks = self._tree()

    def govern(self, devices: dict[str, Device]) -> None:
        """Let `devices` run only while their enable bit is set."""
        for register in _ENABLES:
            for field in self.block.registers[register].fields.values():
                owner = field.name.removesuffix("EN")
                for name in _CLOCKED.get(owner, (owner,)):
                    if field.modelled and name in devices:
                        devices[name].gate = f"RCC_{register} {field.name}"
                        self._gated[name] = devices[name]
        self._spread_enables()

    def reset(self) -> None:
        flags = self.words["CSR"]
        super().reset()
        self.words["CSR"] = flags & ~self.mask("CSR", "LSION", "LSIRDY")
        for alarm in self._ready.values():
            alarm.cancel()
        self._spread_enables()
        self._change_clocks()
        self._update_irq()
        for listener in self.after_reset:
            listener()

    def fail_crystal(self) -> None:
        """Stop the crystal for good, as injected by a fault campaign."""
        self.crystal_dead = True
        was_ready = self.get("CR", "HSERDY")
        self.put("CR", "HSERDY", 0)
        self._ready["HSERDY"].cancel()
        if not was_ready:
            return
        runs_on_it = self._uses_crystal()
        if not self.get("CR", "CSSON"):
            if runs_on_it:
                self.engine.fail(
                    "the crystal failed and RCC_CR CSSON is 0: the core stands still, expected the clock "
                    "security system on before the core depends on HSE"
                )
            return
        self.put("CR", "HSEON", 0)
        if self.get("PLLCFGR", "PLLSRC"):
            self.put("CR", "PLLON", 0)
            self.put("CR", "PLLRDY", 0)
        if runs_on_it:
            self.put("CR", "HSION", 1)
            self.put("CR", "HSIRDY", 1)
            self.put("CFGR", "SW", _HSI)
            self.put("CFGR", "SWS", _HSI)
        self.put("CIR", "CSSF", 1)
        self._change_clocks()
        self.engine.nmi()

    def check(self) -> None:
        """Check the clocks against the limits of flash, regulator and buses. Called whenever one changes."""
        clocks, (scale, over_drive) = self.clocks, self.scale()
        fail = self.engine.fail
        needed = wait_states(clocks.core)
        if self.latency() < needed:
            fail(
                f"flash wait states too few: FLASH_ACR LATENCY is {self.latency()} at {_mhz(clocks.core)}, "
                f"expected {needed} or more"
            )
        core_max = _CORE_MAX[scale][over_drive]
        for name, hz, most in (
            ("the core", clocks.core, core_max),
            ("APB1", clocks.apb1, _APB1_MAX[over_drive]),
            ("APB2", clocks.apb2, _APB2_MAX[over_drive]),
        ):
            if hz > most:
                fail(
                    f"{name} runs at {_mhz(hz)}, expected {_mhz(most)} at most with voltage scale {scale} "
                    f"and over-drive {'on' if over_drive else 'off'}"
                )

    def kernel_clock(self, name: str) -> int:
        select = self.get("DCKCFGR2", f"{name}SEL")
        bus = self.clocks.apb2 if name in ("USART1", "USART6") else self.clocks.apb1
        if select == 3:
            self.engine.fail(f"{name} is clocked by LSE, which this board does not have")
        return (bus, self.clocks.core, HSI_HZ)[select]

    @property
    def usb_hz(self) -> float:
        """Clock of OTG_FS [Hz], from the PLL (CK48MSEL 0); 0 while that is off."""
        if not self.get("CR", "PLLRDY"):
            return 0.0
        m, n, q = (self.get("PLLCFGR", field) for field in ("PLLM", "PLLN", "PLLQ"))
        return (HSE_HZ if self.get("PLLCFGR", "PLLSRC") else HSI_HZ) / m * n / q

    # What the image writes

    def write_cr(self, value: int) -> None:
        changed = self.keep("CR", value)
        if changed & self.mask("CR", "HSION"):
            self._switch("HSI", "HSION", "HSIRDY", HSI_START, self.get("CFGR", "SWS") == _HSI)
        if changed & self.mask("CR", "HSEON"):
            self._switch(
                "HSE", "HSEON", "HSERDY", None if self.crystal_dead else HSE_START, self._uses_crystal()
            )
        if changed & self.mask("CR", "PLLON"):
            if self.get("CR", "PLLON"):
                self._check_pll()
            self._switch("PLL", "PLLON", "PLLRDY", PLL_LOCK, self.get("CFGR", "SWS") == _PLL)

    def write_pllcfgr(self, value: int) -> None:
        if self.keep("PLLCFGR", value) and self.get("CR", "PLLON"):
            self.engine.fail("RCC_PLLCFGR is changed while the PLL is on, expected RCC_CR PLLON 0")

    def write_cfgr(self, value: int) -> None:
        self.keep("CFGR", value)
        source = self.get("CFGR", "SW")
        if source == 3:
            self.engine.fail("RCC_CFGR SW is 3, expected 0 (HSI), 1 (HSE) or 2 (PLL)")
        if not self.get("CR", f"{_SOURCES[source]}RDY"):
            self.engine.fail(f"the core is switched to {_SOURCES[source]}, which is not ready")
        self.put("CFGR", "SWS", source)
        self._change_clocks()

    def write_cir(self, value: int) -> None:
        self.keep("CIR", value)
        for field in self.block.registers["CIR"].fields.values():
            if field.access == "w" and value & field.mask:  # it clears a flag, and itself
                self.put("CIR", f"{field.name[:-1]}F", 0)
                self.put("CIR", field.name, 0)
        self._update_irq()

    def write_csr(self, value: int) -> None:
        before = self.words["CSR"]
        self.words["CSR"] = before & ~self.mask("CSR", "LSION") | value & self.mask("CSR", "LSION")
        if value & self.mask("CSR", "RMVF"):
            self.words["CSR"] &= self.mask("CSR", "LSION", "LSIRDY")
        if (before ^ value) & self.mask("CSR", "LSION"):
            if value & self.mask("CSR", "LSION"):
                self._ready["LSIRDY"].set(self.engine.cycle + LSI_START)
            else:
                self._ready["LSIRDY"].cancel()
                self.put("CSR", "LSIRDY", 0)

    def write_dckcfgr1(self, value: int) -> None:
        self.keep("DCKCFGR1", value)
        self._change_clocks()

    def restore(self, state: dict[str, object]) -> None:
        super().restore(state)
        self._spread_enables()

    def _note_cause(self, cause: str) -> None:
        if cause == "brown-out" and not self.detects_brown_out():
            cause = "power"
        if cause == "power":
            self.words["CSR"] = 0
        self.words["CSR"] |= self.mask("CSR", *_FLAGS[cause])

    def _switch(self, name: str, enable: str, ready: str, delay: int | None, in_use: bool) -> None:
        """Switch an oscillator on, ready after `delay` cycles (None: never), or off."""
        if self.get("CR", enable):
            if delay is not None:
                self._ready[ready].set(self.engine.cycle + delay)
            return
        if in_use:
            self.engine.fail(f"{name} is switched off while the core runs from it")
        self._ready[ready].cancel()
        self.put("CR", ready, 0)

    def _become_ready(self, field: str) -> None:
        self.put("CSR" if field == "LSIRDY" else "CR", field, 1)
        if self.get("CIR", f"{field}IE"):
            self.put("CIR", f"{field}F", 1)
            self._update_irq()

    def _update_irq(self) -> None:
        # Flags HSIRDYF.. lie at bits 0.., their enables at bits 8.. (RM0431 5.3.4).
        self.engine.irq(self._irq, bool(self.words["CIR"] & self.words["CIR"] >> 8 & 0x7F))

    def _uses_crystal(self) -> bool:
        source = self.get("CFGR", "SWS")
        return source == _HSE or (source == _PLL and bool(self.get("PLLCFGR", "PLLSRC")))

    def _check_pll(self) -> None:
        crystal = self.get("PLLCFGR", "PLLSRC")
        source = "HSE" if crystal else "HSI"
        if not self.get("CR", f"{source}RDY"):
            self.engine.fail(f"the PLL is switched on before its source {source} is ready")
        m, n, q = (self.get("PLLCFGR", field) for field in ("PLLM", "PLLN", "PLLQ"))
        if m < 2 or not 50 <= n <= 432 or q < 2:
            self.engine.fail(
                f"PLLM is {m}, PLLN {n}, PLLQ {q}; expected 2 to 63, 50 to 432 and 2 to 15 (RM0431 5.3.2)"
            )
        base = (HSE_HZ if crystal else HSI_HZ) / m
        for name, hz, (least, most) in (("input", base, _VCO_IN), ("output", base * n, _VCO_OUT)):
            if not least <= hz <= most:
                self.engine.fail(
                    f"the PLL's VCO {name} is {_mhz(hz)}, expected {_mhz(least)} to {_mhz(most)}"
                )

    def _tree(self) -> Clocks:
        source = self.get("CFGR", "SWS")
        hz = (HSI_HZ, HSE_HZ, 0)[source]
        if source == _PLL:
            m, n = self.get("PLLCFGR", "PLLM"), self.get("PLLCFGR", "PLLN")
            base = HSE_HZ if self.get("PLLCFGR", "PLLSRC") else HSI_HZ
            hz = base * n // m // (2 * self.get("PLLCFGR", "PLLP") + 2)
        ahb = self.get("CFGR", "HPRE")
        core = hz >> _AHB_SHIFTS[ahb - 8] if ahb >= 8 else hz
        shifts = [max(self.get("CFGR", field) - 3, 0) for field in ("PPRE1", "PPRE2")]
        # Timers: the bus's clock, twice that where the bus is divided, up to four times with TIMPRE
        # (RM0431 5.2).
        most = 4 if self.get("DCKCFGR1", "TIMPRE") else 2
        timers = [min(core, (core >> shift) * most) for shift in shifts]
        return Clocks(core, core >> shifts[0], core >> shifts[1], *timers)

    def _change_clocks(self) -> None:
        clocks = self._tree()
        if clocks == self.clocks:
            return
        self.clocks = clocks
        self.check()
        self.engine.core_clock(clocks.core)
        for listener in self.on_clocks:
            listener(clocks)

    def _enable_devices(self, register: str, value: int) -> None:
        self.keep(register, value)
        self._spread_enables()

    def _spread_enables(self) -> None:
        for device in self._gated.values():
            register, field = device.gate.removeprefix("RCC_").split(" ")
            device.clocked = bool(self.get(register, field))

    def _reset_devices(self, register: str, value: int) -> None:
        changed = self.keep(register, value) & self.words[register]
        for field in self.block.registers[register].fields.values():
            if changed & field.mask:
                name = field.name.removesuffix("RST")
                for device in _RESET.get(name, (name,)):
                    if device in self._gated:
                        self._gated[device].reset()


def wait_states(hz: int) -> int:
    """Return the least FLASH_ACR LATENCY at core clock `hz` with 2.7 to 3.6 V: one more each 30 MHz, 7 at
    most.

    Source: RM0431 3.3.2, number of wait states according to CPU clock frequency.
    """
    return min(max(-(-hz // 30_000_000) - 1, 0), 7)


def _mhz(hz: float) -> str:
    return f"{hz / 1e6:g} MHz"
