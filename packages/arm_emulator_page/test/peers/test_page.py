"""The page in a browser: every control is used, and what it shows is the recorded run."""

import socket
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from browser import (
    box,
    browser,
    choose,
    fill,
    go_to,
    opened,
    press,
    shows,
    tick_of,
    until,
    without_token,
)
from machines import own_three_axis
from made_bags import synthetic

from arm_emulator.analysis.torque_terms import TermsNow, TorqueTerms
from arm_emulator.bags.comparison import compare_bag
from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.bags.timeline_bag import write_timeline
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.ros.recording.bag import Bag
from arm_emulator.ros.recording.bag_metadata import PARENT
from arm_emulator.runs.offline import load_offline_run
from arm_emulator.runs.order import Push, ScaleGains
from arm_emulator.runs.timeline import Timeline
from arm_emulator_page.page_server import PageServer
from arm_emulator_page.run_page import RunPage
from arm_emulator_page.run_view import RunView
from arm_emulator_page.what_if import WhatIf
from bench.page_picture import send_target

__all__ = ["browser"]  # a fixture
viser = pytest.importorskip("viser", reason="see requirements-peers.txt")
LAST = 400


class Served:
    """A page of a recorded run."""

    def __init__(self, folder: Path) -> None:
        bag = synthetic(folder / "bag", [True] * LAST, runs=1)
        self.machine = RecordedMachine.open_run(bag, load_scene("three_axis"))
        self.line = Timeline(self.machine)
        terms = TorqueTerms(self.machine.scene)

        def explain() -> tuple[TermsNow, list[str]]:
            now = terms.evaluate_torques(self.machine.session.plant.save(), np.zeros(3))
            return now, ["nothing is at its limit"]

        events = (120, "power"), (250, "set_state")
        self.page = RunPage(RunView.create_from_line(self.line, LAST, events), explain)
        self.url = self.page.url


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    served_page = Served(tmp_path_factory.mktemp("page"))
    yield served_page
    served_page.page.close()


def answer(url: str, **headers: str) -> tuple[int, dict[str, str]]:
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers)) as response:
            return int(response.status), dict(response.headers)
    except urllib.error.HTTPError as error:
        return error.code, dict(error.headers)


def test_nothing_is_served_without_the_token(served: Served) -> None:
    token = served.url.split("/")[3]
    plain = without_token(served.url)
    for below in ("", "?look=dark", "index.html"):
        status, headers = answer(served.url + below)
        assert status == 200 and "Set-Cookie" not in headers, "no cookie goes to other ports"
    for url, more in (
        (plain, {}), (f"{plain}?token={token}", {}), (plain + "index.html", {}),
        (f"{plain}x{token}/", {}), (plain, {"Cookie": f"arm_emulator_page={token}"}),
        (served.url, {"Host": "evil.example"}), (served.url, {"Origin": "http://evil.example"}),
    ):  # fmt: skip
        assert answer(url, **more)[0] == 403, (url, more)
    for file in ("nothing.js", "assets", "assets/"):
        assert answer(served.url + file)[0] == 404, file


# Requests that are no HTTP, or none for a page.
MALFORMED = (
    "GET /{}/../../../../../../etc/passwd HTTP/1.1", "GET /{}/.. HTTP/1.1",
    "GET {} HTTP/1.1", "GET http://127.0.0.1/{}/ HTTP/1.1", "GET  HTTP/1.1", "GET", "\0\1\2",
    "POST /{}/ HTTP/1.1", "GET /{}/ HTTP/1.0", "GET /{}/ HTTP/9", "GET /{}/\xff HTTP/1.1",
    "GET /{}/ HTTP/1.1\r\nHost: other", "GET /{}/ HTTP/1.1\r\nno header",
    "GET /{}/ HTTP/1.1\r\nOrigin: http://[", "GET /{}/ HTTP/1.1\r\nOrigin: a\r\nOrigin: b",
    "GET /{}/ HTTP/1.1\r\nUpgrade: websocket", "GET /{}/ HTTP/1.1\r\nUpgrade: x\r\nUpgrade: y",
    "GET /{}/ HTTP/1.1\r\nX: " + 9000 * "y",
)  # fmt: skip


