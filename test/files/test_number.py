"""Ranges of numbers are declared once; all that is derived from them agrees."""

import dataclasses
import math
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from refused_numbers import check_refusals, fits

from arm_emulator import Plant, Refusal, load_scene, load_servo_config
from arm_emulator.base.validation import bound
from arm_emulator.base.validation.number import LARGEST, SMALLEST, Number, list_numbers
from arm_emulator.base.validation.parameters import check_parameter, list_parameters
from arm_emulator.demo.demo_plan import DemoPlan
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.servo.servo_config import ServoConfig
from arm_emulator_firmware.board import BOARD, CHANNEL, ENCODER, UART, load_board
from emulator_node.node import EmulatorParameters
from servo_node.node import ServoNodeParameters

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "config"
UNITS = ("", "ohm", "N m s/rad")
Read = Callable[[Any], object]


def draw_number(rng: np.random.Generator) -> Number:
    low, high = sorted(rng.uniform(-10.0, 10.0, 2).round(1).tolist())
    is_integer, in_size = bool(rng.random() < 0.3), bool(rng.random() < 0.3)
    if in_size:
        low, high = 0.0, abs(high)
    if is_integer:
        low, high = math.floor(low), math.ceil(high) + 1
    bounds = [{}, {"above": low}, {"at_least": low}, {"at_most": high},
              {"at_least": low, "at_most": high}, {"above": low, "at_most": high}]  # fmt: skip
    chosen: Any = bounds[rng.integers(len(bounds))]
    return Number("x", str(rng.choice(UNITS)), **chosen, whole=is_integer, in_size=in_size)


def test_words_and_range_agree() -> None:
    rng = np.random.default_rng(22)
    taken = 0
    for _ in range(400):
        number = draw_number(rng)
        ends = [x for x in (number.above, number.at_least, number.at_most) if x is not None]
        near = [math.nextafter(x, to) for x in ends for to in (-math.inf, math.inf)]
        near = [x for x in near if not 0.0 < abs(x) < SMALLEST]
        values = [*ends, *rng.uniform(-15.0, 15.0, 5).tolist(), 0.0, 3, -4]
        for value in [*values, *(-x for x in values), *near]:
            within = number.is_in_range(value)
            assert value in near or within == fits(number.rule, value), (number, value)
            taken += within
            if within:
                assert number.ends[0] <= value <= number.ends[1], (number, value)
                assert number.check_value("here", np.float64(value)) == value
        assert number.rule.startswith("be a whole number" if number.whole else "be a number")
        assert (number.unit in number.rule) and "  " not in number.rule
        check_refusals(number, "x", partial(number.check_value, "here"))
    assert taken > 1000


def test_a_bound_of_a_row_holds_if_it_holds_for_every_number() -> None:
    rng = np.random.default_rng(23)
    verdicts = set()
    for _ in range(2000):
        number = draw_number(rng)
        row = rng.choice([0.0, 1.0, -3.5, 9.0, 1e16, math.nan, -math.inf], int(rng.integers(1, 5)))
        holds = all(map(number.is_in_range, row))
        verdicts.add(holds)
        for values in (row.tolist(), row[np.newaxis]):
            if holds:
                number.check_values("here", values)
            else:
                with pytest.raises(Refusal, match=r"^here: x must be (whole )?numbers"):
                    number.check_values("here", values)
    assert verdicts == {True, False}


def test_words_are_short() -> None:
    """As users read them."""
    assert Number("R", "ohm", above=0).rule == "be a number > 0 ohm"
    assert Number(at_least=0, at_most=48, whole=True).range == "whole number from 0 to 48"
    assert Number(above=0, in_size=True).range == "number other than 0"
    assert Number("k", "1/A", above=0, at_most=2, in_size=True).range == (
        "number of size > 0 and <= 2 1/A"
    )
    assert Number.bound_size("q", "rad", 1e6).range == "number within +-1e+06 rad"
    assert Number("t", "s").range == "number [s]"
    assert Number("share", "1", at_most=math.inf).rule == "be a finite number"
    assert Number("hold_after", "s", above=0).described == "hold after (number > 0 s)"
    assert Number("x", text="what it is", at_least=1).described == "what it is (number >= 1)"
    assert Number().ends == (-LARGEST, LARGEST) and Number(above=0).least == SMALLEST
    with pytest.raises(Refusal, match=r"x must be a number from 1e-15 to 1e\+15 m, got 1e-20"):
        Number("x", "m", above=0.0).check_value("here", 1e-20)
    with pytest.raises(
        Refusal, match=r"^here: q must be numbers within \+-2 rad, got \[0.0, 3.0\]$"
    ):
        Number.bound_size("q", "rad", np.array([4.0, 2.0])).check_row("here", [0.0, 3.0], 2)


