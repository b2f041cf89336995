"""Many machines of one scene in one library."""
