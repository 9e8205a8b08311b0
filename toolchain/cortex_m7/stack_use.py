"""The deepest that an image's stack can become, without running it.

The compiler tells what each function reserves (-fstack-usage); calls are read from the linked code. A call
through a pointer names no callee: it may go to any function in a constant table of the C file that it is
written in, unless `POINTERS` says otherwise. The worst case is the deepest path of the program, and on it
each level of interrupts with the deepest path of its handlers: levels interrupt each other, handlers of one
level do not.

Every path is taken to be possible, and a function that ends in a jump to another to keep its own part.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from elftools.elf.elffile import ELFFile
from elftools.elf.sections import Symbol, SymbolTableSection

from neuroflight.toolchain.cortex_m7.disassembly import Instruction, disassemble
from neuroflight.toolchain.errors import BuildError

# What the core pushes before a handler: 8 words, the FPU's 18, and a word to align them (ARMv7-M B1.5.7).
EXCEPTION_BYTES = 108
THREAD = "reset_handler"
# From the least urgent level to the most: firmware/hal/stm32f7/core/core.h. `fault_handler` ends the program.
LEVELS = (
    ("gyro_sample_handler", "motors_answers_handler", "tick_handler"),
    ("motors_moved_handler",),
    ("gyro_edge_handler",),
    ("fault_handler",),
)


def _in(file: str, *names: str) -> tuple[str, ...]:
    return tuple(f"{file}:{name}" for name in names)


def _services(*names: str) -> tuple[str, ...]:
    return _in("background_services.c", *(f"background_{name}" for name in names))


_LINE = ("look", "waiting", "read", "room", "fill", "send", "sending")  # of a serial_line
_EVENTS = ("reset", "suspend", "setup", "received", "ended")  # of a USB controller
_FUNCTION = ("configure", "suspend", "request", "received", "ended", "cleared")  # of a usb_function

# Where calls through pointers go that no constant table of their own file holds: C file, or C file and
# function of the image, -> functions, or tables whose functions, by file and name.
POINTERS: Mapping[str, tuple[str, ...]] = {
    "boot.c": ("startup.c:reset_handler",),
    "gyro_chip.c:gyro_sample_handler": ("runtime.c:runtime_sample",),
    "gyro_chip.c:gyro_tick": ("runtime.c:runtime_gyro_silent",),
    "gyro_kinds.c": ("gyro_chip.c:gyro_transfer",),
    "hal.c": _in("runtime.c", "runtime_background", "runtime_name"),
    "msp_lines.c": (
        *_in("runtime.c", "runtime_link", "runtime_link_reset", "runtime_link_pause", "runtime_link_lost"),
        "runtime.c:runtime_link_busy",
        *_in("uart_line.c", *(f"uart_line_{name}" for name in _LINE)),
        *_in("usb_serial.c", *(f"serial_{name}" for name in _LINE)),
    ),
    "log_uart.c": _in("uart_line.c", *(f"uart_line_{name}" for name in _LINE)),
    "otg.c": _in("usb_device.c", *(f"device_{name}" for name in _EVENTS)),
    "usb_bus.c": ("usb_device.c:device_reset",),
    "usb_device.c": (
        "otg.c:controller",
        *_in("usb_serial.c", *(f"serial_{name}" for name in _FUNCTION)),
        *_in("usb_disk.c", *(f"disk_{name}" for name in _FUNCTION)),
    ),
    "usb_device.c:device_set_stall": ("otg.c:controller",),
    "usb_device.c:usb_device_stall": ("otg.c:controller",),
    "usb_serial.c": ("otg.c:controller",),
    "usb_disk.c": ("otg.c:controller", "usb_card.c:medium"),
    "flash.c:flash_at": ("hal.c:hal_flash_at",),
    "flash.c:flash_erase": ("flash_memory.c:flash_memory_erase",),
    "flash.c:flash_program": ("flash_memory.c:flash_memory_program",),
    "runtime.c:runtime_sample": (
        *("receiver_line.c:receiver_line_read", "motors.c:motors_write"),
        *_in("hal.c", "hal_trace_write", "hal_cycles", "hal_deadline_missed"),
    ),
    "runtime.c:runtime_rotors": ("motors.c:motors_read",),
    "runtime.c:runtime_gyro_silent": ("motors.c:motors_write",),
    "runtime.c:runtime_background": ("hal.c:hal_watchdog_feed",),
    "background.c": ("power.c:power_read", *_in("hal.c", "hal_cycles", "hal_beeper", "hal_led")),
    "background_start.c": _in("hal.c", "hal_cycles", "hal_watchdog_feed"),
    "background_services.c": ("hal.c:hal_reset", "motors.c:motors_restarts"),
    "session.c": _services("test_motors", "session"),
    "background_blackbox.c": ("hal.c:hal_log",),
    "blackbox.c": (
        *_in("card_log.c", "log_step", "log_status", "log_begin", "log_write", "log_end"),
        *_in(
            "flash_log.c",
            "flash_log_step",
            "flash_log_status",
            "flash_log_begin",
            "flash_log_write",
            "flash_log_end",
        ),
        "log_uart.c:device",
    ),
    "sd_card.c": ("log_spi.c:bus",),
    "card_log.c": ("log_spi.c:bus",),
    "flash_chip.c": ("log_spi.c:bus", "flash_log.c:flash_log_fill"),
    "blackbox_kept.c": (
        *_in("card_log.c", "log_status", "log_entry", "log_read", "log_erase"),
        *_in("flash_log.c", "flash_log_status", "flash_log_entry", "flash_log_read", "flash_log_erase"),
    ),
    "scheduler.c": ("background.c:tasks", "hal.c:hal_cycles"),
    "msp_port.c": _services("record", "arming", "heard"),
    "msp_commands.c": _services(
        *("storing", "channels", "test_motors", "turn_motors", "command_motors", "reboot", "arming"),
        *("calibrate", "acknowledge"),
    ),
    "command_line.c": _services("samples", "session"),
    "command_line.c:command_line_continue": (
        *_services("samples", "session"),
        "commands.c:commands",
        *_in("command_line.c", "greeting", "nothing", "unknown", "spoilt"),
    ),
    "report_commands.c": _services("samples", "storing", "acknowledge"),
    "report_commands.c:command_status": ("report_commands.c:lines",),
    "listing_commands.c": _services("storing", "reboot"),
    "motor_commands.c": _services("samples", "test_motors", "turn_motors"),
    "msp_commands.c:msp_command": ("msp_commands.c:commands", *_services("storing")),
}

_USAGE = re.compile(r"(?P<file>[^:]+):\d+:\d+:(?P<name>\S+)\t(?P<bytes>\d+)\t(?P<kind>\S+)")
_CLONE = re.compile(r"\.(constprop|isra|part|cold|\d+).*$")
_VENEER = re.compile(r"__(.+)_veneer")
_TARGET = re.compile(r"\b([0-9a-f]{1,8}) <[^>]*>")
_CALL = re.compile(r"blx?|b(eq|ne|cs|cc|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)?")
_SAVED = re.compile(r"(push|vpush|stmdb|vstmdb)$")


class StackError(BuildError):
    """The depth cannot be known: recursion, an unknown callee, a stack of variable size."""


@dataclass(frozen=True)
class Depth:
    """A path through the program at its deepest."""

    size: int  # bytes
    path: tuple[str, ...]  # functions, the caller first


@dataclass(frozen=True)
class StackUse:
    """The worst case of an image, and what it is made of."""

    worst: int  # bytes
    size: int  # bytes reserved for it
    thread: Depth
    interrupts: tuple[Depth, ...]  # the deepest handler of each level, exception frame included

    @property
    def margin(self) -> int:
        """Bytes that are never used; negative where the stack is too small."""
        return self.size - self.worst


@dataclass(frozen=True)
class _Function:
    """A function of the linked image."""

    name: str
    file: str  # that a local name belongs to, as "hal.c"; "" for a global one
    start: int
    end: int


def stack_use(program: Path, objects: Path) -> StackUse:
    """Compute the worst case of the image `program`, with .su files below `objects`. Raises StackError."""
    code = _Code(program, _usages(objects))
    thread = code.depth(THREAD)
    levels = tuple(max((code.depth(name) for name in level), key=lambda d: d.size) for level in LEVELS)
    interrupts = tuple(Depth(EXCEPTION_BYTES + depth.size, depth.path) for depth in levels)
    return StackUse(
        worst=thread.size + sum(depth.size for depth in interrupts),
        size=code.stack_bytes,
        thread=thread,
        interrupts=interrupts,
    )


def _usages(objects: Path) -> dict[tuple[str, str], int]:
    """Read the bytes that each function reserves, by its file and name."""
    found: dict[tuple[str, str], int] = {}
    for path in sorted(objects.rglob("*.su")):
        for line in path.read_text().splitlines():
            if (match := _USAGE.fullmatch(line)) is None:
                raise StackError(f"{path.name}: {line!r} is no stack usage")
            if match["kind"] == "dynamic":
                raise StackError(f"{match['name']} in {match['file']} takes a stack of variable size")
            key = Path(match["file"]).name, _CLONE.sub("", match["name"])
            found[key] = max(found.get(key, 0), int(match["bytes"]))
    if not found:
        raise StackError(f"no .su file below {objects}; compile with -fstack-usage")
    return found


class _Code:
    """The linked code: its functions, and their calls."""

    def __init__(self, program: Path, usages: Mapping[tuple[str, str], int]) -> None:
        self._usages = usages
        with program.open("rb") as file:
            elf = ELFFile(file)
            section = elf.get_section_by_name(".stack")
            self.stack_bytes = int(section["sh_size"]) if section else 0
            self._functions = {function.start: function for function in _functions(elf)}
            self._objects = _objects(elf)
        self._names: dict[str, list[_Function]] = {}
        for function in self._functions.values():
            self._names.setdefault(_CLONE.sub("", function.name), []).append(function)
        instructions = disassemble(program, lines=True)
        self._bodies = {
            start: [instructions[at] for at in range(start, function.end, 2) if at in instructions]
            for start, function in self._functions.items()
        }
        self._known: dict[int, Depth] = {}

    def depth(self, name: str) -> Depth:
        """Return the deepest path that begins with the function `name`."""
        return self._depth(self._one(name), ())

    def _depth(self, function: _Function, callers: tuple[_Function, ...]) -> Depth:
        if function in callers:
            loop = [caller.name for caller in callers[callers.index(function) :]]
            raise StackError(f"{' calls '.join([*loop, function.name])}: no bound for its stack")
        if function.start not in self._known:
            own = self._own(function)
            below = [self._depth(callee, (*callers, function)) for callee in self._callees(function)]
            deepest = max(below, key=lambda depth: depth.size, default=Depth(0, ()))
            self._known[function.start] = Depth(own + deepest.size, (function.name, *deepest.path))
        return self._known[function.start]

    def _own(self, function: _Function) -> int:
        """Return the size of a function's own frame: the compiler's, or the bytes that its code pushes."""
        name = _CLONE.sub("", function.name)
        told = [
            size
            for (file, known), size in self._usages.items()
            if known == name and function.file in ("", file)
        ]
        return max([*told, *([] if told else [self._pushed(function)])])

    def _pushed(self, function: _Function) -> int:
        return sum(_pushed_bytes(instruction) for instruction in self._bodies[function.start])

    def _callees(self, function: _Function) -> Iterator[_Function]:
        if match := _VENEER.fullmatch(function.name):
            yield self._one(_CLONE.sub("", match[1]))
            return
        for instruction in self._bodies[function.start]:
            if _goes_by_pointer(instruction):
                yield from self._pointed(function, instruction)
            elif _CALL.fullmatch(instruction.operation) and (target := _TARGET.search(instruction.operands)):
                address = int(target[1], 16)
                if not function.start <= address < function.end or address == function.start:
                    yield self._at(address, function)

    def _pointed(self, function: _Function, instruction: Instruction) -> Iterator[_Function]:
        file = instruction.line.partition(":")[0]
        named = POINTERS.get(f"{file}:{_CLONE.sub('', function.name)}", POINTERS.get(file))
        found = [goal for place in named for goal in self._named(place)] if named else self._tables(file)
        if not found:
            raise StackError(
                f"{function.name} calls through a pointer ({instruction.line}); "
                "say in toolchain/cortex_m7/stack_use.py where it may go"
            )
        yield from found

    def _named(self, place: str) -> list[_Function]:
        """Return the function FILE:NAME, or the functions in the tables of that name."""
        file, name = place.split(":")
        functions = [found for found in self._names.get(name, ()) if found.file in ("", file)]
        if not (goals := functions or self._tables(file, name)):
            raise StackError(f"{place}, which toolchain/cortex_m7/stack_use.py names, is not in the image")
        return goals

    def _tables(self, file: str, name: str | None = None) -> list[_Function]:
        """Return the functions in the constant tables of `file`, or in the one called `name`."""
        words = {
            word & ~1
            for (home, known), held in self._objects.items()
            if home == file and name in (None, _CLONE.sub("", known))
            for word in held
        }
        return [self._functions[address] for address in sorted(words & self._functions.keys())]

    def _at(self, address: int, caller: _Function) -> _Function:
        if address not in self._functions:
            raise StackError(f"{caller.name} calls 0x{address:08X}, where no function begins")
        return self._functions[address]

    def _one(self, name: str) -> _Function:
        """Return the function `name`; the deepest if several files have one."""
        if name not in self._names:
            raise StackError(f"the image has no function {name}")
        candidates = self._names[name]
        if len(candidates) == 1:
            return candidates[0]
        return max(candidates, key=lambda function: self._depth(function, ()).size)


def _symbols(elf: ELFFile, kind: str) -> Iterator[tuple[str, Symbol]]:
    """Yield the defined symbols of a kind, each with the file of a local one, "" for a global one."""
    table = elf.get_section_by_name(".symtab")
    assert isinstance(table, SymbolTableSection)
    file = ""
    for symbol in table.iter_symbols():
        if symbol["st_info"]["type"] == "STT_FILE":
            file = Path(symbol.name).name
        elif symbol["st_info"]["type"] == kind and isinstance(symbol["st_shndx"], int):
            yield file if symbol["st_info"]["bind"] == "STB_LOCAL" else "", symbol


def _functions(elf: ELFFile) -> Iterator[_Function]:
    for file, symbol in _symbols(elf, "STT_FUNC"):
        start = symbol["st_value"] & ~1
        yield _Function(symbol.name, file, start, start + max(symbol["st_size"], 2))


def _objects(elf: ELFFile) -> dict[tuple[str, str], tuple[int, ...]]:
    """Return the words of each constant or initialized object, by its file ("" for a global one) and name."""
    found: dict[tuple[str, str], tuple[int, ...]] = {}
    for file, symbol in _symbols(elf, "STT_OBJECT"):
        section = elf.get_section(symbol["st_shndx"])
        if section["sh_type"] != "SHT_NOBITS":
            offset = symbol["st_value"] - section["sh_addr"]
            data = section.data()[offset : offset + symbol["st_size"] // 4 * 4]
            found[file, symbol.name] = struct.unpack(f"<{len(data) // 4}I", data)
    return found


def _goes_by_pointer(instruction: Instruction) -> bool:
    name, operands = instruction.operation, instruction.operands
    if name in ("blx", "bx"):
        return operands != "lr"
    return (name == "mov" and operands.startswith("pc,")) or (
        name == "ldr" and operands.startswith("pc,") and "sp" not in operands
    )


def _pushed_bytes(instruction: Instruction) -> int:
    """Return the bytes that one instruction takes off the stack pointer."""
    name, operands = instruction.operation, instruction.operands
    if _SAVED.match(name) and (name.endswith("push") or operands.startswith("sp!")):
        return sum(_register_bytes(part) for part in operands[operands.index("{") + 1 : -1].split(","))
    if name in ("sub", "subw") and (match := re.fullmatch(r"sp, (?:sp, )?#(\d+)", operands)):
        return int(match[1])
    if match := re.fullmatch(r".*\[sp, #-(\d+)\]!", operands):
        return int(match[1])
    return 0


def _register_bytes(part: str) -> int:
    """Return the bytes of a register or a span of them in a list."""
    first, _, last = part.strip().partition("-")
    count = int(last[1:]) - int(first[1:]) + 1 if last else 1
    return count * (8 if first.startswith("d") else 4)
