"""Skills in joint space: subgoals, paths through them, allowed contacts and surroundings.

Imports motion and what that imports; the kinds of assemblies import it.
"""
