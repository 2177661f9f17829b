"""The twin of a cell that is running: what it does, what it must not, when it will be done."""
