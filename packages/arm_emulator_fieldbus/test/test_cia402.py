"""Drives behind field buses: dictionary, state machine, page."""

import itertools
import math
import random
import struct
from collections.abc import Iterable
from pathlib import Path

import pytest
from cia402 import (
    ACTUAL,
    CONTROL,
    CSP,
    CST,
    CSV,
    ENABLE,
    MODE,
    PLAIN,
    RESET,
    ROOT,
    SHUTDOWN,
    STATES,
    STATUS,
    SWITCH_ON,
    TARGET,
    N,
    command,
    enable,
    make,
    state,
)
from documents import page_of
from draws import FULL

from arm_emulator import Plant, Refusal, load_servo_config
from arm_emulator.cli.command_line import main
from arm_emulator.toolchain.unit import Unit
from arm_emulator_fieldbus.declared import COUNT, FIRST
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import CANOPEN, ETHERCAT
from arm_emulator_fieldbus.object_dictionary import REALS, Aborted, ObjectEntry, list_entries


def test_every_entry_can_be_read_and_begins_within_its_range() -> None:
    for bus in (ETHERCAT, CANOPEN):
        drives = make(bus=bus)
        for entry in list_entries():
            if not entry.buses & bus:
                with pytest.raises(Aborted, match="06020000"):
                    drives.upload_entry(0, entry.index, entry.sub)
                continue
            raw = drives.upload_entry(0, entry.index, entry.sub)
            if entry.bits:
                assert len(raw) == entry.bits // 8, f"bytes of {entry}"
                value = drives.read(0, entry.index, entry.sub)
                assert entry.least <= value <= entry.most, f"value of {entry}"
        assert drives.upload_entry(1, 0x1008) == b"three_axis", "name of the device"
        assert drives.read(2, 0x1018, 4) == 3, "serial number of the third drive"


def test_units_are_those_of_the_scene() -> None:
    drives = make()
    assert drives.read(0, 0x608F, 1) == 1024, "counts in a turn of the motor"
    assert drives.read(0, 0x6076) == 1000, "rated torque [mN m]: 20 A at 0.05 N m/A"
    assert drives.read(0, 0x6075) == 20000, "rated current [mA]"
    max_speed = 3.0 / 0.01 * 1024 / (2 * math.pi)  # of the link's 3 rad/s
    assert drives.read(0, 0x607F) == math.floor(max_speed), "largest speed [counts/s]"
    assert drives.read(1, ACTUAL) == math.floor(0.5 / 0.01 * 1024 / (2 * math.pi)), (
        "counts at start"
    )
    assert drives.read(0, 0x60C2, 1) == 1, "interpolation time"
    assert drives.read(0, 0x60C2, 2) == -3, "interpolation time is in ms"


# Properties of the machine, which may be written as they are.
FIXED = {0x6075, 0x6076, 0x607B, 0x608F, 0x6091, 0x6092, 0x6402}


def expected_abort(
    entry: ObjectEntry | None, is_object: bool, raw: bytes, value: int, now: bytes = b""
) -> int:
    """Return the result of a write by CiA 301, where the entry has the bytes `now`."""
    if entry is None:
        return 0x06090011 if is_object else 0x06020000
    if entry.access in ("const", "ro"):
        return 0x06010002
    size = len(raw)
    if size != entry.bits // 8:
        return 0x06070012 if size > entry.bits // 8 else 0x06070013
    if entry.index in FIXED:
        return 0 if raw == now else 0x06090030
    if entry.type == "REAL32" and not math.isfinite(*struct.unpack("<f", raw)):
        return 0x06090030
    if value > entry.most:
        return 0x06090031
    return 0x06090032 if value < entry.least else 0


FAULTS = range(0x2010, 0x2014)
OF_PARTS = range(FIRST, FIRST + COUNT)
# Objects with rules beside the range: mappings, histories, stores, faults, modes, methods, probes,
# inputs that not every motor has.
SPECIAL = {0x1003, 0x1010, 0x1011, 0x1C12, 0x1C13, MODE, 0x6098, 0x60B8, *range(0x1600, 0x1604)} | {
    *FAULTS, *range(0x1A00, 0x1A04), *OF_PARTS
}  # fmt: skip


