"""From C and C++ to shared libraries that are cached by content."""
