"""Uses of what other libraries keep to themselves, and cures of their defects.

Each file names the versions that it was written for, its reason, and a test
(test/toolchain/test_workarounds.py). The test fails when the file can go, or when a new version
needs a new check.
"""