def test_random_accesses_crash_nothing_and_refused_ones_change_nothing() -> None:
    """100 000 reads and writes: codes by the rules of CiA 301, values as a model has them.

    Of these, 20 000 in the tests of every day.
    """
    rng = random.Random(402)
    drives = make()
    entries = {
        (entry.index, entry.sub): entry for entry in list_entries() if entry.buses & ETHERCAT
    }
    objects = {index for index, _ in entries}
    model = {key: drives.upload_entry(0, *key) for key in entries}
    writable = [key for key, entry in entries.items() if entry.access == "rw"]
    keys, taken, refused = list(entries), 0, 0
    for k in range(100_000 if FULL else 20_000):
        key = rng.choice(writable if rng.random() < 0.5 else keys)
        if rng.random() < 0.1:
            key = (rng.choice((key[0], rng.randrange(0x10000))), rng.randrange(256))
        entry = entries.get(key)
        if rng.random() < 0.3:
            if entry is None:
                code = 0x06090011 if key[0] in objects else 0x06020000
                with pytest.raises(Aborted) as no:
                    drives.upload_entry(0, *key)
                assert no.value.code == code, f"reading {key}"
            else:
                assert drives.upload_entry(0, *key) == model[key], f"value of {entry}"
            continue
        size = entry.bits // 8 if entry and rng.random() < 0.9 else rng.randrange(9)
        raw = rng.choice((rng.randbytes(size), bytes(size), b"\x01" + bytes(max(0, size - 1))))
        raw = raw[:size]
        value = int.from_bytes(raw, "little", signed=bool(entry and entry.type.startswith("INT")))
        expected = expected_abort(entry, key[0] in objects, raw, value, model.get(key, b""))
        try:
            drives.download_entry(0, *key, raw)
            code = 0
        except Aborted as no:
            code = no.code
        if key[0] not in SPECIAL:
            assert code == expected, f"writing {raw.hex()} to {entry or key}"
        if code == 0:
            taken += 1
            if key[0] not in (0x1003, 0x1011):
                model[key] = raw
        else:
            refused += 1
        if k % 5000 == 0:
            assert {key: drives.upload_entry(0, *key) for key in entries} == model, (
                "the whole dictionary"
            )
    assert {key: drives.upload_entry(0, *key) for key in entries} == model, "the whole dictionary"
    assert min(taken, refused) > 2_000, f"{taken} taken, {refused} refused"
    # The drive runs with any settings.
    drives.period(100)


def test_a_mapping_is_taken_only_in_full_and_only_of_mappable_objects() -> None:
    for bus, locked in ((ETHERCAT, 0x06010003), (CANOPEN, 0x08000022)):
        drives = make(bus=bus)

        def code(index: int, sub: int, value: int, drives: Drives = drives) -> int:
            try:
                drives.write(0, index, value, sub)
            except Aborted as no:
                return no.code
            return 0

        assert code(0x1600, 1, 0x60400010) == locked, "a mapping that is in use"
        assert code(0x1600, 0, 0) == 0, "a mapping is opened"
        assert code(0x1600, 1, 0x60410010) == 0x06040041, "the statusword cannot be received"
        assert code(0x1600, 1, 0x60400020) == 0x06040041, "the controlword has 16 bits"
        assert code(0x1600, 1, 0x70000010) == 0x06020000, "there is no such object"
        assert code(0x1600, 1, 0x60FE0520) == 0x06090011, "there is no such sub-index"
        assert code(0x1600, 1, 0x60400010) == 0, "the controlword"
        assert code(0x1600, 2, 0x00000008) == 0, "a gap"
        assert code(0x1600, 0, 9) == 0x06040041, "there is no ninth object"
        assert code(0x1600, 0, 2) == 0, "a mapping is closed"
        drives.lock_mapping(True)
        assert code(0x1600, 0, 0) == 0x08000022, "EtherCAT beyond pre-operational"
        drives.lock_mapping(False)
        for sub in range(1, 4):
            assert code(0x1A00, 0, 0) == 0, "a mapping is opened"
            assert code(0x1A00, sub, 0x60640020) == 0, "a position"
        assert code(0x1A00, 0, 3) == (0 if bus == ETHERCAT else 0x06040042), "12 bytes in a PDO"


# ------------------------------------------------------------------------------ the state machine

# By state and command: transition and next state. What is not here does nothing.
TABLE = {
    ("switch on disabled", "shutdown"): (2, "ready"),
    ("ready", "switch on"): (3, "switched on"),
    ("ready", "enable"): (3, "switched on"),
    ("ready", "disable voltage"): (7, "switch on disabled"),
    ("ready", "quick stop"): (7, "switch on disabled"),
    ("switched on", "enable"): (4, "operation enabled"),
    ("switched on", "shutdown"): (6, "ready"),
    ("switched on", "disable voltage"): (10, "switch on disabled"),
    ("switched on", "quick stop"): (10, "switch on disabled"),
    ("operation enabled", "switch on"): (5, "switched on"),
    ("operation enabled", "shutdown"): (8, "ready"),
    ("operation enabled", "disable voltage"): (9, "switch on disabled"),
    ("operation enabled", "quick stop"): (11, "quick stop"),
    ("quick stop", "disable voltage"): (12, "switch on disabled"),
    ("quick stop", "enable"): (16, "operation enabled"),
    ("fault", "reset"): (15, "switch on disabled"),
}


