"""The machine behind the registers of an emulated microcontroller that runs its own firmware."""
