"""Try to import modules that are named as arguments; print a line of JSON with those that fail."""

import contextlib
import importlib
import json
import os
import sys


def main() -> None:
    """Import each module; print errors by module."""
    failed = {}
    with contextlib.redirect_stdout(sys.stderr):
        for module in sys.argv[1:]:
            try:
                importlib.import_module(module)
            except BaseException as error:  # whatever a package raises when it is broken
                failed[module] = (str(error).splitlines() or [type(error).__name__])[0]
    print(json.dumps(failed), flush=True)
    os._exit(0)  # libraries that are ill-matched may crash at the end


if __name__ == "__main__":
    main()
