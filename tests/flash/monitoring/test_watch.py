"""Looking at a firmware again and again: what is seen, restarts, pulled cables, other makes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroflight.flash.board.info import read_info
from neuroflight.flash.link.transport import Transport, open_transport
from neuroflight.flash.monitoring import watch as watching
from neuroflight.flash.monitoring.snapshot import CHANNELS, read_snapshot
from neuroflight.flash.monitoring.watch import Watch
from neuroflight.toolchain.contract import Msp
from tests.flash.lockstep import Lockstep, lockstep
from tests.flash.peers import Reply, answering


def test_everything_is_seen_of_a_firmware_in_flight(booted: Lockstep) -> None:
    booted.sticks = {"arm": 2000}
    booted.run(5)
    booted.sticks = {"arm": 2000, "throttle": 1400, "roll": 1600}
    booted.run(30)
    with Watch(lambda: open_transport(booted.port)) as watch:
        sight = watch.look()
    assert (sight.problem, sight.looks, sight.failed, sight.restarts, sight.reconnects) == ("", 1, 0, 0, 0)
    seen, info = sight.snapshot, sight.info
    assert seen is not None and info is not None and info.policy is not None
    assert info.board.target == "HOST" and info.policy.name == "nf1"
    assert seen.overview.armed and seen.overview.flight is not None
    assert (seen.overview.flight.state, seen.overview.arming_reasons) == ("ARMED", {})
    assert tuple(seen.channels_us) == CHANNELS and len(CHANNELS) == 16
    told = seen.channels_us
    sticks = {"roll": 1600, "pitch": 1500, "throttle": 1400, "yaw": 1500, "aux1": 2000}
    assert {name: told[name] for name in sticks} == sticks
    assert len(seen.motors_us) == 4 and all(us > 1000 for us in seen.motors_us)
    assert seen.motors_us[2] > seen.motors_us[0]  # a roll to the right is asked for
    assert seen.tasks is not None and seen.tasks.loads[1].runs > 1000
    assert len(seen.rates_deg_s) == 3 and seen.overview.battery.cells == 4


def test_rates_are_deg_s_by_the_counts_of_the_firmware_and_api_that_tell_them(booted: Lockstep) -> None:
    for _ in range(50):
        booted.program.sticks()
        booted.program.step(np.radians([100.0, -50.0, 25.0]).tolist())
    with booted.client() as client:
        info = read_info(client)
        assert info.api.minor == 47
        assert read_snapshot(client, info).rates_deg_s == (100, 50, -25)
        older = replace(info, api=replace(info.api, minor=46))
        assert read_snapshot(client, older).rates_deg_s == (410, 205, -103), "whole deg/s up to 1.46"
        betaflights = replace(info, policy=None)
        assert read_snapshot(client, betaflights).rates_deg_s == (25, 13, -6), "16.4 counts a deg/s"


def test_it_goes_on_when_the_firmware_is_gone_and_comes_back(host_program: Path, tmp_path: Path) -> None:
    option = f"--settings={tmp_path / 'flash.bin'}"
    ports: list[str] = []
    now = [0.0]
    with Watch(lambda: open_transport(ports[-1]), clock=lambda: now[0]) as watch:
        with lockstep(host_program, option) as one:
            ports.append(one.port)
            first = watch.look()
        now[0] = 3.0
        gone = watch.look()
        now[0] = 5.0
        still = watch.look()
        with lockstep(host_program, option) as one:
            ports.append(one.port)
            back = watch.look()
            last = watch.look()
    assert first.problem == "" and first.snapshot is not None
    assert "the other end closed the connection" in gone.problem or "the line is gone" in gone.problem
    assert gone.snapshot is first.snapshot and gone.silent_s == 3.0
    assert "nobody listens there" in still.problem
    assert (still.silent_s, still.failed, still.looks) == (5.0, 2, 3)
    assert (back.problem, back.restarts, back.reconnects, back.silent_s) == ("", 1, 1, 0.0)
    assert back.snapshot is not None and back.snapshot is not first.snapshot
    assert (last.restarts, last.reconnects) == (1, 1)


def test_a_silent_firmware_keeps_its_line_and_is_not_waited_for_long(booted: Lockstep) -> None:
    """As on a serial port while a board starts anew."""
    opened: list[Transport] = []

    class Mute:
        name = "line"

        def __init__(self) -> None:
            self.inner, self.mute, self.now = open_transport(booted.port), False, 0.0
            opened.append(self)

        def read(self, timeout: float) -> bytes:
            if self.mute:
                self.now += timeout
                return b""
            return self.inner.read(timeout)

        def write(self, data: bytes) -> None:
            if not self.mute:
                self.inner.write(data)

        def close(self) -> None:
            self.inner.close()

    line: list[Mute] = []

    def reopen() -> Transport:
        line.append(Mute())
        return line[-1]

    with Watch(reopen, clock=lambda: line[-1].now if line else 0.0) as watch:
        assert watch.look().problem == ""
        line[0].mute = True
        for failed in (1, 2):
            sight = watch.look()
            assert "got silence" in sight.problem and sight.failed == failed
            assert sight.answer_ms == pytest.approx(1000 * watching.ANSWER_S, abs=1)
        line[0].mute = False
        assert watch.look().problem == ""
    assert len(opened) == 1


def test_a_firmware_of_another_make_shows_what_it_has(
    booted: Lockstep, tcp_server: Callable[..., str]
) -> None:
    ours: dict[int, Reply] = {command: None for command in Msp if command >= 0x4E00}
    port = tcp_server(answering(ours, through=booted.port))
    with Watch(lambda: open_transport(port)) as watch:
        sight = watch.look()
    assert sight.problem == "" and sight.snapshot is not None and sight.info is not None
    assert sight.info.policy is None and sight.snapshot.tasks is None
    assert sight.snapshot.overview.flight is None
    assert len(sight.snapshot.motors_us) == 4
