"""Independent solutions and random machines, with which tests and benches judge the emulator."""
