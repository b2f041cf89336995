"""A scene with its drives as a unit of FMI 2 or 3."""
