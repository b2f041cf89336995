"""List the compiled scenes that are kept."""

import dataclasses
import time

from arm_emulator.cli.command import command
from arm_emulator.cli.output import output
from arm_emulator.toolchain.library_cache import (
    SIZE_VARIABLE,
    explain_distrust,
    list_entries,
    list_left_over,
    list_named_folders,
    read_largest_size,
    remove_library,
)
from arm_emulator.toolchain.trusted import Untrusted, check_folder


@command(keys="`folders`")
def show_cache(*, clear: bool = False) -> int:
    """List the compiled scenes that are kept, or remove them.

    Args:
        clear: remove them.
    """
    return _remove_libraries() if clear else _list_libraries()


def _list_libraries() -> int:
    """Print each folder, whether it is trusted, and its libraries, the last used first."""
    facts = list[dict[str, object]]()
    for folder in list_named_folders():
        reason = explain_distrust(folder)
        entries = list_entries(folder)
        size = sum(entry.size for entry in entries)
        state = f"not trusted, no file of it is loaded: {reason}" if reason else "trusted"
        output.print_line(f"{folder}: {state if folder.is_dir() else 'not there'}")
        for entry in reversed(entries):
            used = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(entry.used))
            output.print_line(
                f"  {used}  {entry.size / 1e6:8.3f} MB  {entry.scene:20s}  {entry.file.name}"
            )
        if entries:
            output.print_line(
                f"  {len(entries)} libraries, {size / 1e6:.3f} of {read_largest_size() / 1e6:g} MB "
                f"({SIZE_VARIABLE})"
            )
        libraries = [dataclasses.asdict(entry) for entry in reversed(entries)]
        facts.append({"folder": folder, "not_trusted": reason, "libraries": libraries})
    output.add_facts({"folders": facts})
    return 0


def _remove_libraries() -> int:
    """Remove the libraries; return 1 if one remains."""
    facts = list[dict[str, object]]()
    for folder in list_named_folders():
        try:
            place = check_folder(folder)
        except OSError:
            continue  # missing
        except Untrusted as reason:
            output.print_line(f"{folder}: left alone: {reason}")
            continue
        libraries = {entry.file for entry in list_entries(place)} | list_left_over(place)
        stay = [library for library in sorted(libraries) if not remove_library(library)]
        output.print_line(f"{folder}: {len(libraries) - len(stay)} libraries removed")
        for library in stay:
            output.print_line(f"  {library.name} stays: it is being compiled, or cannot be removed")
        removed = len(libraries) - len(stay)
        facts.append({"folder": folder, "removed": removed, "stay": stay})
    output.add_facts({"folders": facts})
    return int(any(fact["stay"] for fact in facts))
