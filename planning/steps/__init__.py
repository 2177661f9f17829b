"""Components of assembly steps of any kind: skill paths, candidates, tasks of a step, and robot goals.

Imports cell, geometry, motion and tasks; the assembly kinds supply skills, places and allowed contacts.
"""
