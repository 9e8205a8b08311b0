"""Errors of configurations, alone and for an aircraft that lacks a part."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.estimator import model_constants
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.config.algorithms import PpoConfig
from neuroflight.training.config.randomization import Randomization
from neuroflight.training.config.training_config import OutputMap, TrainingConfig, WorldConfig
from neuroflight.training.tasks.task import EpisodicTask, PulseTask

NF1 = load_aircraft("nf1")


def world(**options: Any) -> dict[str, WorldConfig]:
    return {"world": WorldConfig(**options)}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"steps": 0}, "steps 0, expected 1 to 1000000000000"),
        ({"seed": -1}, "seed -1, expected 0 to 4294967295"),
        ({"control_rate_hz": 1234}, r"control_rate_hz 1234, expected one of: 1000, 2000, 4000"),
        ({"hidden": (64, 100_000)}, r"hidden layers \[64, 100000\], expected 1 to 8 widths of at least 1"),
        ({"idle": 0.6}, "idle 0.6, expected 0 to 0.5"),
        ({"output": OutputMap(scale=0.0)}, "output.scale 0.0, expected 0.001 to 1000"),
        ({"output": OutputMap(0.2, 2.0, squash=True)}, "output reaches from 1.8 to 2.2, expected some of it"),
        ({"observation": "rate~600Hz"}, "observation 'rate~600Hz': "),
        ({"observation": ""}, "unknown observation block ''"),
        ({"task": EpisodicTask(hold_s=0.001)}, "an episode of task episodic is 0.001 s, 1 control steps"),
        (
            {"task": PulseTask(rest_s=500.0), "control_rate_hz": 4000},
            "is 502.5 s, 2010000 control steps; expected 2 to 1000000",
        ),
        (
            {"task": PulseTask(rest_s=500.0)},
            "256 aircraft with episodes of 502500 control steps make 128640000 setpoints, expected at most",
        ),
        ({"algorithm": PpoConfig(horizon=5000)}, "horizon 5000, expected 1 to the 4500 control steps"),
        (world(mount="wall"), "mount 'wall', expected one of: centre, rig, free"),
        (world(gravity=True), "gravity = true with mount 'centre', where it has no effect"),
        (world(wind_m_s=(0.0, 40.0, 0.0)), "wind_m_s .*, expected -30 to 30"),
        (world(throttle_max=1.5), "throttle_max 1.5, expected 0 to 1"),
        ({"recurrent": "gru"}, "recurrent 'gru': ppo trains no memory; choose pathwise"),
        (world(randomization=Randomization(lag=(2.0, 1.0))), r"randomization lag \[2.0, 1.0\]"),
        (world(randomization=Randomization(noise=(1.0, float("nan")))), "randomization noise"),
        (
            world(noise=False, randomization=Randomization(noise=(1.0, 3.0))),
            "randomization noise with noise = false, so nothing to vary",
        ),
    ],
)  # fmt: skip
def test_an_invalid_configuration_is_rejected(options: dict[str, Any], message: str) -> None:
    with pytest.raises(TrainingError, match=message) as error:
        TrainingConfig(**options)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("options", "change", "message"),
    [
        (
            world(randomization=Randomization(charge=(0.0, 1.0))),
            lambda: replace(NF1, battery=None),
            r"aircraft nf1 has no \[battery\] table, so randomization charge has nothing to vary",
        ),
        (
            world(randomization=Randomization(charge=(0.0, 1.0))),
            lambda: replace(NF1, propulsion=replace(NF1.propulsion, supply_voltage=None)),
            "aircraft nf1 has no propulsion.supply_voltage_v, so randomization charge",
        ),
        (
            world(randomization=Randomization(noise=(1.0, 3.0))),
            lambda: replace(NF1, gyro=replace(NF1.gyro, noise=(0.0, 0.0, 0.0), bias=0.0)),
            "aircraft nf1 has an ideal gyro, so randomization noise has nothing to vary",
        ),
        (
            {"observation": "rotor_estimate", "control_rate_hz": 4000},
            lambda: replace(NF1, propulsion=replace(NF1.propulsion, delay=0.003)),
            "aircraft nf1: its delay 0.003 s is 12 control steps, a model has at most 8; observe without",
        ),
        (
            {"observation": ",".join(["previous_action"] * 17)},
            lambda: NF1,
            "aircraft nf1: the observation has",
        ),
    ],
)
def test_a_configuration_is_rejected_when_the_aircraft_lacks_a_part(
    options: dict[str, Any], change: Callable[[], Any], message: str
) -> None:
    config = TrainingConfig(**options)
    with pytest.raises(TrainingError, match=message):
        config.document(change())


def test_every_kind_of_variation_is_taken_by_an_aircraft_that_has_it() -> None:
    varied = Randomization(mass=(0.8, 1.2), noise=(1.0, 3.0), delay_s=(0.0, 0.006), charge=(0.0, 1.0))
    TrainingConfig(world=WorldConfig(mount="rig", gravity=True, randomization=varied)).check(NF1)


@pytest.mark.parametrize(("observation", "estimated"), [("rate,throttle", False), ("rate_estimate", True)])
def test_the_document_has_the_model_when_the_observation_is_made_by_one(
    observation: str, estimated: bool
) -> None:
    document = TrainingConfig(observation=observation).document(NF1)
    assert ("model" in document) == estimated
    if estimated:
        assert document["model"] == model_constants(NF1, 1000).document()


def test_the_document_has_the_filters_that_the_policy_is_trained_behind() -> None:
    assert TrainingConfig().document(NF1)["filters"] == []
    assert TrainingConfig(gyro_filter="mean").document(NF1)["filters"] == [["mean"]]
