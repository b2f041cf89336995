"""Robustness of random formulas beside rtamt's."""

import re

import pytest
from draws import some
from test_requirements import NAMES, PERIOD, draw_case, fed

rtamt = pytest.importorskip("rtamt", reason="see requirements-peers.txt")


def test_rtamt_agrees():
    for k in some(range(10_000), 100):
        text, _, rows, cuts = draw_case([99, k])
        count = len(rows["a"])
        if count < 2:  # which rtamt does not take
            continue
        spec = rtamt.StlDiscreteTimeSpecification()
        spec.set_sampling_period(10, "ms", 0.0)
        plain = {name: name.replace(".", "_") for name in NAMES}
        for name in plain.values():
            spec.declare_var(name, "float")
        spec.declare_var("out", "float")
        spec.spec = f"out = {for_rtamt(text, count)}".replace("b.c", "b_c")
        spec.parse()
        trace = {plain[name]: row.tolist() for name, row in rows.items()}
        value = spec.evaluate({"time": [k * PERIOD for k in range(count)], **trace})[0][1]
        assert fed(text, rows, cuts) == pytest.approx(value, abs=1e-12), text


def for_rtamt(text, count):
    text = re.sub(r"\[([\d.]+), end\]", rf"[\1, {2 * count * PERIOD:.2f}]", text)

    def milliseconds(match):
        return f"[{round(float(match[1]) * 1e3)}ms:{round(float(match[2]) * 1e3)}ms]"

    return re.sub(r"\[([\d.]+), ([\d.]+)\]", milliseconds, text)
