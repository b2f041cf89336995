"""Commands of this package, a module each."""
