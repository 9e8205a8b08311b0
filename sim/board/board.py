"""The emulated MATEKF722 put together: the chip's peripherals, the gyro chip, the ESCs and the battery."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NoReturn

from sim.board.adc import Adc, AdcCommon
from sim.board.bus import Device, Registers, Touch
from sim.board.context import Bus, Context
from sim.board.dma import DmaSystem
from sim.board.dshot import Esc, Frame
from sim.board.exti import Exti
from sim.board.flash import Flash
from sim.board.gpio import Pins
from sim.board.gyro_chip import MPU6500, READY, GyroChip, GyroKind
from sim.board.iwdg import Iwdg
from sim.board.option_bytes import OptionBytes, signature
from sim.board.pwr import Pwr
from sim.board.rcc import Rcc
from sim.board.spi import Spi
from sim.board.syscfg import Syscfg
from sim.board.timer import Timer
from sim.board.usart import Usart

TIMERS = ("TIM1", "TIM2", "TIM3", "TIM4", "TIM5", "TIM8")
USARTS = ("USART1", "USART2", "USART3", "UART4", "UART5")
# Timer and channel behind each motor's line, motors 1 to 8 (the eighth's pin is USART2's transmitter too).
MOTORS = (
    *(("TIM8", channel) for channel in range(1, 5)),
    ("TIM3", 4),
    ("TIM1", 1),
    ("TIM4", 3),
    ("TIM5", 3),
)


class Hardware:
    """All that lies around the core, wired as on the board."""

    def __init__(
        self,
        context: Context,
        kind: GyroKind = MPU6500,
        *,
        options: OptionBytes | None = None,
        seed: int = 0,
        watchdog_resets: bool = False,
    ) -> None:
        """`watchdog_resets`: a missed watchdog resets the chip, as it does; else it is an error."""
        self.context = context
        self.rcc, self.pwr = Rcc(context), Pwr(context)
        self.flash = Flash(context, options, seed)
        self.pins = Pins(context)
        self.syscfg = Syscfg(context)
        self.exti = Exti(context, self.syscfg)
        self.dma = DmaSystem(context)
        self.gyro = GyroChip(context, self.pins, kind)
        self.spi = Spi(context, self.dma, self.pins, self.gyro, seed)
        self.timers = {name: Timer(context, name, self.dma, self.pins) for name in TIMERS}
        self.usarts = {
            name: Usart(context, name, self.dma, self.pins, self.rcc.kernel_clock) for name in USARTS
        }
        self.adc_common = AdcCommon(context)
        self.adc = Adc(context, self.adc_common, self.dma, self.pins)
        self.iwdg = Iwdg(context)
        self.escs = tuple(Esc(number, self._fail) for number in range(1, len(MOTORS) + 1))
        self.on_frame: Callable[[Frame], None] = lambda frame: None
        self.registers = Registers(context)
        for device in self._devices():
            self.registers.add(device)
        self._wire(watchdog_resets)

    def attach(self, bus: Bus) -> None:
        """Put the peripherals behind the engine's bus, and the factory's bytes into system memory."""
        self.registers.attach(bus)
        for address, data in signature():
            self.context.set_memory(address, data)

    def touched(self) -> tuple[Touch, ...]:
        """Every register that the image touched, with counts."""
        return self.registers.touched()

    def lose_power(self) -> None:
        """The supply goes and comes back: everything starts anew but flash and option bytes."""
        self.context.system_reset("power")

    def state(self) -> Any:  # noqa: ANN401
        """What the engine does not keep: chips beside the processor. Registers are attached peripherals."""
        return {"gyro": self.gyro.state(), "escs": [esc.state() for esc in self.escs]}

    def restore(self, state: Any) -> None:  # noqa: ANN401
        """After the engine has restored the attached peripherals."""
        self.gyro.restore(state["gyro"])
        for esc, saved in zip(self.escs, state["escs"], strict=True):
            esc.restore(saved)
        self.dma.relink()

    def _devices(self) -> tuple[Device, ...]:
        return (
            self.rcc,
            self.pwr,
            self.flash,
            *self.pins.ports.values(),
            self.syscfg,
            self.exti,
            *self.dma.controllers.values(),
            self.spi,
            *self.timers.values(),
            *self.usarts.values(),
            self.adc_common,
            self.adc,
            self.iwdg,
            Device(self.context, "DBGMCU"),
        )

    def _wire(self, watchdog_resets: bool) -> None:
        rcc, pwr = self.rcc, self.pwr
        rcc.govern(self.registers.devices)
        rcc.latency, rcc.scale = self.flash.latency, lambda: pwr.scale
        self.flash.on_latency = pwr.on_change = rcc.check
        pwr.pll = lambda: (bool(rcc.get("CR", "PLLON")), rcc.get("CFGR", "SWS") == 2)
        rcc.on_clocks += [
            self.spi.set_clock,
            self.adc.set_clock,
            *(t.set_clock for t in self.timers.values()),
        ]
        rcc.after_reset.append(self.gyro.processor_reset)
        for listener in rcc.on_clocks:
            listener(rcc.clocks)
        self.dma.devices = self.registers.devices
        self.pins.on_drive = self.exti.edge
        line = int(READY[2:])
        self.gyro.watches_fall = lambda: self.exti.watches_fall(line)
        self.context.on_system_reset(self._on_reset)
        for esc, (timer, channel) in zip(self.escs, MOTORS, strict=True):
            esc.on_frame = self._on_frame
            self.timers[timer].outputs[channel] = esc.pulses
        self.iwdg.by_hardware = lambda: self.flash.options.hardware_watchdog
        self.iwdg.reset()
        if not watchdog_resets:
            self.iwdg.on_timeout = lambda: self._fail(
                f"the watchdog was not fed for {self.iwdg.timeout_s * 1e3:.0f} ms: it would reset the chip"
            )

    def _on_frame(self, frame: Frame) -> None:
        self.on_frame(frame)

    def _on_reset(self, cause: str) -> None:
        if cause == "power":
            self.gyro.power_on()

    def _fail(self, message: str) -> NoReturn:
        self.context.fail(message)