# Every number of every room, by the reader of its room


def as_in_yaml(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def scene_numbers(_: Path) -> Iterator[tuple[Number, str, Read]]:
    def read(path: str, more: dict[str, Any], value: Any) -> object:
        # None would take the key out of the scene.
        return load_scene("three_axis", more | {path: "nothing" if value is None else value})

    scene = load_scene("three_axis")
    for owner, above in ((scene, ""), (scene.integrator, "integrator."),
                         (scene.joints[0], f"joints.{scene.joints[0].name}.")):  # fmt: skip
        for key, number in list_numbers(type(owner)).items():
            yield number, above + key, partial(read, above + key, {})
    mass = Number("mass", "kg", at_least=0.0)
    yield mass, "payload.mass", partial(read, "payload.mass", {"payload": {"mass": 1.0}})
    encoder: dict[str, Any] = {"kind": "absolute", "counts_per_turn": 4096, "bits": 16}
    encoder = {"joints.elbow.encoder": encoder | {"ripple": 0.1}}
    for key, highest in (("counts_per_turn", 10**9), ("delay", 100), ("ripple_order", 10**6)):
        number = Number(key, at_least=key != "delay", at_most=highest, whole=True)
        path = f"joints.elbow.encoder.{key}"
        yield number, path, partial(read, path, encoder)
    bits = Number("bits", at_least=12, at_most=48, whole=True)
    path = "joints.elbow.encoder.bits"
    yield bits, path, partial(read, path, encoder)


def servo_numbers(_: Path) -> Iterator[tuple[Number, str, Read]]:
    config = load_servo_config(CONFIG / "servo/three_axis.yaml")
    joint = vars(config.joints[0]) | {"current_limit": 9.0, "voltage_limit": 9.0}
    tables: dict[str, Any] = {"joints.one": {n: x for n, x in joint.items() if n != "name"}}
    tables[""] = {n: getattr(config, n) for n in list_numbers(ServoConfig)}

    def read(table: str, key: str, value: Any) -> object:
        sections = {name: dict(own) for name, own in tables.items()}
        sections[table][key] = value
        parameters = sections[""] | {
            "joint_names": ["one"],
            "joints": {"one": sections["joints.one"]},
        }
        return ServoConfig.from_mapping(parameters, "servo")

    for table, kind in (("", ServoConfig), ("joints.one", type(config.joints[0]))):
        for key, number in list_numbers(kind).items():
            yield number, f"{table}.{key}".lstrip("."), partial(read, table, key)


def node_parameters(_: Path) -> Iterator[tuple[Number, str, Read]]:
    def read(field: dataclasses.Field[Any], value: Any) -> object:
        return check_parameter(value, field, "node")

    for kind in (EmulatorParameters, ServoNodeParameters, MotionConfig):
        for field in list_parameters(kind).values():
            if type(field.default) in (int, float):
                number = list_numbers(kind)[field.name]
                yield number, f"parameter {field.name}", partial(read, field)


def board_numbers(folder: Path) -> Iterator[tuple[Number, str, Read]]:
    sections: dict[str, Any] = {
        "": {"clock": 1e8, "interrupts": 60},
        "encoders.a": {"at": 0x40000010, "bits": 16},
        "adc.ADC": {"status": 0x40000020, "flag": 2},
        "adc.ADC.channels.a": {"at": 0x40000028, "bits": 12, "counts_per_ampere": -4, "offset": 9},
        "uart.line": {"status": 0x40000060, "data": 0x40000064, "control": 0x40000068},
        "memory.flash": {"at": 0, "size": 65536},
        "registers.all": {"at": 0x40000000, "size": 4096},
    }

    def read(path: str, key: str, value: Any) -> object:
        board: dict[str, Any] = {}
        for above, own in sections.items():
            section = board
            for name in filter(None, above.split(".")):
                section = section.setdefault(name, {})
            section |= own | ({key: as_in_yaml(value)} if above == path else {})
        file = folder / "board.yaml"
        file.write_text(yaml.dump(board))
        return load_board(file, ["a"])

    for path, numbers in (("", BOARD), ("encoders.a", ENCODER), ("uart.line", UART),
                          ("adc.ADC.channels.a", CHANNEL)):  # fmt: skip
        for number in numbers:
            key = number.name
            if key == "offset":
                number = dataclasses.replace(number, at_most=2.0**12 - 1.0)
            yield number, f"{path}.{key}".lstrip("."), partial(read, path, key)
    bit = Number("flag", at_least=0, at_most=31, whole=True)
    yield bit, "adc.ADC.flag", partial(read, "adc.ADC", "flag")


def demo_numbers(folder: Path) -> Iterator[tuple[Number, str, Read]]:
    plan = yaml.safe_load((CONFIG / "demo/three_axis.yaml").read_text())
    scene = folder / "arm.yaml"
    scene.write_text("demo: plan.yaml\n")

    def read(key: str, value: Any) -> object:
        (folder / "plan.yaml").write_text(yaml.dump(plan | {key: as_in_yaml(value)}))
        return DemoPlan.load_plan(scene, 10**6)

    settle = Number("settle", at_least=0.0, at_most=1000.0)
    yield settle, "settle", partial(read, "settle")
    count = Number("instructions", at_least=1, at_most=10**6, whole=True)
    yield count, "instructions", partial(read, "instructions")


@cache
def varied_plant() -> Plant:
    return Plant(load_scene("three_axis", {"varied": ["joints.elbow.*", "links.*"]}))


def varied_numbers(_: Path) -> Iterator[tuple[Number, str, Read]]:
    plant = varied_plant()
    for varied in plant.scene.varied:
        yield varied.number, varied.name, partial(plant.set_parameter, varied.name)


ROOMS = (scene_numbers, servo_numbers, node_parameters, board_numbers, demo_numbers, varied_numbers)


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: room.__name__)
def test_a_number_out_of_its_range_is_refused_alike_in_every_room(
    room: Callable[[Path], Iterator[tuple[Number, str, Read]]], tmp_path: Path
) -> None:
    counts = [check_refusals(number, name, read) for number, name, read in room(tmp_path)]
    assert counts and sum(counts) > 20 * len(counts)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", [np.float16, np.float32, np.longdouble, np.int8, np.uint64])
