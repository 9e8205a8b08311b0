"""The gateway: what MAVLink peers say goes to the firmware, what the firmware tells goes to them.

`Session.step` does one thing that is due and never waits but for the firmware's answer to it: between any
two questions packets are read, and a companion's channels go out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.link.client import Client, NoAnswerError
from neuroflight.flash.link.transport import LineGoneError, Transport
from neuroflight.flash.mavlink import commands, telemetry, texts
from neuroflight.flash.mavlink.answers import ANSWERS
from neuroflight.flash.mavlink.commands import Request
from neuroflight.flash.mavlink.customs import Customs, Mode, ModeError, message_mode
from neuroflight.flash.mavlink.endpoint import Peer
from neuroflight.flash.mavlink.firmware import Firmware
from neuroflight.flash.mavlink.ground import Ground
from neuroflight.flash.mavlink.log_server import MESSAGES as LOG_MESSAGES
from neuroflight.flash.mavlink.log_server import LogServer
from neuroflight.flash.mavlink.offboard import TIMEOUT_S, Offboard, Source
from neuroflight.flash.mavlink.parameter_server import MESSAGES as PARAMETER_MESSAGES
from neuroflight.flash.mavlink.parameter_server import ParameterServer
from neuroflight.flash.mavlink.setpoints import STEERING
from neuroflight.flash.mavlink.steering import Steering
from neuroflight.flash.mavlink.streams import DEFAULT_HZ, HEARTBEAT, SAMPLED, default_period, streamed
from neuroflight.flash.mavlink.texts import Condition
from neuroflight.toolchain.errors import LinkError

LOOK, LOOK_FURTHER = "look", "look further"  # at the firmware: tasks beside the messages of DEFAULT_HZ
LOOK_S, LOOK_FURTHER_S, RETRY_S = 0.1, 1.0, 0.5  # their periods; of looking whether it is back
SILENCES_MAX = 3  # unanswered questions in a row until the firmware counts as gone
LINE_S = 60.0  # own choice, for a lost line to come back: a board needs 1 s, a person who acts more


@dataclass(frozen=True)
class Options:
    """The options that the user gave."""

    offboard: bool = False
    allow_arm: bool = False
    timeout_s: float = TIMEOUT_S
    system: int = 1  # MAVLink's id of the aircraft


class Session:
    """A firmware with MAVLink peers around it."""

    def __init__(
        self,
        client: Client,
        peers: Sequence[Peer],
        options: Options,
        clock: Callable[[], float],
        say: Callable[[str], None] = lambda line: None,
        reopen: Callable[[], Transport] | None = None,
    ) -> None:
        """client: its line is closed with the session. clock: monotonic [s]. say: called with each text sent
        to the peers. reopen: opens a lost line again; None: a lost line ends the session.

        Raises LinkError where nobody answers, and where offboard is wanted and cannot be.
        """
        self._client, self._options, self._clock = client, options, clock
        self._ground = Ground(peers, options.system, clock, say)
        self._customs = Customs()
        self._reopen = reopen
        self._silences, self._gone = 0, False
        self._line_open = True
        self._line_lost: float | None = None  # when it was, until the firmware answers again
        self._told: Condition | None = None
        self._periods: dict[int | str, float] = {
            LOOK: LOOK_S,
            LOOK_FURTHER: LOOK_FURTHER_S,
            **{message: default_period(message) for message in DEFAULT_HZ},
        }
        self._due = dict.fromkeys(self._periods, clock())
        self._attach()
        if options.offboard and not self.firmware.hears_msp:
            raise self.firmware.not_listening()

    def close(self) -> None:
        """Stop steering and close the line to the firmware."""
        self._steering.release()
        self.firmware.close()
        self._client.close()

    @property
    def steered(self) -> bool:
        """True if a companion steers."""
        return self._steering.steered

    def step(self) -> float:
        """Do the next due task; return the seconds until the next one. Raises LinkError on a lost line."""
        try:
            self._steering.expire()  # before setpoints are processed that arrived while the firmware was slow
            for source, message in self._ground.heard():
                self._handle(source, message)
            self._steering.send()
            if self._work():
                self._silences = 0
        except NoAnswerError:
            self._silences += 1
            if self._silences >= SILENCES_MAX and not self._gone:
                self._lose("The flight controller does not answer")
        except LineGoneError:
            self._client.close()
            self._line_open = False
            if self._line_lost is None:
                self._line_lost = self._clock()
                if self._reopen is not None:
                    self._lose(f"The line to the flight controller is gone; it has {LINE_S:g} s to come back")
            if self._reopen is None or self._late:
                raise
        return self._pause()

    def _lose(self, line: str) -> None:
        self._gone = True
        self._steering.release()
        self._ground.tell(texts.CRITICAL, line)

    # --- What is due -------------------------------------------------------------------------------
    def _pause(self) -> float:
        now = self._clock()
        if self._gone:
            return max(0.0, self._due[LOOK] - now)
        if self._parameters.busy:
            return 0.0
        times = [self._due[task] for task, period in self._periods.items() if period]
        times += [due for due in (self._steering.due, self._logs.due) if due is not None]
        return max(0.0, min(times) - now)

    def _work(self) -> bool:
        """Do the first task that is due; return True if there was one."""
        now = self._clock()
        for task, period in self._periods.items():
            if not period or now < self._due[task]:
                continue
            period = RETRY_S if self._gone else period
            later = self._due[task] + period
            self._due[task] = later if later > now else now + period
            if task == LOOK:
                self._look()
            elif self._gone:
                continue
            elif task == LOOK_FURTHER:
                self._look_further()
            elif isinstance(task, int):
                self._broadcast(task)
            return True
        if self._parameters.busy and not self._gone:
            self._parameters.tell_one()
            return True
        if self._logs.due is not None and now >= self._logs.due and not self._gone:
            self._logs.step(steered=self._steering.steered)
            return True
        return False

    def _look(self) -> None:
        if not self._line_open and not self._open_line():
            return
        self.firmware.look()
        if self._gone:
            self._attach()
            return
        condition = self.firmware.condition
        for text in texts.changes(self._told, condition):
            self._ground.tell(text.severity, text.text)
        self._told = condition
        self._steering.look()

    @property
    def _late(self) -> bool:
        """True if a lost line has not come back within LINE_S."""
        return self._line_lost is not None and self._clock() >= self._line_lost + LINE_S

    def _open_line(self) -> bool:
        """Open the line again; return True if it is open. Raises LinkError once that has taken too long."""
        assert self._reopen is not None
        try:
            self._client = Client(self._reopen())
        except LinkError:
            if self._late:
                raise
            return False
        self.firmware.ask_over(self._client)
        self._line_open = True
        return True

    def _look_further(self) -> None:
        self.firmware.look_further()
        if self.firmware.restarted:
            self._attach()

    def _attach(self) -> None:
        """Read everything again once the firmware answers, perhaps restarted; nobody steers then."""
        self.firmware = Firmware(self._client, self._clock)
        allowed = self._options.offboard and self.firmware.hears_msp
        if allowed:
            _ = self.firmware.sticks  # raise the error now rather than later
        offboard = Offboard(
            allowed=allowed, may_arm=self._options.allow_arm, timeout_s=self._options.timeout_s
        )
        self._steering = Steering(self.firmware, self._ground, offboard, self._clock)
        self._parameters = ParameterServer(self.firmware, self._ground, self._customs)
        self._logs = LogServer(self._client, self._ground, self._clock)
        self._stream_fast_enough()
        self._gone, self._told, self._line_lost = False, None, None
        version, policy = ".".join(map(str, self.firmware.vehicle.version)), self.firmware.policy
        self._ground.tell(texts.INFO, f"Neuroflight {version}, policy {policy.name} {policy.sha256[:8]}")

    def _broadcast(self, number: int) -> None:
        """Tell the message of that number, which is in DEFAULT_HZ."""
        if number != HEARTBEAT:
            self._ground.broadcast(streamed(number, self.firmware))
            return
        fw, steering, others = self.firmware, self._steering, self._customs.offboard_number
        self._ground.broadcast_each(
            lambda peer: telemetry.heartbeat(
                fw.vehicle, fw.safety, armed=fw.armed, mode=steering.mode(peer, others)
            )
        )

    # --- What peers want ---------------------------------------------------------------------------
    def _handle(self, source: Source, message: Any) -> None:  # noqa: ANN401
        kind = message.get_type()
        if kind in ("COMMAND_LONG", "COMMAND_INT"):
            request = commands.read_request(message, source)
            result = commands.REJECTED if self._gone else commands.carry_out(request, self)
            self._ground.answer(source, commands.acknowledgement(request, result))
        elif kind == "SET_MODE":  # deprecated, and answered as ArduPilot does
            result = commands.REJECTED
            if not self._gone:
                result = self._choose(source, lambda: message_mode(message.base_mode, message.custom_mode))
            told = mavlink.MAVLink_command_ack_message(mavlink.MAVLINK_MSG_ID_SET_MODE, result)
            told.target_system, told.target_component = source[1:]
            self._ground.answer(source, told)
        elif kind == "REQUEST_DATA_STREAM":  # rates are unchanged: the request does not name messages
            self._customs.hear_stream_request(source)
        elif kind in ANSWERS:
            if (answer := ANSWERS[kind](source, message, self.firmware.now_ns)) is not None:
                self._ground.answer(source, answer)
        elif self._gone:
            return
        elif kind in STEERING:
            self._steering.handle(source, message)
        elif kind in PARAMETER_MESSAGES:
            self._parameters.handle(source, message)
        elif kind in LOG_MESSAGES:
            self._logs.handle(source, message)

    def send_once(self, message: int) -> int:
        """Send a message once. This and the methods below are those of commands.Actions."""
        if message not in DEFAULT_HZ:
            return int(commands.UNSUPPORTED)
        self._broadcast(message)
        return int(commands.ACCEPTED)

    def tell_capabilities(self, source: Source) -> int:
        """Send AUTOPILOT_VERSION, which tells how whole numbers are encoded, and note that `source` asked."""
        self._customs.hear_request(source)
        return self.send_once(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)

    def set_interval(self, message: int, interval_us: int) -> int:
        """Change how often a message is sent; not the heartbeat, which tells that the aircraft lives."""
        if message not in DEFAULT_HZ:
            return int(commands.UNSUPPORTED)
        if message == HEARTBEAT:
            return int(commands.DENIED)
        told = {commands.INTERVAL_DEFAULT: default_period(message), commands.INTERVAL_OFF: 0.0}
        self._periods[message] = told.get(interval_us, interval_us / 1e6)
        self._due[message] = self._clock()
        self._stream_fast_enough()
        return int(commands.ACCEPTED)

    def tell_interval(self, message: int) -> int:
        """Send MESSAGE_INTERVAL: 0 for an unknown message, -1 for one that is sent only on request."""
        told = round(self._periods[message] * 1e6) or commands.INTERVAL_OFF if message in DEFAULT_HZ else 0
        self._ground.broadcast(mavlink.MAVLink_message_interval_message(message, told))
        return int(commands.ACCEPTED)

    def store(self, *, defaults: bool) -> int:
        """Store all settings; `defaults`: set them to their defaults before."""
        if self.firmware.armed:
            return int(commands.REJECTED)
        if not defaults:
            return self._attempt(self.firmware.settings.save)
        result = self._attempt(lambda: self.firmware.settings.set_defaults(save=True))
        self._parameters.tell_all()
        return result

    def reboot(self) -> int:
        """Restart the firmware; nobody steers any more. It is attached anew once it answers."""
        if self.firmware.armed:
            return int(commands.REJECTED)
        self._steering.release()
        return self._attempt(self.firmware.reboot)

    def set_mode(self, source: Source, base: int, main: int, sub: int) -> int:
        """Let `source` steer, or nobody, as its mode says."""
        return self._choose(source, lambda: self._customs.command_mode(source, base, main, sub))

    def _choose(self, source: Source, mode: Callable[[], Mode]) -> int:
        try:
            return self._steering.choose(source, mode())
        except ModeError as error:
            self._ground.complain(f"Mode denied: {error}")
            return int(commands.DENIED)

    def arm(self, request: Request) -> int:
        """See Steering."""
        return self._steering.arm(request)

    def disarm(self, request: Request) -> int:
        """See Steering."""
        return self._steering.disarm(request)

    def _attempt(self, action: Callable[[], None]) -> int:
        """Execute `action` and return the MAV_RESULT; a refusal is sent to the peers."""
        try:
            action()
        except NoAnswerError:
            raise
        except LinkError as error:
            self._ground.refuse(str(error).removeprefix(f"{self._client.name}: "))
            return int(commands.FAILED)
        return int(commands.ACCEPTED)

    def _stream_fast_enough(self) -> None:
        periods = [self._periods[message] for message in SAMPLED if self._periods[message]]
        self.firmware.stream_at(1 / min(periods) if periods else 0.0)
