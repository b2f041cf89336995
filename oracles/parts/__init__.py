"""Truths of each part, in a file called as the part's, written apart from its declaration."""
