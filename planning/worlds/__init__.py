"""Plans that begin in the middle of an assembly: the world there is, and what is left to do in it."""
