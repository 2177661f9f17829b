"""Random draws by name, disturbances, and what they make of every node's time.

Imports durations; engine, run and scenario import it.
"""
