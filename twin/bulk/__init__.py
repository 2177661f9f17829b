"""The engine for many replications at once: longest paths through the graph."""