def command_of(word: int, before: int, where: str) -> str:
    if where == "fault":
        return "reset" if word & 0x80 and not before & 0x80 else "nothing"
    if not word & 2:
        return "disable voltage"
    if not word & 4:
        return "quick stop"
    if not word & 1:
        return "shutdown"
    return "enable" if word & 8 else "switch on"


def bring(drives: Drives, where: str) -> None:
    """Every drive to a state, in cyclic velocity, with stops that end where they begin."""
    drives.restart_drive()
    for j in range(N):
        drives.write(j, MODE, CSV)
        drives.write(j, 0x605A, 6)  # stay in Quick stop active
        drives.write(j, 0x605C, 0)
        drives.write(j, 0x605B, 0)
    words = {
        "switch on disabled": (),
        "ready": (SHUTDOWN,),
        "switched on": (SHUTDOWN, SWITCH_ON),
        "operation enabled": (SHUTDOWN, SWITCH_ON, ENABLE),
        "quick stop": (SHUTDOWN, SWITCH_ON, ENABLE, 0x0B),
        "fault": (SHUTDOWN, SWITCH_ON, ENABLE),
    }[where]
    for word in words:
        command(drives, word)
    if where == "fault":
        drives.report_loss()
        drives.period(2)  # to a stand
    assert {state(drives, j) for j in range(N)} == {where}, "where the drives were brought"


def test_every_state_takes_every_command_as_the_table_states() -> None:
    """All 32 words of bits 0 to 3 and 7, bit 7 with and without an edge, in every state."""
    drives = make()
    transitions = set()
    low = [bits | reset for bits in range(16) for reset in (0, RESET)]
    for where in (name for name in STATES if name not in ("not ready", "fault reaction")):
        for word, before in itertools.product(low, (0, RESET)):
            bring(drives, where)
            if where == "fault":
                command(drives, before)
                if before:  # it was an edge: to the fault once more, with the bit set
                    for step in (SHUTDOWN, SWITCH_ON, ENABLE):
                        command(drives, before | step)
                    drives.report_loss()
                    drives.period(2)
            reported = command_of(word, before, where)
            drives.write(0, CONTROL, word)
            drives.period()
            transition, after = TABLE.get((where, reported), (0, where))
            assert state(drives) == after, f"from {where} by 0x{word:02x} after 0x{before:02x}"
            transitions.add(transition)
    assert transitions == {0, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 15, 16}, (
        "transitions that were taken"
    )


class Model:
    """The state machine as CiA 402 reports it, of a drive that stands still, for random walks."""

    def __init__(self) -> None:
        self.state, self.word, self.powered = "switch on disabled", 0, True
        self.options = {0x605A: 2, 0x605B: 0, 0x605C: 1, 0x6007: 1}

    def take(self, word: int) -> None:
        """Go on under one word until nothing changes any more."""
        for _ in range(4):
            reported = command_of(word, self.word, self.state)
            self.word = word
            transition, after = TABLE.get((self.state, reported), (0, self.state))
            if transition == 3 and not self.powered:
                after = "ready"
            if self.state == "switched on" and not self.powered and transition in (0, 4):
                after = "ready"
            if transition == 11 and self.options[0x605A] < 5:
                after = "switch on disabled"  # when it stands
            self.state = after

    def lose_master(self) -> None:
        reaction = self.options[0x6007]
        if reaction and self.state in ("ready", "switched on"):
            self.state = "switch on disabled"
        elif reaction == 1 and self.state in ("operation enabled", "quick stop"):
            self.state = "fault"
        elif reaction == 2 and self.state != "fault":
            self.state = "switch on disabled"
        elif reaction == 3 and self.state == "operation enabled":
            stays = self.options[0x605A] >= 5
            self.state = "quick stop" if stays else "switch on disabled"

    def lose_power(self) -> None:
        if self.state in ("operation enabled", "quick stop"):
            self.state = "fault"


