"""Components of assembly steps of any kind: skill paths, candidates, and tasks of a step.

Imports cell, geometry, motion and tasks; the assembly kinds supply skills, places and allowed contacts.
"""
