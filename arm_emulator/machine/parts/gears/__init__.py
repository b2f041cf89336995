"""Gears between rotor and link."""
