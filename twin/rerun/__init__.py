"""The 3-D recording for the Rerun viewer.

Imports runs, drawing and planning's robot files; trial and follow import it.
"""
