"""What a user of dronekit writes, run as a program of its own: ADDRESS PLAN.

It prints what it saw as one line of JSON.
"""

from __future__ import annotations

import collections
import collections.abc
import json
import sys
import threading
import time
from pathlib import Path
from typing import Any

collections.MutableMapping = collections.abc.MutableMapping  # type: ignore[attr-defined] # gone since Python 3.10

from dronekit import VehicleMode, connect  # noqa: E402

ANSWER_S = 20.0
RATES_AND_THRUST = 0b1000_0000
PERIOD_S = 0.02


def until(done: Any) -> bool:
    """Return whether it becomes true in time."""
    deadline = time.monotonic() + ANSWER_S
    while not done() and time.monotonic() < deadline:
        time.sleep(PERIOD_S)
    return bool(done())


class Setpoints:
    """Sends the same rates and thrust again and again, until they are others."""

    def __init__(self, vehicle: Any) -> None:
        self.rates, self.thrust, self._vehicle = (0.0, 0.0, 0.0), 0.0, vehicle
        threading.Thread(target=self._send, daemon=True).start()

    def _send(self) -> None:
        while True:
            make = self._vehicle.message_factory.set_attitude_target_encode
            whole = [1.0, 0.0, 0.0, 0.0]
            self._vehicle.send_mavlink(make(0, 1, 1, RATES_AND_THRUST, whole, *self.rates, self.thrust))
            time.sleep(PERIOD_S)


def main() -> None:
    """Watch, set all parameters, fly."""
    address, plan_path = sys.argv[1:]
    plan = json.loads(Path(plan_path).read_text())
    needs = ["parameters", "attitude", "mode", "armed"]  # all but a GPS
    vehicle = connect(address, wait_ready=needs, heartbeat_timeout=ANSWER_S)
    rolls = []
    vehicle.add_message_listener("ATTITUDE", lambda *heard: rolls.append(heard[2].rollspeed))
    report: dict[str, Any] = {
        "voltage": vehicle.battery.voltage,
        "mode": vehicle.mode.name,
        "parameters": dict(vehicle.parameters.items()),
        "set": {},
    }
    for name, _, wanted, value in plan["parameters"]:
        if max(wanted, value) > plan["float_max"]:
            continue  # dronekit knows floats alone
        report["set"][name] = [
            vehicle.parameters.set(name, wanted),
            vehicle.parameters[name.lower()],
            vehicle.parameters.set(name.lower(), value),
        ]
    setpoints = Setpoints(vehicle)
    vehicle.mode = VehicleMode("GUIDED")
    report["guided"] = until(lambda: vehicle.mode.name == "GUIDED")

    def armed() -> bool:
        vehicle.armed = True
        return bool(vehicle.armed)

    report["armed"] = until(armed)
    setpoints.rates, setpoints.thrust = (1.0, 0.0, 0.0), 0.3
    report["rolling"] = until(lambda: rolls and abs(rolls[-1] - 1.0) < 0.15)
    setpoints.rates, setpoints.thrust = (0.0, 0.0, 0.0), 0.0
    vehicle.armed = False
    report["disarmed"] = until(lambda: not vehicle.armed)
    print(json.dumps(report), flush=True)
    vehicle.close()


if __name__ == "__main__":
    main()
