"""Decisions about a board: UARTs for each purpose, DMA streams, the ports through which motors are written.

A board is refused, by name, where the gyro, the first four motors, USB or a receiver cannot be served. Of all
else that collides the less important part is left alone, and told: the board flies without it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

from neuroflight.toolchain.boards.facts import Board, Bus, Chip, GyroPlace, Pin, Uart
from neuroflight.toolchain.boards.gyro_kinds import with_kin
from neuroflight.toolchain.boards.processor import (
    ADC_CHANNELS,
    FUNCTIONS,
    PADS,
    REQUESTS,
    USB_PINS,
    Stream,
)
from neuroflight.toolchain.contract import BOARD_MOTOR_PORTS_MAX, MOTOR_COUNT_MAX, BoardLog
from neuroflight.toolchain.errors import WiringError

MSP_USUAL, RECEIVER_USUAL, SECOND_USUAL = 1, 2, 3
MOTORS_NEEDED = 4  # where the board has as many: further ones give way
PORT_CHANNELS = (3, 4, 1, 2)  # of TIM1, in the order in which ports take them
_Claims = dict[Pin, str]  # pin -> what it serves


@dataclass(frozen=True)
class MotorPort:
    """A GPIO port that motors are wired to, and what writes it."""

    port: str
    channel: int  # of TIM1: its compare event asks for DMA
    stream: Stream


@dataclass(frozen=True)
class Allocation:
    """A board and what serves what on it. None: it flies without."""

    board: Board
    gyro_kinds: tuple[str, ...]  # that boards of this name may carry
    receiver: int  # number of its UART, of which the transmitter rests
    msp: int | None
    second: int | None
    log: bool
    gyros: tuple[GyroPlace, ...]  # a second one on SPI 0 is held deselected, no more
    log_chip: Chip | None  # where `log` is false its chip select is held high, no more
    motors: tuple[Pin, ...]
    ports: tuple[MotorPort, ...]
    streams: Mapping[str, Stream]  # request, such as SPI1_RX -> what hears it; of the ports by TIM1_CH3
    osd: Chip | None
    led: Pin | None
    beeper: Pin | None
    usb_supply: Pin | None
    volts: Pin | None
    amps: Pin | None
    left: tuple[str, ...]  # what it flies without and why, a line each


@dataclass(frozen=True)
class _Roles:
    """One way to serve what may be served in several."""

    receiver: int
    msp: int | None
    log: bool
    motors: int
    second: int | None
    second_gyro: bool


def allocate(board: Board, receiver: int | None = None) -> Allocation:
    """Decide what serves what. receiver: UART that the user wired one to, in place of the usual.

    Raises WiringError: one line with every part that has to be served and is not.
    """
    faults = [*_gyro_faults(board), *_motor_faults(board)]
    claims: _Claims = dict.fromkeys(USB_PINS, "USB")
    for part, pins in _needed(board):
        faults += _claim(claims, part, pins)
    if faults:
        raise WiringError(f"{board.name}: " + "; ".join(dict.fromkeys(faults)))
    receivers = _receivers(board, claims, receiver)
    log, second_gyro = _log_fault(board, claims), _second_gyro_fault(board, claims)
    # The gyro, the first motors and one receiver alone find streams on every board.
    roles, (ports, streams) = next(
        (roles, served)
        for roles in _choices(board, claims, receivers, log is None, second_gyro is None)
        if (served := _fitted(board, claims, roles)) is not None
    )
    _claim_roles(board, claims, roles)
    left = [*_without(board, claims, roles, streams, log, second_gyro)]
    gyro, *further = board.gyros
    rest: dict[str, Pin | None] = {}
    for part, pin in (
        ("second gyro's chip select", further[0].select if further and not roles.second_gyro else None),
        ("log's chip", board.log_chip.select if board.log_chip and not roles.log else None),
        *(("battery voltage", board.volts), ("battery current", board.amps)),
        *(("OSD", board.osd.select if board.osd else None), ("beeper", board.beeper), ("LED", board.led)),
        ("USB supply", board.usb_supply),
    ):
        why = _unusable(claims, part, pin)
        left += [why] if why else []
        rest[part] = None if why else pin
        if pin is not None and not why:
            claims[pin] = part
    kinds = with_kin(board.gyro_kinds)
    if gyro.ready is None:
        left.append("data-ready line of the gyro: not told, so it is read at a timer's beat")
    if not roles.second_gyro:  # on a bus that is driven, or not: it must not speak there
        held = rest["second gyro's chip select"] is not None
        further = [replace(place, spi=0, ready=None) for place in further if held]
    return Allocation(
        board=board,
        gyro_kinds=kinds,
        receiver=roles.receiver,
        msp=roles.msp,
        second=roles.second,
        log=roles.log,
        gyros=(gyro, *further[:1]),
        log_chip=board.log_chip if roles.log or rest["log's chip"] else None,
        motors=board.motors[: roles.motors],
        ports=ports,
        streams=streams,
        osd=board.osd if rest["OSD"] else None,
        led=rest["LED"],
        beeper=rest["beeper"],
        usb_supply=rest["USB supply"],
        volts=rest["battery voltage"],
        amps=rest["battery current"],
        left=tuple(left),
    )


def bus_functions(number: int, bus: Bus) -> dict[str, int | None]:
    """Return the alternate function of each pin of an SPI by signal; None: that pin cannot carry it."""
    pins = {"SCK": bus.sck, "MISO": bus.miso, "MOSI": bus.mosi}
    return {signal: FUNCTIONS[f"SPI{number}_{signal}"].get(pin) for signal, pin in pins.items()}


def uart_function(number: int, signal: str, pin: Pin) -> int | None:
    """Return the alternate function by which a pin is that UART's TX or RX; None: it cannot be."""
    return FUNCTIONS[f"UART{number}_{signal}"].get(pin)


