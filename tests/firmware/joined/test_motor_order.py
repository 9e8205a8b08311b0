"""Motors wired to other outputs: whatever turns or tells a motor reaches its output, and only that."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import permutations
from typing import Any

import pytest

from neuroflight.toolchain.contract import (
    DSHOT_ALL_MOTORS,
    MOTOR_TEST_MAGIC,
    DshotCommand,
    Refusal,
)

MOTORS = 4
ORDERS = list(permutations(range(1, MOTORS + 1)))
STOPPED = [0] * MOTORS


def wired(bench: Callable[..., Any], order: Sequence[int]) -> Any:
    """A bench whose motor i is wired to output order[i], both from 1."""
    return bench(**{f"motor{motor}_output": output for motor, output in enumerate(order, start=1)})


def by_output(values: Sequence[int], order: Sequence[int]) -> list[int]:
    """Values of motors as the outputs have them."""
    out = [-1] * len(values)
    for value, output in zip(values, order, strict=True):
        out[output - 1] = value
    return out


@pytest.mark.parametrize("order", ORDERS, ids=lambda order: "".join(map(str, order)))
def test_each_output_gets_its_motors_value_and_the_trace_tells_motors(
    scripted: Any, bench: Callable[..., Any], order: tuple[int, ...]
) -> None:
    flying = wired(bench, order)
    flying.arm()
    scripted.lib.scripted_action = [0.1, 0.2, 0.3, 0.4]
    values = flying.run(5, arm=2000)
    motors = list(flying.trace.dshot)[:MOTORS]
    assert len(set(values)) == MOTORS
    assert motors == sorted(motors)
    assert values == by_output(motors, order)


@pytest.mark.parametrize("order", ORDERS, ids=lambda order: "".join(map(str, order)))
def test_a_motor_test_and_a_command_reach_the_motor_that_they_name(
    scripted: Any, bench: Callable[..., Any], order: tuple[int, ...]
) -> None:
    stand, lib, ffi = wired(bench, order), scripted.lib, scripted.ffi
    stand.run(1100)
    test, commands = (ffi.addressof(stand.fw, name) for name in ("motor_test", "dshot_command"))
    assert lib.motor_test_ask(test, MOTOR_TEST_MAGIC, True) == Refusal.NONE
    fractions = [0.05, 0.1, 0.15, 0.2]
    assert lib.motor_test_give(test, fractions, MOTORS) == Refusal.NONE
    motors = [lib.dshot_value(fraction) for fraction in fractions]
    assert stand.run(1) == by_output(motors, order)
    assert list(stand.trace.dshot)[:MOTORS] == motors
    lib.motor_test_ask(test, 0, True)
    stand.run(1000)
    for motor in range(MOTORS):
        asked = lib.dshot_command_ask(
            commands, DshotCommand.DIRECTION_1, motor, lib.firmware_stopped(stand.fw)
        )
        assert asked == Refusal.NONE
        told = [values for values in (stand.sample() for _ in range(60)) if values != STOPPED]
        only = [int(DshotCommand.DIRECTION_1) if other == motor else 0 for other in range(MOTORS)]
        assert told
        assert all(values == by_output(only, order) for values in told)
    assert lib.dshot_command_ask(commands, DshotCommand.SAVE, DSHOT_ALL_MOTORS, True) == Refusal.NONE
    assert [DshotCommand.SAVE] * MOTORS in [stand.sample() for _ in range(60)]


def test_all_outputs_stop_when_the_gyro_falls_silent(scripted: Any, bench: Callable[..., Any]) -> None:
    flying = wired(bench, (3, 1, 4, 2))
    flying.arm()
    scripted.lib.scripted_action = [0.1, 0.2, 0.3, 0.4]
    assert 0 not in flying.run(5, arm=2000)
    out = scripted.new("uint16_t[8]", [99] * 8)
    scripted.lib.firmware_gyro_silent(flying.fw, out)
    assert list(out) == [0] * MOTORS + [99] * 4
