"""The 3-D recording for the Rerun viewer.

Imports run, drawing and planning's robot files; trial and follow import it.
"""
