"""Expands one xacro source in a process of its own: FILE [NAME:=VALUE ...] to standard output.

A source is a program, with Python expressions in it, and may take whatever it likes: here it has
`SECONDS` and `MEMORY`. It is started by its path and imports nothing of ours.
"""

import resource
import sys

SECONDS = 10  # of the processor
MEMORY = 1 << 30  # bytes
FILES = 1 << 25  # bytes that it may write


def _main() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_FSIZE, (FILES, FILES))
    import xacro

    file, *given = sys.argv[1:]
    mappings = dict(one.split(":=", 1) for one in given)
    try:
        text = xacro.process_file(file, mappings=mappings).toxml()
    except RecursionError:
        sys.exit("a macro or an inclusion without an end")
    except MemoryError:
        sys.exit(f"more than {MEMORY >> 20} MiB of memory")
    # It may fail in any way.
    except (Exception, SystemExit) as error:
        sys.exit(f"{error or type(error).__name__}")
    sys.stdout.buffer.write(text.encode("utf-8", "surrogateescape"))


if __name__ == "__main__":
    _main()