@pytest.mark.parametrize("head", MALFORMED, ids=range(len(MALFORMED)))
def test_a_malformed_request_is_the_fault_of_the_client(served: Served, head: str) -> None:
    token, host = served.url.split("/")[3], served.url.split("/")[2]
    with socket.create_connection((host.split(":")[0], int(host.split(":")[1])), 10.0) as client:
        words = head.format(token) + f"\r\nHost: {host}\r\n\r\n"
        client.sendall(words.encode("latin-1"))
        client.shutdown(socket.SHUT_WR)
        reply = b""
        while piece := client.recv(65536):
            reply += piece
    status = int(reply.split()[1]) if reply else 0  # 0: closed without an answer
    assert status == 0 or 400 <= status < 500, reply[:200]
    assert b"root:" not in reply
    assert answer(served.url)[0] == 200, "the page goes on"


def test_foreign_machines_connect_only_where_the_page_is_served_to_them(served: Served) -> None:
    """127.0.0.2 stands for them: an address of this machine that the page is not served at."""
    port = served.url.split(":")[2].partition("/")[0]
    with pytest.raises(urllib.error.URLError, match="refused"):
        urllib.request.urlopen(served.url.replace("127.0.0.1", "127.0.0.2"))
    with pytest.raises(Refusal, match=f"port must be free, got {port}"):
        PageServer(f"127.0.0.1:{port}")
    every = PageServer("0.0.0.0:0")
    try:
        port, _, token = every.url.split(":")[2].partition("/")
        for url, status in (
            (f"http://127.0.0.2:{port}/{token}", 200), (f"http://127.0.0.2:{port}/", 403),
            (f"http://127.0.0.2:{port}/x/", 403),
        ):  # fmt: skip
            assert answer(url)[0] == status, url
        assert answer(f"http://127.0.0.2:{port}/{token}", Host="evil.example")[0] == 403
    finally:
        every.stop()


def test_no_foreign_page_gets_a_connection(served: Served) -> None:
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    at = served.url.replace("http://", "ws://")
    token = served.url.split("/")[3]
    for address, origin in (
        (without_token(at), None), (at[:-1] + "x/", None), (at, "http://evil.example"),
        (at.replace(f"{token}/", f"?token={token}"), None),
    ):  # fmt: skip
        with pytest.raises(InvalidStatus) as refused:
            connect(address, origin=origin)
        assert refused.value.response.status_code == 403


def test_a_port_that_is_taken_is_refused(served: Served) -> None:
    port = int(served.url.split(":")[2].partition("/")[0])
    with pytest.raises(Refusal, match="port must be free"):
        RunPage(RunView.create_from_line(served.line, LAST), lambda: (TermsNow({}, {}), []), port)


def test_every_control_acts_as_labelled(served: Served, browser: Any) -> None:
    page, scene = opened(browser, served.url), served.machine.scene
    assert page.title() == "arm_emulator"
    for button, tick in (("to end", LAST), ("-1", LAST - 1), ("to start", 0), ("+1", 1)):
        press(page, button)
        shows(page, f"tick {tick},")
    go_to(page, 77)
    shows(page, "tick 77,")
    repeated = RecordedMachine.open_run(served.machine.topics.bag.path, scene)
    repeated.advance(77)
    assert served.machine.session.plant.save() == repeated.session.plant.save(), "to the last bit"
    shows(page, f"{repeated.session.state.q[1]:.4f}")
    page.get_by_role("tab", name="Events").click()
    page.get_by_role("button", name="120: power").click()
    shows(page, "tick 120,")
    condition = box(page, "Condition")
    condition.fill("tick >= 205")
    page.get_by_role("button", name="Find the next").click()
    shows(page, "holds at tick 205")
    condition.fill("v.elbw > 1")
    page.get_by_role("button", name="Find the next").click()
    shows(page, "condition must name signals")
    page.get_by_role("tab", name="Torques").click()
    page.get_by_role("button", name="Explain this moment").click()
    shows(page, "nothing is at its limit")
    page.get_by_role("tab", name="Plot").click()
    page.locator(".uplot canvas").first.wait_for()
    press(page, "to start")
    page.get_by_role("button", name="Play").click()
    page.get_by_role("button", name="Pause").wait_for()
    page.wait_for_function("/tick ([1-9]\\d*),/.test(document.body.innerText)")
    shows(page, f"tick {LAST},")  # it stops at the end
    page.get_by_role("button", name="Play").wait_for()
    page.evaluate("document.activeElement.blur()")  # keys in a field are its own
    for key, tick in (("Home", 0), ("ArrowRight", 1), ("End", LAST), ("ArrowLeft", LAST - 1)):
        page.locator("body").press(key)
        shows(page, f"tick {tick},")
    page.locator("body").press("Home")
    choose(page, "Speed", "0.01")
    page.evaluate("document.activeElement.blur()")
    page.locator("body").press("Space")
    page.get_by_role("button", name="Pause").wait_for()
    page.wait_for_function("/tick ([1-9]\\d*),/.test(document.body.innerText)")
    page.locator("body").press("Space")
    page.get_by_role("button", name="Play").wait_for()
    assert 0 < tick_of(page) < LAST, "slow enough to be stopped on the way"
    choose(page, "Signal", "current")
    last = RecordedMachine.open_run(served.machine.topics.bag.path, scene)
    last.advance(LAST)
    current = last.session.state.current[0]
    until(page, lambda: served.page.plotted[1][-1] == current)
    page.close()


