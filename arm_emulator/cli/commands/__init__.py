"""The commands, a module each: its name is the command's, its first line stands in the list."""
