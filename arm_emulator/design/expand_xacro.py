"""Expands one xacro source in its own process: FILE PACKAGES [NAME:=VALUE ...] to standard output.

A source is a program, with Python expressions in it, and may take whatever it likes: here it has
`SECONDS` and `MEMORY`. It is started by its path and imports nothing of ours. PACKAGES is JSON: the
folders of packages by their names, which precede those of the shell.
"""

import contextlib
import io
import json
import os
import resource
import sys
import types

SECONDS = 10  # of the processor
MEMORY = 1 << 30  # bytes
FILES = 1 << 25  # bytes that it may write
NO_PACKAGE = 3  # exit code; the package's name is on standard error
INDEX = os.path.join("share", "ament_index", "resource_index", "packages")


def _main() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_FSIZE, (FILES, FILES))
    import xacro

    file, packages, *arguments = sys.argv[1:]
    mappings = dict(argument.split(":=", 1) for argument in arguments)
    missing = _find_packages_in(json.loads(packages))
    try:
        with contextlib.redirect_stderr(io.StringIO()):  # warnings, which would hide the reason
            text = xacro.process_file(file, mappings=mappings).toxml()
    except RecursionError:
        sys.exit("a macro or an inclusion without an end")
    except MemoryError:
        sys.exit(f"more than {MEMORY >> 20} MiB of memory")
    # It may fail in any way.
    except (Exception, SystemExit) as error:
        if missing:
            print(missing[-1], file=sys.stderr)
            sys.exit(NO_PACKAGE)
        sys.exit(f"{error or type(error).__name__}")
    sys.stdout.buffer.write(text.encode("utf-8", "surrogateescape"))


def _find_packages_in(folders: dict[str, str]) -> list[str]:
    """Make xacro find packages in folders, then in the shell's prefixes.

    It asks `ament_index_python` for them, which knows the shell only, and need not be installed.

    Returns:
        The names that are not found, as the source asks for them.
    """
    missing: list[str] = []

    def get_package_share_directory(name: str) -> str:
        if name in folders:
            return folders[name]
        for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
            if os.path.isfile(os.path.join(prefix, INDEX, name)):
                return os.path.join(prefix, "share", name)
        missing.append(name)
        raise LookupError(f"no package {name}")

    packages = types.ModuleType("ament_index_python.packages")
    packages.get_package_share_directory = get_package_share_directory  # type: ignore[attr-defined]
    index = types.ModuleType("ament_index_python")
    index.packages = packages  # type: ignore[attr-defined]
    sys.modules |= {"ament_index_python": index, "ament_index_python.packages": packages}
    return missing


if __name__ == "__main__":
    _main()