# --- What has to be served ---------------------------------------------------------------------------
def _gyro_faults(board: Board) -> Iterator[str]:
    if not board.gyros:
        yield "where its gyro is wired to is not told; expected an SPI and a chip select"
        return
    kinds = with_kin(board.gyro_kinds)
    if not kinds:
        told = ", ".join(board.gyro_kinds) or "none"
        yield f"its gyro is not one that the firmware knows: {told}"
    gyro = board.gyros[0]
    if (bus := board.buses.get(gyro.spi)) is None:
        yield f"its gyro is on SPI{gyro.spi}, whose pins are not told"
    else:
        yield from _bus_faults(gyro.spi, bus)


def _bus_faults(number: int, bus: Bus) -> Iterator[str]:
    for signal, function in bus_functions(number, bus).items():
        if function is None:
            pin = getattr(bus, signal.lower())
            able = ", ".join(map(str, FUNCTIONS[f"SPI{number}_{signal}"]))
            yield f"{pin} cannot be SPI{number}'s {signal}, expected {able}"


def _motor_faults(board: Board) -> Iterator[str]:
    if not board.motors:
        yield "no motor output is told"
    ports = list(dict.fromkeys(pin.port for pin in board.motors[:MOTORS_NEEDED]))
    if len(ports) > BOARD_MOTOR_PORTS_MAX:
        yield (
            f"its first {MOTORS_NEEDED} motors are on {len(ports)} ports, {', '.join(ports)}; "
            f"DMA streams write {BOARD_MOTOR_PORTS_MAX}"
        )


def _needed(board: Board) -> Iterator[tuple[str, Sequence[Pin]]]:
    """Yield the pins of what has to be served, by name."""
    for gyro in board.gyros[:1]:
        if (bus := board.buses.get(gyro.spi)) is not None:
            yield f"SPI{gyro.spi}", (bus.sck, bus.miso, bus.mosi)
        yield "the gyro's chip select", (gyro.select,)
        if gyro.ready is not None:
            yield "the gyro's data-ready line", (gyro.ready,)
    for index, pin in enumerate(board.motors[:MOTORS_NEEDED]):
        yield f"motor {index + 1}", (pin,)


