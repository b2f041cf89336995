"""Moving pictures of a Rerun recording, taken without a screen: .mp4, .gif, or .png for one."""

from __future__ import annotations

import contextlib
import io
import os
import socket
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.wheel import need_wheel

RECORDING = ".rrd"
KINDS = (".mp4", ".gif", ".png", RECORDING)
BARS = (37, 30)  # points of the viewer's window above and below what is shown: menu, time line
COLOURS = 96  # of a .gif
QUALITY = "20"  # of H.264: hardly seen to be compressed


def check_film(where: str, file: Path) -> None:
    """Refuse a file that cannot be written.

    Raises:
        Refusal: its kind is unknown, it exists, or a package is missing.
    """
    if file.suffix not in KINDS:
        raise Refusal(where, f"file {file}", "end in a known kind", file.name, ", ".join(KINDS))
    if file.exists():
        raise Refusal(where, f"file {file}", "be new", "one that exists")
    if not file.parent.is_dir():
        raise Refusal(where, f"file {file}", "be in a folder that exists", file.parent)
    if file.suffix == ".mp4":
        need_wheel(where, "av", "av")


def write_film(
    rrd: Path, file: Path, moments: Sequence[float], rate: float, size: tuple[int, int]
) -> None:
    """Write a picture for each moment of a recording.

    Args:
        rrd: the recording.
        file: see `check_film`; a .png has the last moment alone.
        moments: on the recording's time line [s].
        rate: pictures a second.
        size: width and height of the pictures [points], even numbers.

    Raises:
        Refusal: see `take_screenshots`.
    """
    above, below = BARS
    width, height = size
    wanted = moments[-1:] if file.suffix == ".png" else moments
    window = (width, height + above + below)
    shots = take_screenshots(rrd, wanted, size=window, patience=60.0 + 10.0 * len(wanted))
    pictures = [_cut(shot, (0, above, width, above + height)) for shot in shots]
    part = file.with_name(f".{file.stem}.part{file.suffix}")
    try:
        {".mp4": _write_mp4, ".gif": write_gif, ".png": _write_png}[file.suffix](
            pictures, part, rate
        )
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)


def _cut(shot: bytes, box: tuple[int, int, int, int]) -> Any:
    from PIL import Image

    return Image.open(io.BytesIO(shot)).convert("RGB").crop(box)


