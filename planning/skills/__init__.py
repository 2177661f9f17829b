"""Skills in joint space: subgoals, paths through them, and what stands around meanwhile.

Imports motion and what that imports; the kinds of assemblies import it.
"""
