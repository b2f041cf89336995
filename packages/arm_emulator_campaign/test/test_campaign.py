"""Campaigns: what varies, runs as functions of their index, results that outlive kills."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from draws import FULL, some, with_slow
from test_command_line import run as command

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.run_outputs import RunOutputs
from arm_emulator.base.validation.section import Section
from arm_emulator.cli.output import convert_to_plain, output
from arm_emulator.machine.plant.external_wrench import ExternalWrench
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.runs.gains import load_gains
from arm_emulator.runs.servo_step import ServoStep
from arm_emulator.runs.table_run import TableRun
from arm_emulator.runs.target_table import TargetTable
from arm_emulator.servo.servo_arm import ServoArm
from arm_emulator_campaign.commands.campaign import execute_campaign
from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.judging.evaluators import PythonRequirement
from arm_emulator_campaign.results.parts import Results, compute_digest, make_schema, write_part
from arm_emulator_campaign.simulation.batch_simulator import make_simulator
from arm_emulator_campaign.simulation.case import draw_cases
from arm_emulator_campaign.simulation.outcome import Outcomes
from arm_emulator_campaign.simulation.simulator import Simulator
from bench.campaign_kills import Here, simulate_kill

TABLE = {
    "scene": "three_axis",
    "set": {"payload": 1.0},
    "scenario": {"seconds": 0.2, "targets": [{"at": 0.0, "elbow": 1.0}]},
    "vary": {
        "payload.mass": "uniform(0, 3)",
        "faults.push.force.2": "normal(0, 100)",
        "scenario.targets.0.elbow": "uniform(0.7, 1.0)",
        "controller.joints.elbow.velocity_gain": "uniform(120, 180)",
    },
    "faults": {
        "push": {"kind": "wrench", "at": 0.05, "lasting": 0.02, "link": "tool", "force": [0, 0, 1]},
        "cut": {"kind": "power_cut", "at": 0.1, "lasting": 0.03},
        "drop": {"kind": "payload", "at": 0.15, "mass": 0.2},
    },
    "requirements": {"near": "always abs(error.*) < 0.3", "never": "always v.elbow < 0.001"},
    "measures": {
        "error": "max(abs(error.elbow))",
        "z": "max(tool.z)",
        "current": "rms(measured.current.*)",
    },
    "count": 300,
}
MOVES = {
    "scene": "three_axis",
    "scenario": {
        "seconds": 0.3,
        "moves": [{"at": 0.0, "by": [0, 0.03, 0]}, {"at": 0.15, "along": [[0, 0.02, 0.02]]}],
    },
    "vary": {"joints.*.friction.viscous": "nominal * lognormal(1, 0.3)"},
    "requirements": {"near": "always abs(error.*) < 0.1"},
    "count": 40,
}


def written(folder, data, name="c.yaml"):
    file = folder / name
    file.write_text(yaml.safe_dump(data, sort_keys=False))
    return file


def changed(data, path, value):
    data = json.loads(json.dumps(data))
    *steps, last = path.split("/")
    place = data
    for step in steps:
        place = place[int(step) if isinstance(place, list) else step]
    if value is None:
        del place[last]
    else:
        place[last] = value
    return data


# ------------------------------------------------------------------------------------------ runs


@pytest.mark.parametrize("data", with_slow([TABLE, MOVES], 1))
def test_a_run_is_a_function_of_its_index(tmp_path, data):
    definition = load_campaign(written(tmp_path, data))
    first = Simulator(definition)
    runs = {index: first.simulate_run(index) for index in (0, 1, 2, 7)}
    another = Simulator(load_campaign(definition.file))
    for index in (7, 2, 0, 2, 1):
        assert another.simulate_run(index) == runs[index]
    assert len({tuple(run.robustness.values()) for run in runs.values()}) == 4


def test_noise_differs_from_run_to_run_and_repeats(tmp_path):
    data = changed(TABLE, "vary", {"joints.elbow.friction.viscous": "uniform(0.5, 0.50001)"})
    sensor = {"joints.elbow.current_sensor": {"noise": 0.05}}
    # The machine of `test_case_bag`, with a fault that does not come.
    data = changed(data, "set", {"payload": 1.0, "faults": ["elbow.command_lost"], **sensor})
    data = changed(data, "faults", {"cut": TABLE["faults"]["cut"]})
    definition = load_campaign(written(tmp_path, data))
    first, second = Simulator(definition), Simulator(definition)
    currents = [first.simulate_run(index).measures["current"] for index in (0, 1, 2)]
    assert len(set(currents)) == 3
    assert [second.simulate_run(index).measures["current"] for index in (2, 1, 0)] == currents[::-1]


def test_faults_are_exact_to_the_tick(tmp_path):
    # The same by hand: orders to the session between ticks.
    data = changed(changed(TABLE, "vary", None), "requirements", {"q": "always q.elbow < 9"})
    data = changed(data, "measures", {f"{name}": f"last({name}.elbow)" for name in ("q", "v")})
    measures = Simulator(load_campaign(written(tmp_path, data))).simulate_run(0).measures
    machine = {"payload": 1.0, "varied": ["payload.mass"], "external_wrench": True}
    scene, servo = load_scene("three_axis", machine), load_gains("three_axis").servo
    q = scene.start.copy()
    q[2] = 1.0
    run = TableRun(scene, TargetTable(np.zeros(1), q[None]), ServoStep(ServoArm(servo), [0, 1, 2]))
    session = run.session
    run.advance(50)
    session.set_external_wrench("tool", ExternalWrench(force=(0, 0, 1), axes="world"))
    run.advance(20)
    session.set_external_wrench("tool", ExternalWrench())
    run.advance(30)
    session.powered = False
    run.advance(30)
    session.powered = True
    run.advance(20)
    session.set_varied("payload.mass", 0.2)
    run.advance(50)
    assert measures == {"q": session.state.q[2], "v": session.state.v[2]}


def test_measures_and_functions_of_python_get_the_full_trace(tmp_path):
    (tmp_path / "checks.py").write_text(
        "def margin(trace):\n    return 0.5 - abs(trace['error.elbow']).max() + len(trace['t'])\n"
    )
    data = changed(TABLE, "requirements", {
        "python": {"python": "checks.py:margin", "signals": ["error.*"]},
        "formula": "always abs(error.elbow) <= 0.5",
    })  # fmt: skip
    data = changed(data, "measures", {"error": "max(abs(error.elbow))", "t": "last(t)"})
    data = changed(data, "scenario/seconds", 5.0)  # more samples than are taken at once
    outcome = Simulator(load_campaign(written(tmp_path, data))).simulate_run(3)
    margin = 0.5 - outcome.measures["error"]
    assert outcome.robustness == {"python": margin + 5001, "formula": margin}
    assert outcome.measures["t"] == 5.0


def test_a_function_that_returns_no_margin_is_named(tmp_path):
    wrong = ["None", "'abc'", "True", "[1.0]", "10**400", "1j", "1 / 0", "t['no']", "exit(3)"]
    (tmp_path / "checks.py").write_text(
        "def right(t):\n    return t['t'][0]\n"
        + "".join(f"def f{k}(t):\n    return {text}\n" for k, text in enumerate(wrong))
    )
    trace = [np.ones((2, 3)), np.ones((2, 1))]

    def judged(name):
        data = {"p": {"python": f"checks.py:{name}", "signals": ["q.elbow"]}}
        section = Section(data, "c.yaml").require_section("p")
        return PythonRequirement(section, ["q.elbow"], tmp_path).judge_trace(trace)

    assert judged("right") == 1.0
    for k, text in enumerate(wrong):
        reason = rf"c.yaml: p.python must return a margin.*got .*({2 * k + 4}\)|.)$"
        with pytest.raises(Refusal, match=reason):
            judged(f"f{k}")
            pytest.fail(f"took {text}")


def test_a_run_that_diverges_fails_everything(tmp_path):
    data = changed(TABLE, "vary", {"joints.elbow.gear.stiffness": "choice(1e4, 1e9)"})
    data = changed(changed(data, "faults", None), "set", {"integrator.scheme": "paper"})
    simulator = Simulator(load_campaign(written(tmp_path, data)))
    runs = [simulator.simulate_run(index) for index in range(12)]
    for run in runs:
        stiff = run.values["joints.elbow.gear.stiffness"] > 1e5
        assert math.isfinite(run.diverged) == stiff, run
        assert (run.robustness["near"] == -math.inf) == stiff and run.has_failed
    assert {math.isfinite(run.diverged) for run in runs} == {True, False}


# --------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        ("scene", "no_such", "must exist"),
        ("cuont", 3, "key cuont must be known"),
        ("count", 0, "count must be a whole number"),
        ("scenario/secnods", 3, "key scenario.secnods must be known"),
        ("scenario/targets/0/elbwo", 3, "key scenario.targets.0.elbwo must be known"),
        ("scenario/targets/0/at", -1, "scenario.targets.0.at must be"),
        ("scenario/moves", [{"at": 0, "by": [0, 0, 0]}], "one of targets, table and moves"),
        ("scenario/seconds", None, "scenario.seconds must be"),
        ("vary/payload.mess", "uniform(0, 1)", "vary.payload.mess must name"),
        ("vary/joints.*.frction.viscous", "uniform(0, 1)", "must name a number that can vary"),
        ("vary/faults.push.foce", "uniform(0, 1)", "faults.push.force.0"),
        ("vary/payload.mass", "unifrom(0, 1)", "must be a known distribution"),
        ("vary/payload.mass", "uniform(1, 0)", "low end below its high end"),
        ("vary/payload.mass", "uniform(1)", "uniform(low, high)"),
        ("vary/payload.mass", "normal(0, -1)", "have sigma > 0"),
        ("vary/payload.mass", "truncated(3, 0, 1)", "a distribution as argument 1"),
        ("vary/payload.mass", "uniform(0, 1, **more)", "have the arguments of its kind"),
        ("vary/payload.mass", f"choice({10**400})", "have numbers within +-1e+15"),
        ("vary/payload.mass", "__import__('os')", "must be a known distribution"),
        ("vary/payload.mass", "twice * uniform(0, 1)", "nominal *"),
        ("vary/payload.mass", True, "must be a distribution"),
        ("vary", {"payload.mass": "uniform(0", "1)": None}, "vary.1) must have a distribution"),
        ("set/paylaod", 1.0, "c.yaml, set: key paylaod must be known"),
        ("set/payload", "heavy", "c.yaml, set: payload must be"),
        ("vary/controller.joints.elbow.gain", "uniform(0, 1)", "velocity_gain"),
        ("correlate", [{"between": ["payload.mass"], "by": 0.5}], "two numbers that vary"),
        ("correlate", [{"between": ["payload.mass", "faults.*"], "by": 2}], "correlate.0.by"),
        ("sampling", "halton", "random, sobol, latin"),
        ("faults/push/kind", "wench", "payload, power_cut, wrench"),
        ("faults/push/link", "hand", "be one that moves"),
        ("faults/cut/at", None, "faults.cut.at must be"),
        ("faults/cut/at", 0.2, "faults.cut.at must be before the end of a run, 0.2 s"),
        (
            "faults/cut",
            {"kind": "number", "at": 0.1, "name": "payload.mess", "value": 1},
            "faults.cut.name must name a number that can vary",
        ),
        (
            "faults/cut",
            {"kind": "number", "at": 0.1, "name": "joints.*.friction.coulomb", "value": 1},
            "faults.cut: name must be one number, not a pattern",
        ),
        ("faults/cut/latsing", 1, "key faults.cut.latsing must be known"),
        ("requirements/near", "always q.hip < 1", "name signals of the run"),
        ("requirements/near", 3, "requirements.near must be a text"),
        ("requirements/near", {"python": "no.py:f"}, "a file beside the campaign's"),
        ("measures/z", "median(q.elbow)", "rms(...)"),
        ("stop", {"widht": 0.1}, "key stop.widht must be known"),
        ("controller", {"joints": {"elbow": {"gain": 1}}}, "velocity_gain"),
        (
            "controller",
            {"joints": {"elbow": {"observer_bandwidth": 1e6}}},
            "observer_bandwidth must",
        ),
        ("controller", {"servo": "nowhere.yaml"}, "a file beside the campaign's"),
    ],
)
def test_bad_files_are_refused_in_a_line(tmp_path, path, value, reason):
    file = written(tmp_path, changed(TABLE, path, value))
    with pytest.raises(Refusal) as refusal:
        Simulator(load_campaign(file))
    assert reason in str(refusal.value) and "\n" not in str(refusal.value)


def test_values_out_of_range_name_the_run(tmp_path):
    data = changed(TABLE, "vary/payload.mass", "normal(0, 1)")
    simulator = Simulator(load_campaign(written(tmp_path, data)))
    with pytest.raises(Refusal, match=r"c.yaml, run \d+: payload.mass must be a number >= 0 kg"):
        for index in range(20):
            simulator.simulate_run(index)


# ----------------------------------------------------------------------------- workers and results


def digest_alone(file, count=None):
    """The digest of all runs, or the first ones, in random parts in this process."""
    definition = load_campaign(file)
    runs, results = make_simulator(definition), Results(file.parent / "alone", definition)
    order = np.random.default_rng(3).permutation(count or definition.count)
    for part in np.array_split(order, 7):
        cases = draw_cases(definition.variation, np.sort(part))
        write_part(
            results.folder, definition, Outcomes.join_outcomes(list(runs.simulate_runs(cases)))
        )
    return compute_digest(results.collect_columns()), results.collect_columns()


@pytest.mark.slow
def test_results_do_not_depend_on_how_they_were_divided(tmp_path):
    """The campaign stops when it knows enough."""
    file = written(tmp_path, changed(TABLE, "stop", {"width": 0.16, "confidence": 0.9}))
    digest, columns = digest_alone(file, 200)
    units = {
        field.name: (field.metadata or {}).get(b"unit")
        for field in make_schema(load_campaign(file))
    }
    assert units["robustness.near"] == b"rad" and units["measure.current"] == b"A"
    assert units["payload.mass"] == b"kg" and units["robustness.never"] == b"rad/s"
    words = str(file), "--into", str(tmp_path / "two"), "--workers", "2", "--json"
    code, out, errors = command("campaign", *words)
    assert not code, errors
    facts = json.loads(out)
    assert facts["digest"] == digest and facts["count"] == 200
    assert all(share["high"] - share["low"] <= 0.16 for share in facts["shares"])
    assert facts["shares"][1]["hits"] == np.count_nonzero(columns["robustness.never"] < 0) > 0
    report = (tmp_path / "two" / "report.html").read_text()
    assert "faults.push.force.2" in report and report.count("data:image/png") == 3
    for name, unit in (("near", "rad"), ("never", "rad/s")):
        margins = columns[f"robustness.{name}"]
        assert f"margin of {name} [{unit}]" in report, "a column has one unit"
        worst = report.partition("Worst runs")[2].replace("\n", "")
        assert f"{columns['index'][np.argmin(margins)]}<td" in worst
    with pytest.raises(Refusal, match="have results of this campaign"):
        Results(tmp_path / "two", load_campaign(written(tmp_path, changed(TABLE, "seed", 1))))


@pytest.mark.slow
def test_damaged_parts_are_set_aside_and_their_runs_simulated_again(tmp_path, capsys):
    data = changed(changed(TABLE, "count", 70), "scenario/seconds", 0.004)
    for k, fault in enumerate(data["faults"].values()):  # of the machine of all other tests
        fault |= {"at": 0.001 * k, "lasting": 0.001}
    del data["faults"]["drop"]["lasting"]
    file, rng = written(tmp_path, data), np.random.default_rng(1)
    digest, _ = digest_alone(file)
    definition = load_campaign(file)
    reseeded = load_campaign(written(tmp_path, {**data, "seed": 7}, "o.yaml"))
    results, runs = Results(tmp_path / "alone", definition), make_simulator(definition)
    outcomes = make_simulator(reseeded).simulate_runs(draw_cases(reseeded.variation, [3]))
    folder = Results(tmp_path / "other", reseeded).folder
    foreign = write_part(folder, reseeded, Outcomes.join_outcomes(list(outcomes)))
    for round_ in range(60 if FULL else 8):
        some = results.parts[int(rng.integers(len(results.parts)))]
        content = bytearray(some.read_bytes())
        match round_ % 4:
            case 0:
                content[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))
                some.write_bytes(content)
            case 1:
                some.write_bytes(content[: int(rng.integers(len(content)))])
            case 2:
                some.write_bytes(foreign.read_bytes())
            case _:  # with its own name, in the place of one that is missing
                some.unlink()
                (some.parent / foreign.name).write_bytes(foreign.read_bytes())
        results = Results(tmp_path / "alone", definition)  # as the next command finds them
        missing = results.list_missing(70)
        assert 1 <= sum(end - first for first, end in missing) <= 10, "of one part"
        assert ("is set aside" in capsys.readouterr().err) and not (
            some.parent / foreign.name
        ).exists()
        for first, end in missing:
            cases = draw_cases(definition.variation, range(first, end))
            write_part(
                results.folder, definition, Outcomes.join_outcomes(list(runs.simulate_runs(cases)))
            )
        assert not results.list_missing(70) and compute_digest(results.collect_columns()) == digest
    assert list((tmp_path / "alone" / "set_aside").iterdir()), "they are kept"


def test_a_file_of_checks_is_beside_its_campaign_and_cannot_end_the_command(tmp_path):
    inside, outside = tmp_path / "in", tmp_path / "out.py"
    (inside / "below").mkdir(parents=True)
    code = (
        "import pathlib\npathlib.Path(__file__ + '.ran').touch()\ndef f(trace):\n    return 1.0\n"
    )
    outside.write_text(code)
    (inside / "below/checks.py").write_text(code)
    (inside / "link.py").symlink_to(outside)
    data = changed(TABLE, "scenario/seconds", 0.2)
    for name in (str(outside), "../out.py", "below/../../out.py", "link.py", "/dev/stdin"):
        requirements = {"c": {"python": f"{name}:f", "signals": ["q.elbow"]}}
        file = written(inside, changed(data, "requirements", requirements))
        with pytest.raises(Refusal, match="a file beside the campaign's or below its folder"):
            execute_campaign(file, dry=True)
        assert not Path(f"{outside}.ran").exists(), "nothing of it ran"
    requirements = {"c": {"python": "below/checks.py:f", "signals": ["q.elbow"]}}
    Simulator(load_campaign(written(inside, changed(data, "requirements", requirements))))
    for text in ("import sys; sys.exit(0)", "exit()", "raise SystemExit"):
        (inside / "ends.py").write_text(text)
        requirements = {"c": {"python": "ends.py:f", "signals": ["q.elbow"]}}
        with pytest.raises(Refusal, match=r"be a file that Python can run, got SystemExit"):
            execute_campaign(written(inside, changed(data, "requirements", requirements)), dry=True)


def test_no_runs_are_no_success(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "arm_emulator_campaign.commands.campaign._simulate_missing", lambda *_: (False, [])
    )
    assert execute_campaign(written(tmp_path, TABLE), into=tmp_path / "results", workers=1) == 1
    assert output.collected["missed"] == "it has ended before the first run"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("abs(v.elbow) <= 0.001", "alone; always (abs(v.elbow) <= 0.001) judges the whole run"),
        ("0 <= v.elbow <= 1 or t > 2", "always (0 <= v.elbow <= 1 or t > 2) judges the whole run"),
        ("v.elbow < 1 and eventually q.elbow > 1", "a part without always"),
        ("always v.elbow < 1", None),
        ("always[0, 0] v.elbow < 1", None),
        ("q.elbow > 0 implies always q.elbow > 0", None),
        ("v.elbow < 1 until q.elbow > 1", None),
    ],
)
def test_requirements_about_the_first_sample_are_named(tmp_path, capsys, text, line):
    data = changed(changed(TABLE, "requirements", {"asked": text}), "scenario/seconds", 0.2)
    assert execute_campaign(written(tmp_path, data), dry=True) == 0
    warned = capsys.readouterr().err
    assert (line is None and "warning" not in warned) or (
        line is not None and "warning: c.yaml: requirements.asked" in warned and line in warned
    )


def test_a_run_is_driven_again_to_the_last_bit(tmp_path):
    import pyarrow.parquet as pq

    file, record = written(tmp_path, TABLE), tmp_path / "r.parquet"
    definition = load_campaign(file)
    beside = draw_cases(definition.variation, range(20))
    rows = Outcomes.join_outcomes(list(make_simulator(definition).simulate_runs(beside)))
    outputs = RunOutputs(record=record)
    code = execute_campaign(file, replay=17, outputs=outputs)
    facts = json.loads(json.dumps(convert_to_plain(output.collected)))
    assert code == int(facts["failed"]) and bool(facts["missed"]) == facts["failed"]
    assert list(facts["robustness"].values()) == rows.robustness[17].tolist()
    assert list(facts["measures"].values()) == rows.measures[17].tolist()
    assert facts["values"] == beside[17].values
    q, target = pq.read_table(record)["q.elbow"].to_numpy(), facts["values"]
    error = np.abs(q - target["scenario.targets.0.elbow"]).max()
    # The record is that of a single run, which rounds otherwise than lanes.
    assert facts["measures"]["error"] == pytest.approx(error, abs=1e-12) and len(q) == 201


@pytest.mark.slow
@pytest.mark.parametrize("victim", some(("ctrl-c", "worker", "client"), 1))
def test_kills_at_random_moments_lose_nothing(tmp_path, victim):
    """Written runs stay, no process does; `bench.campaign_kills` tries more moments."""
    rng = np.random.default_rng(5)
    file = written(tmp_path, changed(TABLE, "count", 2000))
    after = rng.uniform(0.0, 2.0)
    trial = simulate_kill(file, tmp_path / "killed", Here(), victim, after, rng)
    assert trial.digest == digest_alone(file)[0], trial


def test_the_price_is_stated_before_the_runs(tmp_path, capsys):
    assert execute_campaign(written(tmp_path, TABLE), into=tmp_path / "x", dry=True) == 0
    printed = capsys.readouterr().out
    assert "300 runs of 0.2 s" in printed and "kB" in printed
    assert not (tmp_path / "x").exists()


def test_the_page_lists_every_key_of_a_file():
    from arm_emulator_campaign.definition.campaign_file import KEYS
    from arm_emulator_campaign.definition.scenario import TARGET_KEYS
    from arm_emulator_campaign.judging.evaluators import REDUCTIONS
    from docs.campaign_tables import TABLES

    page = (Path(__file__).parents[1] / "docs/reference/campaign.md").read_text()
    for word in (*KEYS, *TARGET_KEYS):
        assert f"`{word}`" in page, word
    for word in REDUCTIONS:
        assert f"`{word}(...)`" in page, word
    for name, table in TABLES.items():
        assert f"<!-- generated: campaign {name} -->" in page and table().count("\n") > 3
