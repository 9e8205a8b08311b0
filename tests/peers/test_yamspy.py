"""yamspy, unchanged: what it reads of Betaflight it reads of us."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import pytest
from yamspy import MSPy

from neuroflight.flash.link import messages, requests
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.transport import open_transport
from neuroflight.toolchain.contract import SETTINGS, Msp
from tests.firmware.conftest import Program
from tests.peers.conftest import tcp_line
from tests.peers.yamspy_client import ask, hear, new_peer, readers

ANSWERED = 55  # of yamspy's readers, by Betaflight's SITL 4.6.0
RECEIVER_CRSF, RECEIVER_MSP = 1, 2  # choices of the setting receiver_protocol
FEATURE_RX_SERIAL, FEATURE_RX_MSP = 1 << 3, 1 << 14


@pytest.fixture
def answered(betaflight_line: Any) -> set[str]:
    """The requests that Betaflight answers."""
    peer = new_peer()
    peer.conn = betaflight_line
    peer.basic_info()
    return {name for name in readers() if not ask(peer, name).refused}


def connect(line: Any) -> MSPy:
    """yamspy on that line, introduced."""
    peer = new_peer()
    peer.conn = line
    peer.basic_info()
    return peer


def test_it_reads_all_that_it_reads_of_betaflight_when_it_asks_us(answered: set[str], line: Any) -> None:
    assert len(answered) == ANSWERED
    peer = connect(line)
    heard = {name: ask(peer, name) for name in sorted(answered)}
    assert [name for name, one in heard.items() if one.refused] == []
    assert [name for name, one in heard.items() if one.left < 0] == []


# --- What it reads is true ------------------------------------------------------------------------
# None of them at its default. Numbers beside the settings' are those of the ecosystem.
CHANGED: dict[str, float | str] = {
    "receiver_protocol": RECEIVER_CRSF,
    "failsafe_delay_ms": 700,
    "battery_low_v": 3.41,
    "battery_warn_v": 3.62,
    "battery_capacity_mah": 1350,
    "board_roll_deg": 5,
    "board_pitch_deg": -7,
    "board_yaw_deg": 90,
    "craft_name": "Flea",
    "map_throttle": 3,
    "map_yaw": 2,
    "motors_reversed": 1,
    "blackbox_device": 1,
    "blackbox_divider": 4,
    "uart3_function": 2,
    "blackbox_baud": 1_000_000,
}
PROVIDER_CRSF = 9
DEVICE_SERIAL, NO_CARD = 3, 0


def change(host: Program, changed: Mapping[str, float | str] = CHANGED) -> None:
    """Set all of these."""
    with Client(open_transport(f"tcp:127.0.0.1:{host.ports['msp']}")) as client:
        for index, setting in enumerate(SETTINGS):
            if setting.name in changed:
                value = requests.setting_set(index, changed[setting.name], setting.kind)
                client.request(Msp.SETTING_SET, value)


def read_all(peer: MSPy, names: set[str]) -> None:
    """Ask for each; what it heard stands in the peer's fields."""
    for name in sorted(names):
        assert not ask(peer, name).refused, name


def test_what_it_reads_is_what_is_set_when_nothing_is_at_its_default(
    host: Program,
) -> None:
    change(host)
    with tcp_line(host.ports["msp"]) as line:
        peer = connect(line)
        names = {name for name in readers() if not ask(peer, name).refused}
        read_all(peer, names)
    with Client(open_transport(f"tcp:127.0.0.1:{host.ports['msp']}")) as client:
        status = messages.status_ex(client.request(Msp.STATUS_EX))
        rc = messages.rc(client.request(Msp.RC))
        battery = messages.battery_state(client.request(Msp.BATTERY_STATE))
    assert peer.CONFIG["armingDisableFlags"] == status.arming_flags
    assert peer.CONFIG["name"] == "Flea"
    assert tuple(peer.RC["channels"]) == rc
    assert peer.MOTOR_DATA == [1000] * 4 + [0] * 4
    assert peer.BATTERY_STATE["cellCount"] == battery.cells == 4
    assert peer.ANALOG["voltage"] == pytest.approx(battery.voltage_v, abs=0.02)
    assert peer.BATTERY_CONFIG["vbatmincellvoltage"] == pytest.approx(3.41)
    assert peer.BATTERY_CONFIG["vbatwarningcellvoltage"] == pytest.approx(3.62)
    assert peer.BATTERY_CONFIG["capacity"] == 1350
    assert peer.RX_CONFIG["serialrx_provider"] == PROVIDER_CRSF
    assert peer.RC_MAP[:4] == [0, 1, 2, 3]
    assert peer.FAILSAFE_CONFIG["failsafe_delay"] == 7
    assert [peer.BOARD_ALIGNMENT_CONFIG[axis] for axis in ("roll", "pitch", "yaw")] == [5, -7, 90]
    assert peer.MIXER_CONFIG["reverseMotorDir"] == 1
    assert peer.MOTOR_CONFIG["motor_count"] == 4
    assert peer.FEATURE_CONFIG["featuremask"] & FEATURE_RX_SERIAL
    assert not peer.FEATURE_CONFIG["featuremask"] & FEATURE_RX_MSP
    assert len(peer.AUX_CONFIG) == len(peer.AUX_CONFIG_IDS)
    assert peer.AUX_CONFIG[peer.AUX_CONFIG_IDS.index(0)] == "ARM"
    arms = [one for one in peer.MODE_RANGES if one["id"] == 0 and one["range"]["start"] < one["range"]["end"]]
    assert arms[0]["auxChannelIndex"] == 0 and arms[0]["range"]["start"] == 1700
    assert len(peer.MODE_RANGES) == len(peer.MODE_RANGES_EXTRA) == 20
    assert peer.PIDNAMES[:3] == ["ROLL", "PITCH", "YAW"]
    assert len(peer.PIDs) == len(peer.PIDNAMES)
    assert peer.RXFAIL_CONFIG[:4] and len(peer.RXFAIL_CONFIG) == 16
    assert not peer.DATAFLASH["supported"]
    assert peer.SDCARD["supported"] and peer.SDCARD["state"] == NO_CARD
    assert peer.BLACKBOX == {
        **{"supported": True, "blackboxDevice": DEVICE_SERIAL, "blackboxRateNum": 1},
        **{"blackboxRateDenom": 4, "blackboxPDenom": 8},
    }
    assert peer.SERIAL_CONFIG["ports"][2]["functions"] == ["BLACKBOX"]
    assert peer.SERIAL_CONFIG["ports"][2]["blackbox_baudrate"] == "1000000"
    assert peer.COMPASS_CONFIG["mag_declination"] == 0
    assert peer.PID_ADVANCED_CONFIG["pid_process_denom"] == 1