def _claim(claims: _Claims, part: str, pins: Iterable[Pin]) -> Iterator[str]:
    for pin in pins:
        if (why := _unusable(claims, part, pin)) is not None:
            yield why
        claims.setdefault(pin, part)


def _unusable(claims: Mapping[Pin, str], part: str, pin: Pin | None) -> str | None:
    """Return why that pin cannot serve a part, naming both; None: it can, or there is none."""
    if pin is None:
        return None
    if pin not in PADS:
        return f"{part}: the STM32F722 in 64 pins has no {pin}"
    if pin in claims:
        return f"{part}: {pin} serves {claims[pin]}"
    if part.startswith("battery") and pin not in ADC_CHANNELS:
        return f"{part}: {pin} is no input of the converter"
    return None


# --- What may be served in several ways -----------------------------------------------------------------
def _receivers(board: Board, claims: Mapping[Pin, str], wanted: int | None) -> list[int]:
    """Return the UARTs that can hear a receiver, the preferred first. Raises WiringError: there is none."""
    able = [n for n in sorted(board.uarts) if _has(board, claims, n, "RX")]
    if wanted is not None:
        if wanted not in able:
            raise WiringError(
                f"{board.name}: UART{wanted} cannot hear a receiver, expected one of "
                f"{', '.join(f'UART{n}' for n in able) or 'none'}"
            )
        return [wanted]
    if not able:
        raise WiringError(f"{board.name}: it brings out no UART that could hear a receiver")
    return _first(able, board.receiver, RECEIVER_USUAL)


def _has(board: Board, claims: Mapping[Pin, str], number: int, *signals: str) -> bool:
    """Return whether the board brings that UART's signals out, on pins that carry them and are free."""
    uart = board.uarts[number]
    pins = [(signal, getattr(uart, signal.lower())) for signal in signals]
    return all(
        pin is not None and pin not in claims and uart_function(number, signal, pin) is not None
        for signal, pin in pins
    )


def _first(numbers: Iterable[int], *preferred: int | None) -> list[int]:
    """Return the numbers, those preferred first."""
    place = {number: at for at, number in reversed(list(enumerate(preferred)))}
    return sorted(numbers, key=lambda number: (place.get(number, len(preferred)), number))


def _choices(
    board: Board, claims: Mapping[Pin, str], receivers: Sequence[int], log: bool, second_gyro: bool
) -> Iterator[_Roles]:
    """Yield ways to serve all, the best first: what is given up first is the second gyro, then a UART."""
    lines = [n for n in board.uarts if _has(board, claims, n, "TX", "RX")]
    motors = min(len(board.motors), MOTOR_COUNT_MAX)
    fewest = min(motors, MOTORS_NEEDED)
    for receiver, with_msp, with_log, count, msp, second, gyro in product(
        receivers,
        [True, False],
        [True, False] if log else [False],
        range(motors, fewest - 1, -1),
        [*_first(lines, MSP_USUAL), None],
        [*_first(lines, SECOND_USUAL), None],
        [True, False] if second_gyro else [False],
    ):
        if with_msp == (msp is not None) and len({receiver, msp, second, None}) == 2 + (msp is not None) + (
            second is not None
        ):
            yield _Roles(receiver, msp, with_log, count, second, gyro)


def _log_fault(board: Board, claims: Mapping[Pin, str]) -> str | None:
    """Return why the chip for logs cannot be used whatever else is; None: it may, or there is none."""
    chip = board.log_chip
    if board.log_kind is BoardLog.NONE or chip is None:
        return "log: no chip is told that keeps one"
    if chip.spi == board.gyros[0].spi:
        return f"log: its chip shares SPI{chip.spi} with the gyro, which has it alone"
    bus = board.buses.get(chip.spi)
    if bus is None:
        return f"log: its chip is on SPI{chip.spi}, whose pins are not told"
    for fault in _bus_faults(chip.spi, bus):
        return f"log: {fault}"
    return next(_claim(dict(claims), "log", (bus.sck, bus.miso, bus.mosi, chip.select)), None)


