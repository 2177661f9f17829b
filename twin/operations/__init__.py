"""Operation of a cell (``twin operate``): plans are executed, and revised after failures while robots work."""
