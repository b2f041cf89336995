"""The stage of a long command, on a terminal."""

import contextlib
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn


@contextlib.contextmanager
def show_stages() -> Iterator[Callable[[str], None]]:
    """Show the stage that runs; give what begins another one."""
    columns = TextColumn("{task.description}"), SpinnerColumn(), TimeElapsedColumn()
    progress = Console(stderr=True)  # not for JSON, and erased at the end
    hidden = not progress.is_terminal
    with Progress(*columns, console=progress, transient=True, disable=hidden) as bar:
        task = bar.add_task("", total=None)
        yield lambda stage: bar.update(task, description=stage)