def _second_gyro_fault(board: Board, claims: Mapping[Pin, str]) -> str | None:
    """Return why a second gyro cannot be used whatever else is; None: it may, or there is none."""
    if not board.gyros[1:]:
        return "second gyro: there is none"
    gyro, place = board.gyros[:2]
    if place.spi == 0:
        return "second gyro: its SPI is not told"
    pins = [pin for pin in (place.select, place.ready) if pin is not None]
    if place.spi != gyro.spi:
        if (bus := board.buses.get(place.spi)) is None:
            return f"second gyro: it is on SPI{place.spi}, whose pins are not told"
        for fault in _bus_faults(place.spi, bus):
            return f"second gyro: {fault}"
        pins += [bus.sck, bus.miso, bus.mosi]
    return next(_claim(dict(claims), "second gyro", pins), None)


def _fitted(
    board: Board, claims: Mapping[Pin, str], roles: _Roles
) -> tuple[tuple[MotorPort, ...], dict[str, Stream]] | None:
    """Return the ports and streams that serve these roles; None: pins or streams collide."""
    taken = dict(claims)
    if any(_claim_roles(board, taken, roles)):
        return None
    pins = board.motors[: roles.motors]
    ports = list(dict.fromkeys(pin.port for pin in pins))
    if len(ports) > BOARD_MOTOR_PORTS_MAX:
        return None
    spi = board.gyros[0].spi
    requests = [f"SPI{spi}_RX", f"SPI{spi}_TX", f"UART{roles.receiver}_RX"]
    if {board.volts, board.amps} & set(ADC_CHANNELS):
        requests.append("ADC1")
    if roles.log and board.log_chip is not None:
        requests += [f"SPI{board.log_chip.spi}_RX", f"SPI{board.log_chip.spi}_TX"]
    if roles.second_gyro and (further := board.gyros[1].spi) != spi:
        if roles.log and board.log_chip is not None and board.log_chip.spi == further:
            return None
        requests += [f"SPI{further}_RX", f"SPI{further}_TX"]
    for line in (roles.msp, roles.second):
        requests += [f"UART{line}_RX", f"UART{line}_TX"] if line is not None else []
    for channels in _channels(len(ports)):
        streams = _streams([*requests, *(f"TIM1_CH{channel}" for channel in channels)])
        if streams is not None:
            served = zip(ports, channels, strict=True)
            return tuple(MotorPort(port, c, streams[f"TIM1_CH{c}"]) for port, c in served), streams
    return None


def _claim_roles(board: Board, claims: _Claims, roles: _Roles) -> list[str]:
    """Claim the pins of these roles. Returns what collides."""
    faults: list[str] = []
    for index, pin in enumerate(board.motors[MOTORS_NEEDED : roles.motors], MOTORS_NEEDED + 1):
        faults += _claim(claims, f"motor {index}", (pin,))
    faults += _claim(claims, f"the receiver on UART{roles.receiver}", _pins(board, roles.receiver, "rx"))
    for line in (roles.msp, roles.second):
        if line is not None:
            faults += _claim(claims, f"UART{line}", _pins(board, line, "tx", "rx"))
    if roles.log and (chip := board.log_chip) is not None:
        bus = board.buses[chip.spi]
        faults += _claim(claims, "log", (bus.sck, bus.miso, bus.mosi, chip.select))
    if roles.second_gyro:
        place = board.gyros[1]
        shared = place.spi == board.gyros[0].spi
        bus_pins = () if shared else tuple(vars(board.buses[place.spi]).values())
        pins = (place.select, place.ready, *bus_pins)
        faults += _claim(claims, "second gyro", [pin for pin in pins if pin is not None])
    return faults


