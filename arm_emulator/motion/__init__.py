"""Motion control: a tool target in, joint targets out."""
