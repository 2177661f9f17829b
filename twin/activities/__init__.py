"""Activities of robots, derived from the events of a run: what each did when, and how far it is.

Imports runs; drawing, exports, fits and forecasts import it.
"""
