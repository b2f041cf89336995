"""A scene's numbers from records of its motion; validation by real machines."""
