"""The exit code of a command that Ctrl-C ends."""

import sys

# Commands that run until they are stopped, or may: Ctrl-C is their usual end.
UNTIL_STOPPED = ("up", "record", "replay", "modbus", "canopen", "ethercat")
CODE = 0 if sys.argv[1:2] and sys.argv[1] in UNTIL_STOPPED else None
