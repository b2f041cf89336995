"""Moving pictures of a Rerun recording, taken without a screen: .mp4, .gif, or .png for one."""

from __future__ import annotations

import io
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.wheel import need_wheel
from arm_emulator.view.screenshot import take_screenshots

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
