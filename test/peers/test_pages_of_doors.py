"""Commands with `--page` serve their page: to the token alone, and end with Ctrl-C."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from pathlib import Path

import pytest

pytest.importorskip("viser", reason="see requirements-peers.txt")
PATIENCE = 60.0  # s, wall


@pytest.mark.parametrize("words", [
    ["canopen", "three_axis"],
    ["modbus", "three_axis", "--link", "arm"],
], ids=lambda words: words[0])  # fmt: skip
def test_its_page_is_served_to_the_token(words: list[str], tmp_path: Path) -> None:
    command = [sys.executable, "-u", "-m", "arm_emulator", *words, "--page", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=tmp_path) as door:
        late = threading.Timer(PATIENCE, door.kill)
        late.start()
        assert door.stdout is not None
        found = (re.match(r"page: (\S+)$", line) for line in door.stdout)
        url = next(one[1] for one in found if one)
        with urllib.request.urlopen(url) as answer:
            assert answer.status == 200
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(url.partition("?")[0])
        door.send_signal(signal.SIGINT)
        door.stdout.read()
        late.cancel()
    assert door.returncode == 0
