"""Kinds of assembly, a folder each: what the program has for one kind alone."""
