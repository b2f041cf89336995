"""Compilation of C and C++ into shared libraries, cached by content."""
