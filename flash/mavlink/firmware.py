"""The firmware behind the gateway: its identity, its last state, and channels to it."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from functools import cached_property

from neuroflight.flash.board.info import check_api, is_ours, version_of
from neuroflight.flash.channels import receiver
from neuroflight.flash.link import messages, records, requests
from neuroflight.flash.link.client import Client, NoAnswerError, RefusedError
from neuroflight.flash.link.messages import Attitude, BatteryState, PolicyInfo, StatusEx
from neuroflight.flash.link.records import Safety
from neuroflight.flash.link.transport import LineGoneError
from neuroflight.flash.mavlink.parameters import Parameter, parameter_list
from neuroflight.flash.mavlink.sticks import Sticks, sticks_of
from neuroflight.flash.mavlink.telemetry import Inertial, Vehicle
from neuroflight.flash.mavlink.texts import Condition
from neuroflight.flash.monitoring.stream import Sample, Stream, decode_sample
from neuroflight.flash.settings.text import Value, value_text
from neuroflight.flash.settings.values import Settings
from neuroflight.toolchain.contract import MSP_ACCELERATION_COUNTS, FaultKind, Msp, Refusal
from neuroflight.toolchain.errors import LinkError

ASK_S = 0.5  # for one answer: a board takes milliseconds, the emulated one tenths of a second
CHANNELS_S = 0.1  # for the answer to channels, while a companion waits
SAMPLES_HZ_MIN, SAMPLES_HZ_MAX = 10, 100
COUNTS_PER_G_BEFORE = 512  # of RAW_IMU, before messages.RAW_IMU_COUNTS_SINCE
DRIFT = 1e-3  # relative difference of clocks, with margin: crystals differ by 1e-4 at most


class Firmware:
    """A firmware of this project. Every method raises LinkError once the line is gone, NoAnswerError for
    silence."""

    def __init__(self, client: Client, clock: Callable[[], float]) -> None:
        """Read all that does not change. clock: seconds, never going back. Raises LinkError for another make
        of firmware."""
        self._client, self._clock = client, clock
        self._started = self._seen = clock()  # estimated start of the firmware; time of the last estimate
        old = check_api(client).minor < messages.RAW_IMU_COUNTS_SINCE
        self._counts_per_g = COUNTS_PER_G_BEFORE if old else MSP_ACCELERATION_COUNTS
        if not is_ours(client):
            raise LinkError(
                f"{client.name}: the firmware is of another make, expected one of this project; "
                "the gateway needs what only it tells: flash it, or speak MSP to that one"
            )
        self.settings = Settings(client)
        stored = self.settings.read()
        self.parameters = parameter_list(one.info for one in stored)
        self.by_name = {parameter.name: parameter for parameter in self.parameters}  # in capitals
        values: dict[str, Value] = {one.name: one.value for one in stored}
        self._values = values
        self.policy: PolicyInfo = messages.policy_info(client.request(Msp.POLICY_INFO))
        version = version_of(client).split(".")
        self.vehicle = Vehicle(
            motor_count=self.policy.action_count,
            version=(int(version[0]), int(version[1]), int(version[2])),
            uid=messages.uid(client.request(Msp.UID)),
            capacity_mah=int(values["battery_capacity_mah"]),
        )
        self.boots = records.faults(client.request(Msp.FAULTS)).boots
        self.fault: FaultKind | None = None
        self.restarted = False
        self.sample: Sample | None = None
        self._stream = Stream(client, SAMPLES_HZ_MIN, self.policy.control_rate_hz)
        self._stream.begin()
        self.look()
        self.look_further()

    @cached_property
    def sticks(self) -> Sticks:
        """Meaning of the channels. Raises LinkError if the settings leave that open."""
        return sticks_of(self._values)

    @property
    def hears_msp(self) -> bool:
        """True if its settings make it take channels over MSP."""
        return value_text(receiver.SETTING, self._values[receiver.SETTING]) == receiver.MSP

    def not_listening(self) -> LinkError:
        """Return the error for a firmware that takes no channels over MSP."""
        return receiver.not_listening(self._client.name, self._values.__getitem__)

    def close(self) -> None:
        """End the stream, as far as the line still lives."""
        self._stream.stop()

    def ask_over(self, client: Client) -> None:
        """Send requests over another line from now on, to see whether the firmware answers there."""
        self._client = client

    def ask(self, command: Msp, payload: bytes = b"") -> bytes:
        """Send a request once, without retries; updates `sample` as well."""
        answer = self._client.request(command, payload, timeout=ASK_S, retries=0)
        self._take_samples()
        return answer

    def look(self) -> None:
        """Update `safety` and `status`."""
        self.safety: Safety = records.safety(self.ask(Msp.SAFETY))
        self.status: StatusEx = messages.status_ex(self.ask(Msp.STATUS_EX))

    def _take_samples(self) -> None:
        """Take the last sample that arrived with the answers so far."""
        while (payload := self._client.receive(Msp.STREAM_SAMPLE, 0.0)) is not None:
            first, self.sample = self.sample is None, decode_sample(payload)
            now = self._clock()
            started = now - self.sample.step / self.policy.control_rate_hz
            # A sample may be delayed, so the earliest estimate is the best, but for the clocks' drift.
            if first or started < self._started + DRIFT * (now - self._seen):
                self._started, self._seen = started, now

    def look_further(self) -> None:
        """Update `battery` and `fault`; `restarted` becomes True if the firmware has started again."""
        self.battery: BatteryState = messages.battery_state(self.ask(Msp.BATTERY_STATE))
        faults = records.faults(self.ask(Msp.FAULTS))
        self.fault = faults.pending.kind if faults.pending is not None else None
        self.restarted = faults.boots != self.boots

    @property
    def armed(self) -> bool:
        """True if the motors may turn."""
        return self.status.status.armed

    @property
    def condition(self) -> Condition:
        """The state whose changes are announced."""
        return Condition(self.safety, self.armed, self.battery.level, self.fault)

    @property
    def boot_ms(self) -> int:
        """Time of the last sample since the start [ms], of 32 bits; 0 before the first."""
        step = self.sample.step if self.sample is not None else 0
        return round(1000 * step / self.policy.control_rate_hz) & 0xFFFFFFFF

    @property
    def now_ns(self) -> int:
        """Time since the start [ns], by this computer's clock since the last sample."""
        return round(1e9 * (self._clock() - self._started))

    @property
    def gyro(self) -> tuple[float, ...]:
        """Rates [rad/s] about the house's axes, of the last sample."""
        return self.sample.gyro if self.sample is not None else (0.0, 0.0, 0.0)

    def stream_at(self, rate_hz: float) -> None:
        """Ask for samples as often as rates are told, within what a line bears."""
        wanted = min(max(math.ceil(rate_hz), SAMPLES_HZ_MIN), SAMPLES_HZ_MAX)
        if wanted != self._stream.rate_hz:
            self._stream = Stream(self._client, wanted, self.policy.control_rate_hz)
            self._stream.begin()

    def attitude(self) -> Attitude:
        """Read the attitude."""
        return messages.attitude(self.ask(Msp.ATTITUDE))

    def inertial(self) -> Inertial:
        """Read the accelerometer; the rates are those of `sample`."""
        told = messages.raw_imu(self.ask(Msp.RAW_IMU))
        force_g = tuple(count / self._counts_per_g for count in told.acceleration)
        return Inertial(self.gyro, force_g, self.safety.temperature_deg_c)

    def channels(self) -> tuple[int, ...]:
        """Read the receiver's channels [us], in the order of MSP's RC."""
        return messages.rc(self.ask(Msp.RC))

    def motors(self) -> tuple[int, ...]:
        """Read the motors' outputs [us]."""
        return messages.motor(self.ask(Msp.MOTOR))

    def reboot(self) -> None:
        """Restart the firmware. Raises RefusedError; the answer or the line may be lost."""
        with contextlib.suppress(NoAnswerError, LineGoneError):
            self.ask(Msp.REBOOT)

    def value(self, parameter: Parameter) -> Value:
        """Read the present value of a parameter."""
        index = requests.setting_index(parameter.number)
        return requests.setting_value(self.ask(Msp.SETTING_GET, index))

    def send_channels(self, frame: tuple[int, ...]) -> bool:
        """Send channels as a receiver would; returns whether the firmware has an MSP receiver at all."""
        try:
            self._client.request(Msp.SET_RAW_RC, requests.set_raw_rc(frame), timeout=CHANNELS_S)
        except RefusedError as error:
            # Refusal.ORDER: the last channels were not processed yet; the next frame replaces this one.
            return error.reason != Refusal.ABSENT
        except NoAnswerError:
            pass  # the next look shows whether the firmware is gone
        return True
