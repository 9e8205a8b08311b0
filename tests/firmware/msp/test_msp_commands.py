"""msp_commands.c: requests that take a payload, change something or tell what the background knows."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from neuroflight.flash.link import messages, records, requests
from neuroflight.flash.link.msp import Decoder, Direction, Message, Version, encode
from neuroflight.toolchain.contract import (
    CHANNEL_UNTOLD_US,
    FAULT_REGISTERS,
    FLASH_POLICY_SLOTS,
    LOG_ERASE_MAGIC,
    MSP_PAYLOAD_MAX,
    SETTINGS,
    FaultKind,
    LogError,
    LogState,
    Msp,
    Reboot,
    Refusal,
    Task,
)
from neuroflight.toolchain.policy.blob import PolicyBlob, pack
from tests.firmware.conftest import scripted_blob
from tests.firmware.images import HEADER_BYTES, header_of, make_image

MakeChip = Callable[..., Any]
IMAGE = make_image(1)
INDEX = {setting.name: index for index, setting in enumerate(SETTINGS)}
FUNCTIONS = ("storing", "channels", "motor_test", "motors", "dshot_command", "acknowledge", "reboot")


class LogDevice:
    """A device that keeps logs; answers as it is told, and knows what it was asked."""

    DONE, LATER, FAILED = range(3)

    def __init__(self, core: Any) -> None:
        ffi, self.core = core.ffi, core
        self.logs, self.answer, self.asked = [b"one log", bytes(range(256)) * 2], self.DONE, []  # type: ignore[var-annotated]
        self.state, self.error = LogState.READY, LogError.NONE
        self._callbacks = {
            "status": ffi.callback("void(void *, struct log_device_status *)", self._on_status),
            "entry": ffi.callback("uint8_t(void *, unsigned, struct log_entry *)", self._on_entry),
            "read": ffi.callback("uint8_t(void *, unsigned, uint32_t, uint8_t *, size_t *)", self._on_read),
            "erase": ffi.callback("uint8_t(void *)", self._on_erase),
        }
        self.device = core.new("struct log_device *", self._callbacks)

    def _on_status(self, _context: object, status: Any) -> None:
        status.state, status.error, status.logs, status.empty = self.state, self.error, len(self.logs), 7
        status.capacity_kb, status.free_kb = 0x90000, 0x80000

    def _on_entry(self, _context: object, index: int, entry: Any) -> int:
        self.asked.append(("entry", index))
        if self.answer is self.DONE:
            entry.name, entry.bytes = b"LOG%05d.BBL" % (index + 1), len(self.logs[index])
        return self.answer

    def _on_read(self, _context: object, index: int, offset: int, into: Any, count: Any) -> int:
        self.asked.append(("read", index, offset, count[0]))
        piece = self.logs[index][offset : offset + count[0]]
        self.core.ffi.memmove(into, piece, len(piece))
        count[0] = len(piece)
        return self.answer

    def _on_erase(self, _context: object) -> int:
        self.asked.append(("erase",))
        if self.answer is self.DONE:
            self.logs.clear()
        return self.answer


class Server:
    """A server that offers everything, over a chip; what its functions were told stands in `calls`."""

    def __init__(self, chip: Any) -> None:
        self.chip, self.core = chip, chip.core
        ffi, lib = self.core.ffi, self.core.lib
        self.calls: list[tuple[object, ...]] = []
        self.answers = dict.fromkeys(FUNCTIONS, int(Refusal.NONE))
        self.settings = self.core.new("struct nf_settings *")
        self.slots = self.core.new("struct policy_slots *")
        self.image = self.core.new("struct image_update *")
        lib.image_update_init(self.image, chip.flash, 0, b"HOST")
        self.faults = self.core.new("struct fault_log *")
        self.log = LogDevice(self.core)
        self.blackbox = self.core.new("struct blackbox *")
        self._gyro = self.core.new("struct gyro *")
        self.rotors = self.core.new("struct rotors *")
        self.tasks = self.core.new(f"struct task_stats[{len(Task)}]")
        self._policy, self._weights = self.core.new("struct policy *"), self.core.new("float[2]")
        self._callbacks = {
            "storing": ffi.callback("uint8_t(void *, bool)", self._on_storing),
            "channels": ffi.callback("uint8_t(void *, const uint16_t *)", self._on_channels),
            "motor_test": ffi.callback(
                "uint8_t(void *, struct msp_peer *, uint32_t)",
                lambda context, peer, magic: self._on("motor_test")(context, magic),
            ),
            "motors": ffi.callback("uint8_t(void *, const uint16_t *, size_t)", self._on_motors),
            "dshot_command": ffi.callback("uint8_t(void *, unsigned, unsigned)", self._on("dshot_command")),
            "acknowledge": ffi.callback("uint8_t(void *)", self._on("acknowledge")),
            "reboot": ffi.callback("uint8_t(void *, uint8_t)", self._on("reboot")),
            "session": ffi.callback("uint8_t(void *, bool)", lambda _, on: int(Refusal.ARMED)),
            "arming": ffi.callback("uint8_t(void *, struct msp_peer *, bool, bool)", lambda *_: 0),
            "heard": ffi.callback("void(void *, const struct msp_peer *)", lambda *_: None),
            "calibrate": ffi.callback("uint8_t(void *)", lambda _: 0),
            "record": ffi.callback("void(void *, struct control_record *)", lambda *_: None),
        }
        self._texts = [self.core.new("char[]", text) for text in (b"BRD1", b"TARGETNAME", b"MAKR", b"CHIP")]
        self._identity = self.core.new("struct board_identity *", [*self._texts, False, (1, 2, 3)])
        self._pid = self.core.new("struct pid_gains *")
        self.services = self.core.new(
            "struct services *",
            {
                "identity": self._identity,
                "flash": chip.flash,
                "settings": self.settings,
                "pid": self._pid,
                "slots": self.slots,
                "image": self.image,
                "blackbox": self.blackbox,
                "faults": self.faults,
                "rotors": self.rotors,
                "tasks": self.tasks,
                "cycles_hz": 216_000_000,
                **self._callbacks,
            },
        )
        self.status = self.core.new("struct firmware_status *", {"gyro_rate_hz": 4000})
        self._port = self.core.new("struct msp_port *")
        lib.settings_default(self.settings)
        self.keep_logs(self.log.device)
        slot = FLASH_POLICY_SLOTS[0]
        if chip.region(slot)[:4] == b"\xff" * 4:
            chip.fill(slot.address, pack(scripted_blob()))  # as installed
        self.boot()
        lib.msp_port_init(self._port, self.services)

    def keep_logs(self, device: Any) -> None:
        """The blackbox begins anew, with that device or NULL."""
        facts = {"device": device, "gyro": self._gyro, "about": {"settings": self.settings}}
        self.core.lib.blackbox_init(self.blackbox, self.core.new("struct blackbox_config *", facts))

    def boot(self) -> None:
        """What main does with flash before it serves."""
        lib = self.core.lib
        lib.scripted_action = [0.0] * 4
        running = {
            "architecture_hash": 0x01234567,
            "filters_hash": 0x0D4CBB29,
            "control_rate_hz": 1000,
            "weight_count": 2,
            "observation_count": 17,
            "action_count": 4,
        }
        known = self.core.new("struct policy_blob_identity *", running)
        lib.policy_slots_choose(self.slots, self.chip.flash, known, 0, self._policy, self._weights)

    def _on(self, name: str) -> Callable[..., int]:
        def call(_context: object, *arguments: int) -> int:
            self.calls.append((name, *arguments))
            return self.answers[name]

        return call

    def _on_storing(self, _context: object, busy: bool) -> int:
        self.calls.append(("storing", busy, self.chip.operations))
        return self.answers["storing"]

    def _on_channels(self, _context: object, channels_us: Any) -> int:
        self.calls.append(("channels", *(channels_us[i] for i in range(16))))
        return self.answers["channels"]

    def _on_motors(self, _context: object, values_us: Any, count: int) -> int:
        self.calls.append(("motors", *(values_us[i] for i in range(count))))
        return self.answers["motors"]

    def ask(self, command: int, payload: bytes = b"") -> Message:
        """The answer, whichever it is."""
        ask = encode(Message(Version.V2, Direction.REQUEST, command, payload))
        out = self.core.new("uint8_t[1024]")
        count = self.core.lib.msp_port_serve(self._port, self.status, ask, len(ask), out, 1024)
        (answer,) = Decoder().feed(bytes(out)[:count])
        assert isinstance(answer, Message)
        assert answer.command == command
        return answer

    def reply(self, command: int, payload: bytes = b"") -> bytes:
        """Payload of the reply to a request that is carried out."""
        answer = self.ask(command, payload)
        assert answer.direction is Direction.REPLY, answer.payload
        return answer.payload

    def refusal(self, command: int, payload: bytes = b"") -> tuple[int, int]:
        """Reason and detail of a request that is refused."""
        answer = self.ask(command, payload)
        assert answer.direction is Direction.ERROR
        reason, detail = struct.unpack("<Bh", answer.payload)
        return reason, detail


@pytest.fixture
def server(chip: MakeChip) -> Server:
    return Server(chip())


# A payload that each of these takes.
GOOD: dict[Msp, bytes] = {
    Msp.TASKS: b"",
    Msp.SETTING_INFO: requests.setting_index(0),
    Msp.SETTING_GET: requests.setting_index(0),
    Msp.SETTING_SET: requests.setting_set(0, 8000, kind="uint32_t"),
    Msp.EEPROM_WRITE: b"",
    Msp.SET_RAW_RC: requests.set_raw_rc([1500] * 16),
    Msp.MOTOR_TEST: requests.motor_test(1),
    Msp.SET_MOTOR: requests.set_motor([1000] * 4),
    Msp.DSHOT_COMMAND: requests.dshot_command(1),
    Msp.POLICY_SLOT_BEGIN: requests.slot_begin(608),
    Msp.POLICY_SLOT_INFO: b"\0",
    Msp.IMAGE_INFO: b"",
    Msp.IMAGE_BEGIN: header_of(IMAGE),
    Msp.LOG_INFO: b"",
    Msp.LOG_ENTRY: struct.pack("<H", 0),
    Msp.LOG_READ: struct.pack("<HIH", 0, 0, 64),
    Msp.LOG_ERASE: struct.pack("<I", LOG_ERASE_MAGIC),
    Msp.ACKNOWLEDGE: b"",
    Msp.REBOOT: b"",
}


# --- When commands are carried out ---------------------------------------------------------------
def test_a_command_is_unknown_when_nobody_knows_it(server: Server) -> None:
    for command in (0, 11, 225, 0x4E00, 0x4E35, 0x4E56, 0x4E64, 0xFFFF):
        answer = server.ask(command, b"1234")
        assert (answer.direction, answer.payload) == (Direction.ERROR, b"")


STORED = {
    Msp.EEPROM_WRITE: b"",
    Msp.RESET_CONF: b"",
    Msp.FAULTS: requests.acknowledge(1),
    Msp.ACKNOWLEDGE: b"",
    Msp.POLICY_SLOT_BEGIN: requests.slot_begin(608),
    Msp.POLICY_SLOT_WRITE: requests.slot_write(0, bytes(8)),
    Msp.POLICY_SLOT_END: b"",
    Msp.POLICY_SLOT_REVERT: b"",
    Msp.IMAGE_BEGIN: header_of(IMAGE),
    Msp.IMAGE_WRITE: requests.slot_write(0, bytes(8)),
    Msp.IMAGE_END: b"",
    Msp.IMAGE_SWITCH: bytes(32),
}


@pytest.mark.parametrize("command", STORED)
def test_nothing_arms_from_before_to_after_when_flash_is_written(server: Server, command: Msp) -> None:
    assert set(STORED) == requests.STORING
    server.ask(command, STORED[command])
    (_, first, before), *_, (_, last, after) = server.calls
    assert (first, last, before, after) == (True, False, 0, server.chip.operations)


@pytest.mark.parametrize(
    ("command", "sizes"),
    [
        (Msp.TASKS, {0}),
        (Msp.FAULTS, {0, 4}),
        (Msp.ACKNOWLEDGE, {0}),
        (Msp.SETTING_INFO, {2}),
        (Msp.SETTING_GET, {2}),
        (Msp.SETTING_SET, {6}),
        (Msp.EEPROM_WRITE, {0}),
        (Msp.SET_RAW_RC, set(range(8, 33))),
        (Msp.MOTOR_TEST, {4}),
        (Msp.SET_MOTOR, set(range(2, 17))),
        (Msp.DSHOT_COMMAND, {2}),
        (Msp.POLICY_SLOT_BEGIN, {4}),
        (Msp.POLICY_SLOT_WRITE, set(range(8, 100))),
        (Msp.POLICY_SLOT_END, {0}),
        (Msp.POLICY_SLOT_REVERT, {0}),
        (Msp.POLICY_SLOT_INFO, {1}),
        (Msp.IMAGE_INFO, {0}),
        (Msp.IMAGE_BEGIN, {HEADER_BYTES}),
        (Msp.IMAGE_WRITE, set(range(8, 100))),
        (Msp.IMAGE_END, {0}),
        (Msp.IMAGE_HASH, {1}),
        (Msp.IMAGE_SWITCH, {32}),
        (Msp.LOG_INFO, {0}),
        (Msp.LOG_ENTRY, {2}),
        (Msp.LOG_READ, {8}),
        (Msp.LOG_ERASE, {4}),
        (Msp.REBOOT, {0, 1}),
    ],
)
def test_a_payload_is_refused_when_it_has_a_length_that_the_command_does_not_take(
    server: Server, command: Msp, sizes: set[int]
) -> None:
    for size in range(64):
        if size not in sizes:
            assert server.refusal(command, bytes(size)) == (Refusal.PAYLOAD, 0), size
    assert server.calls == []
    assert server.chip.operations == 0


# --- Settings ----------------------------------------------------------------------------------
def test_each_setting_tells_the_contracts_facts_when_asked(server: Server) -> None:
    for index, setting in enumerate(SETTINGS):
        info = requests.setting_info(server.reply(Msp.SETTING_INFO, requests.setting_index(index)))
        assert (info.count, info.name, info.unit) == (len(SETTINGS), setting.name, setting.unit)
        assert info.kind == setting.kind
        assert (info.low, info.high, info.default) == pytest.approx(
            (setting.low, setting.high, setting.default), rel=1e-7
        )
        value = requests.setting_value(server.reply(Msp.SETTING_GET, requests.setting_index(index)))
        assert value == ("" if setting.kind == "text" else info.default)


def test_a_rate_tells_the_limits_of_its_style_when_that_was_changed(server: Server) -> None:
    server.reply(Msp.SETTING_SET, requests.setting_set(INDEX["rates_style"], 1, kind="uint32_t"))
    info = requests.setting_info(server.reply(Msp.SETTING_INFO, requests.setting_index(INDEX["yaw_max"])))
    assert (info.low, info.high, info.unit) == (0.0, 1.0, "1")
    assert info.default == pytest.approx(0.7)
    payload = requests.setting_set(INDEX["yaw_max"], 1.01, kind="float")
    assert server.refusal(Msp.SETTING_SET, payload) == (Refusal.RANGE, 0)


@pytest.mark.parametrize("command", [Msp.SETTING_INFO, Msp.SETTING_GET])
def test_a_setting_is_refused_when_there_is_none_of_that_number(server: Server, command: Msp) -> None:
    for index in (len(SETTINGS), 0xFFFF):
        assert server.refusal(command, requests.setting_index(index)) == (Refusal.INDEX, 0)


def test_a_setting_is_changed_and_kept_when_set_and_saved(server: Server) -> None:
    for name, value, kind in (("deadband_us", 12, "uint32_t"), ("yaw_expo", 0.5, "float")):
        assert server.reply(Msp.SETTING_SET, requests.setting_set(INDEX[name], value, kind)) == b""
        told = server.reply(Msp.SETTING_GET, requests.setting_index(INDEX[name]))
        assert requests.setting_value(told) == value
    loaded = server.core.new("struct nf_settings *")
    assert not server.core.lib.settings_load(loaded, server.chip.flash), "not yet"
    assert server.reply(Msp.EEPROM_WRITE) == b""
    assert server.core.lib.settings_load(loaded, server.chip.flash)
    assert (loaded.deadband_us, loaded.yaw_expo) == (12, 0.5)


def test_a_value_is_refused_when_it_is_beyond_its_limits(server: Server) -> None:
    for name, value, kind in (("deadband_us", 101, "uint32_t"), ("yaw_expo", float("nan"), "float")):
        payload = requests.setting_set(INDEX[name], value, kind)
        assert server.refusal(Msp.SETTING_SET, payload) == (Refusal.RANGE, 0)
    payload = requests.setting_set(len(SETTINGS), 1, kind="uint32_t")
    assert server.refusal(Msp.SETTING_SET, payload) == (Refusal.INDEX, 0)


def test_saving_names_the_setting_when_two_do_not_go_together(server: Server) -> None:
    server.reply(Msp.SETTING_SET, requests.setting_set(INDEX["battery_low_v"], 4.0, kind="float"))
    assert server.refusal(Msp.EEPROM_WRITE) == (Refusal.CONFLICT, INDEX["battery_warn_v"])
    assert server.chip.operations == 0


def test_saving_says_so_when_flash_does_not_take_it(server: Server) -> None:
    server.chip.cut(5, 0, 1)
    assert server.refusal(Msp.EEPROM_WRITE) == (Refusal.FLASH, 0)
    assert server.calls[-1][:2] == ("storing", False)


# --- Sticks and motors -----------------------------------------------------------------------------
def test_sticks_reach_the_receiver_in_the_order_they_were_sent(server: Server) -> None:
    server.reply(Msp.SET_RAW_RC, requests.set_raw_rc(range(1001, 1017)))
    assert server.calls == [("channels", *range(1001, 1017))]


def test_channels_are_not_told_when_few_are_sent(server: Server) -> None:
    server.reply(Msp.SET_RAW_RC, requests.set_raw_rc([1500, 1501, 1502, 1503]) + b"\x05")
    assert server.calls == [("channels", 1500, 1501, 1502, 1503, *[CHANNEL_UNTOLD_US] * 12)]


def test_motors_are_turned_by_their_pulse_widths_when_sent(server: Server) -> None:
    server.reply(Msp.SET_MOTOR, requests.set_motor([1000, 1100, 2000]))
    server.reply(Msp.SET_MOTOR, struct.pack("<8H", 0, 1001, 1002, 1003, 1000, 0, 1000, 0))
    assert server.calls == [("motors", 1000, 1100, 2000), ("motors", *range(1000, 1004))]
    assert server.refusal(Msp.SET_MOTOR, requests.set_motor([1000] * 4 + [1001])) == (Refusal.INDEX, 0)
    assert len(server.calls) == 2, "four motors fly"


def test_all_stop_is_taken_and_a_turn_refused_when_no_test_is_open(server: Server) -> None:
    server.answers["motors"] = int(Refusal.ORDER)
    server.reply(Msp.SET_MOTOR, struct.pack("<8H", *[1000, 0] * 4))
    assert server.refusal(Msp.SET_MOTOR, requests.set_motor([1000, 1001])) == (Refusal.ORDER, 0)


@pytest.mark.parametrize("us", [1, 999, 2001, 0xFFFF])
def test_no_motor_turns_when_one_value_is_no_pulse_width(server: Server, us: int) -> None:
    assert server.refusal(Msp.SET_MOTOR, struct.pack("<4H", 1100, 1100, 1100, us)) == (Refusal.PAYLOAD, 0)
    assert server.calls == []


def test_bench_commands_go_through_with_their_answers_when_sent(server: Server) -> None:
    server.reply(Msp.MOTOR_TEST, requests.motor_test(0xFEDCBA98))
    server.reply(Msp.DSHOT_COMMAND, requests.dshot_command(20, 3))
    server.reply(Msp.DSHOT_COMMAND, requests.dshot_command(1))
    server.reply(Msp.REBOOT)
    server.reply(Msp.REBOOT, bytes([Reboot.FIRMWARE]))
    server.reply(Msp.REBOOT, bytes([Reboot.ROM]))
    server.reply(Msp.REBOOT, bytes([Reboot.CARD]))
    server.reply(Msp.REBOOT, bytes([Reboot.CARD_UTC]))
    assert server.calls == [
        ("motor_test", 0xFEDCBA98),
        ("dshot_command", 3, 20),
        ("dshot_command", 255, 1),
        ("reboot", Reboot.FIRMWARE),
        ("reboot", Reboot.FIRMWARE),
        ("reboot", Reboot.ROM),
        ("reboot", Reboot.CARD),
        ("reboot", Reboot.CARD),
    ]
    for name, command in (
        ("motor_test", Msp.MOTOR_TEST),
        ("dshot_command", Msp.DSHOT_COMMAND),
        ("channels", Msp.SET_RAW_RC),
        ("reboot", Msp.REBOOT),
    ):
        server.answers[name] = int(Refusal.ORDER)
        assert server.refusal(command, GOOD[command]) == (Refusal.ORDER, 0)


@pytest.mark.parametrize("kind", [4, 5, 255])
def test_a_restart_into_what_no_board_has_is_refused_when_asked_for(server: Server, kind: int) -> None:
    assert server.refusal(Msp.REBOOT, bytes([kind])) == (Refusal.PAYLOAD, 0)
    assert server.calls == []


# --- Tasks and faults ----------------------------------------------------------------------------
def test_tasks_tell_their_cycles_when_asked(server: Server) -> None:
    lib = server.core.lib
    for index in range(len(Task)):
        lib.task_stats_init(server.core.ffi.addressof(server.tasks, index), 100 * index)
    for cycles, missed in ((900, False), (600, True), (660, False)):
        lib.task_stats_add(server.core.ffi.addressof(server.tasks, Task.CONTROL), cycles, missed)
    told = records.tasks(server.reply(Msp.TASKS))
    assert told.cycles_hz == 216_000_000
    assert [load.task for load in told.loads] == list(Task)
    assert told.loads[Task.CONTROL] == records.TaskLoad(Task.CONTROL, 100, 3, 1, 900, 600, 720)
    assert told.loads[Task.MSP] == records.TaskLoad(Task.MSP, 500, 0, 0, 0, 0, 0)


def test_the_fault_is_told_until_it_is_acknowledged_when_there_was_one(server: Server) -> None:
    lib = server.core.lib
    lib.fault_log_boot(server.faults, server.chip.flash, server.core.ffi.NULL)
    assert records.faults(server.reply(Msp.FAULTS)) == records.Faults(1, None)
    words = dict(zip(FAULT_REGISTERS, range(256, 256 + 13), strict=True))
    fields = {name: value for name, value in words.items() if name not in ("r0", "r1", "r2", "r3")}
    record = server.core.new(
        "struct fault_record *",
        {"kind": 1, "r": list(range(256, 260)), "line": 12, "file": b"a.c", "uptime_steps": 99, **fields},
    )
    lib.fault_log_boot(server.faults, server.chip.flash, record)
    told = records.faults(server.reply(Msp.FAULTS))
    assert told == records.Faults(2, records.Fault(2, FaultKind.HARD, words, "a.c", 12, 99))
    assert server.refusal(Msp.FAULTS, requests.acknowledge(1)) == (Refusal.INDEX, 0)
    assert server.reply(Msp.FAULTS, requests.acknowledge(2)) == b""
    assert records.faults(server.reply(Msp.FAULTS)) == records.Faults(2, None)
    assert server.refusal(Msp.FAULTS, requests.acknowledge(2)) == (Refusal.INDEX, 0)


# --- Policy slots -----------------------------------------------------------------------------------
def new_policy(blob: PolicyBlob, sequence: int) -> bytes:
    made = {**vars(blob), "sequence": sequence, "weights": np.array([3, 4], np.float32), "aircraft": "other"}
    return pack(PolicyBlob(**(made | {"policy_sha256": "cd" * 32, "idle": 0.25})))


def send(s: Server, data: bytes) -> None:
    """All of a blob but its end."""
    assert requests.slot_begun(s.reply(Msp.POLICY_SLOT_BEGIN, requests.slot_begin(len(data)))) == 1
    for offset in range(0, len(data), requests.SLOT_BYTES_MAX):
        piece = data[offset : offset + requests.SLOT_BYTES_MAX]
        assert s.reply(Msp.POLICY_SLOT_WRITE, requests.slot_write(offset, piece)) == b""


def test_a_policy_is_flown_from_the_next_boot_on_when_sent(
    server: Server, scripted_policy_blob: PolicyBlob
) -> None:
    data = new_policy(scripted_policy_blob, 5)
    send(server, data)
    assert server.reply(Msp.POLICY_SLOT_END) == b""
    assert server.chip.region(FLASH_POLICY_SLOTS[1])[: len(data)] == data
    now = messages.policy_info(server.reply(Msp.POLICY_INFO))
    assert (now.source, now.sequence, now.name, now.idle) == (0, 0, "scripted", 0.0)
    assert now.sha256 == scripted_policy_blob.policy_sha256
    server.boot()
    then = messages.policy_info(server.reply(Msp.POLICY_INFO))
    assert (then.source, then.sequence, then.name, then.idle) == (1, 5, "other", 0.25)
    assert then.sha256 == "cd" * 32
    assert then.found == (0, 0)


def test_a_policy_is_refused_with_its_error_when_it_is_damaged(
    server: Server, scripted_policy_blob: PolicyBlob
) -> None:
    data = new_policy(scripted_policy_blob, 5)
    send(server, data[:450] + b"\x55" + data[451:])
    assert server.refusal(Msp.POLICY_SLOT_END) == (Refusal.BLOB, -10)
    assert server.refusal(Msp.POLICY_SLOT_END) == (Refusal.ORDER, 0)
    server.boot()
    assert messages.policy_info(server.reply(Msp.POLICY_INFO)).source == 0


def test_no_policy_is_told_as_flown_when_none_is_good(server: Server) -> None:
    server.chip.fill(FLASH_POLICY_SLOTS[0].address, bytes(4))
    server.boot()
    info = messages.policy_info(server.reply(Msp.POLICY_INFO))
    assert (info.source, info.name, info.sha256) == (messages.PolicySource.NONE, "none", "00" * 32)
    assert info.found == (-7, -7)
    assert messages.name(server.reply(Msp.NAME)) == "none"
    assert messages.board_info(server.reply(Msp.BOARD_INFO)).name.endswith(" none")


# --- Power goes ---------------------------------------------------------------------------------
def test_what_is_stored_is_old_or_new_when_power_goes_in_session_after_session(
    server: Server, scripted_policy_blob: PolicyBlob
) -> None:
    """Settings, policies and faults side by side in one flash, changed over MSP, each cut somewhere."""
    rng = np.random.default_rng(3)
    deadband, sequence, outcomes = 0, 0, set()
    for session in range(400):
        server.chip.cut(int(rng.integers(300)), int(rng.integers(5)), session)
        wanted = (deadband, sequence)
        if rng.random() < 0.5:
            wanted = (int(rng.integers(1, 101)), sequence)
            server.reply(
                Msp.SETTING_SET, requests.setting_set(INDEX["deadband_us"], wanted[0], kind="uint32_t")
            )
            done = server.ask(Msp.EEPROM_WRITE)
        else:
            wanted = (deadband, sequence + 1)
            data = new_policy(scripted_policy_blob, wanted[1])
            server.ask(Msp.POLICY_SLOT_BEGIN, requests.slot_begin(len(data)))
            for offset in range(0, len(data), requests.SLOT_BYTES_MAX):
                piece = data[offset : offset + requests.SLOT_BYTES_MAX]
                server.ask(Msp.POLICY_SLOT_WRITE, requests.slot_write(offset, piece))
            done = server.ask(Msp.POLICY_SLOT_END)
        server.chip.power_on()
        server.boot()
        server.core.lib.settings_load(server.settings, server.chip.flash)
        server.core.lib.fault_log_boot(server.faults, server.chip.flash, server.core.ffi.NULL)
        if server.faults.crowded:
            server.core.lib.fault_log_renew(server.faults)
        told = server.reply(Msp.SETTING_GET, requests.setting_index(INDEX["deadband_us"]))
        found = (
            int(requests.setting_value(told)),
            messages.policy_info(server.reply(Msp.POLICY_INFO)).sequence,
        )
        assert (
            found == wanted if done.direction is Direction.REPLY else found in (wanted, (deadband, sequence))
        )
        assert server.faults.boots == session + 1
        outcomes.add((done.direction, found == wanted))
        deadband, sequence = found
    assert outcomes == {(Direction.REPLY, True), (Direction.ERROR, False), (Direction.ERROR, True)}


# --- Any bytes -----------------------------------------------------------------------------------
def test_the_server_goes_on_when_payloads_are_wild(server: Server) -> None:
    rng = np.random.default_rng(4)
    commands = [*GOOD, *STORED, Msp.POLICY_INFO]
    for _ in range(3000):
        command = commands[rng.integers(len(commands))]
        size = int(rng.integers(0, 40)) if rng.random() < 0.9 else int(rng.integers(0, MSP_PAYLOAD_MAX + 1))
        payload = bytes(size) if rng.random() < 0.3 else rng.bytes(size)
        answer = server.ask(command, payload)
        assert answer.direction is Direction.REPLY or len(answer.payload) == 3
    rate = requests.setting_value(server.reply(Msp.SETTING_GET, requests.setting_index(0)))
    assert 1000 <= float(rate) <= 8000