def test_a_second_browser_and_a_lost_connection(served: Served, browser: Any) -> None:
    first, two = opened(browser, served.url), opened(browser, served.url)
    press(first, "to end")
    shows(two, f"tick {LAST},")
    first.close()
    press(two, "-1")
    shows(two, f"tick {LAST - 1},")
    again = opened(browser, served.url)
    assert tick_of(again) == LAST - 1
    again.close()
    two.close()


def test_another_future_from_a_moment_of_the_past(browser: Any) -> None:
    line = Timeline(load_offline_run("three_axis"), every=100)
    line.advance(300)
    run_page = RunPage(RunView.create_from_line(line, 300), lambda: (TermsNow({}, {}), []))
    futures = WhatIf(run_page, line)
    try:
        page = opened(browser, run_page.url)
        go_to(page, 100)
        shows(page, "tick 100,")
        page.get_by_role("tab", name="What if").click()
        box(page, "Power").uncheck()
        fill(page, "Go on for [s]", "0.05")
        until(page, lambda: futures.seconds == 0.05 and names(futures) == ["power off"])
        page.get_by_role("button", name="Go on from this moment").click()
        shows(page, "fork 1, from 0.1 s of the run: power off")
        fork = run_page.line
        assert fork is not line and fork.parent is line and fork.newest == 150
        press(page, "to end")
        shows(page, "tick 150,")
        straight = load_offline_run("three_axis")
        straight.advance(100)
        straight.session.powered = False
        straight.advance(50)
        assert fork.run.session.plant.save() == straight.session.plant.save(), "to the last bit"
        shows(page, "no power")
        # At the end of a fork it goes on, and does not fork again.
        page.get_by_role("button", name="Go on from this moment").click()
        page.wait_for_function("/as it was/.test(document.body.innerText)")
        assert run_page.line is fork and fork.newest == 200
        line.go_to(300)
        assert line.run.session.powered, "the run itself is as it was"
        page.close()
    finally:
        run_page.close()


def test_a_push_acts_in_the_future_and_all_futures_remain(browser: Any, tmp_path: Path) -> None:
    scene = own_three_axis(tmp_path / "scene", "external_wrench: true")
    line = Timeline(load_offline_run(str(scene)), every=100)
    line.advance(120)
    run_page = RunPage(RunView.create_from_line(line, 120), lambda: (TermsNow({}, {}), []))
    futures = WhatIf(run_page, line, write_timeline)
    try:
        page = opened(browser, run_page.url)
        page.get_by_role("tab", name="Push").click()
        fill(page, "Force [N], world axes", "4", 2)
        push = page.get_by_role("button", name="Push", exact=True)
        pushed = "forearm is pushed with 0, 4, 0 N"

        def is_pushed() -> bool:
            push.click()  # again: a field's number may arrive after the press
            return names(futures) == [pushed]

        until(page, is_pushed)
        shows(page, pushed)
        go_to(page, 70)
        shows(page, "tick 70,")
        page.get_by_role("tab", name="What if").click()
        fill(page, "Position gains times", "2")
        fill(page, "Go on for [s]", "0.05")
        orders = ["position gains times 2", pushed]
        until(page, lambda: futures.seconds == 0.05 and names(futures) == orders)
        page.get_by_role("button", name="Go on from this moment").click()
        shows(page, ", ".join(orders))
        straight = load_offline_run(str(scene))
        straight.advance(70)
        ScaleGains(2.0)(straight)
        Push("forearm", (0.0, 4.0, 0.0))(straight)
        straight.advance(50)
        fork = run_page.line
        fork.go_to(120)
        assert fork.run.session.plant.save() == straight.session.plant.save(), "to the last bit"
        fill(page, "New folder for bags", str(tmp_path / "kept"))
        until(page, lambda: futures.folder == tmp_path / "kept")
        page.get_by_role("button", name="Keep all as bags").click()
        shows(page, "2 bags in")
        for name in ("the_run", "fork_1"):
            assert compare_bag(tmp_path / "kept" / name, str(scene)).difference is None
        assert Bag(tmp_path / "kept/fork_1").about[PARENT] == str(tmp_path / "kept/the_run")
        page.get_by_role("button", name="Keep all as bags").click()
        shows(page, "be new")
        page.close()
    finally:
        run_page.close()


