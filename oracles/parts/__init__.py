"""What is true of each part, in a file called as the part's, which imports no declaration."""