def _pins(board: Board, number: int, *signals: str) -> list[Pin]:
    uart: Uart = board.uarts[number]
    return [pin for signal in signals if (pin := getattr(uart, signal)) is not None]


def _channels(ports: int) -> Iterator[tuple[int, ...]]:
    """Yield channels of TIM1 for the ports in turn, those first that ports usually take."""
    usual = PORT_CHANNELS[:ports]
    yield usual
    for chosen in product(PORT_CHANNELS, repeat=ports):
        if len(set(chosen)) == ports and chosen != usual:
            yield chosen


def _streams(
    requests: Sequence[str], taken: frozenset[tuple[int, int]] = frozenset()
) -> dict[str, Stream] | None:
    """Return a stream for each request, none for two; None: there is no such way."""
    if not requests:
        return {}
    first, *others = requests
    for stream in REQUESTS[first]:
        if stream.place not in taken:
            rest = _streams(others, taken | {stream.place})
            if rest is not None:
                return {first: stream} | rest
    return None


def _without(
    board: Board,
    claims: Mapping[Pin, str],
    roles: _Roles,
    streams: Mapping[str, Stream],
    log: str | None,
    second_gyro: str | None,
) -> Iterator[str]:
    """Yield what these roles leave out of what the board has and why, a line each."""
    if board.receiver is not None and board.receiver != roles.receiver:
        yield f"receiver: on UART{roles.receiver}, not on UART{board.receiver} as its maker has it"
    for part, line in (("MSP", roles.msp), ("second serial port", roles.second)):
        if line is None:
            others = [n for n in board.uarts if n not in (roles.receiver, roles.msp)]
            why = [_obstacle(board, claims, streams, n) for n in _first(others, SECOND_USUAL)]
            yield f"{part}: " + ("; ".join(why) or "the board brings out no other UART")
    if not roles.log:
        chip = board.log_chip
        yield log or f"log: {_blocked(streams, f'SPI{chip.spi}') if chip else ''}"
    if board.gyros[1:] and not roles.second_gyro:
        chip, bus = board.log_chip, board.gyros[1].spi
        shares = chip is not None and roles.log and chip.spi == bus
        yield second_gyro or (
            f"second gyro: it shares SPI{bus} with the log"
            if shares
            else f"second gyro: {_blocked(streams, f'SPI{bus}')}"
        )
    if roles.motors < len(board.motors):
        pin = board.motors[roles.motors]
        why_not = _unusable(claims, f"motor {roles.motors + 1}", pin)
        yield why_not or (
            f"motors {roles.motors + 1} to {len(board.motors)}: port {pin.port} is one too many for DMA2"
        )


def _obstacle(board: Board, claims: Mapping[Pin, str], streams: Mapping[str, Stream], number: int) -> str:
    """Return why a UART is not a serial port here."""
    uart = board.uarts[number]
    for signal, pin in (("TX", uart.tx), ("RX", uart.rx)):
        if pin is None:
            return f"UART{number} has no {signal} here"
        if pin in claims:
            return f"UART{number}: {pin} serves {claims[pin]}"
        if uart_function(number, signal, pin) is None:
            return f"UART{number}: {pin} cannot be its {signal}"
    return _blocked(streams, f"UART{number}")


def _blocked(streams: Mapping[str, Stream], part: str) -> str:
    """Return which of a part's requests finds its DMA streams taken, and by what."""
    takers = {stream.place: request for request, stream in streams.items()}
    for request in (f"{part}_RX", f"{part}_TX"):
        if all(stream.place in takers for stream in REQUESTS[request]):
            serves = (f"{stream} serves {takers[stream.place]}" for stream in REQUESTS[request])
            return f"{request}: {', '.join(serves)}"
    return f"{part}: its DMA streams serve others"