def test_short_and_long_numbers_of_numpy_are_taken_as_they_are(kind: type[np.number]) -> None:
    """Ranges end beyond what short ones hold, whose comparisons with these would warn."""
    for number in (
        Number("x"),
        Number("x", at_least=-1.0, at_most=1e300),
        Number.bound_size("x", "", 9),
    ):
        assert number.check_value("here", kind(3)) == 3.0
    for bad in {"i": (), "u": ()}.get(np.dtype(kind).kind, (math.nan, math.inf, -math.inf)):
        with pytest.raises(Refusal, match="here: x must be a"):
            Number("x").check_value("here", kind(bad))
    with pytest.raises(Refusal, match="here: x must be a number from 5 to 9"):
        Number("x", at_least=5.0, at_most=9.0).check_value("here", kind(3))


def test_commands_and_measurements_are_refused_in_rows_alike() -> None:
    rows = [value for value in vars(bound).values() if isinstance(value, Number)]
    assert len(rows) > 10
    for row in rows:
        for bad in (math.nan, math.inf, -math.inf, 2.0 * row.most, -2.0 * row.most):
            if abs(bad) < math.inf or row.at_most != math.inf:
                with pytest.raises(Refusal, match=rf"^here: {row.name} must be (finite )?numbers"):
                    row.check_row("here", [0.0, bad, 0.0], 3)
        no_rows: tuple[Any, ...] = "abc", None, [None], ["1"] * 3, [1j] * 3, {}, [[1.0], [2.0, 3.0]]
        for no_row in (*no_rows, [True, 1.0, 2.0]):
            with pytest.raises(Refusal, match=rf"^here: {row.name} must be (finite )?numbers"):
                row.check_row("here", no_row, 3)
