"""Install files of requirements: by uv, with what pip is configured with, or by pip itself.

    python tools/install.py requirements.txt

uv does not read pip's configuration (files, PIP_ variables), so it is handed over. Where uv has no
counterpart for an option, or fails, pip installs.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input")
# pip's option -> uv's variable, and what separates several values there.
OF_UV = {
    "cert": ("SSL_CERT_FILE", ""),
    "client-cert": ("SSL_CLIENT_CERT", ""),
    "constraint": ("UV_CONSTRAINT", " "),
    "default-timeout": ("UV_HTTP_TIMEOUT", ""),
    "extra-index-url": ("UV_INDEX", " "),
    "find-links": ("UV_FIND_LINKS", ","),
    "index-url": ("UV_DEFAULT_INDEX", ""),
    "keyring-provider": ("UV_KEYRING_PROVIDER", ""),
    "no-cache-dir": ("UV_NO_CACHE", ""),
    "no-index": ("UV_NO_INDEX", ""),
    "proxy": ("ALL_PROXY", ""),
    "require-hashes": ("UV_REQUIRE_HASHES", ""),
    "retries": ("UV_HTTP_RETRIES", ""),
    "timeout": ("UV_HTTP_TIMEOUT", ""),
    "trusted-host": ("UV_INSECURE_HOST", " "),
}
# Options that decide nothing of what is installed into an environment, or from where.
WITHOUT_EFFECT = {
    "break-system-packages", "cache-dir", "config-file", "disable-pip-version-check", "log",
    "no-color", "no-input", "no-python-version-warning", "no-warn-script-location",
    "progress-bar", "quiet", "require-virtualenv", "root-user-action", "verbose",
}  # fmt: skip


def read_pip_options(listed: str) -> dict[str, str]:
    """Return what `pip config list` lists, as it counts for `pip install`: the last one wins."""
    rank = {"global": 0, "install": 1, ":env:": 2}
    options: dict[str, tuple[int, str]] = {}
    for line in listed.splitlines():
        key, sign, value = line.partition("=")
        section, _, option = key.rpartition(".")
        if sign and section in rank and rank[section] >= options.get(option, (0, ""))[0]:
            options[option] = rank[section], str(ast.literal_eval(value))
    return {option: value for option, (_, value) in options.items()}


def convert_to_uv_variables(options: dict[str, str]) -> tuple[dict[str, str], list[str]]:
    """Return uv's variables for the same, and the options that have no counterpart."""
    variables = {"UV_INDEX_STRATEGY": "unsafe-best-match"}  # as pip: no index before another
    unknown = []
    for option, value in options.items():
        if option in OF_UV:
            variable, separator = OF_UV[option]
            variables[variable] = separator.join(value.split()) if separator else value
        elif option not in WITHOUT_EFFECT:
            unknown.append(option)
    return variables, unknown


def install_by_uv(files: list[str]) -> str:
    """Install by uv; return why not, or nothing where it is done."""
    listed = subprocess.run([*PIP, "config", "list"], capture_output=True, text=True, check=False)
    variables, unknown = convert_to_uv_variables(read_pip_options(listed.stdout))
    if listed.returncode or unknown:
        return f"pip's options {', '.join(unknown) or 'are not readable'}"
    versions = Path(__file__).resolve().parents[1] / "requirements.txt"
    uv = Path(sys.executable).with_name("uv")
    # pip installs uv itself: of the version that the file has, from where pip installs all else.
    if (
        not uv.exists()
        and subprocess.run([*PIP, "install", "-c", versions, "uv"], check=False).returncode
    ):
        return "uv itself cannot be installed"
    command: list[str | Path] = [uv, "pip", "install", "--python", sys.executable]
    command += [word for file in files for word in ("-r", file)]
    # Settings for uv itself take precedence.
    done = subprocess.run(command, env={**variables, **os.environ}, check=False)
    return f"uv ended with exit code {done.returncode}" if done.returncode else ""


def main() -> int:
    """Install, and return the exit code."""
    files = sys.argv[1:]
    reason = install_by_uv(files)
    if not reason:
        return 0
    print(f"install: {reason}; pip installs", flush=True)
    command = [*PIP, "install", *(word for file in files for word in ("-r", file))]
    return subprocess.run(command, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
