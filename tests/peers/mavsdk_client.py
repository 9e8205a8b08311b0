"""What a user of MAVSDK writes, run as a program of its own: ADDRESS PLAN GRPC_PORT.

It does what the plan, a JSON file, says, and prints what it saw as one line of JSON. MAVSDK 4 has other calls
than 3 for the same.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

ANSWER_S = 20.0
ROLL_DEG_S, THRUST = 60.0, 0.3


class Client:
    """What both have, under the same names."""

    action: Any
    ftp: Any
    log_files: Any
    mission_raw: Any
    offboard: Any
    param: Any
    attitude_rate: Any
    mission_item: Any

    async def connect(self, address: str) -> None:
        """Wait until the aircraft is there."""
        raise NotImplementedError

    def values(self, name: str) -> AsyncIterator[Any]:
        """Give telemetry as it comes."""
        raise NotImplementedError

    async def download(self, entry: Any, path: str) -> None:
        """Fetch a log into a file."""
        async for _ in self.log_files.download_log_file(entry, path):
            pass


class Three(Client):
    """MAVSDK 3, whose streams have the values' names."""

    def __init__(self, grpc_port: int) -> None:
        from mavsdk import System
        from mavsdk.mission_raw import MissionItem
        from mavsdk.offboard import AttitudeRate

        self.attitude_rate, self.mission_item = AttitudeRate, MissionItem
        self._system = System(port=grpc_port)

    async def connect(self, address: str) -> None:
        await self._system.connect(system_address=address)
        async for state in self._system.core.connection_state():
            if state.is_connected:
                break
        for name in ("action", "ftp", "log_files", "mission_raw", "offboard", "param"):
            setattr(self, name, getattr(self._system, name))

    def values(self, name: str) -> AsyncIterator[Any]:
        return aiter(getattr(self._system.telemetry, name)())


class Four(Client):
    """MAVSDK 4, whose streams are subscriptions."""

    async def connect(self, address: str) -> None:
        from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
        from mavsdk.asyncio.plugins import action, ftp, log_files, mission_raw, offboard, param, telemetry

        self.attitude_rate, self.mission_item = offboard.AttitudeRate, mission_raw.MissionItem
        self._mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        await self._mavsdk.add_any_connection(address)
        system = await self._mavsdk.first_autopilot(ANSWER_S)
        self.action, self.ftp = action.ActionAsync(system), ftp.FtpAsync(system)
        self.log_files = log_files.LogFilesAsync(system)
        self.mission_raw, self.param = mission_raw.MissionRawAsync(system), param.ParamAsync(system)
        self.offboard, self._telemetry = offboard.OffboardAsync(system), telemetry.TelemetryAsync(system)

    def values(self, name: str) -> AsyncIterator[Any]:
        return aiter(getattr(self._telemetry, f"subscribe_{name}")())


Report = dict[str, Any]


async def value(client: Client, name: str, count: int = 1) -> Any:
    """Return the last of so many telemetry values."""
    stream = client.values(name)
    for _ in range(count):
        last = await anext(stream)
    return last


async def failure(awaited: Any) -> str:
    """Return what it raises, "" if nothing."""
    try:
        await asyncio.wait_for(awaited, ANSWER_S)
    except Exception as error:
        result = getattr(error, "_result", None)
        return str(getattr(result, "result", None) or error)
    return ""


async def watch(client: Client, report: Report) -> None:
    """Return telemetry of a board on the ground."""
    attitude = await value(client, "attitude_euler")
    quaternion = await value(client, "attitude_quaternion")
    imu = await value(client, "imu")
    report |= {
        "euler": [attitude.roll_deg, attitude.pitch_deg],
        "quaternion": [quaternion.w, quaternion.x, quaternion.y, quaternion.z],
        "down_m_s2": imu.acceleration_frd.down_m_s2,
        "scaled_m_s2": (await value(client, "scaled_imu")).acceleration_frd.down_m_s2,
        "voltage": (await value(client, "battery")).voltage_v,
        "armed": await value(client, "armed"),
        "in_air": await value(client, "in_air"),
        "landed_state": str(await value(client, "landed_state")),
    }


async def parameters(client: Client, plan: Report, report: Report) -> None:
    """Read all parameters; set each to the wanted value and back."""
    read = await client.param.get_all_params()
    report["ints"] = {one.name: one.value for one in read.int_params}
    report["floats"] = {one.name: one.value for one in read.float_params}
    report["set"] = {}
    for name, kind, wanted, value in plan["parameters"]:
        whole = kind != "float"
        put = client.param.set_param_int if whole else client.param.set_param_float
        get = client.param.get_param_int if whole else client.param.get_param_float
        await put(name, int(wanted) if whole else wanted)
        report["set"][name] = await get(name)
        await put(name, int(value) if whole else value)
    report["refused"] = [
        await failure(client.param.set_param_int("DEADBAND_US", 5000)),
        await failure(client.param.get_param_int("NOTHING")),
    ]


async def logs(client: Client, plan: Report) -> None:
    """Download the newest log into a file."""
    entries = await client.log_files.get_entries()
    await client.download(entries[-1], plan["log"])


async def refusals(client: Client, report: Report) -> None:
    """Ask for what the aircraft does not have; return the refusals."""
    item = client.mission_item(0, 6, 16, 1, 1, 0.0, 0.0, 0.0, 0.0, 470000000, 80000000, 10.0, 0)
    report["missions"] = [
        await client.mission_raw.download_mission(),
        await failure(client.mission_raw.upload_mission([item])),
        await failure(client.mission_raw.clear_mission()),
        await failure(client.ftp.list_directory("/")),
        await failure(client.action.return_to_launch()),
    ]


async def take_off(client: Client) -> None:
    """Enable offboard, arm, and roll."""
    rates = client.offboard.set_attitude_rate
    await rates(client.attitude_rate(0.0, 0.0, 0.0, 0.0))
    await client.offboard.start()
    while await failure(client.action.arm()):  # the gyro may still be calibrating
        pass
    await rates(client.attitude_rate(ROLL_DEG_S, 0.0, 0.0, THRUST))


async def fly(client: Client, report: Report) -> None:
    """Fly rates for longer than MAVSDK sends them without seeing offboard in HEARTBEAT; then end offboard."""
    await take_off(client)
    modes = client.values("flight_mode")
    told = [str(await anext(modes)) for _ in range(7)]  # with the heartbeat, once a second
    rates = await value(client, "attitude_angular_velocity_body", 3)
    report |= {
        "roll_rad_s": rates.roll_rad_s,
        "modes": told,
        "active": await client.offboard.is_active(),
        "flying": [await value(client, "armed"), await value(client, "in_air")],
        "set_in_flight": await failure(client.param.set_param_int("DEADBAND_US", 1)),
    }
    await client.offboard.stop()
    while await value(client, "armed"):
        pass


async def vanish(client: Client) -> None:
    """Fly, say so, and never end."""
    await take_off(client)
    print("flying", flush=True)
    await asyncio.Event().wait()


async def main() -> None:
    """Do what the plan says."""
    address, plan_path, grpc_port = sys.argv[1:]
    plan = json.loads(Path(plan_path).read_text())
    client: Client = Three(int(grpc_port)) if plan["major"] == 3 else Four()
    report: Report = {}
    await client.connect(address)
    if plan["vanish"]:
        await vanish(client)
    await watch(client, report)
    await parameters(client, plan, report)
    await logs(client, plan)
    await refusals(client, report)
    await fly(client, report)
    print(json.dumps(report), flush=True)


if __name__ == "__main__":
    asyncio.run(main())