@pytest.mark.parametrize("seed", range(3))
def test_random_commands_options_and_losses_lead_where_a_model_states(seed: int) -> None:
    """3000 words and events on a drive that stands still: every stop is over in a few periods."""
    rng = random.Random(seed)
    drives, model, states = make(), Model(), set()
    drives.write(0, MODE, CSV)
    likely = (SHUTDOWN, SWITCH_ON, ENABLE, ENABLE, RESET, 0, 0x0B, SHUTDOWN | RESET)
    for k in range(3000):
        event = rng.random()
        if event < 0.05 and model.state not in ("operation enabled", "quick stop"):
            index = rng.choice(list(model.options))
            model.options[index] = rng.randrange({0x605A: 9, 0x6007: 4}.get(index, 2))
            drives.write(0, index, model.options[index])
        elif 0.05 < event < 0.07:
            drives.report_loss(0)
            model.lose_master()
        elif 0.07 < event < 0.09:
            drives.plant.powered = model.powered = not model.powered
            if not model.powered:
                model.lose_power()
            model.take(model.word)  # which is still there
            drives.period()
        drives.period(4)
        word = rng.choice(likely) if rng.random() < 0.8 else rng.randrange(256)
        drives.write(0, CONTROL, word)
        drives.period(5)
        model.take(word)
        assert state(drives) == model.state, f"after word {k}, 0x{word:02x}, {model.options}"
        states.add(model.state)
    assert len(states) >= 5, f"states that it was in: {states}"


def test_libraries_of_field_buses_are_compiled_ahead_on_request(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    units: list[str] = []

    def note(some: Iterable[Unit], *_: object) -> list[Path]:
        units.extend(unit.name for unit in some)
        return []

    monkeypatch.setattr("arm_emulator.cli.commands.compile.compile_units", note)
    monkeypatch.setattr("sys.argv", ["arm_emulator", "compile", "three_axis", "--packages"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 0, "exit code"
    assert {"drives", "ethercat"} < set(units), "what is compiled"


def test_a_joint_without_a_drive_is_refused_in_a_line() -> None:
    with pytest.raises(Refusal, match=r"servo.joint_names must name every moving joint"):
        Drives(Plant(PLAIN), load_servo_config(ROOT / "config/servo/ur5.yaml"), ETHERCAT)


def test_the_same_words_give_the_same_bits() -> None:
    def run() -> tuple[bytes, list[bytes]]:
        rng, drives = random.Random(5), make()
        enable(drives, CSP)
        reported = []
        for _ in range(500):
            for j in range(N):
                drives.write(j, MODE, rng.choice((CSP, CSP, CSV, CST)))
                drives.write(j, TARGET, drives.read(j, ACTUAL) + rng.randrange(-50, 50))
                drives.write(j, 0x60FF, rng.randrange(-2000, 2000))
                drives.write(j, 0x6071, rng.randrange(-50, 50))
            drives.period()
            reported.append(drives.upload_entry(0, ACTUAL) + drives.upload_entry(1, STATUS))
        return drives.plant.save(), reported

    assert run() == run(), "the whole machine and what the drives report"


# ---------------------------------------------------------------------------------- documentation


def dictionary_rows() -> list[str]:
    """The dictionary as drives.md lists it: objects of the buses, entries of the drive.

    Objects that parts declare stand on the page of quantities.
    """
    drives = make()
    rows = ["| index | object | sub-indices | on |", "|---|---|---|---|"]
    for entry in list_entries():
        if entry.index < 0x2000 and entry.sub == 0:
            on = {1: "EtherCAT", 2: "CANopen", 3: "both"}[entry.buses]
            rows.append(f"| 0x{entry.index:04X} | {entry.object} | {entry.last_sub or ''} | {on} |")
    rows += [
        "",
        "| index | entry | type | access | PDO | unit | at first | range |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for entry in list_entries():
        if entry.index < 0x2000 or entry.index in OF_PARTS:
            continue
        where = f"0x{entry.index:04X}" + (f":{entry.sub}" if entry.last_sub else "")
        name = entry.object if not entry.sub else f"{entry.object}: {entry.name}"
        pdo = " ".join(word for word, may in (("rx", entry.rx), ("tx", entry.tx)) if may)
        value = drives.read(0, entry.index, entry.sub)
        live = entry.access == "ro" and entry.tx
        first = "" if live else str(entry.standard) if value == entry.standard else "scene"
        signed = entry.type.startswith("I")
        is_full_range = entry.least == (-(1 << entry.bits - 1) if signed else 0)
        is_full_range &= entry.most == (1 << entry.bits - signed) - 1
        is_full_range |= entry.type in REALS
        bounds = (
            "" if is_full_range or "w" not in entry.access else f"{entry.least} to {entry.most}"
        )
        cells = (where, name, entry.type, entry.access, pdo, entry.unit, first, bounds)
        rows.append(f"| {' | '.join(cells)} |")
    return rows


def test_the_page_lists_the_dictionary() -> None:
    page = page_of("drives").read_text()
    rows = "\n".join(dictionary_rows())
    assert page.endswith(f"\n{rows}\n"), f"the end of drives.md; it should be\n{rows}"
