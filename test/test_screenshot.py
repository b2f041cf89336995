"""Pictures of recordings."""

import io

import numpy as np
import pytest
from PIL import Image

from arm_emulator.base.refusal import Refusal
from arm_emulator.view.film import take_screenshot

DRIVERLESS = "mesa-vulkan-drivers"


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """One second; a picture that is red in the first half and green in the second."""
    import rerun as rr

    file = tmp_path_factory.mktemp("recording") / "a.rrd"
    stream = rr.RecordingStream("test_screenshot")
    stream.save(file)
    for time_ms, colour in ((0, (255, 0, 0)), (500, (0, 255, 0)), (1000, (0, 255, 0))):
        stream.set_time("t", duration=np.timedelta64(time_ms, "ms"))
        stream.log("surface", rr.Image(np.full((48, 64, 3), colour, np.uint8)))
    stream.disconnect()
    return file


def shoot(recording, png, at):
    try:
        take_screenshot(recording, png, at=at, size=(640, 480))
    except Refusal as reason:
        if DRIVERLESS in str(reason):
            pytest.skip(str(reason))
        raise
    return np.array(Image.open(io.BytesIO(png.read_bytes())).convert("RGB"), int)


def test_the_picture_is_of_the_moment_asked_for(tmp_path, recording):
    for at, channel in ((0.3, 0), (None, 1)):
        picture = shoot(recording, tmp_path / "new" / "a.png", at)
        assert picture.shape == (480, 640, 3)
        pure = [(picture[..., c] > 250) & (picture.sum(axis=-1) < 260) for c in (0, 1)]
        assert pure[channel].mean() > 0.4  # the surface fills about half of the window
        assert pure[1 - channel].sum() == 0


def test_a_moment_outside_is_refused(tmp_path, recording):
    end = 10 * 0.1 + 2.0**-52  # as sums of steps may round it
    assert end > 1.0
    shoot(recording, tmp_path / "a.png", end)  # skips where no viewer can start
    with pytest.raises(Refusal, match=r"^screenshot: time must lie .* 0 to 1 s, got 1.5$"):
        take_screenshot(recording, tmp_path / "b.png", at=1.5)
    assert not (tmp_path / "b.png").exists()


def test_no_recording_is_refused(tmp_path):
    with pytest.raises(Refusal, match=r"^screenshot: recording must be an \.rrd file, got "):
        take_screenshot(tmp_path / "none.rrd", tmp_path / "a.png")
