"""A board in the field: the whole program, what it lets the pilot hear and see, and its MSP line."""

from __future__ import annotations

import math
from typing import Any

from neuroflight.flash.link import messages, records
from neuroflight.flash.link.client import Client
from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import (
    CHANNEL_PITCH,
    CHANNEL_ROLL,
    CHANNEL_YAW,
    GESTURE_MS,
    FaultKind,
    FlightState,
    Msp,
    Task,
)

G = 9.80665


class Field:
    """The whole program around a scripted policy and a PID, a millisecond a step; heard and seen."""

    def __init__(
        self, core: Any, chip: Any, *, fault: FaultKind | None = None, fw: Any = None, **settings: int
    ) -> None:
        """settings: whole numbers that this boot has other than stored."""
        self.core, self.chip, self.name = core, chip, "field"
        new, ffi, lib = core.new, core.ffi, core.lib
        lib.scripted_action = [0.3] * 4
        self.board, self.hal = new("struct host_board *"), new("struct hal *")
        if chip.region(contract.FLASH_POLICY_SLOTS[0])[:4] == b"\xff" * 4:
            lib.host_board_install(chip._bytes)
        lib.host_board_init(self.board, chip._bytes)
        self.hal[0] = lib.host_board_hal(self.board)
        self.hal.flash = chip.flash[0]
        self.beeps, self.light = "", ""
        self.beeping, self.lit = False, False
        self._calls = [
            ffi.callback("void(void *, bool)", lambda _, on: setattr(self, "beeping", bool(on))),
            ffi.callback("void(void *, bool)", lambda _, on: setattr(self, "lit", bool(on))),
        ]
        self.hal.beeper, self.hal.led = self._calls
        pid = new("struct pid_gains *")
        pid.motor_count, pid.idle, pid.period_s, pid.smoothing = 4, 0.2, 1e-3, 1.0
        record = new("struct fault_record *", {"kind": fault}) if fault else ffi.NULL
        changes = [
            {"index": lib.settings_find(name.encode()), "value": {"as_uint32_t": value}}
            for name, value in settings.items()
        ]
        self._keep = [
            pid,
            record,
            new(f"struct task_stats[{len(Task)}]"),
            new("uint64_t[4]"),
            new("struct firmware *") if fw is None else fw,
            new("struct background *"),
            new("struct setting_change[]", changes),
        ]
        _, _, stats, self.weights, self.fw, self.background, changed = self._keep
        config = new(
            "struct background_config *",
            {
                "board": {
                    "hal": self.hal,
                    "alignment": 2,  # as the simulated board's
                    "identity": lib.host_identity,
                    "changes": changed,
                    "change_count": len(changes),
                    "gyro_rate_hz": 1000,
                    "cycles_hz": 1_000_000_000,
                },
                "firmware": self.fw,
                "weights": ffi.cast("float *", self.weights),
                "stats": stats,
                "pid": pid,
                "fault": record,
            },
        )
        # The scripted policy's self-test expects 0 of the compiled-in one.
        lib.scripted_action = [0.0] * 4
        assert lib.background_start(self.background, config) == 0
        lib.scripted_action = [0.3] * 4
        self.log = new("struct log_ring *")
        parts = (self.hal, self.fw, stats, self.background, self.log)
        self.runtime = new("struct runtime *", parts)
        self.ms = 0
        self.sticks: dict[int, int] = {}
        self.arm, self.throttle, self.pid = 1000, 1000, 1000
        self.heard = True
        self._reply = b""

    def sample(self) -> None:
        """What the gyro's interrupt does each millisecond; a frame comes each ten."""
        if self.heard and self.ms % 10 == 0:
            channels = [1500, 1500, self.throttle, 1500, self.arm, self.pid, *[1000] * 10]
            for channel, us in self.sticks.items():
                channels[channel] = us
            self.core.lib.receiver_line_put(
                self.core.ffi.addressof(self.board.line), self.core.new("uint16_t[]", channels)
            )
        sample = self.core.lib.host_board_sample([0.0] * 3, [0.0, 0.0, -G - 0.01 * (self.ms % 2)])
        self.core.lib.runtime_sample(self.runtime, self.core.new("struct imu_sample *", sample))
        self.ms += 1

    def run(self, ms: int) -> None:
        self.beeps = self.light = ""
        for _ in range(ms):
            self.sample()
            self.core.lib.runtime_background(self.runtime)
            self.core.lib.runtime_background(self.runtime)
            self.beeps += ".#"[self.beeping]
            self.light += ".#"[self.lit]

    def boot(self) -> None:
        self.run(4000)

    def gesture(self, ms: int = GESTURE_MS + 300) -> None:
        """Both sticks down and apart, then centred."""
        self.sticks = {CHANNEL_YAW: 1000, CHANNEL_PITCH: 1000, CHANNEL_ROLL: 2000}
        self.run(ms)
        self.sticks = {}
        self.run(200)

    def take_off(self) -> None:
        self.arm = 2000
        self.run(50)
        assert self.safety.state == FlightState.ARMED
        self.throttle = 1400
        self.run(500)

    def land(self) -> None:
        self.arm, self.throttle = 1000, 1000
        self.run(300)

    def fall_back(self) -> None:
        """The policy answers no number for one step."""
        self.core.lib.scripted_action = [0.3, math.nan, 0.3, 0.3]
        self.run(1)
        self.core.lib.scripted_action = [0.3] * 4

    # An MSP line of its own.
    def write(self, data: bytes) -> None:
        reply = self.core.new("uint8_t[1024]")
        count = self.core.lib.runtime_link(self.runtime, 0, data, len(data), reply, 1024)
        self._reply += bytes(self.core.ffi.buffer(reply, count))

    def read(self, timeout: float) -> bytes:
        answer, self._reply = self._reply, b""
        return answer

    def close(self) -> None:
        """Nothing to release."""

    def ask(self, command: Msp, payload: bytes = b"") -> bytes:
        return Client(self).request(command, payload)

    @property
    def safety(self) -> records.Safety:
        return records.safety(self.ask(Msp.SAFETY))

    @property
    def faults(self) -> records.Faults:
        return records.faults(self.ask(Msp.FAULTS))

    @property
    def reasons(self) -> set[str]:
        return set(messages.arming_reasons(self.safety.arming_flags))