def write_gif(pictures: Sequence[Any], file: Path, rate: float) -> None:
    """Write pictures of Pillow as one that moves, over and over."""
    from PIL import Image

    palette = pictures[len(pictures) // 2].quantize(COLOURS)
    frames = [one.quantize(palette=palette, dither=Image.Dither.NONE) for one in pictures]
    each = round(1e3 / rate)
    frames[0].save(
        file, save_all=True, append_images=frames[1:], duration=each, loop=0, optimize=True
    )


def _write_png(pictures: Sequence[Any], file: Path, rate: float) -> None:
    pictures[-1].save(file)


def _write_mp4(pictures: Sequence[Any], file: Path, rate: float) -> None:
    import av

    with av.open(str(file), "w", options={"movflags": "faststart"}) as container:
        stream: Any = container.add_stream("libx264", Fraction(rate).limit_denominator(1000))
        stream.width, stream.height = pictures[0].size
        stream.pix_fmt, stream.options = "yuv420p", {"crf": QUALITY}
        for one in pictures:
            for packet in stream.encode(av.VideoFrame.from_ndarray(np.asarray(one), "rgb24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)


if TYPE_CHECKING:
    from rerun.experimental import Timeline, ViewerClient

TIMELINE = "t"
SECOND = 1_000_000_000  # ns
POLL = 0.1  # s
# The viewer reports when data are loaded, but draws meshes and curves some pictures later, and its
# words of welcome cover a part of the window for 1 to 3 s.
SETTLE = 4.0  # s, and
SETTLE_PICTURES = 8  # on a busy machine
SETTLE_NEXT = 2  # pictures, where only the moment has changed

T = TypeVar("T")


def take_screenshot(
    rrd: str | Path,
    png: str | Path,
    *,
    at: float | None = None,
    size: tuple[int, int] = (1600, 900),
) -> None:
    """Show a recording in an invisible viewer and write what it shows.

    Args:
        rrd: the recording, as `arm_emulator.view.rerun_stream` writes it.
        png: the picture to write.
        at: moment on the time line `t` [s]; None is its end.
        size: width and height of the viewer's window [points].

    Raises:
        Refusal: no such recording, a moment outside of it, or the viewer cannot start.
    """
    (picture,) = take_screenshots(rrd, [at], size=size)
    png = Path(png)
    png.parent.mkdir(parents=True, exist_ok=True)
    png.write_bytes(picture)


def take_screenshots(
    rrd: str | Path,
    moments: Sequence[float | None],
    *,
    size: tuple[int, int] = (1600, 900),
    patience: float = 180.0,
) -> list[bytes]:
    """Return a picture (PNG) of a recording at each moment, as `take_screenshot` takes one."""
    rrd = Path(rrd)
    if not rrd.is_file():
        raise Refusal("screenshot", "recording", "be an .rrd file", rrd)
    deadline = time.monotonic() + patience
    pictures = []
    with _viewer(rrd, size, deadline) as viewer:
        line = _poll(lambda: _timeline(viewer), deadline, f"{rrd} to show a time line {TIMELINE}")
        start, end = line.start or 0, line.end or 0
        for number, at in enumerate(moments):
            # In whole nanoseconds, as recorded: a sum of periods is off in its last bits.
            moment = end if at is None else round(at * SECOND)
            if not start <= moment <= end:
                rule = f"lie in the recording, {start / SECOND:g} to {end / SECOND:g} s"
                raise Refusal("screenshot", "time", rule, f"{moment / SECOND:g}")
            viewer.set_time(TIMELINE, duration=moment / SECOND, play_state="paused")
            _settle(viewer, *((SETTLE, SETTLE_PICTURES) if number == 0 else (0.0, SETTLE_NEXT)))
            pictures.append(viewer.take_screenshot())
    return pictures


def _settle(viewer: ViewerClient, seconds: float, pictures: int) -> None:
    """Keep the viewer drawing until it shows the moment as a whole."""
    settled, taken = time.monotonic() + seconds, 0
    while time.monotonic() < settled or taken < pictures:
        viewer.take_screenshot()
        taken += 1
        time.sleep(5.0 * POLL)


@contextlib.contextmanager
def _viewer(rrd: Path, size: tuple[int, int], deadline: float) -> Iterator[ViewerClient]:
    import rerun_cli  # type: ignore[import-untyped]
    from rerun.experimental import ViewerClient

    # The program itself: its Python wrapper, when ended, would leave it running.
    folder = Path(rerun_cli.__file__).parent
    program = next(file for file in folder.iterdir() if file.stem == "rerun")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [
        str(program), "--headless", "--hide-welcome-screen", "--bind", "127.0.0.1",
        "--port", str(port), "--window-size", f"{size[0]}x{size[1]}", str(rrd),
    ]  # fmt: skip
    process = subprocess.Popen(
        command,
        env=os.environ | {"RERUN_APP_ONLY": "true"},  # no questions about analytics
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )

    def connect() -> ViewerClient | None:
        if process.poll() is not None:
            raise _no_viewer(process)
        try:
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.get_state()
        except Exception:  # not listening yet
            return None
        return client

    try:
        yield _poll(connect, deadline, "the Rerun viewer to start")
    except (ConnectionError, RuntimeError):
        # It listens before it knows whether it can draw.
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(2.0)
            raise _no_viewer(process) from None
        raise
    finally:
        process.terminate()
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _no_viewer(process: subprocess.Popen[bytes]) -> Refusal:
    rule = "start without a screen"
    remedy = "a machine with a Vulkan driver, on Debian mesa-vulkan-drivers and libvulkan1"
    return Refusal("screenshot", "Rerun viewer", rule, f"exit {process.returncode}", remedy)


def _timeline(viewer: ViewerClient) -> Timeline | None:
    """Return the recording's time line once all is loaded."""
    state = viewer.get_state()
    if state.loading:
        return None
    lines = [line for recording in state.recordings for line in recording.timelines]
    return next((line for line in lines if line.name == TIMELINE and line.end is not None), None)


def _poll(question: Callable[[], T | None], deadline: float, what: str) -> T:
    while (answer := question()) is None:
        if time.monotonic() > deadline:
            raise Refusal("screenshot", "timeout", f"be long enough for {what}", "too short")
        time.sleep(POLL)
    return answer
