"""Goals: accepted, followed, reported; control laws that act on them."""
