"""Uses of what other libraries keep to themselves, and cures of their defects.

Each file names the versions that it was written for, its reason, and the test that fails where it
can go, or where a new version needs another look (test/toolchain/test_workarounds.py).
"""
