from __future__ import annotations

import pytest

from neuroflight.sim.ports.port import control_divider
from neuroflight.toolchain.errors import LinkError


def test_control_divider_is_whole_when_the_rates_fit() -> None:
    assert control_divider(4000, 1000) == 4


@pytest.mark.parametrize(("gyro", "control"), [(4000, 3000), (1000, 2000), (4000, 0)])
def test_control_divider_refuses_when_the_rates_do_not_fit(gyro: int, control: int) -> None:
    with pytest.raises(LinkError, match="does not divide"):
        control_divider(gyro, control)