# --- What it changes ------------------------------------------------------------------------------
def turning(host: Program, samples: int = 20) -> list[float]:
    """Motor fractions, some samples from now."""
    for _ in range(samples):
        host.sticks()
        motors = host.step()
    return list(motors)


def test_motors_turn_only_after_it_has_opened_a_motor_test_as_the_app_does(host: Program) -> None:
    values = [1100, 1000, 1150, 1000, 1000, 1000, 1000, 1000]
    with tcp_line(host.ports["msp"]) as line:
        peer = connect(line)
        peer.set_ARMING_DISABLE(1, 0)
        assert not hear(peer).refused
        assert turning(host) == [0, 0, 0, 0]
        peer.send_RAW_MOTORS(values)
        assert hear(peer).refused, "no motor test is open"
        peer.conn.reset_input_buffer()
        assert turning(host) == [0, 0, 0, 0]
        peer.set_ARMING_DISABLE(0, 1)
        assert not hear(peer).refused
        peer.send_RAW_MOTORS(values)
        assert not hear(peer).refused
        first, second, third, fourth = turning(host)
        assert first > 0 and third > first and (second, fourth) == (0, 0)
        assert not ask(peer, "MSP_MOTOR").refused
        assert peer.MOTOR_DATA[:4] == pytest.approx([1100, 1000, 1150, 1000], abs=1)
        peer.set_ARMING_DISABLE(1, 0)
        assert not hear(peer).refused
        assert turning(host) == [0, 0, 0, 0]


def test_nothing_arms_while_it_says_so(host: Program) -> None:
    def switch_on() -> bool:
        for _ in range(30):
            host.sticks(arm=2000)
            host.step()
        assert not ask(peer, "MSP_STATUS").refused
        armed = bool(peer.CONFIG["mode"] & 1)
        turning(host)
        return armed

    with tcp_line(host.ports["msp"]) as line:
        peer = connect(line)
        peer.set_ARMING_DISABLE(1, 0)
        assert not hear(peer).refused
        assert not switch_on()
        assert not ask(peer, "MSP_STATUS_EX").refused
        assert peer.CONFIG["armingDisableFlags"] & 1 << 16  # MSP, in the ecosystem's numbers
        peer.set_ARMING_DISABLE(0, 0)
        assert not hear(peer).refused
        turning(host)
        assert switch_on()


def test_it_flies_sticks_and_changes_map_and_features_when_the_receiver_is_msp(
    start_host: Callable[..., Program],
) -> None:
    host = start_host(receiver_protocol=RECEIVER_MSP)  # of this start; and as it is set
    change(host, {"receiver_protocol": RECEIVER_MSP})
    with tcp_line(host.ports["msp"]) as line:
        peer = connect(line)
        for _ in range(60):
            peer.send_RAW_RC([1600, 1400, 1000, 1550, 1000, 1000, 1000, 1000])
            assert not hear(peer).refused
            for _ in range(10):
                host.step()
        assert not ask(peer, "MSP_RC").refused
        assert peer.RC["channels"][:4] == [1600, 1400, 1550, 1000]
        assert not ask(peer, "MSP_FEATURE_CONFIG").refused
        features = peer.FEATURE_CONFIG["featuremask"]
        assert features & FEATURE_RX_MSP and not features & FEATURE_RX_SERIAL
        peer.set_FEATURE_CONFIG(features & ~FEATURE_RX_MSP | FEATURE_RX_SERIAL)
        assert not hear(peer).refused
        assert not ask(peer, "MSP_FEATURE_CONFIG").refused
        assert peer.FEATURE_CONFIG["featuremask"] & FEATURE_RX_SERIAL
        assert not ask(peer, "MSP_RX_MAP").refused
        turned = [1, 0, *peer.RC_MAP[2:]]
        peer.set_RX_MAP(turned)
        assert not hear(peer).refused
        assert not ask(peer, "MSP_RX_MAP").refused
        assert turned == peer.RC_MAP
        peer.save2eprom()
        assert not hear(peer).refused


def test_its_quick_readers_tell_the_same_as_its_others(host: Program) -> None:
    with tcp_line(host.ports["msp"]) as line:
        peer = connect(line)
        for name, quick in (
            ("MSP_RAW_IMU", peer.fast_read_imu),
            ("MSP_ATTITUDE", peer.fast_read_attitude),
            ("MSP_ANALOG", peer.fast_read_analog),
        ):
            assert not ask(peer, name).refused
            slow = repr((peer.SENSOR_DATA, peer.ANALOG.get("voltage")))
            quick()
            assert repr((peer.SENSOR_DATA, peer.ANALOG.get("voltage"))) == slow