def names(futures: WhatIf) -> list[str]:
    return [order.name for order in futures.orders]


def tool_of(run: Any) -> Any:
    scene = run.session.scene
    model = pin.buildModelFromXML(scene.urdf)
    data = model.createData()
    q = pin.integrate(model, pin.neutral(model), run.session.state.q)  # joints without an end, too
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId(scene.tool)].translation.copy()


def moved(run: Any) -> None:
    send_target(run, np.array([0.0, 0.05, -0.05]))


def test_a_fork_and_its_run_are_overlaid(browser: Any, tmp_path: Path) -> None:
    """The page shows the tools' distance and differences of signals, as straight runs have them."""
    line = Timeline(load_offline_run("three_axis"), every=100)
    line.advance(200)
    fork = line.fork()
    line.change("move", moved)
    line.advance(300)
    fork.advance(280)
    straight, left = load_offline_run("three_axis"), load_offline_run("three_axis")
    for run in (straight, left):
        run.advance(200)
    moved(straight)
    for run in (straight, left):
        run.advance(260)
    apart = 1e3 * float(np.linalg.norm(tool_of(straight) - tool_of(left)))
    assert apart > 1.0
    run_page = RunPage(
        RunView.create_from_line(line, 500),
        lambda: (TermsNow({}, {}), []),
        over=RunView.create_from_line(fork, 480),
    )
    try:
        page = opened(browser, run_page.url)
        go_to(page, 460)
        shows(page, f"tools {apart:.4g} mm apart")
        assert line.run.session.plant.save() == straight.session.plant.save(), "to the last bit"
        go_to(page, 100)
        shows(page, "tools 0 mm apart")
        page.get_by_role("tab", name="Plot").click()
        page.locator(".uplot canvas").first.wait_for()
        choose(page, "Of", "difference")
        by = straight.session.state.q - left.session.state.q
        until(page, lambda: len(run_page.plotted[0]) == 481)
        t, *differences = run_page.plotted
        assert t[460] == pytest.approx(0.46), "where both runs are"
        np.testing.assert_array_equal([difference[460] for difference in differences], by)
        page.screenshot(path=tmp_path / "over.png")
        go_to(page, 500)  # the other run stays at its end
        shows(page, "tick 500,")
        run_page.show_second_run(None)
        page.wait_for_function("!/mm apart/.test(document.body.innerText)")
        assert len(run_page.plotted[0]) == 501
        page.close()
    finally:
        run_page.close()


def test_the_tab_of_futures_overlays_them(browser: Any) -> None:
    line = Timeline(load_offline_run("three_axis"), every=100)
    line.advance(300)
    run_page = RunPage(RunView.create_from_line(line, 300), lambda: (TermsNow({}, {}), []))
    WhatIf(run_page, line)
    try:
        page = opened(browser, run_page.url)
        page.get_by_role("tab", name="What if").click()
        choose(page, "Laid over it", "the run")
        shows(page, "tools 0 mm apart")
        choose(page, "Laid over it", "nothing")
        page.wait_for_function("!/mm apart/.test(document.body.innerText)")
        page.close()
    finally:
        run_page.close()


def test_runs_of_different_joints_are_not_overlaid(served: Served) -> None:
    timeline = Timeline(load_offline_run("panda"))
    timeline.advance(1)
    with pytest.raises(Refusal, match="joints of the other run must be"):
        served.page.show_second_run(RunView.create_from_line(timeline, 1))
    scene = SimpleNamespace(joint_names=served.machine.scene.joint_names, servo_period=0.5)
    run = SimpleNamespace(session=SimpleNamespace(scene=scene))
    slow: Any = SimpleNamespace(line=SimpleNamespace(run=run))
    with pytest.raises(
        Refusal, match=r"servo period of the other run must be 0.001 \[s\], got 0.5"
    ):
        served.page.show_second_run(slow)
