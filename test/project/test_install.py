"""`tools/install.py`: uv is given what pip is configured with, and pip installs where uv cannot."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

FILE = Path(__file__).resolve().parents[2] / "tools" / "install.py"
spec = importlib.util.spec_from_file_location("install", FILE)
assert spec is not None and spec.loader is not None
install = importlib.util.module_from_spec(spec)
spec.loader.exec_module(install)

CONFIGURED = """\
[global]
index-url = https://user:word@index.example/simple
find-links = /nowhere
trusted-host = index.example
    other.example:8080
timeout = 7
[install]
extra-index-url =
    https://one.example/simple
    https://two.example/simple
find-links = /a/wheels /b/wheels
"""


def listed(tmp_path: Path, text: str, **more: str) -> dict[str, str]:
    """Return pip's own listing of a file and of variables, as install.py reads it."""
    file = tmp_path / "pip.conf"
    file.write_text(text)
    own = {name: value for name, value in os.environ.items() if not name.startswith("PIP_")}
    done = subprocess.run(
        [sys.executable, "-m", "pip", "config", "list"],
        capture_output=True, text=True, check=True,
        env={**own, "PIP_CONFIG_FILE": str(file), "HOME": str(tmp_path), **more},
    )  # fmt: skip
    return dict(install.read_pip_options(done.stdout))


def test_files_and_variables_of_pip_become_those_of_uv(tmp_path: Path) -> None:
    options = listed(
        tmp_path, CONFIGURED, PIP_CERT="/etc/own.pem", PIP_TIMEOUT="30", PIP_NO_INDEX="1"
    )
    variables, unknown = install.convert_to_uv_variables(options)
    assert not unknown
    assert variables == {
        "SSL_CERT_FILE": "/etc/own.pem",
        "UV_DEFAULT_INDEX": "https://user:word@index.example/simple",
        "UV_FIND_LINKS": "/a/wheels,/b/wheels",
        "UV_HTTP_TIMEOUT": "30",
        "UV_INDEX": "https://one.example/simple https://two.example/simple",
        "UV_INDEX_STRATEGY": "unsafe-best-match",
        "UV_INSECURE_HOST": "index.example other.example:8080",
        "UV_NO_INDEX": "1",
    }


def test_an_option_without_counterpart_is_left_to_pip(tmp_path: Path) -> None:
    options = listed(tmp_path, "[install]\nno-binary = :all:\nquiet = 1\n")
    assert "no-binary" in install.convert_to_uv_variables(options)[1]
    assert "quiet" not in install.convert_to_uv_variables(options)[1]


@pytest.mark.parametrize(
    ("listed", "code", "installer"),
    [("", 0, "uv"), ("", 1, "pip"), ("install.no-binary=':all:'", 0, "pip")],
)
def test_pip_installs_where_uv_cannot(
    listed: str, code: int, installer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[list[str]] = []

    def run(command: list[object], **_: object) -> subprocess.CompletedProcess[str]:
        words = [str(word) for word in command]
        calls.append(words)
        is_uv = words[0].endswith("uv")
        return subprocess.CompletedProcess(words, code if is_uv else 0, listed, "")

    monkeypatch.setattr(install.subprocess, "run", run)
    monkeypatch.setattr(sys, "argv", ["install.py", "requirements.txt"])
    assert install.main() == 0
    assert calls[-1][-2:] == ["-r", "requirements.txt"]
    assert calls[-1][0].endswith("uv") == (installer == "uv")
