"""Joint angles for a pose of the tool."""
