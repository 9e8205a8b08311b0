"""The page of results from stored figures, and `neuroflight report` as a user types it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.training.results_page.page import render
from neuroflight.training.results_page.stored_results import (
    ResultsError,
    Stored,
    compact,
    read_commands,
    read_results,
)
from neuroflight.training.results_page.summary import summary

Capture = pytest.CaptureFixture[str]
Document = dict[str, Any]
ROOT = Path(__file__).resolve().parents[3]
FIGURES = ("success", "success_bare", "settling_ms", "failure", "failure_bare", "rise_ms", "peak", "error")
SHARES = ("in_band_500", "in_band_750", "in_band_500_bare", "in_band_750_bare")


def response(value: float) -> Document:
    """The same value for every figure; no failure in yaw."""
    found: Document = {
        name: {"value": [value, value, value], "count": [9, 9, 9]}
        for name in (*FIGURES, "stability", *SHARES)
    }
    found["failure"] = {"value": [12.3, 0.0, 0.0], "count": [2, 1, 0]}
    return found | {f"all_{name}": {"value": value, "count": 9} for name in SHARES}


def evaluated(controller: str, task: str = "pulse", aircraft: str = "nf1", **more: Any) -> Document:
    """The output of `evaluate --json`, as far as the page reads it."""
    return {
        "command": f"neuroflight evaluate {controller} --aircraft {aircraft} --task {task}",
        "controller": controller,
        "aircraft": aircraft,
        "aircraft_sha256": "ab" * 32,
        "task": task,
        "episodes": 1000,
        "seed": 1,
        "mount": "centre",
        "throttle": 0.0,
        "noise": True,
        "delay_s": 0.002,
        **{name: [2.5, 2.25, 1.5] for name in ("mae", "mse", "iae", "ise", "itae", "itse")},
        "margin_95": {"mae": [0.125, 0.25, 0.5]},
        "output": 0.1234,
        "change": 0.01234,
        "response": response(0.875),
    } | more


def compared(*entries: Document) -> Document:
    """The output of `compare --json`, as far as the page reads it; differences to the first."""
    own = {
        *("controller", "pid", "policy_sha256", "throttle", "idle", "response", "output", "change"),
        *("mae", "mse", "iae", "ise", "itae", "itse", "margin_95", "smoothness", "difference"),
    }
    first = entries[0]
    return {key: value for key, value in first.items() if key not in own} | {
        "command": "neuroflight compare",
        "comparison": [{key: value for key, value in entry.items() if key in own} for entry in entries],
    }


def difference(value: float, low: float, high: float) -> Document:
    """One figure of `difference`."""
    return {"value": value, "low": low, "high": high, "significant": low > 0 or high < 0}


def trained(**more: Any) -> Document:
    """The training.json of a monitored run, as far as the page reads it."""
    readings = [
        {"steps": steps, "mae": {"mean": mae, "least": 0.0, "greatest": 9.0}}
        for steps, mae in ((1_000_000, 8.0), (2_000_000, 4.0), (4_000_000, 4.9))
    ]
    return {
        "config": {
            "aircraft": {"name": "nf1", "sha256": "ab" * 32},
            "algorithm": {"name": "ppo"},
            "observation": "rate_error",
            "seed": 3,
        },
        "steps": 4_000_000,
        "seconds": 80.0,
        "steps_per_second": 50_000,
        "command": "neuroflight train",
        "chosen": readings[1],
        "monitor": readings,
    } | more


def robust(*controllers: Document) -> Document:
    """The output of `robustness --json`, as far as the page reads it."""
    return {
        "command": "neuroflight robustness",
        "aircraft": "nf1",
        "aircraft_sha256": "ab" * 32,
        "robustness": {
            "task": "pulse",
            "throttle_max": 0.8,
            "episodes": 200,
            "draws": 100,
            "commands_per_draw": 5,
            "divergence": "it tumbles",
            "bars": {"case": 2.0, "median": 1.5, "high": 2.5},
            "high_quantile": 0.95,
            "controllers": list(controllers),
        },
    }


def at_equal_thrust(*labels: Document) -> Document:
    """The output of `compare --thrust 0 1 2 --json`, as far as the page reads it, of these controllers."""

    def mean(value: float) -> Document:
        return {"value": value, "low": value - 0.25, "high": value + 0.25}

    def controller(number: int, thrust: float) -> Document:
        means = {"mae": mean(1.0 + number), "mse": mean(80.0 * thrust), "motor_change": mean(0.003)}
        found = {
            **labels[number],
            "throttle": 0.25 * thrust,
            "mae": [1.5, 1.25, 1.0],
            "means": means,
            "thrust_at_rest": mean(max(thrust, 0.75)),
            "motor_deviation_at_rest": 0.00375,
            "reached": thrust == 1 or number == 0,
        }
        if number:
            found["difference"] = {name: mean(0.125) for name in means}
            found["difference"]["mae"] = mean(1.0)
        return found

    numbers = range(len(labels))
    return {
        "command": "neuroflight compare --thrust 0 1 2",
        "aircraft": "nf1",
        "aircraft_sha256": "ab" * 32,
        "task": "pulse",
        "episodes": 100,
        "equal_thrust": [
            {"thrust": thrust, "controllers": [controller(number, thrust) for number in numbers]}
            for thrust in (0.0, 1.0, 2.0)
        ],
        "transparency": [
            {
                **label,
                "throttle": [0.0, 0.5, 1.0],
                "thrust": [0.06, 2.5, 6.5],
                "motor": [0.055, 0.5, 1.0],
                "ideal": [0.055, 0.5275, 1.0],
                "deviation": {"throttles": [0.15, 0.8], "value": -0.0275, "throttle": 0.5},
                "falls": falls,
            }
            for label, falls in zip(labels, (None, [0.0, 0.5]), strict=True)
        ],
    }


def bore(**more: Any) -> Document:
    """One controller of a robustness result."""

    def case(ratio: float, diverged: int = 0) -> Document:
        mean = {"value": 1.75, "low": 1.5, "high": 2.0}
        return {"mae": mean, "ratio": {k: ratio / 1.75 * v for k, v in mean.items()}, "diverged": diverged}

    return {
        "controller": "pid",
        "pid": "tuned",
        "idle": 0.23,
        "cases": {"nominal": case(1.0), "mass x 0.8": case(1.75), "delay 6 ms": case(3.5, 2)},
        "joint": {
            "median": {"value": 1.25, "low": 1.0, "high": 1.5},
            "high": {"value": 2.75, "low": 2.5, "high": 3.0},
            "diverged": 3,
        },
    } | more


def flown(*names: str) -> Document:
    """The output of `fly --json`, as far as the page reads it."""
    sums = {name: [1.25, 1.5, 1.75] for name in ("mae", "mse", "iae", "ise", "itae", "itse")}
    flight = {"tracking": sums, "effort": {"output": 0.2, "change": 0.005}, "response": None}
    return {
        "on": "betaflight",
        "scenario": "pulses",
        "seed": 7,
        "episodes": 10,
        "aircraft": "nf1",
        "aircraft_sha256": "cd" * 32,
        "flights": dict.fromkeys(names, flight),
    }


def freely(*controllers: Document) -> Document:
    """The output of `manoeuvres --json`, as far as the page reads it."""
    return {
        "command": "neuroflight manoeuvres",
        "aircraft": "nf1",
        "aircraft_sha256": "ab" * 32,
        "manoeuvres": {
            **{"seeds": 5, "seed": 1, "descents": 3, "battery": 0.9, "gust_m_s": 7.7, "settle_s": 1.0},
            "contenders": list(controllers),
        },
    }


def controller(mae: float, wins: list[str], clear: list[str], **more: Any) -> Document:
    """One controller of a result of manoeuvres, the same in two of them."""

    def mean(value: float) -> Document:
        return {"value": value, "low": value - 0.25, "high": value + 0.25}

    names = ("mse", "overshoot", "stray", "stray_peak", "thrust", "change")
    figures = {"mae": mean(mae), **{name: mean(3.0) for name in names}, "wins": wins, "clear_wins": clear}
    return {
        "controller": "pid:tuned",
        "pid": "tuned",
        "idle": 0.0,
        "throttle": [0.0, 0.15, 0.3, 0.6, 1.0],
        "thrust_at_rest": [0.06, 0.36, 1.22, 3.65, 6.1],
        "figures": {"split-s": figures, "punch-out": figures},
        "descent": {"sink_m_s": mean(18.5)},
    } | more


def drifted() -> Document:
    """The output of `stability --json`."""
    runs = [
        ("reduced", 2.0, 2e-16),
        ("reduced", 1.0, 2e-16),
        ("maximal", 1.0, 3.4e-4),
        ("maximal", 0.25, 1e-5),
    ]
    return {
        "command": "neuroflight stability",
        "aircraft": "nf1",
        "aircraft_sha256": "ab" * 32,
        "combinations": 16,
        "rate_limit_deg_s": 2000.0,
        "runs": [{"formulation": f, "step_ms": ms, "drift_m": drift} for f, ms, drift in runs],
    }


def page(*documents: Document) -> str:
    return render([Stored(f"{number}.json", document) for number, document in enumerate(documents)])


def row(text: str, label: str, table: int = 0) -> list[str]:
    """Cells of the `table`-th row that begins with `label`."""
    lines = [line for line in text.splitlines() if line.startswith(f"| {label} |")]
    return [cell.strip() for cell in lines[table].split("|")[2:-1]]


def test_pulses_stand_above_the_dissertations_when_flown_on_the_nf1() -> None:
    text = page(evaluated("pid:tuned", pid="tuned"))
    assert " | ".join(row(text, "PID `tuned`")) == (
        "1000 | 2.50 ± 0.12 / 2.25 ± 0.25 / 1.50 ± 0.50 | 2.08 | 2 / 2 / 2 | 2 | 0.123 | 0.0123 | "
    )
    assert " | ".join(row(text, "dissertation, PID")) == (
        "100 | 4 / 4 / 3 | 4.51 | 414 / 492 / 199 | 368 | 0.03 | 0.04 | "
    )
    assert row(text, "dissertation, PID", 1)[0] == "4,773 / 4,941 / 3,829"
    assert row(text, "PID `tuned`", 2)[0] == "87.5 / 87.5 / 87.5"
    assert row(text, "dissertation, policy")[3:5] == ["148 / 135 / 66", "117"]  # of the axes it would be 116
    assert text.index("PID `tuned`") < text.index("dissertation, PID")


@pytest.mark.parametrize(
    ("more", "label"),
    [
        ({"pid": "published"}, "PID `published`"),
        ({"pid": "published", "noise": False}, "PID `published`, no noise"),
        (
            {"pid": "a", "noise": False, "delay_s": 0.0, "command": "neuroflight evaluate pid:a --delay 0"},
            "PID `a`, no noise, delay 0 ms",
        ),
        ({"pid": "a", "mount": "rig", "throttle": 0.3}, "PID `a`, mount rig, throttle 0.3"),
        ({"controller": "training/policies/nf1-nominal/policy.onnx"}, "shipped policy (nf1-nominal)"),
        (
            {"controller": "training/policies/nf1/policy.onnx", "policy_sha256": "cd" * 32},
            "policy shipped before (nf1)",
        ),
        ({"controller": "mine.onnx"}, "policy `mine.onnx`"),
        ({"controller": "runs/iris/ppo-m1/policy.onnx"}, "policy `ppo-m1`"),
        ({"pid": "a", "idle": 0.23, "throttle": 0.3}, "PID `a`, idle 0.23, throttle 0.3"),
    ],
)
def test_row_says_how_it_was_flown_when_that_is_not_the_usual(more: Document, label: str) -> None:
    assert row(page(evaluated("pid") | more), label)[0] == "1000"


def test_rows_keep_the_order_of_files_when_there_are_several() -> None:
    text = page(evaluated("pid", pid="z"), evaluated("pid", pid="a"), flown("firmware", "PID"))
    places = [
        text.index(f"| {label} |") for label in ("PID `z`", "PID `a`", "Betaflight, default PID (SITL)")
    ]
    assert places == sorted(places)
    assert row(text, "PID, same gyro rate and commands as the row above")[1] == "1.25 / 1.50 / 1.75"


def test_command_of_a_flight_is_made_from_its_conditions_when_it_stores_none() -> None:
    assert (
        "`neuroflight fly --on betaflight --scenario pulses --aircraft nf1 --throttle 0 --count 10 --seed 7`"
        in page(flown("firmware"))
    )


def test_episodic_rows_stand_in_sections_by_aircraft() -> None:
    text = page(evaluated("pid", "episodic", "iris", pid="tuned"), evaluated("pid", "episodic", pid="tuned"))
    assert row(text, "PID `tuned`")[:3] == ["1000", "87.5 / 87.5 / 87.5", "87.5 / 87.5 / 87.5"]
    assert row(text, "PID `tuned`")[3] == "12.3 / 0.0 / -"
    assert text.index("## Episodic task, iris") < text.index("## Episodic task, nf1")


def test_envelope_has_shares_of_each_axis_and_of_all_at_once() -> None:
    text = page(evaluated("pid", "envelope", pid="tuned"))
    assert row(text, "PID `tuned`") == ["1000", "", "", "87.5", "87.5", "87.5", "87.5"]
    assert row(text, "PID `tuned`", 1)[0] == "87.5 / 87.5 / 87.5"
    assert row(text, "dissertation, policy") == ["1000", "72", "", "", "", "", ""]
    assert row(text, "dissertation, PID") == ["1000", "16", "", "", "", "", ""]
    assert "after 750 ms they are 76 % (policy) and 29 % (PID)" in text


def test_envelope_has_the_strict_share_when_it_was_taken() -> None:
    strict = {"steady": {"value": 0.8125, "count": 9}, "steady_bare": {"value": 0.5, "count": 9}}
    text = page(evaluated("pid", "envelope", pid="tuned") | {"response": response(0.875) | strict})
    assert row(text, "PID `tuned`")[:3] == ["1000", "81.2", "50.0"]


def test_comparison_gives_a_row_each_and_their_differences() -> None:
    differences = {"mae": difference(-0.25, -0.375, -0.125), "output": difference(0.5, -1.5, 2.5)}
    text = page(
        compared(
            evaluated("pid", pid="tuned", idle=0.23, smoothness=1.5e-4),
            evaluated("a/policy.onnx", idle=0.25, smoothness=5e-5, difference=differences),
            evaluated("pid", pid="tuned", idle=0.23, throttle=0.3),
            evaluated("b.onnx", throttle=0.3, difference=differences, policy_sha256="cd" * 32),
        )
    )
    assert row(text, "PID `tuned`, idle 0.23")[-1] == "150"
    assert row(text, "policy `a`, idle 0.25")[-1] == "50"
    assert " | ".join(row(text, "policy `a`, idle 0.25 less PID `tuned`, idle 0.23")) == (
        "-0.25 ± 0.12 |  | ≈ +0.5000 ± 2.0000 |  | "
    )
    assert row(text, "policy `b.onnx`, throttle 0.3 less PID `tuned`, idle 0.23, throttle 0.3")
    assert row(text, "`0.json`")[-1] == "nf1 `abababababab`, policy `cdcdcdcdcdcd`"


@pytest.fixture
def lifted() -> Document:
    """Betaflight and a PID at equal thrust."""
    return at_equal_thrust(
        {"controller": "betaflight", "betaflight": "0.0.6", "idle": 0.055},
        {"controller": "pid", "pid": "tuned", "idle": 0.23},
    )


def test_equal_thrust_has_a_row_a_thrust_and_controller_their_mean_and_the_throttle(lifted: Document) -> None:
    page = render([Stored("equal.json", lifted)])
    assert "## Equal thrust, nf1" in page
    name = "Betaflight 4.6, its defaults, idle 0.055"
    pid = "PID `tuned`, idle 0.23"
    assert f"| closed, {name} | 0.000 | 0.750 | 1.50 / 1.25 / 1.00 | 1.000 ± 0.250 |" in page
    assert f"| 2, {pid} | 0.500 | 2.000, nearest |" in page
    assert "| +1.000 ± 0.250 | ≈ +0.1 ± 0.2 | ≈ +0.12500 ± 0.25000 |" in page
    assert "| 0.00300 ± 0.25000 | 0.00375 |" in page
    assert f"| {pid} | 2.000 | 2.000 | 120.0 | 1.000 | 0.00300 | 1.000 |" in page  # of the thrusts 1 and 2
    assert f"| {name} | 0.06 (0.055 / 0.055) | 2.50 (0.500 / 0.527) | 6.50 (1.000 / 1.000) |" in page
    assert "| -0.028 at 0.5 | yes |" in page or "| -0.027 at 0.5 | yes |" in page
    assert "| no: 0 to 0.5 |" in page


def test_equal_thrust_of_flights_tells_what_holds(lifted: Document) -> None:
    mean = {"value": 2.5, "low": 2.25, "high": 2.75}
    for level in lifted["equal_thrust"]:
        for each in level["controllers"]:
            for figures in (each["means"], each.get("difference", {})):
                figures |= {"rest_late": mean, "drift": mean}
    page = render([Stored("equal.json", lifted | {"task": "flight"})])
    assert "Flights of a minute: ten pulses one after another" in page
    assert "| 0.00375 | 2.50 ± 0.25 | 2.5 ± 0.2 |" in page
    assert "| rest late | of the first's | drift, ° | of the first's |" in page
    assert "Flights of a minute" not in render([Stored("equal.json", lifted)])


def test_thrust_against_throttle_stands_alone_beside_a_comparison(lifted: Document) -> None:
    both = compared(evaluated("pid", pid="tuned")) | {"transparency": lifted["transparency"]}
    page = render([Stored("both.json", both)])
    assert "## Thrust against throttle, nf1" in page
    assert "## Equal thrust" not in page
    lifted["transparency"][0]["thrust"] = "much"
    with pytest.raises(ResultsError, match=r"equal.json.*thrust: got 'much', expected a list of numbers"):
        render([Stored("equal.json", lifted)])


def test_robustness_has_a_column_each_and_marks_what_misses_its_bar() -> None:
    text = page(robust(bore(), bore(policy_sha256="cd" * 32, joint=None)))
    assert "|  | at most | PID `tuned`, idle 0.23 | PID `tuned`, idle 0.23 |" in text
    assert row(text, "nominal, MAE, deg/s") == ["", "1.75 ± 0.25", "1.75 ± 0.25"]
    assert row(text, "mass x 0.8") == ["2", "1.75 ± 0.25", "1.75 ± 0.25"]
    assert row(text, "delay 6 ms") == ["2", *["**3.50** ± 0.50, 2 diverged"] * 2]
    assert "all at once" not in text.split("## What made")[0].split("| nominal")[1]
    assert row(text, "`0.json`")[-1] == "nf1 `abababababab`, policy `cdcdcdcdcdcd`"
    alone = page(robust(bore()))
    assert row(alone, "all at once, median") == ["1.5", "1.25 (1.00 to 1.50)"]
    assert row(alone, "all at once, 95th percentile") == ["2.5", "**2.75** (2.50 to 3.00)"]
    assert row(alone, "all at once, diverged") == ["0", "3"]


def test_runs_have_their_speed_and_the_time_to_a_small_error() -> None:
    text = page(evaluated("pid", pid="a"), trained(), trained(chosen=None, monitor=[]))
    assert row(text, "ppo, nf1, `rate_error`, seed 3") == ["4.0", "80", "50,000", "40", "2.0", "4.00"]
    assert row(text, "ppo, nf1, `rate_error`, seed 3", 1) == ["4.0", "80", "50,000", "", "", ""]
    assert row(text, "`1.json`") == ["`neuroflight train`", "nf1 `abababababab`"]


def test_drift_stands_beside_the_dissertations_when_the_step_is_the_same() -> None:
    text = page(drifted())
    assert row(text, "reduced") == ["2", "2e-13", ""]  # shown at 1 ms alone
    assert row(text, "reduced", 1) == ["1", "2e-13", "0"]
    assert row(text, "maximal") == ["1", "0.34", "39"]
    assert row(text, "maximal", 1) == ["0.25", "0.01", ""]


def timed(**more: Any) -> Document:
    """The output of `timing IMAGE.bin --json`, as far as the page reads it."""

    def entry(work: str, controller: str | None, *, armed: bool = True) -> Document:
        return {
            "work": work,
            "armed": armed,
            "controller": controller,
            "runs": 4500,
            "instructions": {"worst": 12_900, "best": 12_300},
            "predicted_cycles": {"worst": 21_600.0, "best": 19_440.0},
            "variability": 0.1,
        }

    return {
        "command": "neuroflight timing neuroflight.bin",
        "image_sha256": "ef" * 32,
        "network": "6-32-32-4 tanh",
        "policy_sha256": "cd" * 32,
        "aircraft": "nf1",
        "aircraft_sha256": "ab" * 32,
        "count": 3,
        "core_hz": 216_000_000,
        "device_cycles": 12,
        "model": "LLVM 14.0.6",
        "predicted_cycles_reason": None,
        "interruptions": 7,
        "edge_instructions": {"worst": 66, "best": 11},
        "board_timing": [
            entry("control algorithm", "policy"),
            entry("control task", "pid"),
            entry("control task", None, armed=False),
        ],
    } | more


def test_tasks_stand_above_the_dissertations_when_an_image_was_timed() -> None:
    text = page(timed())
    ours = ["4,500", "12,900 / 12,300", "21,600 / 19,440", "100.0 / 90.0", "10.0"]
    assert row(text, "policy 6-32-32-4 tanh, armed") == ours
    assert row(text, "PID, armed") == row(text, "disarmed") == ours
    printed = "dissertation, policy 6-32-32-4, armed"
    assert row(text, printed) == ["", "", "", "210 / 195", "7.1"]
    assert row(text, printed, 1) == ["", "", "", "423 / 263", "37.8"]
    assert row(text, "dissertation, Betaflight, armed") == ["", "", "", "15 / 9", "40.0"]
    assert row(text, "dissertation, Betaflight, disarmed", 1) == ["", "", "", "58 / 45", "22.4"]
    assert text.index("| control algorithm,") < text.index("| PID, armed") < text.index("| disarmed")
    assert "predicted by LLVM 14.0.6's model of the Cortex-M7, with 12 more" in text.replace("\n", " ")
    assert "which came 7 times" in text.replace("\n", " ")
    assert row(text, "`0.json`")[1] == "nf1 `abababababab`, image `efefefefefef`, policy `cdcdcdcdcdcd`"


def test_tasks_have_instructions_only_when_there_is_no_model() -> None:
    plain = timed(model=None, predicted_cycles_reason="llvm-mca is not installed")
    for entry in plain["board_timing"]:
        entry["predicted_cycles"] = None
    text = page(plain)
    assert row(text, "PID, armed") == ["4,500", "12,900 / 12,300", "", "", "10.0"]
    assert "No cycles: llvm-mca is not installed." in text.replace("\n", " ")


def test_sources_name_command_and_digests_when_listed() -> None:
    text = page(evaluated("mine.onnx", policy_sha256="ef" * 32))
    command, digests = row(text, "`0.json`")
    assert command == "`neuroflight evaluate mine.onnx --aircraft nf1 --task pulse`"
    assert digests == "nf1 `abababababab`, policy `efefefefefef`"


def without(key: str) -> Callable[[Document], Document]:
    return lambda document: {name: value for name, value in document.items() if name != key}


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (without("mae"), "mae: got 'nothing', expected a value"),
        (lambda d: d | {"mae": [1, 2]}, "mae: got '[1, 2]', expected three finite numbers"),
        (lambda d: d | {"mae": [1, 2, float("nan")]}, "expected three finite numbers"),
        (lambda d: d | {"output": "much"}, "output: got 'much', expected a finite number"),
        (lambda d: d | {"task": "loop"}, "task: got 'loop', expected one of pulse, episodic, envelope"),
        (lambda d: d | {"aircraft": "a\nb"}, "aircraft: got 'a\\nb', expected a line of text"),
        (lambda d: d | {"response": {"success": 1}}, "response.success.value"),
        (without("task"), "what a command printed with --json"),
        (lambda d: compared(d) | {"comparison": 3}, "comparison: got '3', expected a list of objects"),
        (lambda d: compared(d, without("mae")(d)), "comparison[1]: mae: got 'nothing'"),
        (lambda d: compared(d, d | {"difference": {"mae": {"low": 1}}}), "difference.mae.value"),
        (lambda d: robust(), "robustness.controllers: got '[]', expected a list of objects"),
        (lambda d: robust(bore(cases={})), "robustness.controllers[0]: cases: got '{}'"),
        (
            lambda d: robust(bore(), bore(cases={"nominal": {}})),
            "robustness.controllers[1]: cases.nominal.mae",
        ),
        (lambda d: trained(monitor=3), "monitor: got '3', expected a list of objects"),
        (lambda d: trained(monitor=[{"steps": 1}]), "monitor[0]: mae: got 'nothing'"),
        (lambda d: trained(seconds=None), "seconds: got 'None', expected a finite number"),
        (lambda d: flown("PID") | {"scenario": "flip"}, "scenario: got 'flip'"),
        (lambda d: flown("PID") | {"flights": 3}, "flights: got '3'"),
        (lambda d: drifted() | {"runs": [1]}, "expected a list of objects"),
        (lambda d: drifted() | {"runs": [{"formulation": "reduced"}]}, "runs[0]: step_ms"),
    ],
)
def test_page_is_rejected_when_a_file_is_damaged(
    damage: Callable[[Document], Document], message: str
) -> None:
    with pytest.raises(ResultsError) as caught:
        page(damage(evaluated("pid", pid="tuned")))
    assert message in str(caught.value)
    assert str(caught.value).startswith("0.json: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"{", "not JSON"),
        (b"[]", "holds a list"),
        (b"\xff", "not JSON"),
        (b" " * 5_000_000, "at most 4194304"),
    ],
)
def test_file_is_rejected_when_it_is_not_a_result(content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(content)
    with pytest.raises(ResultsError, match=message):
        read_results(tmp_path)


def test_command_writes_checks_and_notices_when_a_figure_changes(tmp_path: Path, capsys: Capture) -> None:
    folder, out = tmp_path / "results", tmp_path / "results.md"
    folder.mkdir()
    (folder / "a.json").write_text(json.dumps(evaluated("pid", pid="tuned")))
    words = ["report", "--folder", str(folder), "--out", str(out)]
    assert main([*words, "--check"]) == 1
    assert "run `neuroflight report`" in capsys.readouterr().err
    assert not out.exists()
    assert main(words) == 0
    assert main([*words, "--check"]) == 0
    assert out.read_text() == render(read_results(folder))
    (folder / "a.json").write_text(json.dumps(evaluated("pid", pid="tuned", episodes=999)))
    assert main([*words, "--check"]) == 1


def test_command_rejects_in_one_line_when_there_is_nothing_to_show(tmp_path: Path, capsys: Capture) -> None:
    assert main(["report", "--folder", str(tmp_path), "--out", str(tmp_path / "a.md")]) == 1
    error = capsys.readouterr().err
    assert "0 .json files" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "a.md").exists()


def test_page_is_made_from_the_output_of_the_commands(tmp_path: Path, capsys: Capture) -> None:
    commands = {
        "a": ["evaluate", "pid:published", "--task", "pulse", "--episodes", "2", "--no-noise"],
        "b": ["evaluate", "pid:published", "--task", "episodic", "--episodes", "2"],
        "c": ["compare", "pid:tuned", "pid:published", "--task", "envelope", "--episodes", "2"],
        "d": ["stability", "--steps-ms", "2"],
    }
    for name, words in commands.items():
        assert main([*words, "--json"]) == 0
        (tmp_path / f"{name}.json").write_text(capsys.readouterr().out)
    results = read_results(tmp_path)
    text = render(results)
    stored = [Stored(each.name, summary(each.name, dict(each.document))) for each in results]
    assert render(stored) == text
    assert all(
        len(compact(short.document)) < len(compact(each.document))
        for short, each in zip(stored, results, strict=True)
    )
    for heading in (
        "Pulses, nf1",
        "Episodic task, nf1",
        "Flight envelope, nf1",
        "Stability of the simulation, nf1",
    ):
        assert f"## {heading}" in text
    assert load_aircraft("nf1").sha256[:12] in text


def test_shipped_page_is_what_the_stored_figures_give_when_checked(capsys: Capture) -> None:
    assert main(["report", "--check"]) == 0
    assert (ROOT / "docs" / "results.md").is_file()
    assert "up to date" in capsys.readouterr().out


def command_file(folder: Path, *lines: str) -> None:
    (folder / "commands.txt").write_text("# file and command\n\n" + "\n".join(lines) + "\n")


@pytest.mark.slow
def test_again_repeats_the_commands_of_the_folder(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("neuroflight.cli.training.results.OUTPUTS", tmp_path / "outputs")
    fly = "neuroflight evaluate pid:published --task envelope --seed 3 --episodes"
    command_file(tmp_path, f"a.json {fly} 2", "b.json neuroflight nothing")
    words = ["report", "--folder", str(tmp_path), "--out", str(tmp_path / "a.md"), "--again"]
    assert main([*words, "a.json"]) == 0
    stored = (tmp_path / "a.json").read_text()
    assert json.loads(stored)["episodes"] == 2
    assert len(stored) < len((tmp_path / "outputs/full/a.json").read_text()) / 3
    assert "PID `published`" in (tmp_path / "a.md").read_text()
    (tmp_path / "b.json").write_text("as it was")
    capsys.readouterr()
    assert main([*words, "b.json"]) == 1
    captured = capsys.readouterr()
    assert "b.json: `neuroflight nothing" in captured.err
    assert "no command 'nothing'" in captured.err
    assert captured.err.count("\n") == 1
    assert (tmp_path / "b.json").read_text() == "as it was"


@pytest.mark.parametrize(
    ("lines", "names", "message"),
    [
        (["a.json rm -r x"], [], "line 3: 'a.json rm -r x', expected NAME.json neuroflight COMMAND"),
        (["../a.json neuroflight evaluate pid"], [], "line 3: '../a.json"),
        (["a.txt neuroflight evaluate pid"], [], "line 3: 'a.txt"),
        (["a.json neuroflight evaluate 'pid"], [], 'line 3: "a.json neuroflight evaluate \'pid"'),
        (["a.json neuroflight evaluate pid"] * 2, [], "line 4: a.json for a second time"),
        (["a.json neuroflight evaluate pid"], ["b.json"], "b.json: not there, expected one of: a.json"),
    ],
)
def test_again_rejects_invalid_commands_in_one_line(
    lines: list[str], names: list[str], message: str, tmp_path: Path, capsys: Capture
) -> None:
    command_file(tmp_path, *lines)
    words = ["report", "--folder", str(tmp_path), "--out", str(tmp_path / "a.md"), "--again", *names]
    assert main(words) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["commands.txt"]


def test_shipped_files_hold_what_the_page_reads_and_no_more() -> None:
    folder = ROOT / "docs" / "results"
    for each in read_results(folder):
        text = compact(summary(each.name, dict(each.document))) + "\n"
        assert (folder / each.name).read_text() == text, f"neuroflight report --again {each.name}"


def test_every_shipped_file_can_be_made_again() -> None:
    folder = ROOT / "docs" / "results"
    assert {path.name for path in folder.glob("*.json")} == set(read_commands(folder))


def test_manoeuvres_mark_the_lowest_error_and_count_wins() -> None:
    other = controller(2.0, ["mae"], ["mae"], controller="betaflight", betaflight="0.0.6", idle=0.055)
    text = page(freely(controller(2.5, ["mse"], []), other))
    assert "## Manoeuvres, nf1" in text
    lines = [line for line in text.splitlines() if line.startswith(("| Split-S |", "|  |"))]
    split_s, betaflight = ([cell.strip() for cell in line.split("|")[2:-1]] for line in lines[1:3])
    assert split_s[:3] == ["PID `tuned`", "2.50 ± 0.25", "≈ **3 ± 0**"]
    assert betaflight[:3] == ["Betaflight 4.6, its defaults, idle 0.055", "**2.00 ± 0.25**", "3 ± 0"]
    assert split_s[3:] == ["3", "3.0", "3", "3.00", "3.0000"]
    told = "PID `tuned`: 0 in MAE, 2 in MSE; Betaflight 4.6, its defaults, idle 0.055: 2 in MAE, 0 in MSE."
    assert f"Won of 2: {told}" in text
    assert row(text, "PID `tuned`") == ["0.06", "0.36", "1.22", "3.65", "18.5 ± 0.2"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"figures": {}}, "figures: got '{}'"),
        ({"throttle": [0.0]}, "thrust_at_rest: got"),
        ({"throttle": [0.0, 0.1, 0.3, 0.6, 1.0]}, "expected 0.15 among them"),
        ({"descent": {}}, "descent.sink_m_s"),
    ],
)
def test_manoeuvres_are_refused_by_key(change: Document, message: str) -> None:
    with pytest.raises(ResultsError, match=message.replace("{", r"\{")):
        page(freely(controller(2.0, [], []) | change))
